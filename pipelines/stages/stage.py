"""The table of stages of a replay: for each its work, the config keys it reads, and the files it writes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from quadlog.results.stages import STAGE_FILES, stages_until

if TYPE_CHECKING:
    from quadlog.pipelines.stages.context import ReplayContext


@dataclass(frozen=True, slots=True)
class Stage:
    """A unit of work that is done, marked and reused as a whole. `filter` and `map` are one, as maps need the scans.

    names: as `--until` takes them and reports show them. work: "module:function" in this package, imported when it is
    called with the replay's context. reads: sections and keys of the configuration that decide the results, besides
    those of earlier stages; `test_stage` compares them with what is really read. files: all that it may write.
    needs_compiled: whether the work calls compiled code, given what earlier stages have found.
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


# lidar.level: whether the IMU is read for the scans, which may change where the recording begins. robot.model: the
# lengths of the legs that may tell the position; whether a log has joints is not known before it is read.
POSITION = Stage(
    ("position",),
    "positions.position:locate_walk",
    reads=(
        "topics",
        "uwb",
        "robot.preset",
        "robot.model",
        "robot.joints",
        "robot.feet",
        *(f"lidar.{key}" for key in ("level", "mount", "deskew", "odometry", "min_range_m")),
    ),
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
# Compact scans are not saved: changed map settings read the recording again.
MAP = Stage(
    ("filter", "map"),
    "perceive:filter_and_map",
    reads=(
        *FILTER.reads,
        *(f"grid.{key}" for key in ("cell_m", "size_cells", "min_height_m", "max_height_m", "min_points")),
        *(f"grid.{key}" for key in ("memory", "extent", "clear_s", "decay_s", "target_radius_m")),
        *("robot.preset", "robot.length_m", "robot.width_m", "robot.height_m", "results.ground_cell_m"),
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


ALL = (POSITION, FILTER, MAP, PLAN, CONTROL)
"""In the order of their work; `filter` is done alone only where no map is asked for."""


def stages_for(last: str) -> tuple[Stage, ...]:
    """The stages of `--until last`, in order, without `ingest` and `report`, which are done each time."""
    asked = stages_until(last)
    return tuple(stage for stage in ALL if stage.name in asked and not (stage is FILTER and "map" in asked))
