"""The stages of a replay, one entry each: what does it, by which keys of the configuration, into which files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from quadlog.results.run.stages import STAGE_FILES, stages_until

if TYPE_CHECKING:
    from quadlog.pipelines.stages.context import ReplayContext


@dataclass(frozen=True, slots=True)
class Stage:
    """What is done, marked and reused as a whole; `filter` and `map` are, because a map needs its scans' points.

    names: as `--until` takes them and reports show them. work: "module:function" in this package, which is called with
    the replay's context, and loaded only then. reads: sections and keys of the configuration that decide the results,
    beside those of the stages before; `test_stage` holds them against what is really read. files: all that it may
    write. needs_compiled: whether the work, on what has been found so far, calls compiled code.
    """

    names: tuple[str, ...]
    work: str
    reads: tuple[str, ...]
    files: tuple[str, ...]
    needs_compiled: Callable[[ReplayContext], bool]

    @property
    def name(self) -> str:
        """The last one of its names."""
        return self.names[-1]

    def load(self) -> Callable[[ReplayContext], None]:
        """The function that does the work."""
        module, function = self.work.split(":")
        work: Callable[[ReplayContext], None] = getattr(import_module(f"{__package__}.{module}"), function)
        return work


# Whether the IMU is read for the scans' sake decides when the recording begins, and with it all of `position`.
POSITION = Stage(
    ("position",),
    "position:locate_walk",
    reads=("topics", "uwb", "lidar.level"),
    files=(*STAGE_FILES["ingest"], *STAGE_FILES["position"], "trajectory.tum"),
    needs_compiled=lambda walk: walk.streams.ranges is not None,
)
FILTER = Stage(
    ("filter",),
    "perceive:filter_scans",
    reads=("lidar", "ground", "results.cloud_samples"),
    files=STAGE_FILES["filter"],
    needs_compiled=lambda _: True,
)
# What is kept of clouds is gone with the process: other maps read the recording again.
MAP = Stage(
    ("filter", "map"),
    "perceive:filter_and_map",
    reads=(
        *FILTER.reads,
        *(f"grid.{key}" for key in ("cell_m", "size_cells", "min_height_m", "max_height_m", "min_points")),
        *(f"grid.{key}" for key in ("memory", "extent", "clear_s", "decay_s", "target_radius_m")),
        *("robot.length_m", "robot.width_m", "robot.height_m", "results.ground_cell_m"),
    ),
    files=(*STAGE_FILES["filter"], *STAGE_FILES["map"]),
    needs_compiled=lambda _: True,
)
PLAN = Stage(
    ("plan",),
    "plan:replan_walk",
    reads=("planner", "smoothing", "grid.dilation_m", "grid.dilation"),
    files=STAGE_FILES["plan"],
    needs_compiled=lambda walk: walk.target is not None,
)
CONTROL = Stage(
    ("control",),
    "control:resimulate_walk",
    reads=("pursuit", "robot.model", "mpc", "wbc", "simulation"),
    files=STAGE_FILES["control"],
    needs_compiled=lambda walk: walk.target is not None,
)


def stages_for(last: str) -> tuple[Stage, ...]:
    """Those that `--until last` asks for, in order. `ingest` and `report` are done each time, and are none of them."""
    asked = stages_until(last)
    scans = MAP if "map" in asked else FILTER
    return tuple(stage for stage in (POSITION, scans, PLAN, CONTROL) if stage.name in asked)
