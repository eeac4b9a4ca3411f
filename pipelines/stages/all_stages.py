"""The stages of a replay: their names, what of the configuration they read, and the functions that do them.

A stage is imported when it is done, or when its result is wanted: its key needs only what stands here.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from quadlog.pipelines.store import Stage

if TYPE_CHECKING:
    from quadlog.pipelines.stages.log import Facts
    from quadlog.pipelines.stages.tracks import Tracks, WalkedBody

READING = (
    *("topics", "uwb.anchors", "uwb.range_topics", "robot.joints", "robot.feet"),
    *("lidar.level", "lidar.mount", "lidar.pose_gap_s"),
)
"""What decides which topics are read, and how."""
LOCATING = (
    *("topics", "uwb", "robot.model", "robot.joints", "robot.feet", "robot.max_speed_mps"),
    *(f"lidar.{key}" for key in ("deskew", "odometry", "min_range_m", "pose_gap_s")),
)
FILTERING = ("lidar", "ground", "results.cloud_samples")
MAPPING = (
    *FILTERING,
    *(f"grid.{key}" for key in ("cell_m", "size_cells", "min_height_m", "max_height_m", "min_points")),
    *(f"grid.{key}" for key in ("memory", "extent", "clear_s", "target_radius_m")),
    *("robot.model", "robot.length_m", "robot.width_m", "robot.height_m", "results.ground_cell_m"),
)
PLANNING = (
    *("planner", "smoothing", "grid.dilation_m", "grid.dilation", "lidar.pose_gap_s"),
    *("robot.model", "robot.length_m", "robot.width_m", "robot.height_m"),
)
WALKING = ("pursuit", "robot", "mpc", "simulation")

_HERE = "quadlog.pipelines.stages"
INGEST: Stage[Facts] = Stage(("ingest",), READING, f"{_HERE}.log:ingest", f"{_HERE}.log:Facts")
LOCATE: Stage[Tracks] = Stage(("position",), LOCATING, f"{_HERE}.positions.position:locate", f"{_HERE}.tracks:Tracks")
FILTER: Stage[Path] = Stage(("filter",), FILTERING, f"{_HERE}.maps:filter_scans")
# One pass over the clouds for both: classified scans are not saved, so changed settings of maps read the clouds again.
FILTER_AND_MAP: Stage[Path] = Stage(("filter", "map"), MAPPING, f"{_HERE}.maps:filter_and_map")
REPLAN: Stage[Path] = Stage(("plan",), PLANNING, f"{_HERE}.plan:replan")
RESIMULATE: Stage[WalkedBody | None] = Stage(
    ("control",), (*PLANNING, *WALKING), f"{_HERE}.control:resimulate", f"{_HERE}.tracks:WalkedBody"
)
WALK_BY_COMMANDS: Stage[WalkedBody | None] = Stage(
    ("control",), (*WALKING, "lidar.pose_gap_s"), f"{_HERE}.control:walk_by_commands", f"{_HERE}.tracks:WalkedBody"
)
