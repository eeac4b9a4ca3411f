"""The folder in which a summary is made: the folder of runs itself, or of one behind a URL what its page shows."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from quadlog.errors import QuadlogError
from quadlog.results.names import run_name
from quadlog.results.small_multiples import MAX_THUMBNAILS
from quadlog.storage.copying import copy_object
from quadlog.storage.remote_path import RemotePath

_PAGE, _TABLE = "report.html", "summary.parquet"
_DRAWN = ("poses.parquet", "target.parquet", "control.parquet")


@contextmanager
def open_summary_folder(folder: Path) -> Iterator[Path]:
    """The folder to read and write the two files in; behind a URL they are published when the block ends."""
    if not isinstance(folder, RemotePath):
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
        here = Path(scratch) / run_name(folder.name)
        here.mkdir()
        for name in (_TABLE, _PAGE):
            _fetch(folder / name, here / name)
        _lay_out(folder, here)
        before = {name: _version(here / name) for name in (_TABLE, _PAGE)}
        yield here
        for name in (_TABLE, _PAGE):
            if _version(here / name) != before[name]:
                (folder / name).upload(str(here / name))


def _lay_out(folder: RemotePath, here: Path) -> None:
    """What the page looks for in the runs: their own pages, which it links to, and walks to draw, of some of them."""
    for page in (folder / "*" / _PAGE).matches():
        run = page.parent
        if run.name != run_name(run.name):
            continue
        (here / run.name).mkdir(exist_ok=True)
        (here / run.name / _PAGE).touch()
    for name in sorted(entry.name for entry in here.iterdir() if entry.is_dir())[:MAX_THUMBNAILS]:
        for table in _DRAWN:
            _fetch(folder / name / table, here / name / table)


def _fetch(remote: RemotePath, target: Path) -> None:
    with suppress(FileNotFoundError, QuadlogError):  # one that is not there, or too large to draw, is not shown
        copy_object(remote.open_object(), target)


def _version(path: Path) -> tuple[int, int] | None:
    return (path.stat().st_ino, path.stat().st_mtime_ns) if path.is_file() else None
