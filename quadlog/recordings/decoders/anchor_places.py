"""Where anchors are, as range messages carry it, checked against one another."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from quadlog.errors import some_of
from quadlog.messages import Float

MOST_ANCHORS = 256
"""Anchors whose positions are collected; the ids of a damaged log are no end of anchors."""
MOVED_M = 0.3
"""Positions of an anchor that stands scatter by less: self-surveys are repeated to a few centimetres."""
FEWEST_ANCHORS = 3
_FARTHEST_M = 1e6
_AGREEING = 0.95


@dataclass(frozen=True, slots=True)
class AnchorPlace:
    """position_m (3,): the median of what n messages say; moved_m: within so much of it are 95 % of them."""

    position_m: tuple[float, float, float]
    moved_m: float
    n: int


def places_of(ranges: Iterable[np.ndarray]) -> dict[int, AnchorPlace]:
    """Anchor id -> place, by rising id, of the positions that rows of ranges carry, those of MOST_ANCHORS at most.

    NaN and (0, 0, 0), which drivers write for none, are no position.
    """
    placed = [
        each[["anchor", "anchor_position_m"]] for each in ranges if "anchor_position_m" in (each.dtype.names or ())
    ]
    if not placed:
        return {}
    rows = np.concatenate(placed)
    position_m = rows["anchor_position_m"]
    given = (rows["anchor"] >= 0) & position_m.any(axis=1) & (np.abs(position_m) < _FARTHEST_M).all(axis=1)
    anchor, position_m = rows["anchor"][given], position_m[given]
    places = {}
    for each in np.unique(anchor)[:MOST_ANCHORS].tolist():
        mine_m = position_m[anchor == each]
        median_m = np.median(mine_m, axis=0)
        moved_m = float(np.quantile(np.linalg.norm(mine_m - median_m, axis=1), _AGREEING))
        x_m, y_m, z_m = median_m.tolist()
        places[each] = AnchorPlace((x_m, y_m, z_m), moved_m, len(mine_m))
    return places


def place_warnings(places: Mapping[int, AnchorPlace], configured_m: Mapping[int, Float]) -> list[str]:
    """One line for anchors whose messages contradict one another, one for those that contradict the configuration.

    configured_m: anchor id -> position (3,), empty where none are configured.
    """
    texts = []
    moved_m = {anchor: place.moved_m for anchor, place in places.items() if place.moved_m > MOVED_M}
    if moved_m:
        texts.append(
            f"the messages contradict one another on where anchors are: {_worst(moved_m)}; the medians are taken"
        )
    apart_m = {
        anchor: float(np.linalg.norm(configured_m[anchor] - np.array(place.position_m)))
        for anchor, place in places.items()
        if anchor in configured_m
    }
    far_m = {anchor: each_m for anchor, each_m in apart_m.items() if each_m > MOVED_M}
    if far_m:
        texts.append(
            f"the positions of {len(far_m)} of {len(apart_m)} anchors in the messages are not those of "
            f"[[uwb.anchors]], which are used: {_worst(far_m)}"
        )
    return texts


def _worst(distance_m: Mapping[int, float]) -> str:
    """The anchors with the largest distances, and how many more there are."""
    ranked = sorted(distance_m, key=lambda anchor: -distance_m[anchor])
    return some_of([f"anchor {anchor} by {distance_m[anchor]:.2f} m" for anchor in ranked], 4)
