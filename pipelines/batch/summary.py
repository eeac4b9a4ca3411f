"""summary.parquet and report.html of a folder of runs: a row for each recording, also for one that failed.

Several machines may write runs into one folder. Rows of finished runs are read from the runs, and again after the
summary is written, so that no machine loses the rows of another.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from quadlog.errors import ExitCode, NotARun, QuadlogError
from quadlog.pipelines.executor.progress import Kept, Progress
from quadlog.pipelines.request import ReplayOutcome
from quadlog.results.find_runs import run_name
from quadlog.results.page.runs_page import MOST_THUMBNAILS
from quadlog.results.record import RunRecord, read_metrics, read_record
from quadlog.results.tables import COST_NAMES, METRIC_NAMES, TABLES, has_table, read_table, write_table
from quadlog.storage.remote_path import RemotePath, copy_object

_PAGE, _TABLE = "report.html", "summary.parquet"
_DRAWN = ("poses.parquet", "target.parquet", "control.parquet")


@contextmanager
def open_summary_folder(folder: Path) -> Iterator[Path]:
    """The folder to read and write the two files in; of a URL a local copy, uploaded when the block ends."""
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
    """Copy what the page uses of the runs: links to their pages, and the tracks of some of them."""
    for page in (folder / "*" / _PAGE).matches():
        run = page.parent
        if run.name != run_name(run.name):
            continue
        (here / run.name).mkdir(exist_ok=True)
        (here / run.name / _PAGE).touch()
    for name in sorted(entry.name for entry in here.iterdir() if entry.is_dir())[:MOST_THUMBNAILS]:
        for table in _DRAWN:
            _fetch(folder / name / table, here / name / table)


def _fetch(remote: RemotePath, target: Path) -> None:
    with suppress(FileNotFoundError, QuadlogError):  # missing or too large files are not shown
        copy_object(remote.open_object(), target)


def _version(path: Path) -> tuple[int, int] | None:
    return (path.stat().st_ino, path.stat().st_mtime_ns) if path.is_file() else None


_ROUNDS = 5

Rows = dict[str, dict[str, Any]]


def summarise(folders: set[Path], outcomes: Sequence[ReplayOutcome], progress: Progress) -> None:
    """Write both files of each output folder; rows of earlier commands stay, and foreign files are not touched."""
    from quadlog.results.page.runs_page import write_folder_page

    for folder in sorted(folders):
        if not folder.is_dir():
            continue
        own = {each.run.name: each for each in outcomes if not each.refused and each.run.parent == folder}
        for _ in range(_ROUNDS):
            with open_summary_folder(folder) as here:
                earlier = _earlier_rows(here)
                if earlier is None:
                    name = "its summary.parquet or report.html"
                    progress.say(f"warning: {folder}: {name} is not quadlog's and is left alone")
                    break
                rows = _rows(folder, earlier, own)
                columns = {name: [rows[run][name] for run in sorted(rows)] for name in TABLES["summary"].names}
                write_table(here / "summary.parquet", TABLES["summary"], columns)
                write_folder_page(here)
            if not _finished_runs(folder, rows):
                break


def rebuild_summary(folder: Path) -> Path:
    """Summary and page of the runs that are in a folder now. Raises NotARun where there are none, CannotWrite."""
    if not has_table(folder, "summary") and not _finished_runs(folder, ()):
        raise NotARun(folder, "is no run, and there is none in it")
    summarise({folder}, [], said := Kept())
    if said.lines:
        raise NotARun(folder, said.lines[0].removeprefix(f"warning: {folder}: "))
    return folder / "report.html"


def _rows(folder: Path, earlier: Rows, own: Mapping[str, ReplayOutcome]) -> Rows:
    """Rows by run: of this command's outcomes, of runs finished by other processes, and of the earlier summary."""
    there = {entry.name for entry in folder.iterdir() if entry.is_dir()}
    failed = {run for run, row in earlier.items() if row["exit_code"] == ExitCode.FAILED}
    # A recording that could not be read has no folder, only its row.
    rows = {run: row for run, row in earlier.items() if run in there | failed}
    # From Python, and simulated, a run has no cost but that of its run.json.
    costless = {run for run, outcome in own.items() if not outcome.cost and not outcome.failed}
    written_ns = _written_ns(folder / "summary.parquet")
    new = {run for run in failed | costless if _written_ns(folder / run / "run.json") > written_ns}
    rows |= _finished_runs(folder, (rows.keys() | own.keys()) - new)
    return rows | {run: _row(outcome, rows.get(run, {})) for run, outcome in own.items()}


def _written_ns(path: Path) -> int:
    return path.stat().st_mtime_ns if path.is_file() else 0


def _finished_runs(folder: Path, known: Any) -> Rows:
    """Rows of finished runs that are not among the known ones."""
    rows = {}
    for run in folder.iterdir():
        if run.name in known or run.name != run_name(run.name) or not run.is_dir():
            continue
        try:
            rows[run.name] = _row_of_run(run.name, read_record(run), read_metrics(run))
        except QuadlogError:
            continue  # not finished, of another format, or damaged
    return rows


def _row_of_run(name: str, record: RunRecord, metrics: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    lost = "; ".join(loss.detail for loss in record.losses)
    cost = {
        "wall_s": record.startup_s + sum(stage.seconds for stage in record.stages),
        "peak_memory_mb": max((stage.peak_memory_mb for stage in record.stages), default=float("nan")),
        "input_bytes": float(record.input.size_bytes),
        "worker": str(record.host.get("name", "")),
    }
    return _filled(name, ExitCode.WITH_LOSS if lost else ExitCode.DONE, lost, metrics, cost)


def _row(outcome: ReplayOutcome, earlier: Mapping[str, Any]) -> dict[str, Any]:
    """One row; a run that was reused keeps its earlier cost."""
    cost = outcome.cost or ({} if outcome.failed else earlier)
    return _filled(outcome.run.name, outcome.exit_code, outcome.reason, outcome.metrics, cost)


def _filled(
    name: str, exit_code: int, reason: str, metrics: Mapping[str, Mapping[str, Any]], cost: Mapping[str, Any]
) -> dict[str, Any]:
    own = {"recording": name, "exit_code": int(exit_code), "reason": reason}
    values = {each: metrics[each]["value"] if each in metrics else float("nan") for each in METRIC_NAMES}
    costs = {each: cost.get(each, float("nan")) for each in COST_NAMES} | {"worker": cost.get("worker", "")}
    return own | values | costs


def _earlier_rows(folder: Path) -> Rows | None:
    """Rows of the existing summary; None when summary.parquet or report.html is not quadlog's."""
    if not has_table(folder, "summary"):
        return None if (folder / "report.html").exists() else {}
    try:
        table = read_table(folder, "summary")
    except NotARun:
        return None
    count = len(table["recording"])
    rows = ({name: column[index] for name, column in table.items()} for index in range(count))
    return {row["recording"]: row for row in rows}
