"""From one recording to one run folder: the story of `quadlog replay`, top to bottom."""

from __future__ import annotations

import enum
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from quadlog.config import Config
from quadlog.errors import CannotWrite, ExitCode
from quadlog.pipelines.progress import Progress, StageClock
from quadlog.results.files import is_full
from quadlog.results.record import InputRecord, describe_input
from quadlog.results.stage_marks import MARKS_FILE
from quadlog.stages import reused_words, stages_until

if TYPE_CHECKING:
    from quadlog.pipelines.stages.first_compilation import Compilation
    from quadlog.pipelines.stages.ingest import Clouds
    from quadlog.pipelines.stages.walk import Walk

GOES_ON = "--resume goes on"


class Existing(enum.Enum):
    """What happens to a run folder that is already there."""

    REFUSE = "refuse"
    FORCE = "force"
    RESUME = "resume"


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What decides the result beside the recording and the configuration."""

    stamp: Literal["header", "log"] = "header"
    start_s: float | None = None
    duration_s: float | None = None
    until: str = "report"
    seed: int = 0
    msg_path: tuple[Path, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As `run.json` keeps them."""
        return {
            "stamp": self.stamp,
            "start_s": self.start_s,
            "duration_s": self.duration_s,
            "until": self.until,
            "seed": self.seed,
            "msg_path": [str(path) for path in self.msg_path],
        }


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """One recording and the folder its run goes to. notes: lines for run.json on how the config was made."""

    recording: Path
    run: Path
    config: Config
    options: ReplayOptions = ReplayOptions()
    existing: Existing = Existing.REFUSE
    command: tuple[str, ...] = ("quadlog", "replay")
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReplayOutcome:
    """What became of a request: exit_code 0 done, 1 failed, 3 done with loss; reason says what was lost or why.

    reused: stages that an earlier replay had done, all of them for a run that was finished already.
    cost: of a replay in a batch, by the last columns of summary.parquet.
    """

    recording: Path
    run: Path
    exit_code: int
    reason: str = ""
    metrics: dict[str, dict[str, Any]] = field(default_factory=dict)
    reused: Sequence[str] = ()
    refused: bool = False
    cost: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_failure(cls, request: ReplayRequest, reason: str, refused: bool = False) -> ReplayOutcome:
        """A recording that could not be replayed; refused: because its run is there already, and stays."""
        # The recording stands beside the reason wherever it is shown.
        reason = reason.removeprefix(f"{request.recording}: ")
        return cls(request.recording, request.run, ExitCode.FAILED, reason, refused=refused)

    @property
    def failed(self) -> bool:
        """Whether there is no run of this request."""
        return self.exit_code == ExitCode.FAILED

    def to_dict(self) -> dict[str, Any]:
        """One flat object: where, how it ended, and the metrics as plain numbers."""
        values = {name: metric["value"] for name, metric in self.metrics.items()}
        ended = {"exit_code": self.exit_code, "reason": self.reason}
        return {"run": str(self.run), "recording": str(self.recording), **ended, **values}


def replay(request: ReplayRequest, progress: Progress) -> ReplayOutcome:
    """Run the stages of one recording and leave its run folder. Raises QuadlogError when there is nothing to leave."""
    described = _input_of_earlier(request) if request.existing is Existing.RESUME else None
    if described is not None:
        from quadlog.pipelines.finished_runs import outcome_there, refuse_another

        if (finished := outcome_there(request, described)) is not None:
            progress.say(f"{request.run}: already done with the same input, config and version")
            return finished
        refuse_another(request, described)

    from quadlog.pipelines.stages.ingest import open_walk
    from quadlog.pipelines.stages.reuse import MarkedStages, find_reusable, stages_of
    from quadlog.pipelines.stages.units import CONTROL, FILTER, MAP, PLAN, POSITION
    from quadlog.pipelines.stages.warm_up import compilation

    earlier = {} if described is None else find_reusable(request, described.identity)
    if described is not None:
        progress.say(reused_words(stages_of(earlier), request.options.until))
    todo = stages_until(request.options.until)
    clock = StageClock()
    missing = [stage for stage in todo if stage not in stages_of(earlier)]
    clouds = _clouds(todo, stages_of(earlier))
    with (
        compilation(missing, request.config, progress.say) as compiled,
        open_walk(request, clock, progress, described, clouds, partial(_compile, compiled, "filter", "map")) as walk,
        _telling_how_to_go_on(request.run),
    ):
        stages = MarkedStages(walk, request, earlier)
        if "position" in todo:
            stages.do(POSITION, partial(_locate, compiled))
        if "map" in todo:
            stages.do(MAP, _filter_and_map)
        elif "filter" in todo:
            stages.do(FILTER, _filter)
        if "plan" in todo:
            stages.do(PLAN, partial(_replan, compiled))
        if "control" in todo:
            stages.do(CONTROL, partial(_resimulate, compiled))
        with clock.stage("report"):
            # Drawing is not loaded before there is something to draw.
            from quadlog.pipelines.stages.report import finish_walk

        metrics = finish_walk(walk, request, compiled.seconds)
        losses, reused = walk.losses, walk.reused
    reason = "; ".join(loss.detail for loss in losses)
    return ReplayOutcome(request.recording, request.run, _code(reason), reason, metrics, reused)


def reusable_stages(request: ReplayRequest) -> tuple[str, ...]:
    """The stages whose results an earlier replay has left in the run folder; nothing is run, and nothing written.

    Only where there are any marks is the input looked at. Raises RecordingNotFound.
    """
    described = _input_of_earlier(request)
    if described is None:
        return ()
    from quadlog.pipelines.stages.reuse import find_reusable, stages_of

    return stages_of(find_reusable(request, described.identity))


def _input_of_earlier(request: ReplayRequest) -> InputRecord | None:
    """The input, if there is anything of an earlier replay that could be of it too: its hash takes a while."""
    began = any((request.run / name).is_file() for name in ("run.json", MARKS_FILE))
    return describe_input(request.recording) if began else None


@contextmanager
def _telling_how_to_go_on(written: Path | str) -> Iterator[None]:
    """Whatever can no longer be written, in `written` if nothing else tells: what is done need not be done again."""
    try:
        yield
    except CannotWrite as error:
        raise CannotWrite(error.path, f"{error.reason}; {GOES_ON}") from error
    except OSError as error:
        if not is_full(error):
            raise
        raise CannotWrite(error.filename or written, f"{os.strerror(error.errno or 0)}; {GOES_ON}") from error


def _clouds(todo: Sequence[str], reused: Sequence[str]) -> Clouds:
    """What the clouds are read for, when some of the stages to do have been done before."""
    if "map" in todo:
        return None if "map" in reused else "map"
    return "filter" if "filter" in todo and "filter" not in reused else None


def _locate(compiled: Compilation, walk: Walk) -> None:
    from quadlog.pipelines.stages.position import locate_walk

    if walk.streams.ranges is not None:
        _compile(compiled, "position")
    locate_walk(walk)


def _filter_and_map(walk: Walk) -> None:
    from quadlog.pipelines.stages.perceive import filter_and_map

    filter_and_map(walk)


def _filter(walk: Walk) -> None:
    from quadlog.pipelines.stages.perceive import filter_scans

    filter_scans(walk)


def _replan(compiled: Compilation, walk: Walk) -> None:
    from quadlog.pipelines.stages.plan import replan_walk

    if walk.target is not None:
        _compile(compiled, "plan")
    replan_walk(walk)


def _resimulate(compiled: Compilation, walk: Walk) -> None:
    from quadlog.pipelines.stages.control import resimulate_walk

    if walk.target is not None:
        _compile(compiled, "control")
    resimulate_walk(walk)


def _compile(compiled: Compilation, *stages: str) -> None:
    with _telling_how_to_go_on("the cache of compiled code"):
        compiled.before(*stages)


def _code(losses: str) -> ExitCode:
    return ExitCode.WITH_LOSS if losses else ExitCode.DONE
