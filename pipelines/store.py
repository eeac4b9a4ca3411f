"""Results by key: a folder for each in `.stages`, filled once, whole or not at all, and copied into the runs.

A key is a digest of all that a result depends on. `--resume`, sweeps, `--dry-run` and the second try of a killed worker
are one thing here: they ask for results by their keys, and what is there is not made again. Deleting it is safe.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib
import json
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial, reduce
from operator import getitem
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from quadlog.config.schema import Config
from quadlog.config.section import Section
from quadlog.config.version import package_versions
from quadlog.errors import NotARun, QuadlogError, RecordingNotFound
from quadlog.pipelines.executor.progress import start_up
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.stages.journal import Journal
from quadlog.plugins import all_plugins
from quadlog.results.record import RUN_FORMAT, own_files, read_object
from quadlog.results.run import STORE
from quadlog.storage.atomic_write import is_part, part_folder, remove_stale_parts, whole_file, write_whole
from quadlog.storage.remote_path import RemotePath
from quadlog.version import __version__

R = TypeVar("R")
ENDS_BYTES = 1 << 16
MSG_PATTERNS = ("*.msg", "*/*.msg", "*/msg/*.msg")
"""Where definitions are looked for below a folder of --msg-path."""
STATE = "_state.json"
"""Of a result: its journal, what its stage returned, and size and SHA-256 of its files. It is not copied into runs."""
LOCK = ".lock-"
FRESH_S = 24 * 3600.0
"""For so long results of a replay that did not finish stay."""
_CLONE = 0x40049409  # FICLONE of ioctl_ficlonerange(2): two files share their blocks until one is written to


@dataclass(frozen=True)
class Stage(Generic[R]):
    """Names: as `--until` takes them. reads: the sections and keys of the configuration that `fill` is given; it has no
    others, so that none can be missing in the key. function, result: `module:name`, imported when they are used.
    """

    names: tuple[str, ...]
    reads: tuple[str, ...]
    function: str
    result: str = ""

    def fill(self, folder: Path, journal: Journal, config: Config, *inputs: Any) -> Any:
        """Write files, and return a state of JSON, by the stage's function of these arguments."""
        return _named(self.function)(folder, journal, config, *inputs)

    def load(self, folder: Path, state: Any) -> R:
        """The result, as its class reads files and state; the folder where it has none."""
        return cast(R, _named(self.result).load(folder, state) if self.result else folder)


def _named(place: str) -> Any:
    module, _, name = place.partition(":")
    with start_up.loading():
        return getattr(importlib.import_module(module), name)


@dataclass(frozen=True)
class Keyed(Generic[R]):
    """What a stage needs: its key, and how to have it, where it is needed."""

    key: str
    get: Callable[[], R]


Do = Callable[..., Keyed[Any]]
"""do(stage, *inputs) gives a stage's result on its inputs, each Keyed or a plain value of JSON: Keys or Doing."""


class Keys:
    """Does nothing, and knows the key of every stage that would be done, in order."""

    def __init__(self, config: Config) -> None:
        self._config = config.model_dump(mode="json")
        self.of: dict[str, str] = {}

    def __call__(self, stage: Stage[R], *inputs: Any) -> Keyed[R]:
        key = key_of(stage, self._config, inputs)
        self.of |= dict.fromkeys(stage.names, key)
        return Keyed(key, partial(not_done, stage.names))


class Doing:
    """Does stages, or takes them from the store, and copies their files into the folder of a run.

    last: the last stage that is wanted. journal, keys: of all stages so far. reused: the names of those that were in
    the store, but for `ingest`.
    """

    def __init__(
        self,
        store: Store,
        run: Path,
        config: Config,
        last: str,
        journal: Journal,
        before: Callable[[str], None] = lambda _: None,
        made: Callable[[str], bool] = lambda _: False,
    ) -> None:
        """Functions of a stage's name. before: called when it is done next; made: whether another process just did."""
        self._before, self._made = before, made
        self._store, self._run, self._config, self._last = store, run, config, last
        self._dumped = config.model_dump(mode="json")
        self.journal = journal
        self.reused: tuple[str, ...] = ()
        self.keys: dict[str, str] = {}

    def __call__(self, stage: Stage[R], *inputs: Any) -> Keyed[R]:
        key = key_of(stage, self._dumped, inputs)
        if self._last in self.keys:
            return Keyed(key, partial(not_done, stage.names))
        made = self._made(stage.names[0])
        kept, there = self._store.get(key, partial(self._fill, stage, inputs), self._run)
        if there and not made:
            self.reused += tuple(name for name in stage.names if name != "ingest")
        self.keys |= dict.fromkeys(stage.names, key)
        self.journal.add(kept["journal"])
        # From the run: another process may remove results that no finished run has.
        return Keyed(key, partial(stage.load, self._run, kept["state"]))

    def _fill(self, stage: Stage[Any], inputs: tuple[Any, ...], folder: Path) -> None:
        page = self.journal.page()
        given = [each.get() if isinstance(each, Keyed) else each for each in inputs]
        for name in stage.names:
            self._before(name)
        state = stage.fill(folder, page, only(self._config, stage.reads), *given)
        write_whole(folder / STATE, json.dumps({"journal": page.to_json(), "state": state}).encode())


def not_done(names: tuple[str, ...]) -> Any:
    raise LookupError(f"{names[-1]} was not requested")


class Store:
    """The results beside the runs of a folder."""

    def __init__(self, output: Path) -> None:
        self.folder = output / STORE

    def has(self, key: str) -> bool:
        """Whether the result of this key is there, by the sizes of its files."""
        folder = self.folder / key
        with suppress(OSError, *_DAMAGE):
            files = json.loads((folder / STATE).read_bytes())["files"]
            return all((folder / name).stat().st_size == size for name, (size, _) in files.items())
        return False

    def get(self, key: str, fill: Callable[[Path], None], run: Path) -> tuple[Any, bool]:
        """The state of a result, whose files are copied into a run, and whether it was there.

        `fill` makes all of it where there is none yet, or a damaged one. Raises OSError, and what fill raises.
        """
        folder = self.folder / key
        if (kept := _taken(folder, run)) is not None:
            return kept, True
        with self._alone(key), part_folder(self.folder) as part:
            if (kept := _taken(folder, run)) is not None:  # the process that was waited for has left it
                return kept, True
            shutil.rmtree(folder, ignore_errors=True)
            fill(part)
            _seal(part)
            kept = _taken(part, run)
            try:
                part.rename(folder)
            except OSError:
                if not self.has(key):  # another process was not faster
                    raise
        return kept, False

    @contextmanager
    def _alone(self, key: str) -> Iterator[None]:
        """Wait for another process that fills this key, where the file system has locks; else both fill it."""
        path = self.folder / f"{LOCK}{key}"
        with ExitStack() as stack:
            with suppress(OSError):
                self.folder.mkdir(parents=True, exist_ok=True)
                file = stack.enter_context(path.open("wb"))
                stack.callback(path.unlink, missing_ok=True)
                fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def forget(self, keys: Iterable[str]) -> None:
        """Remove results."""
        for key in keys:
            shutil.rmtree(self.folder / key, ignore_errors=True)

    def settle(self, keys: Iterable[str]) -> None:
        """Let results of a run that is finished go as soon as no run has them."""
        for key in keys:
            with suppress(OSError):
                os.utime(self.folder / key, (0, 0))

    def trim(self) -> None:
        """Remove what killed processes have begun, and results that no run has, of unfinished ones after FRESH_S."""
        if not self.folder.is_dir():
            return
        kept = set(self._keys_of_runs())
        for folder in (state.parent for state in self.folder.glob(f"*/{STATE}")):
            with suppress(FileNotFoundError):  # another process removes it
                fresh = time.time() - folder.stat().st_mtime < FRESH_S
                if not (fresh or folder.name in kept or is_part(folder.name)):
                    shutil.rmtree(folder, ignore_errors=True)
        with suppress(OSError):
            remove_stale_parts(self.folder)
            for lock in self.folder.glob(f"{LOCK}*"):  # of killed processes
                lock.unlink(missing_ok=True)
            self.folder.rmdir()  # if it is empty

    def _keys_of_runs(self) -> Iterator[str]:
        for run in self.folder.parent.iterdir():
            with suppress(NotARun):
                results = read_object(run, "run.json", "").get("results")
                yield from results.values() if isinstance(results, dict) else ()


def stored_bytes(output: Path) -> int:
    """Size of the results beside the runs of a folder."""
    folder = output / STORE
    return sum(file.stat().st_size for file in folder.glob("*/*")) if folder.is_dir() else 0


_DAMAGE = (FileNotFoundError, ValueError, LookupError, TypeError, AttributeError)


def _seal(folder: Path) -> None:
    """Note sizes and digests of a result's files, and make all read-only where the file system can."""
    state = json.loads((folder / STATE).read_bytes())
    files = {file.name: [file.stat().st_size, file_digest(file)] for file in folder.iterdir() if file.name != STATE}
    write_whole(folder / STATE, json.dumps(state | {"files": files}).encode())
    for file in folder.iterdir():
        with suppress(OSError):
            file.chmod(0o444)


def _taken(source: Path, run: Path) -> Any:
    """The state of a result, and copies of its files in a run, so that no run shares a file; None if it is damaged."""
    with suppress(*_DAMAGE):
        kept = json.loads((source / STATE).read_bytes())
        for name, (size, sha256) in kept["files"].items():
            with whole_file(run / name) as part:
                _copy(source / name, part)
                if (part.stat().st_size, file_digest(part)) != (size, sha256):
                    raise ValueError(name)
        with suppress(OSError):
            os.utime(source)
        return kept
    return None


def _copy(source: Path, path: Path) -> None:
    """Copy a file; where the file system can, its blocks are shared, which takes neither time nor room."""
    with source.open("rb") as one, path.open("wb") as other:
        try:
            fcntl.ioctl(other, _CLONE, one.fileno())
        except OSError:
            shutil.copyfileobj(one, other, 1 << 20)


def digest(*parts: Any) -> str:
    """A key from values of JSON."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:40]


def file_digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@cache
def versions() -> str:
    """A digest of what all results depend on: quadlog, the packages that decide, plug-ins, Python, kind of machine."""
    plugins = [(each.name, each.distribution, each.version) for each in all_plugins()]
    # Compiled code may round otherwise on another kind of machine.
    machine = [platform.python_version(), platform.system(), platform.machine()]
    return digest(__version__, RUN_FORMAT, package_versions(), plugins, machine)


def key_of(stage: Stage[Any], config: dict[str, Any], inputs: tuple[Any, ...]) -> str:
    """A digest of versions, the stage's names, its configuration (as JSON has it) and its inputs."""
    values = {name: _content(reduce(getitem, name.split("."), config)) for name in stage.reads}
    keys = [each.key if isinstance(each, Keyed) else each for each in inputs]
    return digest(versions(), stage.names, values, keys)


def _content(value: Any) -> Any:
    """The value, with what is in the files that it names."""
    if isinstance(value, dict):
        return {name: _content(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_content(each) for each in value]
    with suppress(OSError, ValueError):  # of what is no path
        if isinstance(value, str) and value and Path(value).is_file():
            return [value, _content_of(Path(value))]
    return value


def _content_of(path: Path) -> str:
    """A digest of a file, that of a robot with its includes."""
    with path.open("rb") as file:
        if not file.read(100).lstrip().startswith(b"<"):
            return file_digest(path)
    from quadlog.simulation.robot.model_files import content_digest

    try:
        return content_digest(path)
    except QuadlogError:
        return file_digest(path)  # no robot, or one that the stage will refuse


def only(config: Config, names: tuple[str, ...]) -> Config:
    """The configuration with these sections and keys, and no others: to read one of those is an AttributeError."""
    fields: dict[str, Any] = {}
    parts: dict[str, set[str]] = {}
    for section, _, key in (name.partition(".") for name in names):
        if key:
            parts.setdefault(section, set()).add(key)
        else:
            fields[section] = getattr(config, section)
    for section, keys in parts.items():
        whole: Section = getattr(config, section)
        fields.setdefault(section, _with_fields(whole, {key: getattr(whole, key) for key in keys}))
    return _with_fields(config, fields)


def _with_fields(section: Any, fields: dict[str, Any]) -> Any:
    copy = section.model_copy()
    object.__setattr__(copy, "__dict__", fields)
    object.__setattr__(copy, "__pydantic_fields_set__", section.model_fields_set & fields.keys())
    return copy


def log_key(path: Path, options: ReplayOptions) -> str:
    """A digest of a recording and of what of it is read, without reading all of it.

    A file is known by its size, the time of its last change and its two ends, where containers have their indexes.
    """
    folders = [Path(each) for each in options.msg_path]
    definitions = [
        (file.relative_to(folder).as_posix(), file_digest(file))
        for folder in folders
        for pattern in MSG_PATTERNS
        for file in sorted(folder.glob(pattern))
    ]
    files = [_identity(each) for each in own_files(path)]
    return digest(files, definitions, [options.stamp, options.start_s, options.duration_s])


def _identity(path: Path) -> list[Any]:
    if isinstance(path, RemotePath):
        info = path.info()
        return [str(path), info.size_bytes, info.etag or info.last_modified]
    try:
        status = path.stat()
    except FileNotFoundError:
        raise RecordingNotFound(path) from None
    with path.open("rb") as file:
        ends = file.read(ENDS_BYTES)
        file.seek(max(status.st_size - ENDS_BYTES, 0))
        return [path.name, status.st_size, status.st_mtime_ns, digest((ends + file.read(ENDS_BYTES)).hex())]


def run_key(request: ReplayRequest) -> str:
    """A digest of all that a run depends on, but for the stage it ends with."""
    options = request.options.to_dict() | {"until": None}
    config = _content(request.config.model_dump(mode="json"))
    return digest(versions(), log_key(request.recording, request.options), config, options)
