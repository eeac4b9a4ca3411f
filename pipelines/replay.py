"""From one recording to one run folder: the story of `quadlog replay`, top to bottom."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from quadlog.config import Config
from quadlog.errors import ExitCode, NotARun
from quadlog.pipelines.progress import Progress, StageClock
from quadlog.plugins import is_installed
from quadlog.results.record import describe_input
from quadlog.results.run_folder import RunFolder, read_metrics, read_run_json
from quadlog.stages import stages_until
from quadlog.version import __version__


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
    """One recording and the folder its run goes to."""

    recording: Path
    run: Path
    config: Config
    options: ReplayOptions = ReplayOptions()
    existing: Existing = Existing.REFUSE
    command: tuple[str, ...] = ("quadlog", "replay")


@dataclass(frozen=True, slots=True)
class ReplayOutcome:
    """What became of a request: exit_code 0 done, 1 failed, 3 done with loss; reason says what was lost or why."""

    recording: Path
    run: Path
    exit_code: int
    reason: str = ""
    metrics: dict[str, dict[str, Any]] = field(default_factory=dict)
    refused: bool = False

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
    if request.existing is Existing.RESUME and (finished := finished_outcome(request)) is not None:
        progress.say(f"{request.run}: already done with the same input, config and version")
        return finished

    from quadlog.pipelines.stages.ingest import open_walk
    from quadlog.pipelines.stages.perceive import filter_and_map, filter_scans
    from quadlog.pipelines.stages.position import locate_walk
    from quadlog.pipelines.stages.warm_up import warm_up

    todo = stages_until(request.options.until)
    clock = StageClock()
    progress.begin("start-up", None)
    startup_s = warm_up(todo, request.config, progress.say)
    with open_walk(request, clock, progress) as walk:
        if "position" in todo:
            locate_walk(walk)
        if "map" in todo:
            filter_and_map(walk)
        elif "filter" in todo:
            filter_scans(walk)
        if "plan" in todo:
            from quadlog.pipelines.stages.plan import replan_walk

            replan_walk(walk)
        if "control" in todo:
            from quadlog.pipelines.stages.control import resimulate_walk

            resimulate_walk(walk)
        with clock.stage("report"):
            # Drawing is not loaded before there is something to draw.
            from quadlog.pipelines.stages.report import finish_walk

        metrics = finish_walk(walk, request, startup_s)
        losses = walk.losses
    reason = "; ".join(loss.detail for loss in losses)
    return ReplayOutcome(request.recording, request.run, _code(reason), reason, metrics)


def finished_outcome(request: ReplayRequest) -> ReplayOutcome | None:
    """The outcome of an earlier run with the very same input, config, options and version; None when there is none."""
    folder = RunFolder(request.run)
    if not (request.run / "run.json").is_file():
        return None
    digest = describe_input(request.recording).sha256
    if not folder.is_finished(
        digest, request.config.model_dump(exclude_none=True), __version__, request.options.to_dict()
    ):
        return None
    try:
        record, metrics = read_run_json(request.run), read_metrics(request.run)
    except NotARun:
        return None
    if any(not is_installed(**each) for each in record.get("plugins", [])):
        return None
    reason = "; ".join(str(loss.get("detail", "")) for loss in record.get("losses", []))
    return ReplayOutcome(request.recording, request.run, _code(reason), reason, metrics)


def _code(losses: str) -> ExitCode:
    return ExitCode.WITH_LOSS if losses else ExitCode.DONE
