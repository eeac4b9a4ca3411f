"""Anchors on one line or at one height: which of two mirror images a fix is, and whether heights are observable."""

from __future__ import annotations

from typing import Literal

import numpy as np

from quadlog.messages import Float
from quadlog.positioning.epochs import thin_rows
from quadlog.positioning.fix.least_squares import Fixes, complete_fixes, descend_all, invert_directions

Side = Literal["left", "right"]
NEAR_LINE_STD = 3.0
"""A fix that its own std across the line, times this, would carry over the line has no side."""


def start_on_side(anchors_m: Float, range_m: Float, tag_height_m: float, range_std_m: float, side: Side) -> Float:
    """(E, 2) positions to the left or right of the way from the first to the last of anchors (A, 3) on a line.

    In closed form: squared ranges are linear in the place along the line, and what is left of them is the distance from
    it, taken as range_std_m at least, so that a descent knows the side. NaN with fewer than three ranges.
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

    Starts near a track that is already known carry its side through the log by continuity. Near the line a fix has no
    side, and its covariance no meaning: those epochs are degenerate, as are those whose start is NaN or whose descent
    crosses the line (one in 10 000 from within 2 m).
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


THIN_STD = 10.0
"""Anchors this many range stds or more off their line (rms) do not take a fix for its image. At half of that one in
a thousand is, at a tenth one in ten (measured with four anchors)."""
AMBIGUOUS_STD2 = 9.0
"""Two minima whose costs differ by less, in std^2, are both possible: the likelihoods' ratio is below 90."""


def descend_both_sides(
    anchors_m: Float, range_m: Float, start_m: Float, solve_z: bool, range_std_m: float, long_m: float, short_m: float
) -> tuple[Float, Float]:
    """Positions (E, 3) and (sum w u u^T)^-1 (E, D, D) of the lower of two minima, NaN where both are possible.

    One lies downhill from start_m (E, 3), the other from its mirror image.
    Minima nearer to each other than the fix's own std count as one.
    """
    first_m, first, first_m2 = descend_all(anchors_m, range_m, start_m, solve_z, long_m, short_m)
    image_m = reflect_places(anchors_m, np.isfinite(range_m), start_m, first.shape[1])
    second_m, second, second_m2 = descend_all(anchors_m, range_m, image_m, solve_z, long_m, short_m)
    better = second_m2 < first_m2
    position_m = np.where(better[:, None], second_m, first_m)
    inverse = np.where(better[:, None, None], second, first)

    both = np.isfinite(first_m2) & np.isfinite(second_m2)
    difference_m2 = np.abs(np.where(both, first_m2, np.inf) - np.where(both, second_m2, 0.0))
    own_std_m = range_std_m * np.sqrt(np.trace(inverse, axis1=1, axis2=2))
    apart = np.linalg.norm(first_m - second_m, axis=1) > own_std_m
    ambiguous = apart & (difference_m2 < AMBIGUOUS_STD2 * range_std_m**2)
    position_m[ambiguous] = np.nan
    return position_m, inverse


def reflect_places(anchors_m: Float, heard: np.ndarray, position_m: Float, unknowns: int) -> Float:
    """(E, 3) mirror images of positions in what fits the anchors heard (E, A) best: a vertical plane through their
    line with two unknowns, their plane with three. NaN with as few anchors as unknowns.
    """
    image_m = np.full_like(position_m, np.nan)
    patterns, pattern = np.unique(heard, axis=0, return_inverse=True)
    for i in range(len(patterns)):
        if patterns[i].sum() <= unknowns:
            continue
        mine = pattern.reshape(-1) == i
        known_m = anchors_m[patterns[i], :unknowns]
        normal = np.zeros(3)
        normal[:unknowns] = np.linalg.svd(known_m - known_m.mean(axis=0))[2][-1]
        off_m = (position_m[mine, :unknowns] - known_m.mean(axis=0)) @ normal[:unknowns]
        image_m[mine] = position_m[mine] - 2 * off_m[:, None] * normal
    return image_m


TOLD_STD_M = 0.3
"""A height that someone wrote down is off by a few decimetres, as much as a person lifts or lowers a tag. One that
is solved for must be known better than that."""
MIRROR_APART_STD = 6.0
"""A mirror image whose ranges differ by this many std in all is taken for the fix once in 700 epochs."""
MAX_PLACES = 2000


def heights_are_told(
    anchors_m: Float, position_m: Float, height_m: float, heard: np.ndarray, range_std_m: float
) -> bool:
    """Whether to solve for the heights of a whole log, from its fixes (E, 2) at a height that is about right.

    heard: (E, A) bool, the ranges of each epoch to anchors (A, 3). True where half of the epochs or more would know
    the height to TOLD_STD_M, and half or more could not be mistaken for a mirror image.
    """
    placed = thin_rows(np.isfinite(position_m.sum(axis=1)), MAX_PLACES)
    if len(placed) == 0:
        return False
    place = (anchors_m, position_m[placed], height_m, heard[placed], range_std_m)
    return bool(
        np.median(height_std_m(*place)) <= TOLD_STD_M and np.median(mirror_apart_std(*place)) >= MIRROR_APART_STD
    )


def height_std_m(anchors_m: Float, position_m: Float, height_m: float, heard: np.ndarray, range_std_m: float) -> Float:
    """(E,) Cramér-Rao bound of a height that is solved for at places (E, 2), with heard (E, A) of the anchors (A, 3).

    Infinite with fewer than four anchors, and where the directions to them do not span space.
    """
    place_m = np.column_stack([position_m, np.full(len(position_m), float(height_m))])
    offset_m = place_m[:, None, :] - anchors_m
    direction = offset_m / np.maximum(np.linalg.norm(offset_m, axis=2), 1e-9)[:, :, None]
    told, inverse = invert_directions(direction, heard, 3)
    told &= heard.sum(axis=1) > 3
    return range_std_m * np.sqrt(np.where(told, inverse[5], np.inf))


def mirror_apart_std(
    anchors_m: Float, position_m: Float, height_m: float, heard: np.ndarray, range_std_m: float
) -> Float:
    """(E,) by how many std, root sum square, the ranges of a place differ from those of its mirror image.

    The image is the minimum downhill from the reflection in the plane of the
    anchors heard. Infinite where there is none but the place itself.
    """
    place_m = np.column_stack([position_m, np.full(len(position_m), float(height_m))])
    distance_m = np.linalg.norm(place_m[:, None, :] - anchors_m, axis=2)
    range_m = np.where(heard, distance_m, np.nan)
    image_m, _, cost_m2 = descend_all(
        anchors_m, range_m, reflect_places(anchors_m, heard, place_m, 3), True, np.inf, np.inf
    )
    itself = ~(np.linalg.norm(image_m - place_m, axis=1) > 1e-3)
    return np.where(itself, np.inf, np.sqrt(cost_m2) / range_std_m)
