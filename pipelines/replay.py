"""Replay one recording into one run folder: every step is a stage, and its result the input of the next ones."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import cache, lru_cache, partial
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from quadlog.config.controllers import COMMAND, controller_plugin
from quadlog.config.schema import Config
from quadlog.errors import CannotWrite, ExitCode, NotARun, RunExists, RunOfAnother, UnknownRunFormat
from quadlog.pipelines.executor.progress import Progress, start_up
from quadlog.pipelines.executor.second_process import second_process
from quadlog.pipelines.request import GOES_ON, Existing, ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.stages.all_stages import (
    FILTER,
    FILTER_AND_MAP,
    INGEST,
    LOCATE,
    REPLAN,
    RESIMULATE,
    WALK_BY_COMMANDS,
)
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.store import Do, Doing, Keyed, Keys, R, Stage, Store, log_key, not_done, run_key
from quadlog.results import STAGES, reused_words, stages_until
from quadlog.results.find_runs import FAILED, is_run, own_files, run_name
from quadlog.results.record import InputRecord, describe_input, read_metrics, read_record, write_record
from quadlog.results.run import check_place, new_run, settle
from quadlog.storage.atomic_write import is_full, is_part, new_folder
from quadlog.storage.remote_path import RemotePath

if TYPE_CHECKING:
    from quadlog.pipelines.stages.log import Facts, Log, LogData
    from quadlog.pipelines.stages.tracks import Tracks, WalkedBody


RECORD, DONE_BEFORE = "run.json", "{}: already done with the same input, config and version"


class StageResults(NamedTuple):
    """Results of the stages that the report is made of."""

    facts: Keyed[Facts]
    tracks: Keyed[Tracks]
    body: Keyed[WalkedBody | None]


def steps(do: Do, log: Keyed[Callable[[], LogData]], request: ReplayRequest, last: str) -> StageResults:
    """A replay from top to bottom. `do` does the stages up to the last one; or finds their keys, and does none."""
    seed = request.options.seed
    facts = do(INGEST, log)
    data = Keyed(facts.key, lambda: log.get()())
    tracks = do(LOCATE, data)
    undone = StageResults(facts, tracks, Keyed("", partial(not_done, ("control",))))
    if last in ("ingest", "position"):
        return undone
    by_command = request.config.simulation.controller == COMMAND
    if by_command and last == "control":  # which needs no maps
        return undone._replace(body=do(WALK_BY_COMMANDS, data, tracks, seed))
    # Only the papers' fit of the ground draws numbers.
    drawn = seed if request.config.lidar.method == "paper" else 0
    maps = do(FILTER if last == "filter" else FILTER_AND_MAP, data, tracks, drawn)
    if last in ("filter", "map"):
        return undone
    do(REPLAN, maps, tracks)
    body = do(WALK_BY_COMMANDS, data, tracks, seed) if by_command else do(RESIMULATE, maps, tracks, seed)
    return undone._replace(body=body)


def replay(request: ReplayRequest, progress: Progress) -> ReplayOutcome:
    """Run the stages of one recording and leave its run folder. Raises QuadlogError when there is nothing to leave.

    What the store has is not done again, but with FORCE. A run that is replaced stands until the new one is complete.
    A run at a URL that is not finished is made from the start.
    """
    outcome = finished_outcome(request) if request.existing is Existing.RESUME else None
    if outcome is None:
        do = _replay_there if isinstance(request.run, RemotePath) else _replay_here
        outcome = do(request, progress)
    else:
        progress.say(DONE_BEFORE.format(request.run))
    (request.run / FAILED).unlink(missing_ok=True)  # of an earlier try
    return outcome


def _replay_here(request: ReplayRequest, progress: Progress) -> ReplayOutcome:
    began_s = start_up.seconds
    if request.existing is Existing.RESUME:
        refuse_another(request)
        if reusable := reusable_stages(request):
            progress.say(reused_words(reusable, request.options.until))
    elif request.existing is Existing.FORCE:
        Store(request.run.parent).forget(planned_keys(request).values())
    replaces = request.existing is not Existing.REFUSE
    check_place(request.run, replaces)
    journal = Journal(progress)
    with (
        _opened(request, journal) as log,
        _with_resume_hint(request.run),
        new_folder(request.run.parent),
        new_run(request.run, replaces) as run,
    ):
        do, made = _do_stages(request, log, run, journal)
        with start_up.loading():  # drawing is not loaded before there is something to draw
            from quadlog.pipelines.stages.report import Finished, finish
        metrics = finish(run, Finished(request, log, do, made, start_up.seconds - began_s))
        if request.existing is Existing.RESUME:
            refuse_another(request)  # which another process may have finished meanwhile
    Store(request.run.parent).settle(do.keys.values())
    reason = "; ".join(loss.detail for loss in journal.losses)
    code = ExitCode.WITH_LOSS if reason else ExitCode.DONE
    return ReplayOutcome(request.recording, request.run, code, reason, metrics, do.reused)


def _replay_there(request: ReplayRequest, progress: Progress) -> ReplayOutcome:
    """Replay into a local folder and upload it, the finished record last: object storage has no rename."""
    run = cast(RemotePath, request.run)
    there = list(run.iterdir()) if run.is_dir() else []
    if any(each.name != FAILED for each in there):
        if not is_run(request.run):
            raise CannotWrite(str(run), "the folder holds other files and is no run of quadlog")
        if request.existing is Existing.REFUSE:
            raise RunExists(str(run))
        if request.existing is Existing.RESUME:
            refuse_another(request)
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
        local = Path(scratch) / run_name(run.name)
        outcome = _replay_here(replace(request, run=local, existing=Existing.REFUSE), progress)
        names = {path.relative_to(local).as_posix() for path in local.rglob("*") if path.is_file()}
        write_record(Path(scratch), read_record(local), finished=False)
        run.upload_all(Path(scratch), [RECORD])
        for name in sorted(own_files(there).keys() - names):
            (run / name).unlink()
        run.upload_all(local, sorted(names - {RECORD}))
        run.upload_all(local, [RECORD])
    return replace(outcome, run=request.run)


@contextmanager
def _opened(request: ReplayRequest, journal: Journal) -> Iterator[Log]:
    """The open recording; that counts as `ingest`."""
    journal.progress.begin("open", None)
    with ExitStack() as stack:
        with start_up.loading():
            from quadlog.pipelines.stages.log import open_log
        with journal.clock.stage("ingest"):
            log = stack.enter_context(open_log(request.recording, request.config, request.options))
        yield log


def _do_stages(request: ReplayRequest, log: Log, run: Path, journal: Journal) -> tuple[Doing, StageResults]:
    """Do the stages up to the last one that is wanted and that the log allows."""
    from quadlog.pipelines.stages.log import read_log

    last, store = log.last_stage(), Store(request.run.parent)
    missing = [name for name, key in planned_keys(request, last).items() if not store.has(key)]
    controller = request.config.simulation.controller
    if "control" in missing and (plugin := controller_plugin(controller)) is not None:
        from quadlog.control.locomotion.plugged import plugged_controller

        plugged_controller(plugin)  # an unusable one is refused before anything is done
    with ExitStack() as stack:
        second = stack.enter_context(second_process(missing, request, journal.progress))
        before = stack.enter_context(_compiling(missing, log, request.config, journal.progress))
        made_there = (lambda _: False) if second is None else second.made
        do = Doing(store, run, request.config, last, journal, before, made_there)
        read = cache(partial(read_log, log, journal.progress))
        made = steps(do, Keyed(log_key(request.recording, request.options), lambda: read), request, last)
    if request.options.until == "report" != last:
        why = log.roles.choices("lidar") or log.roles.why_none("lidar")
        journal.warn(f"stopped after {last}: {why}")
    return do, made


def _compiling(
    stages: list[str], log: Log, config: Config, progress: Progress
) -> AbstractContextManager[Callable[[str], None]]:
    """As compilation, whose import takes half a second, where stages have compiled code."""
    from quadlog.pipelines.stages.outlook import wants_lidar_track

    if {*stages} <= {"ingest", "position"} and not wants_lidar_track(log, config):
        return nullcontext(lambda _: None)
    with start_up.loading():
        from quadlog.pipelines.executor.compilation import compilation

    return compilation(config, progress)


def control_alone(request: ReplayRequest, scratch: Path, progress: Progress) -> None:
    """Fill the store with the result of stage `control`, which needs none of `plan`; what is before it is there."""

    def do_without_plan(stage: Stage[R], *inputs: Any) -> Keyed[R]:
        return Keyed("", partial(not_done, stage.names)) if stage.names == ("plan",) else do(stage, *inputs)

    do = Doing(Store(request.run.parent), scratch, request.config, "control", Journal(progress))
    read = partial(not_done, ("ingest",))
    steps(do_without_plan, Keyed(log_key(request.recording, request.options), read), request, "control")


def planned_keys(request: ReplayRequest, last: str | None = None) -> dict[str, str]:
    """The key of each stage up to the last that is wanted, in order; the recording is not read.

    Raises RecordingNotFound.
    """
    last, keys = last or request.options.until, Keys(request.config)
    steps(keys, Keyed(log_key(request.recording, request.options), partial(not_done, ("ingest",))), request, last)
    return {name: keys.of[name] for name in stages_until(last) if name in keys.of}


def reusable_stages(request: ReplayRequest) -> tuple[str, ...]:
    """The stages whose results are in the store, but for `ingest`; nothing is run or written. As planned_keys."""
    store, keys = Store(request.run.parent), planned_keys(request)
    return tuple(takewhile(lambda name: store.has(keys[name]), keys))[1:]


def finished_outcome(request: ReplayRequest) -> ReplayOutcome | None:
    """The outcome of an earlier run with the very same input, config, options and version; None when there is none.

    A run of a later --until is finished, too.
    """
    try:
        if isinstance(request.run, Path):
            settle(request.run)
        record, metrics = read_record(request.run), read_metrics(request.run)
    except (NotARun, UnknownRunFormat):
        return None
    until = str(record.options.get("until"))
    if until not in STAGES[STAGES.index(request.options.until) :] or record.results.get("run") != run_key(request):
        return None
    if until == "report" and request.draws and not (request.run / "report.html").is_file():
        return None
    reason = "; ".join(loss.detail for loss in record.losses)
    reused = stages_until(request.options.until)[1:]
    code = ExitCode.WITH_LOSS if reason else ExitCode.DONE
    return ReplayOutcome(request.recording, request.run, code, reason, metrics, reused)


def refuse_another(request: ReplayRequest) -> None:
    """Raises RunOfAnother for a finished run of another recording, by their digests.

    What has none, behind a URL, is known by its place.
    """
    try:
        recorded = read_record(request.run).input
    except (NotARun, UnknownRunFormat):
        return
    found = _described(request.recording, log_key(request.recording, ReplayOptions()))
    without = found.fingerprint is recorded.fingerprint is None and found.path == recorded.path
    if not without and found.identity != recorded.identity:
        raise RunOfAnother(f"{request.run}: is the run of {recorded.path}; --force replaces it, another -o keeps it")


@lru_cache(64)
def _described(recording: Path, _: str) -> InputRecord:
    """A recording that is read once as long as its log_key stays."""
    return describe_input(recording)


@contextmanager
def _with_resume_hint(written: Path | str) -> Iterator[None]:
    """Add `--resume goes on` to errors of writing; written: path for those without one, and of unfinished folders."""
    try:
        yield
    except CannotWrite as error:
        parts = Path(error.path).parts
        within = [parts[number + 1 :] for number, part in enumerate(parts) if is_part(part)]
        path = Path(written, *within[-1]) if within else error.path
        raise CannotWrite(path, f"{error.reason}; {GOES_ON}") from error
    except OSError as error:
        if not is_full(error):
            raise
        raise CannotWrite(error.filename or written, f"{os.strerror(error.errno or 0)}; {GOES_ON}") from error
