"""From the ranges of the tags of one body to its track: start, cuts where it was carried away, batch, covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from quadlog.messages import Float, Int
from quadlog.positioning.batch.factors import ERRORS_LAST_S, Axes, RangeModel, Steps, TagRanges, Way
from quadlog.positioning.batch.links import delete_anchors, range_priors
from quadlog.positioning.batch.motion import Timeline, lifting, make_timeline, turning, walking
from quadlog.positioning.batch.robust import USUAL_RANGES, USUAL_STD_M, link_stds
from quadlog.positioning.batch.solve import Estimate, Problem, posterior_of_globals, solve

KNOT_S = 0.2
"""Between knots; ranges of a link are averaged from each to the next."""
LONGEST_GAP_S = 2.0
"""After so long without a range a new segment begins."""
SCALE_STD, DRIFT_STD_RADPS, WALK_STD = 0.05, 0.003, 0.003
"""Of an odometry: its scale, the drift of its yaw, and the random walk of that (rad/sqrt s)."""
JUMP_STRESS, JUMP_SHORT_SHARE, SHORT_STD = 20.0, 0.1, 4.0
"""A second of track is suspected where the motion's normalised residuals sum to more, and more ranges are too short:
nothing in the way makes ranges short. Bursts on three anchors reach 6 and 0.01, jumps of 2 m 23 and 0.12."""
JUMP_FIXES, JUMP_STD, JUMP_SCATTER, MOST_REPEATS = 4, 10.0, 3.0, 2
"""The means of so many fixes before and after a jump are at least so many std of a range apart, and so many times as
far as these scatter. So a jump is believed after four fixes, a causal track errs until then."""

HARDLY_LATE_STD = 0.05
"""By so much of a std late ranges that seem to be in sight move biases. Chosen on seeds 501, 502, 711 and 712."""

MUCH_FITTED, MOST_REFITS, SETTLED_STD = 0.15, 4, 0.05
"""Where a track takes up more of its ranges' squared errors, their std is estimated for that; and until it settles."""
LEAST_SCALE, SCALE_STDS = 0.01, 10.0
"""A scale is taken for real if it is larger, by so many std, leaving out anchors included: far ranges are late more
often, which looked like a scale of up to 9.1 std on simulated walks; a real one of 7 % was clear by 10.5."""


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """range_std_m: None where estimated; height_std_m: zero where not tracked; calibrate: a bias for each link."""

    range_std_m: float | None
    acceleration_std_mps2: float
    height_std_m: float
    calibrate: bool


@dataclass(frozen=True, slots=True)
class Starts:
    """Where a track may start: at rising t_s (F,), pose (F, 2) in x, y, or (F, 3) with yaw, not wrapped."""

    t_s: Float
    pose: Float


@dataclass(frozen=True, slots=True)
class Odometry:
    """A way with the std (M,) of a second's mean velocity at each of its instants.

    In a frame of its own, for a body whose yaw is tracked, or in_map, as it was known at each instant.
    """

    way: Way
    std_mps: Float
    in_map: bool

    def steps(self, timeline: Timeline, axes: Axes, column: int) -> tuple[Steps, ...]:
        """Between knots, the scale being in a column and the drift in the next; in map by what had come by the last."""
        n = int(np.searchsorted(self.way.t_s, timeline.t_s[-1], side="right")) if self.in_map else len(self.way.t_s)
        if n < 2:
            return ()
        way = Way(self.way.t_s[:n], self.way.xy_m[:n], self.way.yaw_rad[:n])
        dt_s, middle_s = np.diff(timeline.t_s), (timeline.t_s[1:] + timeline.t_s[:-1]) / 2
        variance_m2 = np.interp(middle_s, way.t_s, self.std_mps[:n]) ** 2 * ERRORS_LAST_S * dt_s
        columns = () if self.in_map else (column, column + 1)
        return (Steps(timeline, way, axes, columns, (variance_m2, WALK_STD**2 * dt_s)),)


@dataclass(frozen=True)
class Body:
    """R > 0 ranges in time order of a body's tags among anchors; cuts_s: carried away; yaw: whether that is tracked."""

    ranges: TagRanges
    anchors_m: Float
    settings: TrackSettings
    cuts_s: Float
    yaw: bool = False
    motion: Odometry | None = None
    scaled: bool | None = None

    @cached_property
    def timeline(self) -> Timeline:
        """The knots."""
        t_s = self.ranges.t_s
        return make_timeline(t_s, KNOT_S, LONGEST_GAP_S, self.cuts_s[self.cuts_s > t_s[0]])

    @property
    def axes(self) -> Axes:
        """The coordinates that are tracked."""
        motions, lifted = [walking(self.settings.acceleration_std_mps2)] * 2, self.settings.height_std_m > 0
        motions += [lifting(self.settings.height_std_m)] * lifted + [turning()] * self.yaw
        return Axes(tuple(motions), 2 if lifted else None, len(motions) - 1 if self.yaw else None)

    def problem(self) -> Problem:
        """All measurements; globals are the biases of the links, the scale of the ranges, then those of its motion."""
        from scipy.linalg import block_diag  # slow to import

        n = self.ranges.n_links
        priors = range_priors(n, self.settings.calibrate, bool(self.scaled))
        mean, others = np.zeros(n + 1), tuple[Steps, ...]()
        if self.motion is not None:
            others = self.motion.steps(self.timeline, self.axes, n + 1)
        if self.motion is not None and not self.motion.in_map:  # its scale, and the drift of its yaw
            mean, own = np.append(mean, [1.0, 0.0]), np.diag([SCALE_STD**2, DRIFT_STD_RADPS**2])
            priors = np.array([block_diag(prior, own) for prior in priors])
        model, slots = RangeModel(self.axes, self.anchors_m, scale=n), self.ranges.slots(self.timeline.t_s)
        std_m, calibrated = self.settings.range_std_m, self.settings.calibrate
        return Problem(self.timeline, model, slots, std_m, mean, priors, others, calibrated=calibrated)

    def knots_from(self, starts: Starts, timeline: Timeline) -> Float:
        """(K, 2, D) knots that stand at their places between starts."""
        axes = self.axes
        knots, own = np.zeros((len(timeline.t_s), 2, len(axes))), [0, 1] if axes.yaw is None else [0, 1, axes.yaw]
        for axis, each in zip(own, starts.pose.T, strict=False):
            knots[:, 0, axis] = np.interp(timeline.t_s, starts.t_s, each)
        return knots


@dataclass(frozen=True, slots=True)
class Tracked:
    """known (R,): all ranges; restarts_s: where the body was carried away; last: the estimate.

    covariance (K, 2D, 2D): of its knots, raised by what positions differ by without each anchor, for the place by
    spread. without: the globals (G, M) without each of some anchors (G,).
    """

    body: Body
    known: np.ndarray
    restarts_s: Float
    last: Estimate
    covariance: Float
    spread: float
    without: tuple[Int, Float]

    def poses(self, t_s: Float) -> tuple[Float, Float, Float]:
        """Coordinates and rates (N, D) at instants (N,), and their covariances (N, 2D, 2D)."""
        sampling = self.last.problem.timeline.sample(t_s)
        row, after = sampling.interval, sampling.value[2][:, None, None]
        covariance = (1 - after) * self.covariance[row] + after * self.covariance[row + 1]
        return *sampling.of(self.last.knots), covariance

    def of_ranges(self) -> tuple[Float, Float, Float]:
        """(R,) residuals, weights, and squares over their due variance, for a mean weight of one."""
        problem, weights, given = self.last.problem, self.last.weights, self.body.ranges
        slots, of = problem.slots, problem.slots.of_given
        pose, rate, _ = self.poses(slots.t_s)
        _, slope, _, _ = problem.model.predict(slots, pose, self.last.values)
        trust = max(float(weights.knots.mean()), 1e-3) * (1 - self.last.fitted_share())
        speed_mps = np.einsum("ni,ni->n", slope, rate)[slots.slot]
        residual_m = self.last.linear.residual_m - slots.range_m + speed_mps * slots.range_t_s
        residual_m = residual_m[of] + given.range_m - speed_mps[of] * given.t_s
        weight, variance_m2 = weights.knots[of], weights.std_m[slots.range_link[of]] ** 2
        return residual_m, weight, weight * residual_m**2 / (variance_m2 * trust)

    def biases(self) -> tuple[Float, Float]:
        """Of all links (L,), and their std."""
        n, (anchors, values) = self.body.ranges.n_links, self.without
        weights, variance_m2 = self.last.weights, np.diag(self.last.covariance)[:n]
        if weights.blocked:
            variance_m2 = variance_m2 + (HARDLY_LATE_STD * weights.std_m) ** 2
        if len(anchors):
            # What is left of a link's bias without its own anchor is the prior.
            own = np.arange(n) % self.body.ranges.n_anchors == anchors[:, None]
            values = np.where(own, np.nan, values[:, :n])
            count = np.isfinite(values).sum(axis=0)
            off_m = values - np.nanmean(values, axis=0)
            variance_m2 = variance_m2 + (count - 1) / count * np.nansum(off_m**2, axis=0)
        return self.last.values[:n], np.sqrt(variance_m2)

    def scale(self) -> tuple[float, float]:
        """Of all ranges less one, and its std; zero where they show none."""
        if not self.body.scaled:
            return 0.0, 0.0
        n, without = self.body.ranges.n_links, self.without[1]
        off = without[:, n] - without[:, n].mean() if len(without) else np.zeros(1)
        variance = self.last.covariance[n, n] + (len(off) - 1) / len(off) * float(off @ off)
        return float(self.last.values[n]), float(np.sqrt(variance))

    def corrected(self, t_s: Float, range_m: Float) -> Float:
        """Ranges (N, L) of all links at instants (N,) without biases and scale."""
        n = self.body.ranges.n_links
        return (range_m - self.last.values[:n]) / (1 + self.last.values[n])


def track_body(body: Body, starts: Starts, *, final: bool = True) -> Tracked:
    """The track of a body from F > 0 starts; final: not one that odometry is to steady.

    Jumps are looked for where no yaw is tracked, of a tag by itself; what has a yaw starts from a track without them.
    """
    for _ in range(1 + MOST_REPEATS):
        problem, knots = body.problem(), body.knots_from(starts, body.timeline)
        if body.yaw:
            knots[:, 1] = np.gradient(knots[:, 0], body.timeline.t_s, axis=0)
        estimate = solve(problem, knots, problem.mean)
        jumps_s = body.cuts_s[:0] if body.yaw else np.setdiff1d(find_jumps(estimate, starts), body.cuts_s)
        if len(jumps_s) == 0:
            break
        body = replace(body, cuts_s=np.union1d(body.cuts_s, jumps_s))
    if final and problem.range_std_m is None and (taken := estimate.fitted_share()) > MUCH_FITTED:
        estimate = _refined(estimate, estimate.weights.std_m / np.sqrt(1 - taken))
    tracked = _tracked(replace(body, scaled=bool(body.scaled)), estimate)
    if body.scaled is not None or not body.settings.calibrate:
        return tracked
    scaled = replace(body, scaled=True)
    priors, n = scaled.problem().priors, body.ranges.n_links
    both = replace(estimate.problem, priors=np.concatenate([estimate.problem.priors, priors]))
    step, _, shares = posterior_of_globals(both, estimate.for_globals, estimate.values)
    if shares[len(priors) :].sum() <= 0.5 or abs(step[n]) <= LEAST_SCALE / 2:  # they favour none
        return tracked
    problem = replace(estimate.problem, priors=priors, range_std_m=estimate.weights.std_m)
    other = solve(problem, estimate.knots, estimate.values, warm=True)
    found = _tracked(scaled, other)
    off, std = found.scale()
    if abs(off) <= max(LEAST_SCALE, SCALE_STDS * std):
        return tracked
    return _tracked(scaled, _refined(other, estimate.weights.std_m)) if body.settings.range_std_m is None else found


def _tracked(body: Body, estimate: Estimate) -> Tracked:
    """With covariances that are raised by what single anchors change."""
    size, own = len(body.axes), estimate.knot_covariances
    raised, (anchors, knots, values) = own.copy(), delete_anchors(estimate)
    if len(anchors):
        # Jackknife, (m - 1)/m sum (q - mean)^2, less what it overstates: each of m anchors has a share of 2/m in a
        # place. x and y are raised alike; height and yaw each by themselves.
        off, m, axis = knots[:, :, 0] - knots[:, :, 0].mean(axis=0), len(anchors), np.array([0, 0, 1, 2])[:size]
        spread = (m - 2) / m * np.bincount(axis, (off**2).sum(axis=0).mean(axis=0))
        scale = np.sqrt(1 + spread / np.bincount(axis, np.diagonal(own.mean(axis=0))[:size]))[axis]
        raised[:, :size, :size] *= scale[:, None] * scale
    spread = np.trace(raised[:, :2, :2].mean(axis=0)) / np.trace(own[:, :2, :2].mean(axis=0))
    known = np.ones(len(body.ranges.t_s), dtype=bool)
    return Tracked(body, known, body.cuts_s, estimate, raised, float(spread), (anchors, values))


def _refined(estimate: Estimate, std_m: Float) -> Estimate:
    """Solved again with a std of each link's ranges (L,), for the part of their errors that a fit takes up."""
    for _ in range(MOST_REFITS):
        problem = replace(estimate.problem, range_std_m=std_m)
        estimate = solve(problem, estimate.knots, estimate.values, warm=True)
        slots, prior = problem.slots, (USUAL_STD_M, USUAL_RANGES)
        own_m = link_stds(estimate.linear.residual_m, slots.range_link, slots.n_links, prior)
        own_m /= np.sqrt(1 - estimate.fitted_share())
        if np.abs(own_m / std_m - 1).max() < SETTLED_STD:
            break
        std_m = own_m
    return estimate


def find_jumps(estimate: Estimate, starts: Starts) -> Float:
    """Instants at which a tag jumped to another place, from an estimate that ignores jumps: between the fixes that are
    farthest apart where the motion is stressed and ranges are short.
    """
    problem, timeline = estimate.problem, estimate.problem.timeline
    std_m = estimate.weights.std_m
    short = estimate.linear.residual_m < -SHORT_STD * std_m[problem.slots.range_link]
    if len(starts.t_s) < 2 * JUMP_FIXES or not short.any():
        return np.empty(0)
    stress = problem.stress(estimate.knots) * timeline.connected
    stress[timeline.firsts[timeline.firsts < len(stress)]] = 0.0  # these hold what is known of a start
    interval, second = problem.sampling.interval[problem.slots.slot], np.ones(round(1 / KNOT_S))
    counts = [np.bincount(interval, each, len(stress)) for each in (np.ones(len(short)), short)]
    n, shorts, stress = (np.convolve(each, second, "same") for each in (*counts, stress))
    suspect = (stress > JUMP_STRESS) & (shorts > JUMP_SHORT_SHARE * n)
    sides = sliding_window_view(starts.pose[:, :2], 2 * JUMP_FIXES, axis=0).reshape(-1, 2, 2, JUMP_FIXES)
    step_m, at_s = np.hypot(*np.diff(sides.mean(axis=3))[..., 0].T), starts.t_s[JUMP_FIXES : 1 - JUMP_FIXES]
    step_m[step_m < JUMP_SCATTER * np.sqrt(sides.var(axis=3).sum(axis=(1, 2)))] = 0.0
    found: list[float] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], suspect.astype(np.int64), [0]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        inside = slice(*np.searchsorted(at_s, [timeline.t_s[first] - 0.5, timeline.t_s[end] + 0.5]))
        if step_m[inside].max(initial=0.0) > JUMP_STD * np.median(std_m):
            cut_s = float(at_s[inside][np.argmax(step_m[inside])])
            found += [cut_s] if all(abs(cut_s - other) > 0.5 for other in found) else []
    return np.array(sorted(found))
