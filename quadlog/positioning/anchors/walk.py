"""The survey's input: a walk by odometry with ranges along it; and places of an anchor that fit its ranges."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from quadlog.geometry import turned
from quadlog.messages import Float, Int
from quadlog.positioning.batch.factors import TagRanges, Way
from quadlog.positioning.batch.motion import Timeline, make_timeline

KNOT_S, MOST_KNOTS, MOST_CELLS = 0.5, 4000, 700_000
"""Between knots, longer in a long log; and how many there are at most, also times the global unknowns."""
MOST_RANGES = 10_000
MAX_GAP_S = 1.0
"""A range farther than this from the odometry's poses is left out."""
STANDING_M = 0.02
"""Way that a step counts for at least."""


@dataclass(frozen=True, slots=True)
class OdometryPrior:
    """Std of an odometry's scales of way and turns, of its yaw's drift; random drift, in m and rad after 1 m."""

    scale_std: float
    turn_scale_std: float
    yaw_drift_std_radps: float
    drift: tuple[float, float]


@dataclass(frozen=True)
class Walk:
    """A way seen from its first pose, K knots on it, ranges along it, and what is expected of anchors and odometry.

    way_m: its length by odometry, from knot to knot; drifting_m (K - 1,): of that, for which it drifts at random.
    heights_m (2, A): expected above the floor, and their std.
    """

    way: Way
    timeline: Timeline
    way_m: float
    drifting_m: Float
    ranges: TagRanges
    heights_m: Float
    odometry: OdometryPrior

    @cached_property
    def knots(self) -> Float:
        """(K, 2, 3) poses and rates by odometry."""
        pose = np.column_stack(self.way.at(self.timeline.t_s))
        return np.stack([pose, np.gradient(pose, self.timeline.t_s, axis=0)], axis=1)

    def of_anchors(self, anchors: Int) -> Walk:
        """The same walk with the ranges to some anchors alone, which are numbered as in anchors (B,)."""
        number = np.full(self.ranges.n_anchors, -1)
        number[anchors] = np.arange(len(anchors))
        kept = self.ranges.rows(number[self.ranges.anchor] >= 0)
        ranges = replace(kept, anchor=number[kept.anchor], n_anchors=len(anchors))
        return replace(self, ranges=ranges, heights_m=self.heights_m[:, anchors])

    def candidates(self, knots: Float) -> list[tuple[Float, Float]]:
        """For each anchor the places (C, 4) that fit best locally along the knots (K, 2, 3), and their misfits (C,)."""
        ranges, found = self.ranges, []
        pose, _ = self.timeline.sample(ranges.t_s).of(knots)
        xy_m = pose[:, :2] + turned(pose[:, 2], ranges.lever_m[ranges.tag])
        tag_m = np.column_stack([xy_m, ranges.height_m[ranges.tag]])
        for anchor in range(self.ranges.n_anchors):
            rows = ranges.anchor == anchor
            found.append(anchor_candidates(tag_m[rows], ranges.range_m[rows], self.heights_m[:, anchor]))
        return found


def make_walk(
    way: Way, ranges: TagRanges, heights_m: Float, odometry: OdometryPrior, most_ranges: int = MOST_RANGES
) -> tuple[Walk, int]:
    """The walk, and the number of ranges left out as they are not near an odometry pose.

    way: M >= 2 poses in the odometry's own frame. ranges: in time order, by the same clock, of which at most
    most_ranges, evenly of each link, are used. heights_m: (2, A) as in Walk.
    """
    t_s, last_s = way.t_s - way.t_s[0], max(float(way.t_s[-1] - way.t_s[0]), 1e-3)
    after = np.searchsorted(way.t_s, ranges.t_s).clip(1, len(t_s) - 1)
    gap_s = np.maximum(ranges.t_s - way.t_s[after - 1], way.t_s[after] - ranges.t_s)
    near = (np.abs(gap_s) <= MAX_GAP_S) & (ranges.t_s >= way.t_s[0]) & (ranges.t_s <= way.t_s[-1])
    rows = np.flatnonzero(near)
    if len(rows) > most_ranges:
        link = ranges.tag[rows] * ranges.n_anchors + ranges.anchor[rows]
        of_link = [rows[link == each] for each in np.unique(link)]
        limit = max(most_ranges // len(of_link), 1)
        spread = [np.linspace(0, len(mine) - 1, min(len(mine), limit)).astype(np.int64) for mine in of_link]
        rows = np.sort(np.concatenate([mine[some] for mine, some in zip(of_link, spread, strict=True)]))
    kept, yaw_rad = ranges.rows(rows), np.unwrap(way.yaw_rad)
    xy_m = turned(np.full(len(t_s), -yaw_rad[0]), way.xy_m - way.xy_m[0])
    most = min(MOST_KNOTS, most_ranges, MOST_CELLS // (ranges.n_links + 3 * ranges.n_anchors))
    timeline = make_timeline(np.array([0.0, last_s]), max(KNOT_S, last_s / most), np.inf, np.empty(0))
    relative = Way(t_s, xy_m, yaw_rad - yaw_rad[0])
    walked_m = np.hypot(*np.diff(relative.at(timeline.t_s)[0], axis=0).T)
    kept, drifting_m = replace(kept, t_s=kept.t_s - way.t_s[0]), np.maximum(walked_m, STANDING_M)
    return Walk(relative, timeline, float(walked_m.sum()), drifting_m, kept, heights_m, odometry), int((~near).sum())


MOST_ROWS, ROUNDS = 240, 15
KERNEL_M = 0.3
"""Misfits beyond this count by their order of magnitude."""
APART_M = 0.5
"""Two minima nearer to each other are one."""
USUAL_BIAS_M, BIAS_STD_M = 0.15, 0.15


def anchor_candidates(tag_m: Float, range_m: Float, expected: Float) -> tuple[Float, Float]:
    """Places (C, 4) x_m, y_m, z_m, bias_m of one anchor that fit its ranges (N,) locally best, and their misfits (C,).

    tag_m (N, 3): where the tag was; expected: the anchor's height and its std. By misfit, the mean of log(1 + (r /
    KERNEL_M)^2). They start where the squared ranges, linear in place and squared distance, have the anchor, and at
    both sides of the main axis of the way, at that distance.
    """
    rows = np.arange(len(range_m))[:: max(1, -(-len(range_m) // MOST_ROWS))]
    tag_m, range_m = tag_m[rows], range_m[rows]
    middle_m = tag_m[:, :2].mean(axis=0)
    axes = np.linalg.svd(tag_m[:, :2] - middle_m, full_matrices=False)[2]
    along_m = (tag_m[:, :2] - middle_m) @ axes.T
    level_m2 = (range_m - USUAL_BIAS_M) ** 2 - (expected[0] - tag_m[:, 2]) ** 2
    design = np.column_stack([2 * along_m, -np.ones(len(rows))])
    u_m, v_m, square_m2 = np.linalg.lstsq(design, (along_m**2).sum(axis=1) - level_m2)[0]
    side_m = np.sqrt(max(square_m2 - u_m**2, 0.0))
    mean, weight = np.array([0, 0, expected[0], USUAL_BIAS_M]), np.array([0, 0, expected[1] ** -2, BIAS_STD_M**-2])
    found = list[tuple[float, Float]]()
    for start_m in middle_m + np.array([[u_m, v_m], [u_m, side_m], [u_m, -side_m]]) @ axes:
        place = np.append(start_m, mean[2:])
        for step in range(ROUNDS + 1):  # damped Gauss-Newton of the Cauchy kernel
            offset_m = place[:3] - tag_m
            distance_m = np.maximum(np.linalg.norm(offset_m, axis=1), 1e-6)
            off_m = range_m - place[3] - distance_m
            if step < ROUNDS:
                slope = np.column_stack([offset_m / distance_m[:, None], np.ones(len(rows))])
                weighted = slope / (KERNEL_M**2 + off_m**2)[:, None]
                pull = weighted.T @ off_m - weight * (place - mean)
                place = place + np.linalg.solve(weighted.T @ slope + np.diag(weight + 1e-3), pull)
        found.append((float(np.log1p((off_m / KERNEL_M) ** 2).mean()), place))
    kept = list[tuple[float, Float]]()
    for each in sorted(found, key=lambda each: each[0]):
        if all(np.hypot(*(each[1] - other)[:2]) > APART_M for _, other in kept):
            kept.append(each)
    return np.array([place for _, place in kept]), np.array([misfit for misfit, _ in kept])
