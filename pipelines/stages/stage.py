"""What a replay does as a whole and reuses as a whole: which stages, by which keys of the config, into which files."""

from __future__ import annotations

from dataclasses import dataclass

from quadlog.results.run.stages import STAGE_FILES


@dataclass(frozen=True, slots=True)
class Unit:
    """Stages that are done together.

    reads: sections and keys of the configuration that decide its results, beside those of the units before it;
    `test_units` holds them against what is really read. files: all that it may write.
    """

    stages: tuple[str, ...]
    reads: tuple[str, ...]
    files: tuple[str, ...]

    @property
    def name(self) -> str:
        """That of its last stage."""
        return self.stages[-1]


# Whether the IMU is read for the scans' sake decides when the recording begins, and with it all of `position`.
POSITION = Unit(
    ("position",),
    ("topics", "uwb", "lidar.level"),
    (*STAGE_FILES["ingest"], *STAGE_FILES["position"], "trajectory.tum"),
)
_FILTER_READS = ("lidar", "ground", "results.cloud_samples")
FILTER = Unit(("filter",), _FILTER_READS, STAGE_FILES["filter"])
# What is kept of clouds is gone with the process: other maps read the recording again.
MAP = Unit(
    ("filter", "map"),
    (
        *_FILTER_READS,
        *(f"grid.{key}" for key in ("cell_m", "size_cells", "min_height_m", "max_height_m", "min_points")),
        *(f"grid.{key}" for key in ("memory", "extent", "clear_s", "decay_s", "target_radius_m")),
        *("robot.length_m", "robot.width_m", "robot.height_m", "results.ground_cell_m"),
    ),
    (*STAGE_FILES["filter"], *STAGE_FILES["map"]),
)
PLAN = Unit(("plan",), ("planner", "smoothing", "grid.dilation_m", "grid.dilation"), STAGE_FILES["plan"])
CONTROL = Unit(("control",), ("pursuit", "robot.model", "mpc", "wbc", "simulation"), STAGE_FILES["control"])

_UNITS = {
    "ingest": (),
    "position": (POSITION,),
    "filter": (POSITION, FILTER),
    "map": (POSITION, MAP),
    "plan": (POSITION, MAP, PLAN),
    "control": (POSITION, MAP, PLAN, CONTROL),
    "report": (POSITION, MAP, PLAN, CONTROL),
}


def units_until(last: str) -> tuple[Unit, ...]:
    """The units up to the stage `last`, in order. `ingest` and `report` belong to none: they are done each time."""
    return _UNITS[last]
