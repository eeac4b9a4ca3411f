"""Anchors on one line: every fix has a mirror image. Which of the two it is must come from elsewhere."""

from __future__ import annotations

from typing import Literal

import numpy as np

from quadlog.messages import Float
from quadlog.positioning.descent import descend_all
from quadlog.positioning.fixes import Fixes, complete_fixes

Side = Literal["left", "right"]
NEAR_LINE_STD = 3.0
"""A fix that its own std across the line, times this, would carry over the line has no side."""


def start_on_side(anchors_m: Float, range_m: Float, tag_height_m: float, range_std_m: float, side: Side) -> Float:
    """(E, 2) positions to the left or right of the way from the first to the last of anchors (A, 3) on a line.

    In closed form: squared ranges are linear in the place along the line, and
    what is left of them is the distance from it, taken as range_std_m at least,
    so that a descent knows the side. NaN with fewer than three ranges.
    """
    centre_m, along, across = _anchor_line(anchors_m)
    heard = np.isfinite(range_m)
    enough = heard.sum(axis=1) >= 3
    place_m = (anchors_m[:, :2] - centre_m) @ along
    square_m2 = np.maximum(np.where(heard, range_m, 0.0) ** 2 - (anchors_m[:, 2] - tag_height_m) ** 2, 0.0)

    n = np.where(enough, heard.sum(axis=1), np.nan)
    mean_m = heard @ place_m / n
    offset_m = np.where(heard, place_m - mean_m[:, None], 0.0)
    lower_m2 = square_m2 - place_m**2
    with np.errstate(divide="ignore", invalid="ignore"):
        along_m = -(offset_m * lower_m2).sum(axis=1) / (2 * (offset_m**2).sum(axis=1))
    off_m2 = np.where(heard, square_m2 - (along_m[:, None] - place_m) ** 2, 0.0).sum(axis=1) / n
    off_m = np.maximum(np.sqrt(np.maximum(off_m2, 0.0)), range_std_m)
    signed_m = off_m if side == "left" else -off_m
    start_m: Float = centre_m + along_m[:, None] * along + signed_m[:, None] * across
    return start_m


def solve_on_side(
    anchors_m: Float, range_m: Float, tag_height_m: float, range_std_m: float, outlier_m: float, start_m: Float
) -> Fixes:
    """Maximum-likelihood fixes from anchors (A, 3) on a line, each on the side of its own start (E, 2).

    Starts near a track that is already known carry its side through the log by
    continuity. Near the line a fix has no side, and its covariance no meaning:
    those epochs are degenerate, as are those whose start is NaN or whose
    descent crosses the line (one in 10 000 from within 2 m).
    """
    centre_m, _, across = _anchor_line(anchors_m)
    enough = np.isfinite(range_m).sum(axis=1) >= 3
    place_m = np.column_stack([np.where(enough[:, None], start_m, np.nan), np.full(len(range_m), float(tag_height_m))])
    side = np.sign((place_m[:, :2] - centre_m) @ across)

    position_m, inverse, _ = descend_all(anchors_m, range_m, place_m, False, np.inf, np.inf)
    off_m = side * ((position_m[:, :2] - centre_m) @ across)
    across_std_m = range_std_m * np.sqrt(np.einsum("i,eij,j->e", across, inverse, across))
    position_m[~(off_m > NEAR_LINE_STD * across_std_m)] = np.nan
    return complete_fixes(anchors_m, range_m, position_m, range_std_m**2 * inverse, outlier_m)


def _anchor_line(anchors_m: Float) -> tuple[Float, Float, Float]:
    """Centre (2,) of the anchors' line, its direction from the first to the last of them, and the one left of that."""
    centre_m = anchors_m[:, :2].mean(axis=0)
    along = np.linalg.svd(anchors_m[:, :2] - centre_m)[2][0]
    if along @ (anchors_m[-1, :2] - anchors_m[0, :2]) < 0:
        along = -along
    return centre_m, along, np.array([-along[1], along[0]])
