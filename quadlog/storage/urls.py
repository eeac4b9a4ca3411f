"""What a user types as a place: a path, or a URL of object storage, of a web server, or of any system fsspec knows."""

from __future__ import annotations

import re
from pathlib import Path
from typing import cast
from urllib.parse import unquote, urlsplit

from quadlog.errors import StorageUnknown

_PROTOCOL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
# Outside HTTP a `?` may stand in a name; what says NAME=VALUE behind one does not. The value may hold any character.
_QUERY = re.compile(r"\?[^/?]*=")
# A password may hold a `/` that nobody escaped; HOST:PORT/PLACE@NAME has none.
_USER = re.compile(r"(?<=://)(?:[^/]*|[^/:]*:(?!\d+/)[^@]*)@")
_IN_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://[^\s'\"<>]+")
_WEB = ("http", "https")


def is_url(text: object) -> bool:
    """Whether a text names a place by URL; a path never has `://` in it once it is a Path."""
    return "://" in str(text)


def to_path(text: str | Path) -> Path:
    """A place as a Path; behind a URL as a RemotePath, which has those methods of Path that quadlog uses.

    `file://` is a plain path. Nothing is looked up yet. Raises StorageUnknown for a URL that cannot be one.
    """
    # A Path, and a RemotePath too, whose text leaves out its secrets.
    if not isinstance(text, str):
        return text
    if not is_url(text):
        return Path(text)
    protocol = protocol_of(text)
    if protocol in ("file", "local"):
        return _local_path(text)

    from quadlog.storage.remote_path import RemotePath

    return cast(Path, RemotePath(text))


def _local_path(url: str) -> Path:
    """The path that a file:// URL names. Raises StorageUnknown."""
    try:
        parts = urlsplit(url)
    except ValueError as error:  # brackets without an address, or a host name that Unicode would change
        raise StorageUnknown(redacted(url), f"no URL that quadlog can read: {error}") from error
    if parts.netloc not in ("", "localhost"):
        raise StorageUnknown(redacted(url), "a file:// URL of another machine; mount it, or name its path")
    path = unquote(parts.path)
    if "\0" in path:
        raise StorageUnknown(redacted(url), "no path has a NUL in it")
    return Path(path)


def protocol_of(url: str) -> str:
    """The protocol, in small letters. Raises StorageUnknown where there is none."""
    match = _PROTOCOL.match(url)
    if match is None or len(url) == match.end():
        raise StorageUnknown(redacted(url), "no URL that quadlog can read; write PROTOCOL://PLACE")
    return match[1].lower()


def split_query(url: str) -> tuple[str, str]:
    """The URL without what stands behind its path, and that."""
    if url.partition("://")[0].lower() in _WEB:
        cut = min((place for place in (url.find("?"), url.find("#")) if place >= 0), default=len(url))
    else:
        found = _QUERY.search(url)
        cut = found.start() if found else len(url)
    return url[:cut], url[cut:]


def redacted(url: str) -> str:
    """The URL as it may be shown and saved: without user and password, and without its query, which may sign it."""
    place, query = split_query(_USER.sub("", url))
    return place + ("?..." if query else "")


def secrets_in(url: str) -> list[str]:
    """The words of a URL that `redacted` leaves out."""
    user = _USER.search(url)
    hidden = (user[0].rstrip("@") if user else "") + " " + split_query(url)[1]
    return [word for word in re.split(r"[\s/:?&=@#]+", hidden) if word]


def redacted_text(text: str) -> str:
    """A text with all URLs in it redacted."""
    return _IN_TEXT.sub(lambda match: redacted(match[0]), text)
