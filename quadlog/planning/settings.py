"""Who plans, and how cells become a curve: the sections [planner] and [smoothing]."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from pydantic import AfterValidator, Field

from quadlog.config.section import Section
from quadlog.planning.planners import PLANNER_NAMES
from quadlog.plugins import PLANNERS, known_name


class PlannerSettings(Section):
    """Who plans, and on what."""

    name: Annotated[str, AfterValidator(partial(known_name, group=PLANNERS, own=PLANNER_NAMES))] = Field(
        "ia_star", description="any planner of quadlog compare-planners; ia_star [Planning]"
    )
    stop_short_m: float = Field(1.0, ge=0, le=1000, description="the path ends so far from a person")
    corner_cutting: bool = Field(False, description="allow diagonal steps between two obstacles' corners")


class SmoothingSettings(Section):
    """From cells to a curve [Planning, eq. 14]."""

    enabled: bool = Field(True, description="false: the robot follows the path from cell to cell")
    merge_m: float = Field(
        0.6,
        ge=0,
        le=100,
        description="inflection points closer than this become one where the line between them is free; [Planning] "
        "prints no distance",
    )
    spacing_m: float = Field(0.05, ge=0.005, le=10, description="distance of the points along the smooth path")
