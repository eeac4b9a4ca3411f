"""Runs behind a URL: made in a local folder and uploaded file by file, the record of a finished run last.

Object storage has no rename, but a PUT appears whole or not at all.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import cast

from quadlog.errors import CannotWrite, QuadlogError, RunExists
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing, ReplayOutcome, ReplayRequest
from quadlog.pipelines.stages.resume import finished_outcome
from quadlog.results.find_runs import OWN_FILES, PLOTS, fetch, is_run, own_files, run_name
from quadlog.results.record import is_finished, read_record, write_record
from quadlog.results.stage_marks import MARKS_FILE
from quadlog.storage.remote_path import RemotePath

_RECORD = "run.json"
_LAST = (MARKS_FILE, _RECORD)
_Version = tuple[int, int, int]


def replay_anywhere(request: ReplayRequest, progress: Progress) -> ReplayOutcome:
    """`replay`, whose run folder may lie behind a URL. Raises as it does, and StorageFailed."""
    if not isinstance(request.run, RemotePath):
        return replay(request, progress)
    if request.existing is Existing.RESUME and (finished := finished_outcome(request)) is not None:
        progress.say(f"{request.run}: already done with the same input, config and version")
        return finished
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
        shadow = RunShadow(request.run, Path(scratch) / run_name(request.run.name), request.existing)
        with shadow.published(progress):
            outcome = replay(replace(request, run=shadow.local, existing=shadow.existing), progress)
    return replace(outcome, run=request.run)


class RunShadow:
    """A local run folder that is uploaded to a URL."""

    def __init__(self, remote: RemotePath, local: Path, existing: Existing) -> None:
        """With RESUME the existing files are fetched. Raises AlreadyExists, CannotWrite, TooLarge."""
        self.remote, self.local = remote, local
        entries = list(remote.iterdir()) if remote.is_dir() else []
        there = own_files(entries)
        if entries:
            if not is_run(cast(Path, remote)):
                raise CannotWrite(str(remote), "the folder holds other files and is no run of quadlog")
            if existing is Existing.REFUSE:
                raise RunExists(str(remote))
        self.existing = Existing.RESUME if existing is Existing.RESUME else Existing.REFUSE
        self._published: dict[str, _Version] = {}
        self._there = set(there)
        self._replaces = existing is Existing.FORCE and is_finished(cast(Path, remote))
        if existing is Existing.RESUME:
            fetch(there, local)
            self._published = _versions(local)

    @contextmanager
    def published(self, progress: Progress) -> Iterator[None]:
        """Upload the folder when the block ends; when it fails, as unfinished and over no finished run."""
        try:
            yield
        except BaseException:
            if self._replaces:
                raise  # the finished run there stays as it is
            try:
                self._publish(finished=False)
            except QuadlogError as error:
                progress.say(f"warning: what was done could not be saved either: {error}")
            raise
        self._publish(finished=True)

    def _publish(self, *, finished: bool) -> None:
        """Upload what is new and delete what is gone; `run.json` is first that of an unfinished run, and comes last."""
        now = _versions(self.local)
        if not now:
            return
        new = sorted(name for name, version in now.items() if self._published.get(name) != version)
        gone = sorted(self._there - now.keys())
        if not new and not gone:
            return
        write_record(self.local.parent, read_record(self.local, unfinished=True), finished=False)
        (self.remote / _RECORD).upload(str(self.local.parent / _RECORD))
        for name in gone:
            (self.remote / name).unlink()
        # Marks after the files they list, the record after all.
        for name in sorted(new, key=lambda name: (name in _LAST, name == _RECORD, name)):
            if name != _RECORD or finished:
                (self.remote / name).upload(str(self.local / name))


def _versions(folder: Path) -> dict[str, _Version]:
    """The files of a run by name, each with a value that changes when it is rewritten."""
    plots = folder / PLOTS
    paths = [folder / name for name in OWN_FILES] + (sorted(plots.glob("*.png")) if plots.is_dir() else [])
    stats = {path.relative_to(folder).as_posix(): path.stat() for path in paths if path.is_file()}
    return {name: (stat.st_ino, stat.st_size, stat.st_mtime_ns) for name, stat in stats.items()}
