"""Whether the anchors tell a tag's height, so that it need not be given."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float
from quadlog.positioning.descent import descend_all
from quadlog.positioning.fixes import invert_directions
from quadlog.positioning.mirror import reflect_places

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

    heard: (E, A) bool, the ranges of each epoch to anchors (A, 3). Told where half of the epochs or more would know
    the height to TOLD_STD_M, and half or more could not be mistaken for a mirror image.
    """
    placed = np.flatnonzero(np.isfinite(position_m).all(axis=1))
    placed = placed[:: max(1, -(-len(placed) // MAX_PLACES))]
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
