"""summary.parquet and report.html of a folder of runs, always made from the runs and failures that are in it."""

from __future__ import annotations

import json
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

from quadlog.errors import ExitCode, NotARun, QuadlogError
from quadlog.pipelines.executor.progress import Progress, Silent
from quadlog.pipelines.request import ReplayOutcome
from quadlog.results.find_runs import FAILED, SUMMARY, fetch, is_run, run_name
from quadlog.results.record import is_finished, read_metrics, read_object, read_record
from quadlog.results.run import check_place
from quadlog.results.tables import TABLES, has_table, read_table, write_table
from quadlog.storage.atomic_write import write_whole
from quadlog.storage.remote_path import RemotePath

_PAGE = "report.html"
NOT_OURS = f"its {SUMMARY} or {_PAGE} is not quadlog's and is left alone"
_READ = ("run.json", "metrics.json", FAILED)
_DRAWN = ("poses.parquet", "target.parquet", "control.parquet")


def note_failure(outcome: ReplayOutcome) -> None:
    """Leave the reason in the folder of a run that failed, if that can be written; it is printed, too."""
    content = json.dumps({"recording": str(outcome.recording), "reason": outcome.reason}, indent=2).encode()
    with suppress(QuadlogError, OSError), tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
        if isinstance(outcome.run, RemotePath):
            Path(scratch, FAILED).write_bytes(content)
            outcome.run.upload_all(Path(scratch), [FAILED])
        else:
            check_place(outcome.run, replace=True)  # nobody else's folder
            outcome.run.mkdir(exist_ok=True)
            write_whole(outcome.run / FAILED, content)


def summarise(folder: Path, progress: Progress) -> None:
    """Write both files, again if another machine finishes a run meanwhile; somebody else's files are left alone.

    Raises CannotWrite.
    """
    known: set[str] = set()
    while folder.is_dir() and not (names := _names(folder)) <= known:
        known |= names
        with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
            here = _fetched(folder, Path(scratch)) if isinstance(folder, RemotePath) else folder
            if not _is_ours(here):
                progress.say(f"warning: {folder}: {NOT_OURS}")
                return
            rows = [row for name in sorted(_names(here)) if (row := _row(here / name)) is not None]
            if not rows:
                return
            columns = {name: [row.get(name, float("nan")) for row in rows] for name in TABLES["summary"].names}
            from quadlog.results.page.runs_page import write_folder_page  # loads the templates

            write_table(here / SUMMARY, TABLES["summary"], columns)
            write_folder_page(here)
            if isinstance(folder, RemotePath):
                folder.upload_all(here, [SUMMARY, _PAGE])


def rebuild_summary(folder: Path) -> Path:
    """Summary and page of the runs that are in a folder now. Raises NotARun where there are none, CannotWrite."""
    if all(_row(folder / name) is None for name in _names(folder)):
        raise NotARun(folder, "is not a run folder and contains none")
    if not _is_ours(folder):
        raise NotARun(folder, NOT_OURS)
    summarise(folder, Silent())
    return folder / _PAGE


def _names(folder: Path) -> set[str]:
    """The folders that hold a finished run or the reason of a failure."""
    inside = [entry for entry in folder.iterdir() if entry.is_dir() and entry.name == run_name(entry.name)]
    return {entry.name for entry in inside if (entry / FAILED).is_file() or is_finished(entry)}


def _row(run: Path) -> dict[str, Any] | None:
    """The row of a run, or of a recording that failed since; None for a run that is damaged or of another format."""
    try:
        if (run / FAILED).is_file():
            reason = str(read_object(run, FAILED, "").get("reason", ""))
            return {"recording": run.name, "exit_code": int(ExitCode.FAILED), "reason": reason, "worker": ""}
        record, metrics = read_record(run), read_metrics(run)
    except QuadlogError:
        return None
    lost = "; ".join(loss.detail for loss in record.losses)
    # A simulated walk that ended early is done, and says how it ended.
    ended = [text for text in record.warnings if text.startswith("the robot ") and "course" in record.options]
    return {
        **{name: metric["value"] for name, metric in metrics.items()},
        "recording": run.name,
        "exit_code": int(ExitCode.WITH_LOSS if lost else ExitCode.DONE),
        "reason": lost or "; ".join(ended),
        "wall_s": record.startup_s + sum(stage.seconds for stage in record.stages),
        "peak_memory_mb": max((stage.peak_memory_mb for stage in record.stages), default=float("nan")),
        "input_bytes": float(record.input.size_bytes),
        "worker": str(record.host.get("name", "")),
    }


def _is_ours(folder: Path) -> bool:
    """Whether both files are quadlog's, or not there."""
    try:
        return bool(read_table(folder, "summary", ["recording"]))
    except NotARun:
        return not (has_table(folder, "summary") or (folder / _PAGE).exists() or is_run(folder))


def _fetched(folder: RemotePath, scratch: Path) -> Path:
    """A copy of a folder of runs, with what table and page need of it: of the first runs their tracks, too."""
    from quadlog.results.page.runs_page import MOST_DRAWN  # loads the templates

    here = scratch / run_name(folder.name)
    here.mkdir()
    files = {name: folder / name for name in (SUMMARY,) if (folder / name).is_file()}
    for number, name in enumerate(sorted(_names(cast(Path, folder)))):
        there = {path.name: path for path in (folder / name).iterdir()}
        wanted = (*_READ, *(_DRAWN if number < MOST_DRAWN else ()))
        files |= {f"{name}/{each}": there[each] for each in wanted if each in there}
        if _PAGE in there:
            (here / name).mkdir(exist_ok=True)
            (here / name / _PAGE).touch()  # it is linked to
    fetch(files, here)
    if (folder / _PAGE).is_file():
        (here / _PAGE).touch()
    return here
