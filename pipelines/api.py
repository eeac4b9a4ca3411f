"""`quadlog.replay`: what `quadlog replay` does with one recording, for a caller in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from quadlog.config.file import configure
from quadlog.errors import UnknownName, UsageError
from quadlog.pipelines.batch.batch import replay_alone
from quadlog.pipelines.batch.plan import kept_names
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.recordings.clocks.clock import Stamp
from quadlog.results import STAGES
from quadlog.results.run import Run, load_run
from quadlog.storage.remote_path import to_path

MAX_SEED = 2**32 - 1


def replay(
    recording: Path | str,
    *,
    config: Path | str | None = None,
    settings: Mapping[str, Any] | None = None,
    preset: str | None = None,
    output: Path | str = "runs",
    start_s: float | None = None,
    duration_s: float | None = None,
    until: str = "report",
    stamp: Stamp = "auto",
    seed: int = 0,
    msg_path: Sequence[Path | str] = (),
    force: bool = False,
    resume: bool = False,
    plots: bool = True,
) -> Run:
    """Replay one recording into a run folder below `output`, and load it. Prints nothing. Both may be URLs.

    config: a quadlog.toml. settings: keys that override the file: `{"planner.name": "astar"}` or
    `{"planner": {"name": "astar"}}`. plots: in plots/, beside the page. The other arguments are the options of
    `quadlog replay` of the same names. Choices, warnings and losses are in the run's `record`; a damaged recording
    that can be read in part is no error.

    Raises a QuadlogError: UsageError and UnknownName for wrong options, those of the configuration, AlreadyExists for
    an existing run without `force` and `resume`, and those of opening and replaying the recording.
    """
    _check(start_s, duration_s, until, stamp, seed)
    start_s, duration_s = (None if each is None else float(each) for each in (start_s, duration_s))
    options = ReplayOptions(stamp, start_s, duration_s, until, int(seed), tuple(map(Path, msg_path)))
    if force and resume:
        raise UsageError("force and resume exclude each other")
    existing = Existing.RESUME if resume else Existing.FORCE if force else Existing.REFUSE
    path, there = to_path(recording), to_path(output)
    configured = configure(None if config is None else Path(config), preset=preset, settings=settings or {})
    request = ReplayRequest(
        recording=path,
        run=there / kept_names([path], there)[0],
        config=configured.config,
        options=options,
        existing=existing,
        command=("quadlog.replay", str(recording)),
        notes=configured.notes,
        plots=plots,
    )
    replay_alone(request, Silent())
    return load_run(request.run)


def _check(start_s: float | None, duration_s: float | None, until: str, stamp: str, seed: int) -> None:
    """Raises UnknownName and UsageError, as the command line does."""
    if until not in STAGES:
        raise UnknownName("stage", until, STAGES)
    if stamp not in get_args(Stamp):
        raise UnknownName("stamp", stamp, get_args(Stamp))
    if start_s is not None and not start_s >= 0:
        raise UsageError(f"start_s is {start_s}; it cannot be negative")
    if duration_s is not None and not duration_s > 0:
        raise UsageError(f"duration_s is {duration_s}; it must be positive")
    if not 0 <= seed <= MAX_SEED:
        raise UsageError(f"seed is {seed}; it lies between 0 and {MAX_SEED}")
