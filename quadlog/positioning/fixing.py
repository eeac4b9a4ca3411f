"""The fixes of one tag: which method, in how many dimensions, and on which side of anchors on a line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from quadlog.errors import AnchorsCollinear
from quadlog.messages import Float, Int
from quadlog.positioning.collinear import solve_on_side, start_on_side
from quadlog.positioning.fixes import Fixes, require_spread
from quadlog.positioning.spatial import heights_are_told
from quadlog.positioning.trilateration import solve_fixes

Mirror = Literal["refuse", "left", "right"]
Height = Literal["auto", "given", "solved"]


@dataclass(frozen=True, slots=True)
class FixSettings:
    """method: of `trilateration.METHODS`; height, mirror: as `uwb.height` and `uwb.mirror` explain them."""

    range_std_m: float
    outlier_m: float
    method: str
    height: Height
    mirror: Mirror


def anchors_on_line(anchor_ids: Int, anchors_m: Float, settings: FixSettings) -> bool:
    """Whether all anchors (A, 3) lie on a line, which leaves two mirrored places.

    Raises MissingInput for fewer than three, AnchorsCollinear where they do and no side was asked for.
    """
    try:
        require_spread(anchor_ids, anchors_m, settings.range_std_m)
    except AnchorsCollinear:
        if settings.mirror == "refuse":
            raise
        return True
    return False


def solve_height(anchors_m: Float, range_m: Float, tag_height_m: float, settings: FixSettings) -> bool:
    """Whether the height is solved for, with the ranges (E, A) of a whole log: where asked, or where they tell it."""
    if settings.height != "auto":
        return settings.height == "solved"
    flat = solve_fixes(
        "gauss_newton", anchors_m, range_m, tag_height_m, settings.range_std_m, settings.outlier_m
    ).position_m
    return heights_are_told(anchors_m, flat, tag_height_m, np.isfinite(range_m), settings.range_std_m)


def fix_tag(anchors_m: Float, range_m: Float, tag_height_m: float | None, settings: FixSettings) -> Fixes:
    """Fixes from ranges (E, A) to anchors that are not on a line; a height of None is solved for."""
    return solve_fixes(settings.method, anchors_m, range_m, tag_height_m, settings.range_std_m, settings.outlier_m)


def fix_on_side(anchors_m: Float, range_m: Float, tag_height_m: float, settings: FixSettings) -> Fixes:
    """First fixes from anchors on a line, all of them on the side that was asked for; always by Gauss-Newton."""
    assert settings.mirror != "refuse"
    start_m = start_on_side(anchors_m, range_m, tag_height_m, settings.range_std_m, settings.mirror)
    return fix_near(anchors_m, range_m, tag_height_m, settings, start_m)


def fix_near(anchors_m: Float, range_m: Float, tag_height_m: float, settings: FixSettings, start_m: Float) -> Fixes:
    """Fixes from anchors on a line, each on the side of its own start (E, 2): a track carries its side along."""
    return solve_on_side(anchors_m, range_m, tag_height_m, settings.range_std_m, settings.outlier_m, start_m)
