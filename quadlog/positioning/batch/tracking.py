"""From the ranges of the tags of one body to its track: start, cuts where it was carried away, batch, covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from quadlog.messages import Float, Int
from quadlog.positioning.batch.factors import (
    ERRORS_LAST_S,
    Axes,
    Border,
    Moves,
    RangeModel,
    Steps,
    TagRanges,
    Turns,
    Way,
)
from quadlog.positioning.batch.links import Deleted, bias_priors, delete_anchors
from quadlog.positioning.batch.motion import Track, lifting, turning, walking
from quadlog.positioning.batch.solve import Estimate, Factor, Problem, solve
from quadlog.positioning.batch.spline import Timeline, make_timeline

KNOT_S = 0.2
"""Between knots; ranges of a link are averaged from each to the next."""
LONGEST_GAP_S = 2.0
"""After so long without a range a new segment begins."""
STAMP_STD_S = 0.05
"""How well the stamps of ranges are known: radios, drivers and references have clocks of their own, unknown to the
ranges. Real recordings were 0.08 and 0.11 s off."""
SCALE_STD, DRIFT_STD_RADPS, WALK_STD = 0.05, 0.003, 0.003
"""Of an odometry: its scale, the drift of its yaw, and the random walk of that (rad/sqrt s)."""
STIFF_SHORT_SHARE, SOFTER, MOST_REPEATS = 0.03, 10.0, 2
"""Where more ranges are too short, the body moves harder than assumed: its acceleration is let go."""

JUMP_STRESS, JUMP_SHORT_SHARE = 20.0, 0.1
"""A second of track is suspected where the motion's normalised residuals sum to more, and more ranges are too short:
nothing in the way makes ranges short. Bursts on three anchors reach 6 and 0.01, jumps of 2 m 23 and 0.12."""
SHORT_STD = 4.0
FEWEST_FIXES = 4
JUMP_STD = 10.0
"""A jump is at least so many std of a range."""


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """height_std_m: of the given heights, zero where they are not tracked; calibrate: estimate a bias for each link."""

    range_std_m: float
    acceleration_std_mps2: float
    height_std_m: float
    calibrate: bool


@dataclass(frozen=True, slots=True)
class Starts:
    """Where a track may start: at rising t_s (F,), pose (F, 2) in x, y, or (F, 3) with yaw, not wrapped."""

    t_s: Float
    pose: Float

    def at(self, t_s: Float) -> Float:
        """(N, 2) or (N, 3) poses between them."""
        return np.column_stack([np.interp(t_s, self.t_s, each) for each in self.pose.T])


@dataclass(frozen=True, slots=True)
class Odometry:
    """A way with the std (M,) of a second's mean velocity at each of its instants.

    In a frame of its own, for a body whose yaw is tracked, or in_map, as it was known at each instant.
    """

    way: Way
    std_mps: Float
    in_map: bool

    @property
    def globals(self) -> tuple[Float, Float]:
        """Mean and std of its own globals: the drift of its yaw, and its scale; none in map."""
        n = 0 if self.in_map else 2
        return np.array([0.0, 1.0])[:n], np.array([DRIFT_STD_RADPS, SCALE_STD])[:n]

    def factors(self, timeline: Timeline, axes: Axes, column: int) -> tuple[Factor, ...]:
        """Turns and steps between knots, the drift being in a column and the scale in the next; in map steps alone, by
        what had come by the last knot.
        """
        n = int(np.searchsorted(self.way.t_s, timeline.t_s[-1], side="right")) if self.in_map else len(self.way.t_s)
        if n < 2:
            return ()
        way = Way(self.way.t_s[:n], self.way.xy_m[:n], self.way.yaw_rad[:n])
        dt_s, middle_s = np.diff(timeline.t_s), (timeline.t_s[1:] + timeline.t_s[:-1]) / 2
        variance_m2 = np.interp(middle_s, way.t_s, self.std_mps[:n]) ** 2 * ERRORS_LAST_S * dt_s
        if self.in_map:
            return (Moves(timeline, way, len(axes), variance_m2),)
        turns = Turns(timeline, way, axes, (column, None), WALK_STD**2 * dt_s)
        return turns, Steps(timeline, way, axes, column + 1, variance_m2)


@dataclass(frozen=True)
class Body:
    """What the track of a body with one tag or several is estimated from: R > 0 ranges in time order among anchors.

    cuts_s: where it was carried away; softer: by how much the variance of its acceleration is raised; yaw: whether
    that is tracked.
    """

    ranges: TagRanges
    anchors_m: Float
    settings: TrackSettings
    cuts_s: Float
    softer: float = 1.0
    yaw: bool = False
    motion: Odometry | None = None

    @cached_property
    def timeline(self) -> Timeline:
        """The knots."""
        t_s = self.ranges.t_s
        return make_timeline(t_s, KNOT_S, LONGEST_GAP_S, self.cuts_s[self.cuts_s > t_s[0]])

    @property
    def axes(self) -> Axes:
        """The coordinates that are tracked."""
        motions = [walking(self.settings.acceleration_std_mps2 * float(np.sqrt(self.softer)))] * 2
        z = len(motions) if self.settings.height_std_m > 0 else None
        if z is not None:
            motions.append(lifting(self.settings.height_std_m))
        if self.yaw:
            motions.append(turning())
        return Axes(tuple(motions), z, len(motions) - 1 if self.yaw else None)

    def problem(self) -> Problem:
        """All measurements; globals are the biases of the links, then those of its motion."""
        n = self.ranges.n_links
        priors, mean, others = bias_priors(n, self.settings.calibrate), np.zeros(n), tuple[Factor, ...]()
        if self.motion is not None:
            own_mean, own_std = self.motion.globals
            others = self.motion.factors(self.timeline, self.axes, n)
            mean = np.append(mean, own_mean)
            priors = np.array([block_diag(prior, np.diag(own_std**2)) for prior in priors])
        model = RangeModel(self.axes, Border(n, len(mean)), self.anchors_m)
        slots = self.ranges.slots(self.timeline.t_s)
        return Problem(self.timeline, model, slots, self.settings.range_std_m, mean, priors, others)

    def knots_from(self, starts: Starts) -> Float:
        """(K, 2, D) knots at their places between starts, moving as these do."""
        knots, axes = np.zeros((len(self.timeline), 2, len(self.axes))), self.axes
        own = [0, 1] if axes.yaw is None else [0, 1, axes.yaw]
        knots[:, 0, own] = starts.at(self.timeline.t_s)[:, : len(own)]
        return knots


@dataclass(frozen=True, slots=True)
class Tracked:
    """last: the estimate; covariance (K, 2D, 2D): of its knots; excess: by how much that of the place was raised.

    deleted: without each anchor, None with fewer than three.
    """

    body: Body
    last: Estimate
    covariance: Float
    excess: float
    deleted: Deleted | None

    @property
    def known(self) -> np.ndarray:
        """(R,) bool, the ranges with which there is a pose: all."""
        return np.ones(len(self.body.ranges.t_s), dtype=bool)

    @property
    def restarts_s(self) -> Float:
        """Where the body was carried away."""
        return self.body.cuts_s

    def poses(self, t_s: Float) -> tuple[Float, Float, Float]:
        """Coordinates and rates (N, D) at instants (N,), and their covariances (N, 2D, 2D)."""
        pose, rate = self.last.at(t_s)
        return pose, rate, self.last.problem.timeline.between(t_s, self.covariance)

    def track(self, t_s: Float, t_ns: Int, tag: int | None) -> Track:
        """Of a tag, or of the body's origin, at t_ns (N,), which are t_s."""
        return track_of(self.body, t_ns, self.poses(t_s), np.array([self.excess]), tag)

    def of_ranges(self) -> tuple[Float, Float, Float]:
        """For each of the body's ranges (R,): residual, weight, and its square over the variance that it should have.

        The last as a track that fits R ranges with D numbers leaves it, and for a mean weight of one.
        """
        problem, weights = self.last.problem, self.last.weights
        slots, axes, residual_m = problem.slots, problem.model.axes, self.last.linear.residual_m
        pose, _, covariance = self.poses(slots.t_s)
        _, slope, _, _ = problem.model.predict(slots, pose, self.last.values)
        known = np.einsum("ni,nij,nj->n", slope, covariance[:, : len(axes), : len(axes)], slope) / self.excess
        variance_m2 = problem.range_std_m**2
        fitted = float((weights.knots * known[slots.slot]).mean()) / (weights.lasts * variance_m2)
        trust = max(float(weights.knots.mean()), 1e-3) * (1 - min(fitted, 0.9))
        found = np.empty((3, len(residual_m)))
        found[:, slots.order] = residual_m, weights.knots, weights.knots * residual_m**2 / (variance_m2 * trust)
        return found[0], found[1], found[2]

    def biases(self) -> tuple[Float, Float]:
        """Of all links (L,), and their std."""
        n = self.body.ranges.n_links
        variance_m2 = np.diag(self.last.covariance)[:n]
        if self.deleted is not None:
            # What is left of a link's bias without its own anchor is the prior.
            own = np.arange(n) % self.body.ranges.n_anchors == self.deleted.anchors[:, None]
            values = np.where(own, np.nan, self.deleted.values[:, :n])
            count = np.isfinite(values).sum(axis=0)
            off_m = values - np.nanmean(values, axis=0)
            variance_m2 = variance_m2 + (count - 1) / count * np.nansum(off_m**2, axis=0)
        return self.last.values[:n], np.sqrt(variance_m2)


def track_of(body: Body, t_ns: Int, poses: tuple[Float, Float, Float], excess: Float, tag: int | None) -> Track:
    """Of a tag, or of the body's origin at the mean height of its tags.

    poses: coordinates and rates (N, D), and their covariances (N, 2D, 2D); excess: see Track.
    """
    pose, rate, covariance = poses
    axes, size, n = body.axes, len(body.axes), len(t_ns)
    lever_m = np.zeros(2) if tag is None else body.ranges.lever_m[tag]
    height_m = body.ranges.height_m.mean() if tag is None else body.ranges.height_m[tag]
    place_m, swing_m = axes.places(pose, np.broadcast_to(lever_m, (n, 2)))
    velocity_mps, change = rate[:, :2].copy(), np.zeros((n, 2, size))
    change[:, 0, 0] = change[:, 1, 1] = 1.0
    if axes.yaw is not None:
        velocity_mps += swing_m * rate[:, axes.yaw, None]
        change[:, :, axes.yaw] = swing_m
    own, rates, back = covariance[:, :size, :size], covariance[:, size:, size:], change.transpose(0, 2, 1)
    z_m, z_std_m = np.full(n, float(height_m)), np.zeros(n)
    if axes.z is not None:
        z_m, z_std_m = z_m + pose[:, axes.z], np.sqrt(own[:, axes.z, axes.z])
    place_m2, velocity_m2ps2 = change @ own @ back, change @ rates @ back
    return Track(t_ns, place_m, velocity_mps, place_m2, velocity_m2ps2, z_m, z_std_m, excess)


def track_body(body: Body, starts: Starts) -> Tracked:
    """The track of a body from F > 0 starts.

    Jumps are looked for where no yaw is tracked, of a tag by itself; what has a yaw starts from a track without them.
    """
    for _ in range(1 + MOST_REPEATS):
        problem, knots, jumps_s = body.problem(), body.knots_from(starts), body.cuts_s[:0]
        if body.yaw:
            knots[:, 1] = np.gradient(knots[:, 0], body.timeline.t_s, axis=0)
        estimate = solve(problem, knots, problem.mean)
        if not body.yaw:
            jumps_s = np.setdiff1d(find_jumps(estimate, starts), body.cuts_s)
        if len(jumps_s):
            body = replace(body, cuts_s=np.union1d(body.cuts_s, jumps_s))
        elif short_share(estimate) > STIFF_SHORT_SHARE:
            body = replace(body, softer=body.softer * SOFTER)
        else:
            break
    return finish(body, estimate)


def finish(body: Body, estimate: Estimate) -> Tracked:
    """With covariances: the model's, raised by what positions differ by without each anchor, and by the stamps."""
    size = len(body.axes)
    own = estimate.knot_covariances()
    raised, deleted = own.copy(), delete_anchors(estimate)
    if deleted is not None:
        # x and y are raised alike; height and yaw each by themselves.
        axis = np.append([0, 0], np.arange(1, size - 1))[:size]
        mean = np.bincount(axis, np.diagonal(own, axis1=1, axis2=2)[:, :size].mean(axis=0))
        scale = np.sqrt(1 + np.bincount(axis, deleted.variances().mean(axis=0)) / mean)[axis]
        raised[:, :size, :size] *= scale[:, None] * scale
    rate = estimate.knots[:, 1]
    raised[:, :size, :size] += STAMP_STD_S**2 * rate[:, :, None] * rate[:, None, :]
    excess = np.trace(raised[:, :2, :2].mean(axis=0)) / np.trace(own[:, :2, :2].mean(axis=0))
    return Tracked(body, estimate, raised, float(excess), deleted)


def short_share(estimate: Estimate) -> float:
    """Share of all ranges that are far too short, which no blocked path explains."""
    return float((estimate.linear.residual_m < -SHORT_STD * estimate.problem.range_std_m).mean())


def find_jumps(estimate: Estimate, starts: Starts) -> Float:
    """Instants at which a tag jumped to another place, from an estimate that ignores jumps.

    Suspected where the motion is stressed and ranges are short; a jump where lines through the fixes before and after
    miss each other by JUMP_STD.
    """
    problem, timeline = estimate.problem, estimate.problem.timeline
    short = estimate.linear.residual_m < -SHORT_STD * problem.range_std_m
    if len(starts.t_s) < 2 * FEWEST_FIXES or not short.any():
        return np.empty(0)
    stress = problem.stress(estimate.knots) * timeline.connected
    stress[timeline.firsts[timeline.firsts < len(stress)]] = 0.0  # these hold what is known of a start
    interval = problem.sampling.interval[problem.slots.slot]
    second = np.ones(round(1 / KNOT_S))
    n, shorts = (
        np.convolve(np.bincount(interval, each, len(stress)), second, "same") for each in (np.ones(len(short)), short)
    )
    suspect = (np.convolve(stress, second, "same") > JUMP_STRESS) & (shorts > JUMP_SHORT_SHARE * n)
    found: list[float] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], suspect.astype(np.int64), [0]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        cut_s = _change_point(starts, float(timeline.t_s[first]), float(timeline.t_s[end]), problem.range_std_m)
        if cut_s is not None and all(abs(cut_s - other) > 0.5 for other in found):
            found.append(cut_s)
    return np.array(sorted(found))


def _change_point(starts: Starts, low_s: float, high_s: float, std_m: float) -> float | None:
    """The instant within [low, high] around which two lines through the fixes about it fit best, if they jump."""
    best, least = None, np.inf
    for k in range(*np.searchsorted(starts.t_s, [low_s - 0.5, high_s + 0.5])):
        low, high = np.searchsorted(starts.t_s, [starts.t_s[k] - 1.0, starts.t_s[k] + 1.0])
        before, after = slice(min(low, max(k - FEWEST_FIXES, 0)), k), slice(k, max(high, k + FEWEST_FIXES))
        if k < FEWEST_FIXES or len(starts.t_s) - k < FEWEST_FIXES:
            continue
        ends, misfit = [], 0.0
        for side in (before, after):
            t_s = starts.t_s[side] - starts.t_s[k]
            line, rest, *_ = np.linalg.lstsq(np.column_stack([np.ones_like(t_s), t_s]), starts.pose[side], rcond=None)
            ends.append(line[0])
            misfit += float(rest.sum()) / len(t_s)
        gap_m = float(np.hypot(*(ends[1] - ends[0])))
        if gap_m > max(JUMP_STD * std_m, 3 * np.sqrt(misfit)) and misfit < least:
            best, least = float(starts.t_s[k]), misfit
    return best
