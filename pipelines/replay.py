"""Replay one recording into one run folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from quadlog.errors import CannotWrite, ExitCode
from quadlog.pipelines.executor.progress import Progress, StageClock
from quadlog.pipelines.request import GOES_ON, Existing, ReplayOutcome, ReplayRequest
from quadlog.results.places import claim, place_of_new, publish_new, remove_new
from quadlog.results.record import InputRecord, describe_input, is_finished
from quadlog.results.stage_marks import MARKS_FILE
from quadlog.results.stages import reused_words
from quadlog.storage.atomic_write import is_full

if TYPE_CHECKING:
    from quadlog.pipelines.stages.context import ReplayContext
    from quadlog.pipelines.stages.ingest import Clouds
    from quadlog.pipelines.stages.stage import Stage


def replay(request: ReplayRequest, progress: Progress) -> ReplayOutcome:
    """Run the stages of one recording and leave its run folder. Raises QuadlogError when there is nothing to leave.

    A finished run that is replaced stands until the new one, in `place_of_new` meanwhile, is complete. If that fails,
    RESUME goes on there, as long as it has stages of the same request.
    """
    if request.existing is Existing.REFUSE:
        return _replay(request, progress)
    publish_new(request.run)  # completed by a process that was killed
    placed = _placed(request)
    if placed is request or request.existing is Existing.FORCE:
        remove_new(request.run)
    outcome = _replay(placed, progress)
    publish_new(request.run)
    return replace(outcome, run=request.run)


def _placed(request: ReplayRequest) -> ReplayRequest:
    """The request with the folder to work in; unchanged where that is the run itself."""
    place = place_of_new(request.run)
    if request.existing is Existing.FORCE and is_finished(request.run):
        claim(request.run, replace=True)  # raises for what must not be replaced
        return replace(request, run=place)
    if request.existing is Existing.RESUME and (place / MARKS_FILE).is_file():
        from quadlog.pipelines.stages.resume import find_reusable

        described = request.described or describe_input(request.recording)
        if find_reusable(resumed := replace(request, run=place, described=described), described.identity):
            return resumed
    return request


def _replay(request: ReplayRequest, progress: Progress) -> ReplayOutcome:
    described = _input_of_earlier(request) if request.existing is Existing.RESUME else None
    if described is not None:
        from quadlog.pipelines.stages.resume import outcome_there, refuse_another

        if (finished := outcome_there(request, described)) is not None:
            progress.say(f"{request.run}: already done with the same input, config and version")
            return finished
        refuse_another(request, described)

    from quadlog.pipelines.executor.compilation import compilation, compiling_s
    from quadlog.pipelines.stages.ingest import open_log, open_walk, reachable_stages
    from quadlog.pipelines.stages.resume import MarkedStages, find_reusable, names_of
    from quadlog.pipelines.stages.scans import wants_lidar_track
    from quadlog.pipelines.stages.stage import stages_for

    earlier = {} if described is None else find_reusable(request, described.identity)
    if described is not None:
        progress.say(reused_words(names_of(earlier), request.options.until))
    clock, compiled_s = StageClock(), compiling_s()
    with open_log(request, clock, progress) as log:
        reachable = reachable_stages(log.roles, request.options.until)
        todo = _until_pause(reachable, request.pause_after)
        missing = [name for stage in todo if stage not in earlier for name in stage.names]
        to_compile = [name for name in missing if name != "position" or log.by_uwb]
        clouds: Clouds = "map" if "map" in missing else "filter" if "filter" in missing else None
        tracked = "position" in missing and wants_lidar_track(request.config, log.roles, log.by_uwb)
        with (
            compilation(to_compile, request.config, progress.say) as before,
            open_walk(log, request, clock, progress, described, clouds, tracked=tracked) as walk,
            _with_resume_hint(request.run),
        ):
            marked = MarkedStages(walk, request, earlier)
            for stage in todo:
                marked.do(stage, partial(_work, stage, before))
            if reachable != stages_for(request.options.until):
                why = log.roles.choices("lidar") or log.roles.why_none("lidar")
                walk.warn(f"nothing is filtered, mapped, planned or walked: {why}")
            if request.pause_after is not None:
                return ReplayOutcome(request.recording, request.run, ExitCode.DONE, reused=walk.reused)
            with clock.stage("report"):
                # Drawing is not loaded before there is something to draw.
                from quadlog.pipelines.stages.report import finish_walk

            metrics = finish_walk(walk, request, compiling_s() - compiled_s)
            losses, reused = walk.losses, walk.reused
    reason = "; ".join(loss.detail for loss in losses)
    return ReplayOutcome(request.recording, request.run, _code(reason), reason, metrics, reused)


def reusable_stages(request: ReplayRequest) -> tuple[str, ...]:
    """The stages whose results in the run folder can be reused; nothing is run or written.

    The input is read only if the folder has marks of stages. Raises RecordingNotFound.
    """
    described = _input_of_earlier(request)
    if described is None:
        return ()
    from quadlog.pipelines.stages.resume import find_reusable, names_of

    return names_of(find_reusable(request, described.identity))


def _input_of_earlier(request: ReplayRequest) -> InputRecord | None:
    """The input, if the folder holds anything of an earlier replay; else it is not hashed, which takes a while."""
    began = any((request.run / name).is_file() for name in ("run.json", MARKS_FILE))
    return (request.described or describe_input(request.recording)) if began else None


def _until_pause(stages: tuple[Stage, ...], pause_after: str | None) -> tuple[Stage, ...]:
    """The stages up to the one of this name; all without a name, or where the log does not reach it."""
    names = [stage.name for stage in stages]
    return stages[: names.index(pause_after) + 1] if pause_after in names else stages


@contextmanager
def _with_resume_hint(written: Path | str) -> Iterator[None]:
    """Add `--resume goes on` to errors of writing; written: path for those without one."""
    try:
        yield
    except CannotWrite as error:
        raise CannotWrite(error.path, f"{error.reason}; {GOES_ON}") from error
    except OSError as error:
        if not is_full(error):
            raise
        raise CannotWrite(error.filename or written, f"{os.strerror(error.errno or 0)}; {GOES_ON}") from error


def _work(stage: Stage, before: Callable[[str], None], walk: ReplayContext) -> None:
    if stage.needs_compiled(walk):
        before(stage.name)
    stage.load()(walk)


def _code(losses: str) -> ExitCode:
    return ExitCode.WITH_LOSS if losses else ExitCode.DONE
