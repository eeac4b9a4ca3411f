"""Which runs need not be made again, and which must not be: what an output folder holds, against what is asked for."""

from __future__ import annotations

from pathlib import PurePosixPath

from quadlog.errors import ExitCode, NotARun, RunOfAnother, UnknownRunFormat
from quadlog.pipelines.replay import ReplayOutcome, ReplayRequest
from quadlog.pipelines.stages.units import units_until
from quadlog.plugins import is_installed
from quadlog.results.record import InputRecord, describe_input
from quadlog.results.run_folder import RunFolder, read_metrics, read_run_json
from quadlog.results.stage_marks import files_are_whole, read_marks
from quadlog.stages import STAGES, stages_until
from quadlog.version import __version__


def finished_outcome(request: ReplayRequest) -> ReplayOutcome | None:
    """The outcome of an earlier run with the very same input, config, options and version; None when there is none."""
    if not (request.run / "run.json").is_file():
        return None
    return outcome_there(request, describe_input(request.recording))


def outcome_there(request: ReplayRequest, described: InputRecord) -> ReplayOutcome | None:
    """The same, when the input is described already. A run that went further than is asked for is finished, too."""
    config, options = request.config.model_dump(exclude_none=True), request.options.to_dict()
    folder = RunFolder(request.run)
    for until in STAGES[STAGES.index(request.options.until) :]:
        if folder.is_finished(described.identity, config, __version__, options | {"until": until}):
            return _outcome(request, until)
    return None


def refuse_another(request: ReplayRequest, described: InputRecord) -> None:
    """Raises RunOfAnother for a finished run of another recording: it is neither this one's to keep nor to complete."""
    try:
        told = read_run_json(request.run)["input"]
    except (NotARun, UnknownRunFormat, KeyError):
        return
    if isinstance(told, dict) and InputRecord.identity_in(told) != described.identity:
        path = str(told.get("path", ""))
        if not _may_be_one(path, str(request.recording)):
            raise RunOfAnother(request.run, path)


def _outcome(request: ReplayRequest, until: str) -> ReplayOutcome | None:
    """Of a run that is finished as far as `until`, if it still has what its stages left, and its page."""
    marks = read_marks(request.run)
    if until == "report" and not (request.run / "report.html").is_file():
        return None
    if not all(unit.name in marks and files_are_whole(request.run, marks[unit.name]) for unit in units_until(until)):
        return None
    try:
        record, metrics = read_run_json(request.run), read_metrics(request.run)
    except NotARun:
        return None
    if any(not is_installed(**each) for each in record.get("plugins", [])):
        return None
    reason = "; ".join(str(loss.get("detail", "")) for loss in record.get("losses", []))
    code = ExitCode.WITH_LOSS if reason else ExitCode.DONE
    reused = stages_until(request.options.until)[1:]
    return ReplayOutcome(request.recording, request.run, code, reason, metrics, reused)


def _may_be_one(saved: str, asked: str) -> bool:
    """Whether two texts may name one recording: one of them may be seen from a folder within the other's."""
    one, other = (PurePosixPath(text.replace("\\", "/")).parts for text in (saved, asked))
    shorter = min(len(one), len(other))
    return bool(shorter) and one[-shorter:] == other[-shorter:]
