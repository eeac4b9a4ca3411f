"""The request for a replay, and its outcome."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from quadlog.config.schema import Config
from quadlog.errors import ExitCode

GOES_ON = "--resume goes on"


class Existing(enum.Enum):
    """What happens to a run folder that is there. FORCE makes all results again, REPLACE takes those in the store."""

    REFUSE = "refuse"
    FORCE = "force"
    REPLACE = "replace"
    RESUME = "resume"


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """Options that decide the result, besides the recording and the configuration."""

    stamp: Literal["auto", "header", "log"] = "auto"
    start_s: float | None = None
    duration_s: float | None = None
    until: str = "report"
    seed: int = 0
    msg_path: tuple[Path, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As `run.json` keeps them."""
        return asdict(self) | {"msg_path": [str(path) for path in self.msg_path]}


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """One recording and the folder its run goes to. notes: lines for run.json on how the config was made.

    draws: whether the run gets a page, and derived.mcap with its layout. plots: whether also pictures in plots/.
    size_bytes: of the recording; in a batch the largest ones begin first.
    """

    recording: Path
    run: Path
    config: Config
    options: ReplayOptions = ReplayOptions()
    existing: Existing = Existing.REFUSE
    command: tuple[str, ...] = ("quadlog", "replay")
    notes: tuple[str, ...] = ()
    draws: bool = True
    plots: bool = True
    size_bytes: int = 0


@dataclass(frozen=True, slots=True)
class ReplayOutcome:
    """The outcome of a request. exit_code: 0 done, 1 failed, 3 done with loss; reason: what was lost or why it failed.

    reused: stages taken from an earlier replay, all of them for a run that was finished already.
    """

    recording: Path
    run: Path
    exit_code: int
    reason: str = ""
    metrics: dict[str, dict[str, Any]] = field(default_factory=dict)
    reused: Sequence[str] = ()
    refused: bool = False

    @classmethod
    def of_failure(cls, request: ReplayRequest, reason: str, refused: bool = False) -> ReplayOutcome:
        """A recording that could not be replayed; refused: because its run exists, and is kept."""
        # The recording is always shown beside the reason.
        reason = reason.removeprefix(f"{request.recording}: ")
        return cls(request.recording, request.run, ExitCode.FAILED, reason, refused=refused)

    @property
    def failed(self) -> bool:
        """Whether there is no run of this request."""
        return self.exit_code == ExitCode.FAILED

    def to_dict(self) -> dict[str, Any]:
        """One flat object: run, exit code, and the metrics as plain numbers."""
        values = {name: metric["value"] for name, metric in self.metrics.items()}
        ended = {"exit_code": self.exit_code, "reason": self.reason}
        return {"run": str(self.run), "recording": str(self.recording), **ended, **values}
