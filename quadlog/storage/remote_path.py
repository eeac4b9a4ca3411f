"""A place behind a URL with the methods of pathlib.Path that quadlog uses, and a copy of what lies there.

Not universal-pathlib's UPath: its text shows signatures and passwords, its
names end in the URL's query, and of a web server it reads whole files to see
whether they are folders.
"""

from __future__ import annotations

import io
import posixpath
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from quadlog.errors import CannotWrite, StorageFailed, TooLarge
from quadlog.storage.byte_source import fill
from quadlog.storage.remote_object import ObjectInfo, RemoteBytes, filesystem, info_of, object_info
from quadlog.storage.urls import explained, is_url, is_web, local_path, protocol_of, reason_of, redacted, split_query


def to_path(text: str | Path) -> Path:
    """A place as a Path; behind a URL as a RemotePath, which has those methods of Path that quadlog uses.

    `file://` is a plain path. Nothing is looked up yet. Raises FileError for a URL that cannot be one.
    """
    # A Path, and a RemotePath too, whose text leaves out its secrets.
    if not isinstance(text, str):
        return text
    if not is_url(text):
        return Path(text)
    protocol = protocol_of(text)
    if protocol in ("file", "local"):
        return local_path(text)
    return cast(Path, RemotePath(text))


def copy_object(remote: RemotePath, target: Path) -> None:
    """All bytes of an object into a new file.

    Raises what `fill` raises, FileNotFoundError, StorageFailed, StorageChanged.
    """
    info = remote.info()
    fill(target, RemoteBytes(remote.url, info).stream(), remote, info.st_size)


_NO_LISTING = "a web server's folders cannot be listed; name the recordings in them"
_PATTERN = frozenset("*?[")
# Lists, metadata, run records: what is read at once.
MAX_WHOLE_BYTES = 1 << 26


@dataclass(unsafe_hash=True, repr=False, slots=True)
class RemotePath:
    """One URL. Its text leaves out what is secret; url is the whole. What is found there is kept.

    Methods do what those of pathlib.Path do, and raise StorageFailed and FileError beside their errors.
    """

    url: str
    _info: ObjectInfo | None = field(default=None, compare=False)

    def __str__(self) -> str:
        return redacted(self.url)

    def __repr__(self) -> str:
        return f"RemotePath({str(self)!r})"

    def __lt__(self, other: object) -> bool:
        # Paths of this machine come first; Python asks this one where they do not know what it is.
        return isinstance(other, RemotePath) and self.url < other.url

    def __gt__(self, other: object) -> bool:
        return not isinstance(other, RemotePath) or self.url > other.url

    @property
    def name(self) -> str:
        """The last part of the path, as it stands in the URL."""
        return redacted(self._place).rstrip("/").rpartition("/")[2]

    @property
    def suffix(self) -> str:
        return posixpath.splitext(self.name)[1]

    @property
    def stem(self) -> str:
        return posixpath.splitext(self.name)[0]

    @property
    def parent(self) -> RemotePath:
        protocol, _, place = self._place.rstrip("/").partition("://")
        above = place.rpartition("/")[0]
        return RemotePath(f"{protocol}://{above or place}")

    @property
    def _place(self) -> str:
        return split_query(self.url)[0]

    def __truediv__(self, name: str) -> RemotePath:
        return RemotePath(f"{self._place.rstrip('/')}/{name}")

    def with_name(self, name: str) -> RemotePath:
        return self.parent / name

    def resolve(self) -> RemotePath:
        return self

    def is_symlink(self) -> bool:
        return False

    def exists(self) -> bool:
        return self.look() is not None

    def is_file(self) -> bool:
        info = self.look()
        return info is not None and not info.is_folder

    def is_dir(self) -> bool:
        # A web server has no folders: its pages are files.
        return not self.is_web() and (info := self.look()) is not None and info.is_folder

    def stat(self) -> ObjectInfo:
        info = self.look()
        if info is None:
            raise FileNotFoundError(str(self))
        if info.size_bytes is None:
            raise StorageFailed(str(self), "the server does not report its size")
        return info

    def look(self) -> ObjectInfo | None:
        """What stands there: looked up until there is something, or known from the listing that named it."""
        if self._info is None:
            if self.is_web() and self.url.endswith("/"):
                raise StorageFailed(str(self), _NO_LISTING)
            with suppress(FileNotFoundError):
                self._info = info_of(self.url)
        return self._info

    def info(self) -> ObjectInfo:
        """The metadata as it is now. Raises FileNotFoundError."""
        return info_of(self.url)

    def iterdir(self) -> Iterator[RemotePath]:
        """What a folder holds, by name."""
        if self.is_web():
            raise StorageFailed(str(self), _NO_LISTING)
        system = filesystem(self.url)
        with explained(self.url):
            top = system._strip_protocol(self._place).rstrip("/")
            system.invalidate_cache(top)
            listed = system.ls(top, detail=True)
        for found in self._named(listed):
            if found.parent.url.rstrip("/") == self._place.rstrip("/"):
                yield found

    def has_pattern(self) -> bool:
        """Whether `*`, `?` or `[` stand in the path; in a web address they mean nothing."""
        return not self.is_web() and not _PATTERN.isdisjoint(self._place)

    def matches(self) -> list[RemotePath]:
        """What a pattern leads to, by name."""
        system = filesystem(self.url)
        with explained(self.url):
            system.invalidate_cache()
            return list(self._named(system.glob(system._strip_protocol(self._place), detail=True).values()))

    def _named(self, listed: Iterable[Mapping[str, Any]]) -> Iterator[RemotePath]:
        """What a listing names, in order; names that lead elsewhere, as a hostile server may send, are left out."""
        for info in sorted(listed, key=lambda info: str(info["name"])):
            name = str(info["name"]).strip("/")
            if {"", ".", ".."}.isdisjoint(name.split("/")):
                top = "/" if str(info["name"]).startswith("/") else ""
                yield RemotePath(f"{self.url.partition('://')[0]}://{top}{name}", object_info(info))

    def open(self, mode: str = "rb") -> io.BytesIO:
        if mode != "rb":
            raise StorageFailed(str(self), "is written as a whole, not opened for writing")
        return io.BytesIO(self.read_bytes())

    def read_bytes(self) -> bytes:
        """All of a small file. Raises TooLarge."""
        data = bytearray()
        for block in RemoteBytes(self.url, self.info()).stream():
            data += block
            if len(data) > MAX_WHOLE_BYTES:
                raise TooLarge(f"{self}: bytes to read at once", len(data), MAX_WHOLE_BYTES)
        return bytes(data)

    def read_text(self, encoding: str = "utf-8") -> str:
        return self.read_bytes().decode(encoding)

    def upload_all(self, folder: Path, names: Sequence[str]) -> None:
        """Files of a folder of this machine, under the same names here, each whole: one PUT. Raises CannotWrite."""
        here = [str(folder / name) for name in names]
        self._write(lambda system, place: system.put(here, [f"{place.rstrip('/')}/{name}" for name in names]))

    def unlink(self, missing_ok: bool = True) -> None:
        """Take the file away; one that is gone already is as well. Raises CannotWrite."""
        try:
            self._write(lambda system, place: system.rm_file(place))
        except CannotWrite as error:
            if not isinstance(error.__cause__, FileNotFoundError):
                raise

    def _write(self, act: Any) -> None:
        if self.is_web():
            raise CannotWrite(str(self), "a web server takes no files; give a path, or a bucket")
        system = filesystem(self.url)
        self._info = None
        try:
            act(system, system._strip_protocol(self._place))
        except FileNotFoundError as error:
            raise CannotWrite(str(self), "no such bucket or folder") from error
        except Exception as error:  # whatever a library raises for a server that refuses
            raise CannotWrite(str(self), reason_of(error, self.url)) from error

    def is_web(self) -> bool:
        """Whether a web server gives it, which lists nothing and takes nothing."""
        return is_web(self.url)
