"""Runs behind a URL: made in a local folder and uploaded when they are complete, the finished record last.

Object storage has no rename, but a PUT appears whole or not at all.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import cast

from quadlog.errors import CannotWrite, RunExists
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.replay import finished_outcome, replay
from quadlog.pipelines.request import Existing, ReplayOutcome, ReplayRequest
from quadlog.results.find_runs import FAILED, is_run, own_files, run_name
from quadlog.results.record import read_record, write_record
from quadlog.storage.remote_path import RemotePath

_RECORD = "run.json"


def replay_anywhere(request: ReplayRequest, progress: Progress) -> ReplayOutcome:
    """`replay`, whose run folder may lie behind a URL. Raises as it does, and StorageFailed.

    A run behind a URL that is not finished is made from the start, and a finished one stands until the new one is.
    """
    if isinstance(request.run, RemotePath):
        outcome = _replay_there(request, request.run, progress)
    else:
        outcome = replay(request, progress)
    (request.run / FAILED).unlink(missing_ok=True)  # of an earlier try
    return outcome


def _replay_there(request: ReplayRequest, run: RemotePath, progress: Progress) -> ReplayOutcome:
    there = list(run.iterdir()) if run.is_dir() else []
    if any(each.name != FAILED for each in there):
        if not is_run(cast(Path, run)):
            raise CannotWrite(str(run), "the folder holds other files and is no run of quadlog")
        if request.existing is Existing.REFUSE:
            raise RunExists(str(run))
    if request.existing is Existing.RESUME and (finished := finished_outcome(request)) is not None:
        progress.say(f"{run}: already done with the same input, config and version")
        return finished
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
        local = Path(scratch) / run_name(run.name)
        outcome = replay(replace(request, run=local, existing=Existing.REFUSE), progress)
        names = {path.relative_to(local).as_posix() for path in local.rglob("*") if path.is_file()}
        gone = own_files(there).keys() - names
        write_record(Path(scratch), read_record(local), finished=False)
        run.upload_all(Path(scratch), [_RECORD])
        for name in sorted(gone):
            (run / name).unlink()
        run.upload_all(local, sorted(names - {_RECORD}))
        run.upload_all(local, [_RECORD])
    return replace(outcome, run=request.run)
