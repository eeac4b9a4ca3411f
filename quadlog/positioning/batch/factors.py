"""What a measurement says about a body's pose at the knots and about the global unknowns, as linearised rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.geometry import turned
from quadlog.messages import Float, Int
from quadlog.positioning.batch.motion import Motion, Timeline

HOLD_S = 0.5
"""A sensor that is silent for longer says nothing of the interval."""
ERRORS_LAST_S = 1.0
"""Correlation time of an odometry's errors: this much time counts as one measurement."""
MOST_IN_SLOT = 10
"""More ranges of a link, 50 a second between knots, are averaged: their errors last longer, and they cost time."""


@dataclass(frozen=True, slots=True)
class Rows:
    """N scalar measurements, linearised.

    interval (N,): between which knots, in order; local (4D, N): slope by the two knots (q, q', q, q'); residual (N,):
    measured minus predicted. column, slope (G, N): slopes by G global unknowns each, and which.
    """

    interval: Int
    local: Float
    residual: Float
    column: Int
    slope: Float

    def rows(self, rows: Int) -> Rows:
        """Those of indices."""
        parts = self.interval[rows], self.local.take(rows, axis=1), self.residual[rows]
        return Rows(*parts, self.column[:, rows], self.slope[:, rows])


@dataclass(frozen=True, slots=True)
class Axes:
    """Coordinates of the body: x, y, then height above the given one (z) and yaw, where they are tracked."""

    motions: tuple[Motion, ...]
    z: int | None = None
    yaw: int | None = None

    def __len__(self) -> int:
        return len(self.motions)

    def places(self, pose: Float, lever_m: Float) -> tuple[Float, Float]:
        """Places (N, 2) of tags at lever_m (N, 2) in base, whose pose is (N, D), and their slopes by yaw (N, 2)."""
        if self.yaw is None:
            return pose[:, :2], np.zeros_like(lever_m)
        arm_m = turned(pose[:, self.yaw], lever_m)
        return pose[:, :2] + arm_m, arm_m[:, ::-1] * [-1, 1]


@dataclass(frozen=True, slots=True)
class Slots:
    """N means of one link's ranges over a slot each, in time order, and the R ranges, by link, then time.

    t_s (N,): mean time; link, anchor (N,); lever_m (N, 2): the tag in base; height_m (N,): of the tag. slot (R,): which
    slot a range belongs to; begin (N,): at which range another slot begins; late_s (R,): by how much a range is later
    than its slot; range_m (R,): of neighbours the mean where a slot has more than MOST_IN_SLOT. of_given: which of
    these each of the ranges is, or is in, as they were given.
    """

    t_s: Float
    link: Int
    anchor: Int
    lever_m: Float
    height_m: Float
    slot: Int
    begin: Int
    late_s: Float
    range_m: Float
    of_given: Int
    n_links: int

    @property
    def range_t_s(self) -> Float:
        """(R,) when each range was measured."""
        return self.t_s[self.slot] + self.late_s

    @property
    def range_link(self) -> Int:
        """(R,) the link of each range."""
        return self.link[self.slot]

    def sums(self, value: Float) -> Float:
        """(N,) sums of values (R,) of the ranges."""
        sums = np.empty(len(self.t_s))
        sums[self.slot[self.begin]] = np.add.reduceat(value, self.begin)
        return sums


@dataclass(frozen=True, slots=True)
class TagRanges:
    """R ranges of the T tags of a body: t_s, tag, anchor (indices), range_m (R,).

    lever_m (T, 2): where the tags sit in base; height_m (T,): in map. n_anchors: that may be heard.
    """

    t_s: Float
    tag: Int
    anchor: Int
    range_m: Float
    lever_m: Float
    height_m: Float
    n_anchors: int

    @property
    def n_links(self) -> int:
        """A link for each tag and anchor."""
        return len(self.lever_m) * self.n_anchors

    def rows(self, rows: np.ndarray | slice) -> TagRanges:
        """Those of a mask, of indices or of a slice."""
        t_s, tag, anchor, range_m = self.t_s[rows], self.tag[rows], self.anchor[rows], self.range_m[rows]
        return replace(self, t_s=t_s, tag=tag, anchor=anchor, range_m=range_m)

    def slots(self, edges_s: Float) -> Slots:
        """Means of each link's ranges between rising edges, of MOST_IN_SLOT of them at most."""
        link = self.tag * self.n_anchors + self.anchor
        order, of_given = np.lexsort((self.t_s, link)), np.empty(len(link), np.int64)
        t_s, link = self.t_s[order], link[order]
        cell = np.searchsorted(edges_s, t_s, side="right") * self.n_links + link
        begin = np.flatnonzero(np.diff(cell, prepend=-1))
        n = np.diff(begin, append=len(cell))
        most = np.minimum(n, MOST_IN_SLOT)
        part = (np.arange(len(cell)) - np.repeat(begin, n)) * np.repeat(most, n) // np.repeat(n, n)
        first = np.flatnonzero((np.diff(cell, prepend=-1) != 0) | (np.diff(part, prepend=-1) != 0))
        some = np.diff(first, append=len(cell))
        of_given[order] = np.repeat(np.arange(len(first)), some)
        t_s, range_m = (np.add.reduceat(each, first) / some for each in (t_s, self.range_m[order]))
        begin, n, of_slot = np.searchsorted(first, begin), most, link[begin]
        mean_s = np.add.reduceat(t_s, begin) / n
        in_time = np.argsort(mean_s, kind="stable")
        slot, late_s = np.repeat(np.argsort(in_time), n), t_s - np.repeat(mean_s, n)
        mean_s, of_slot = mean_s[in_time], of_slot[in_time]
        tag, anchor = np.divmod(of_slot, self.n_anchors)
        place = self.lever_m[tag], self.height_m[tag]
        return Slots(mean_s, of_slot, anchor, *place, slot, begin, late_s, range_m, of_given, self.n_links)

    def single(self) -> Slots:
        """Each range by itself, in time order."""
        n, link = len(self.t_s), self.tag * self.n_anchors + self.anchor
        own = np.arange(n)
        place = self.lever_m[self.tag], self.height_m[self.tag]
        return Slots(self.t_s, link, self.anchor, *place, own, own, np.zeros(n), self.range_m, own, self.n_links)


@dataclass(frozen=True, slots=True)
class RangeModel:
    """range = (1 + scale) |tag - anchor| + bias of the link, of a body with these axes among anchors (A, 3).

    The first global unknowns are the biases of the links. free: the first column of 3A displacements of the anchors,
    None where they stay; delay, scale: the column of the ranges' stamps, and of their scale, if any.
    """

    axes: Axes
    anchors_m: Float
    free: int | None = None
    delay: int | None = None
    scale: int | None = None

    def predict(self, slots: Slots, pose: Float, values: Float) -> tuple[Float, Float, Int, Float]:
        """Predictions (N,), slopes by pose (N, D), globals' columns and slopes (G, N); values (M,) of globals."""
        axes, first = self.axes, self.free
        place_m, swing_m = axes.places(pose, slots.lever_m)
        apart_m = np.vstack([place_m.T, slots.height_m]) - self.anchors_m.T.take(slots.anchor, axis=1)
        if first is not None:
            apart_m -= values[first : first + self.anchors_m.size].reshape(-1, 3)[slots.anchor].T
        if axes.z is not None:
            apart_m[2] += pose[:, axes.z]
        distance_m = np.sqrt(np.einsum("in,in->n", apart_m, apart_m))
        factor = 1.0 if self.scale is None else 1 + values[self.scale]
        unit = factor * apart_m / np.maximum(distance_m, 1e-6)
        by_pose = np.zeros((len(axes), len(pose)))
        by_pose[:2] = unit[:2]
        if axes.z is not None:
            by_pose[axes.z] = unit[2]
        if axes.yaw is not None:
            by_pose[axes.yaw] = np.einsum("in,ni->n", unit[:2], swing_m)
        columns, slopes = [slots.link], [np.ones(len(distance_m))]
        if first is not None:
            columns += [first + 3 * slots.anchor + axis for axis in range(3)]
            slopes += list(-unit)
        if self.scale is not None:
            columns, slopes = [*columns, np.full(len(distance_m), self.scale)], [*slopes, distance_m]
        return factor * distance_m + values[slots.link], by_pose.T, np.array(columns), np.array(slopes)


@dataclass(frozen=True, slots=True)
class Way:
    """Poses of base at t_s (M,) in a frame of its own: xy_m (M, 2), yaw_rad (M,) not wrapped."""

    t_s: Float
    xy_m: Float
    yaw_rad: Float

    def at(self, t_s: Float) -> tuple[Float, Float]:
        """xy_m (N, 2) and yaw (N,), interpolated."""
        x_m, y_m, yaw_rad = (np.interp(t_s, self.t_s, each) for each in (*self.xy_m.T, self.yaw_rad))
        return np.column_stack([x_m, y_m]), yaw_rad


class Steps:
    """An odometry's steps between knots in base, scale R(-psi) (p_1 - p_0) with psi halfway, and its turns between them
    in a frame of its own, turn_scale turn = psi_1 - psi_0 + drift dt; or its steps in map alone, p_1 - p_0.

    columns: of scale, drift and turn_scale, which is left out where that is 1; in map none. variances (K - 1,): of a
    step along each axis, and of a turn.
    """

    def __init__(
        self, timeline: Timeline, way: Way, axes: Axes, columns: tuple[int, ...], variances: tuple[Float, Float]
    ) -> None:
        after, self.axes, self.columns = np.searchsorted(way.t_s, timeline.t_s), axes, columns
        ends = after.clip(max=len(way.t_s) - 1), (after - 1).clip(0)
        near = np.min([np.abs(way.t_s[each] - timeline.t_s) for each in ends], axis=0) <= HOLD_S
        self.interval = np.flatnonzero(timeline.connected & near[1:] & near[:-1])
        (xy_m, yaw_rad), self.rows = way.at(timeline.t_s), 3 if columns else 2
        middle_rad = (yaw_rad[1:] + yaw_rad[:-1]) / 2 * bool(columns)
        step = np.column_stack([turned(-middle_rad, np.diff(xy_m, axis=0)), np.diff(yaw_rad)])
        self.step, self.dt_s = step[self.interval, : self.rows], np.diff(timeline.t_s)[self.interval]
        self.weight = 1 / np.column_stack([variances[0], *variances])[self.interval, : self.rows].ravel()

    def linearise(self, knots: Float, values: Float) -> tuple[Rows, Float]:
        """Rows of both axes and the turn, and one over their variances."""
        before, after = knots[self.interval, 0], knots[self.interval + 1, 0]
        n, size, yaw, scale, middle_rad = len(before), len(self.axes), self.axes.yaw or 0, 1.0, np.zeros(len(before))
        if self.columns:
            scale, middle_rad = values[self.columns[0]], (before[:, yaw] + after[:, yaw]) / 2
        cos, sin, moved_m = np.cos(middle_rad), np.sin(middle_rad), turned(-middle_rad, (after - before)[:, :2])
        local, slope = np.zeros((4 * size, n, self.rows)), np.zeros((len(self.columns), n, self.rows))
        residual = self.step.copy()
        residual[:, :2] -= scale * moved_m
        for first, sign in ((0, -1.0), (2 * size, 1.0)):
            local[first : first + 2, :, :2] = sign * scale * np.array([[cos, -sin], [sin, cos]]).transpose(0, 2, 1)
            if self.columns:
                local[first + yaw, :, :2] = scale / 2 * moved_m[:, ::-1] * [1, -1]
                local[first + yaw, :, 2] = sign
        if self.columns:
            slope[0, :, :2], slope[1, :, 2] = moved_m, self.dt_s
            residual[:, 2] -= after[:, yaw] - before[:, yaw] + values[self.columns[1]] * self.dt_s
        for column in self.columns[2:]:
            residual[:, 2] += (values[column] - 1) * self.step[:, 2]
            slope[2, :, 2] = -self.step[:, 2]
        columns = np.repeat(np.array(self.columns, dtype=np.int64)[:, None], self.rows * n, axis=1)
        rows = np.repeat(self.interval, self.rows), local.reshape(4 * size, -1), residual.ravel()
        return Rows(*rows, columns, slope.reshape(columns.shape)), self.weight
