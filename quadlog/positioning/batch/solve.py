"""The batch: knots and global unknowns from all factors at once, by iteratively reweighted least squares.

The normal equations are an arrow: a band over the knots, and a thin border of global unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.batch import robust
from quadlog.positioning.batch.factors import RangeModel, Rows, Slots, Steps
from quadlog.positioning.batch.motion import Sampling, Timeline, motion_information

ROUNDS, PLAIN_ROUNDS, WHITE_ROUNDS, BLOCKED_ROUNDS = 24, 2, 5, 3
SETTLED_M, NEAR_M, FAR_M = 2e-3, 0.02, 0.1
NEAR_KNOTS, WALKING_MPS = 5, 0.2
"""A body slower than this over so many knots to either side stands, the more so the slower it is."""
TAKEN_SHARE, LEAST_FREE = 0.9, 0.2
"""Of errors that last, of n links, a track with D coordinates takes up this share of D/n, but leaves the second."""


class Arrow:
    """[[A, B], [B^T, C]] and its right side [a, c]: A banded over K knots of `size` numbers, C over `width` globals.

    Nothing is added once a solution was asked for.
    """

    def __init__(self, n_knots: int, size: int, width: int) -> None:
        self.n_knots, self.size, self.width = n_knots, size, width
        self.blocks, self.side = np.zeros((n_knots - 1, 2 * size, 2 * size)), np.zeros((n_knots, size))
        self.border = np.zeros((n_knots * size, width))
        self.corner, self.pull = np.zeros((width, width)), np.zeros(width)

    def copy(self) -> Arrow:
        """A copy that may be added to."""
        other = Arrow(self.n_knots, self.size, self.width)
        for name in ("blocks", "side", "border", "corner", "pull"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def add(self, rows: Rows, weight: Float) -> None:
        """Add measurements with weights (N,), one over their variances; a negative weight takes them away."""
        if len(weight) == 0:
            return
        firsts, size = np.flatnonzero(np.diff(rows.interval, prepend=-1)), self.size
        ends, both = np.append(firsts[1:], len(weight)), np.vstack([rows.local, rows.residual])
        n = ends - firsts
        usual = np.sort(n)[-1 - len(n) // 10]
        for begin in range(0, n.max(), usual):  # products of matrices add up; few intervals have more rows than usual
            some = np.flatnonzero(n > begin)
            row = firsts[some, None] + np.arange(begin, begin + usual)
            padded = both.take(row, axis=1, mode="clip")
            weighted = np.where(row < ends[some, None], weight.take(row, mode="clip"), 0.0) * padded
            sums, touched = weighted.transpose(1, 0, 2) @ padded.transpose(1, 2, 0), rows.interval[firsts[some]]
            self.blocks[touched] += sums[:, :-1, :-1]
            self.side[touched] += sums[:, :size, -1]
            self.side[touched + 1] += sums[:, size:-1, -1]
        weighted, row = weight * rows.local, rows.interval * size + np.arange(2 * size)[:, None]
        for column, slope in zip(rows.column, rows.slope, strict=True):
            cells, values = (row * self.width + column).ravel(), (weighted * slope).ravel()
            self.border += np.bincount(cells, values, self.border.size).reshape(self.border.shape)
            self.pull += np.bincount(column, weight * slope * rows.residual, self.width)
            for other, other_slope in zip(rows.column, rows.slope, strict=True):
                cells, values = column * self.width + other, weight * slope * other_slope
                self.corner += np.bincount(cells, values, self.corner.size).reshape(self.corner.shape)

    def add_motion(self, information: Float, knots: Float) -> None:
        """Add information (K - 1, 4D, 4D) about a zero of each two neighbouring knots of (K, 2, D)."""
        self.blocks += information
        pulls = (information @ _neighbours(knots)[:, :, None])[:, :, 0]
        self.side[:-1] -= pulls[:, : self.size]
        self.side[1:] -= pulls[:, self.size :]

    @cached_property
    def chol(self) -> Float:
        """The upper banded Cholesky factor U of A."""
        from scipy.linalg import cholesky_banded  # slow to import

        size, n, band = self.size, self.n_knots * self.size, 2 * self.size - 1
        upper = np.zeros((band + 1, n))
        for j in range(2 * size):
            for i in range(j + 1):
                upper[band + i - j, j : n - size + j : size] += self.blocks[:, i, j]
        return cholesky_banded(upper, check_finite=False)

    @cached_property
    def reduced(self) -> tuple[Float, Float]:
        """Information (M, M) about the globals, the knots being free: C - B^T A^-1 B, and the pull c - B^T A^-1 a."""
        from scipy.linalg.lapack import dtbtrs

        half = dtbtrs(self.chol, np.vstack([self.side.ravel(), self.border.T]).T, trans="T")[0]  # U^-T [a, B]
        inner = half.T @ half
        return self.corner - inner[1:, 1:], self.pull - inner[0, 1:]

    def step_of_knots(self, global_step: Float) -> Float:
        """(K, 2, D) step of the knots where the globals move by (M,)."""
        return self._solved(self.side.ravel() - self.border @ global_step).reshape(self.n_knots, 2, -1)

    def _solved(self, side: Float) -> Float:
        from scipy.linalg import cho_solve_banded

        solved: Float = cho_solve_banded((self.chol, False), side, check_finite=False)  # A^-1 side
        return solved

    def covariances(self, global_covariance: Float) -> Float:
        """(K, 2D, 2D) marginals of the knots by selected inversion, with that of the globals (M, M)."""
        size, count = self.size, self.n_knots
        column, above = np.arange(count * size).reshape(count, 1, size), np.arange(size)[:, None] - np.arange(size)
        own = np.where(above <= 0, self.chol[(above - 1).clip(max=-1), column], 0.0)
        next_ = self.chol[above - 1 - size, column[1:]]
        inverse = np.linalg.inv(own)
        gain, found = inverse[:-1] @ next_, inverse @ inverse.transpose(0, 2, 1)
        for k in range(count - 2, -1, -1):
            found[k] += gain[k] @ found[k + 1] @ gain[k].T
        reach = self._solved(self.border).reshape(count, size, -1)
        return found + reach @ global_covariance @ reach.transpose(0, 2, 1)


def _neighbours(knots: Float) -> Float:
    """(K - 1, 4D) each knot of (K, 2, D) and the next."""
    flat = knots.reshape(len(knots), -1)
    return np.concatenate([flat[:-1], flat[1:]], axis=1)


@dataclass(frozen=True)
class Problem:
    """All measurements and priors.

    mean (M,), priors (P, M, M): of the globals, and covariances that are possible a priori. others: beside the ranges.
    range_std_m: of ranges in sight, of all links or each (L,), None: estimated for each link. past: what earlier ranges
    say of the globals: values (M,), and information (M, M) and pull (M,) there. in_sight: ranges count by the
    probability of line of sight, for knots and globals. calibrated: links may have biases of their own.
    """

    timeline: Timeline
    model: RangeModel
    slots: Slots
    range_std_m: float | Float | None
    mean: Float
    priors: Float
    others: tuple[Steps, ...] = ()
    past: tuple[Float, Float, Float] | None = None
    in_sight: bool = False
    calibrated: bool = True

    @cached_property
    def sampling(self) -> Sampling:
        """Of the slots."""
        return self.timeline.sample(self.slots.t_s)

    @cached_property
    def windows(self) -> tuple[Int, Int]:
        """Of the ranges."""
        return robust.link_windows(self.slots.range_t_s, self.slots.range_link)

    @cached_property
    def heard(self) -> tuple[float, float]:
        """Seconds of the timeline without its gaps, and ranges of each link."""
        span_s = float(np.diff(self.timeline.t_s)[self.timeline.connected].sum())
        return max(span_s, 1e-3), len(self.slots.range_m) / len(np.unique(self.slots.link))

    @cached_property
    def prior_information(self) -> Float:
        """(P, M, M) inverse of the priors."""
        return np.linalg.inv(self.priors)

    @cached_property
    def motion(self) -> Float:
        """(K - 1, 4D, 4D) information about neighbouring knots."""
        return motion_information(self.model.axes.motions, self.timeline)

    def stress(self, knots: Float) -> Float:
        """(K - 1,) normalised squared misfit of the knots to the motion."""
        around = _neighbours(knots)
        return np.einsum("ki,kij,kj->k", around, self.motion, around)


@dataclass(frozen=True)
class Weights:
    """Of R ranges for the knots and for the globals (R,), and their noise: std_m (L,) of those in sight of each link.

    lasts (R,): how many ranges of a link share an error. blocked: whether paths are blocked, so that many ranges are
    late; None where that was not found out.
    """

    std_m: Float
    lasts: Float
    blocked: bool | None
    knots: Float = field(default_factory=lambda: np.ones(1))
    globals: Float = field(default_factory=lambda: np.ones(1))

    def information(self, slots: Slots) -> tuple[Float, Float]:
        """(R,) of each range, for the knots and for the globals."""
        variance_m2 = self.lasts * self.std_m[slots.range_link] ** 2
        return self.knots / variance_m2, self.globals / variance_m2


@dataclass(frozen=True, slots=True)
class Linearised:
    """The ranges at a state: rows of the slots, whose residuals are still open, and residuals (R,) of all ranges."""

    rows: Rows
    residual_m: Float

    def weighted(self, slots: Slots, weight: Float) -> tuple[Rows, Float]:
        """Rows of the slots with the weighted means of their residuals, and the sums of their weights."""
        total = np.maximum(slots.sums(weight), 1e-12)
        mean_m = slots.sums(weight * self.residual_m) / total
        return replace(self.rows, residual=mean_m), total


@dataclass(frozen=True)
class Estimate:
    """knots (K, 2, D), values (M,) of the globals with covariance (M, M), and the share (P,) of each prior in them.

    Weights and equations are those at the solution, but for a last step (M,) of the globals.
    """

    problem: Problem
    knots: Float
    values: Float
    covariance: Float
    shares: Float
    weights: Weights
    linear: Linearised
    for_globals: Arrow
    for_knots: Arrow
    last_step: Float

    def past(self) -> tuple[Float, Float, Float]:
        """What its ranges, and those before, say of the globals; see Problem."""
        information, pull = self.for_globals.reduced
        return self.values, information, pull - information @ self.last_step

    @cached_property
    def knot_covariances(self) -> Float:
        """(K, 2D, 2D) of the knots' coordinates and rates."""
        return self.for_knots.covariances(self.covariance)

    def fitted_share(self) -> float:
        """Share of the squared errors of the ranges that the knots take up, 0.9 at most."""
        problem, weights, axes = self.problem, self.weights, self.problem.model.axes
        slots, sampling, size = problem.slots, problem.sampling, len(axes)
        _, slope, _, _ = problem.model.predict(slots, sampling.of(self.knots)[0], self.values)
        after, covariance = sampling.value[2][:, None, None], self.knot_covariances[:, :size, :size]
        covariance = (1 - after) * covariance[sampling.interval] + after * covariance[sampling.interval + 1]
        known = np.einsum("ni,nij,nj->n", slope, covariance, slope)[slots.slot]
        return min(float((weights.knots * known / (weights.lasts * weights.std_m[slots.range_link] ** 2)).mean()), 0.9)


def linearise(problem: Problem, knots: Float, values: Float) -> Linearised:
    """The ranges at a state; each at its own time, to first order about its slot's."""
    slots, (pose, rate) = problem.slots, problem.sampling.of(knots)
    predicted_m, by_pose, column, slope = problem.model.predict(slots, pose, values)
    speed_mps = np.einsum("nd,nd->n", by_pose, rate)
    late_s, delay = slots.late_s, problem.model.delay
    if delay is not None:
        late_s = late_s + values[delay]
        column, slope = np.vstack([column, np.full(len(speed_mps), delay)]), np.vstack([slope, speed_mps])
    residual_m = slots.range_m - predicted_m[slots.slot] - speed_mps[slots.slot] * late_s
    local = (problem.sampling.value[:, None, :] * by_pose.T[None]).reshape(-1, len(by_pose))
    return Linearised(Rows(problem.sampling.interval, local, np.zeros(len(by_pose)), column, slope), residual_m)


def weigh(problem: Problem, residual_m: Float, noise: Weights) -> Weights:
    """Robust weights from residuals (R,) and their noise."""
    slots, std_m = problem.slots, noise.std_m[problem.slots.range_link]
    late = robust.lateness_weights(problem.windows, residual_m, std_m)
    if noise.blocked or problem.in_sight:
        sight, odd, _ = robust.sight_probabilities(slots.range_t_s, slots.range_link, residual_m, std_m)
        late, alike = sight if problem.in_sight else late * (sight + odd), sight
    else:
        alike = robust.symmetric_weights(residual_m, slots.range_link, std_m)
    return replace(noise, knots=late, globals=alike)


def judge(problem: Problem, residual_m: Float, weights: Weights, knots: Float) -> tuple[Weights, bool]:
    """The noise by what rounds so far show, and whether that is all.

    More ranges that are late than early show blocked paths; but where errors last, only if most are late: others are
    reflections. Three anchors are too few to show which is late; without calibration a link with a bias seems late.
    """
    slots, (span_s, n) = problem.slots, problem.heard
    std_m = weights.std_m[slots.range_link]
    excess = np.mean(residual_m > robust.LATE_BY_STD * std_m) - np.mean(residual_m < -robust.LATE_BY_STD * std_m)
    able = problem.calibrated and not problem.in_sight and len(np.unique(slots.anchor)) > 3
    if weights.blocked is None and able and excess > robust.BLOCKED_SHARE:
        return replace(weights, blocked=True), False
    lasts = persistence(problem, residual_m, weights, knots)
    white = np.median(lasts) <= max(robust.WHITE_S * n / span_s, robust.WHITE_RANGES)
    if weights.blocked and not white and excess <= robust.MOSTLY_SHARE:
        return replace(weights, blocked=False), False
    if weights.blocked:
        sight, odd, _ = robust.sight_probabilities(slots.range_t_s, slots.range_link, residual_m, std_m)
        lasts = lasts / robust.sure_share(slots.range_link, residual_m / std_m, sight, odd)
    return replace(weights, lasts=lasts), True


def walking_clock(timeline: Timeline, knots: Float) -> Float:
    """(K,) seconds at the knots by a clock that slows down with the body, and goes on between segments."""
    t_s, place_m, at = timeline.t_s, knots[:, 0, :2], np.arange(len(timeline.t_s))
    before, after = (at - NEAR_KNOTS).clip(0), (at + NEAR_KNOTS).clip(max=len(t_s) - 1)
    speed_mps = np.hypot(*(place_m[after] - place_m[before]).T) / (t_s[after] - t_s[before])
    return np.append(0.0, np.cumsum(np.diff(t_s) * np.minimum(speed_mps[1:] / WALKING_MPS, 1.0)))


def persistence(problem: Problem, residual_m: Float, weights: Weights, knots: Float) -> Float:
    """(R,) how many ranges of a link share an error.

    By a clock that slows down with the body: errors depend on the place, so those of a body that stands last.
    """
    slots, t_s, walked_s = problem.slots, problem.timeline.t_s, walking_clock(problem.timeline, knots)
    link, weight, heard = slots.range_link, weights.globals, len(np.unique(slots.link))
    std_m = weights.std_m[link]
    if problem.in_sight:  # Of ranges in sight alone errors seem to be white, of all to last for seconds.
        weight = np.sqrt(robust.symmetric_weights(residual_m, link, std_m) * weight)
    else:  # What lasts for the whole log is the biases'.
        mean_m = np.bincount(link, weight * residual_m) / np.maximum(np.bincount(link, weight), 1e-12)
        residual_m = residual_m - mean_m[link]
    free, clock_s = 1 - TAKEN_SHARE * len(problem.model.axes) / heard, np.interp(slots.range_t_s, t_s, walked_s)
    return robust.persistence(clock_s, link, weight * residual_m / std_m**2, max(free, LEAST_FREE))


def assemble(
    problem: Problem, linear: Linearised, weights: Weights, knots: Float, values: Float
) -> tuple[Arrow, Arrow]:
    """Normal equations for the globals and for the knots, which differ by the weights of the ranges."""
    for_globals = Arrow(len(knots), 2 * len(problem.model.axes), len(problem.mean))
    for_globals.add_motion(problem.motion, knots)
    for steps in problem.others:
        for_globals.add(*steps.linearise(knots, values))
    for_knots = for_globals if problem.in_sight else for_globals.copy()
    if problem.past is not None:
        at, information, pull = problem.past
        for_globals.corner += information
        for_globals.pull += pull - information @ (values - at)
    of_knots, of_globals = weights.information(problem.slots)
    for_globals.add(*linear.weighted(problem.slots, of_globals))
    if not problem.in_sight:
        for_knots.add(*linear.weighted(problem.slots, of_knots))
    return for_globals, for_knots


def posterior_of_globals(problem: Problem, arrow: Arrow, values: Float) -> tuple[Float, Float, Float]:
    """Step (M,) and covariance (M, M) of the globals, the knots being free, and the share (P,) of each prior.

    A mean over the possible priors: each, P, counts by how likely the log is under it [Laplace]. With information L
    about the globals and gradient g at their prior mean, log p = (g^T (L + P^-1)^-1 g - log |I + L P|) / 2.
    """
    (information, pull), off = arrow.reduced, values - problem.mean
    gradient = pull + information @ off
    covariances = np.linalg.inv(information + problem.prior_information)
    means = covariances @ gradient
    volumes = np.linalg.slogdet(np.eye(len(off)) + information @ problem.priors)[1]
    evidence = (means @ gradient - volumes) / 2
    shares = np.exp(evidence - evidence.max())
    shares /= shares.sum()
    mean = shares @ means
    apart = means - mean
    covariance = np.einsum("p,pij->ij", shares, covariances + apart[:, :, None] * apart[:, None, :])
    return mean - off, covariance, shares


def solve(
    problem: Problem,
    knots: Float,
    values: Float,
    known: Weights | None = None,
    rounds: int = ROUNDS,
    *,
    warm: bool = False,
) -> Estimate:
    """Iterate from a start: the globals with weights that are alike on both sides, the knots with lateness weights.

    One-sided weights would shift a bias, unless paths are blocked: then a link's median may be late, and ranges count
    by the probability of line of sight, for both. Rounds: all ranges with weight one; robust weights, the std of ranges
    being estimated, errors taken as white; then, after some more where paths are blocked, the persistence of the errors
    is estimated, once, as motion that a stiffer track cannot follow would look like it. warm: the start is near enough
    for robust weights. known: the noise; then the start is warm, and a move of NEAR_M is the last.
    """
    n, n_links, moved_m = len(problem.slots.range_m), problem.slots.n_links, np.inf
    given_m = robust.USUAL_STD_M if problem.range_std_m is None else problem.range_std_m
    weights = known or Weights(np.full(n_links, given_m), np.ones(n), None)
    linear, settled, due = linearise(problem, knots, values), known is not None, WHITE_ROUNDS
    for index in range(rounds):
        if warm or known or index >= PLAIN_ROUNDS:
            if problem.range_std_m is None and not settled:
                seen = linear.residual_m, problem.slots.range_link, n_links, (robust.USUAL_STD_M, robust.USUAL_RANGES)
                weights = replace(weights, std_m=robust.link_stds(*seen, by_zero=weights.blocked is not False))
            weights = weigh(problem, linear.residual_m, weights)
            if not settled and index >= due and (moved_m < FAR_M or index >= due + WHITE_ROUNDS):
                weights, settled = judge(problem, linear.residual_m, weights, knots)
                weights, due = weigh(problem, linear.residual_m, weights), index + BLOCKED_ROUNDS
        for_globals, for_knots = assemble(problem, linear, weights, knots, values)
        global_step, covariance, shares = posterior_of_globals(problem, for_globals, values)
        step = for_knots.step_of_knots(global_step)
        moved_m = max(np.abs(step[:, 0]).max(), np.abs(global_step).max(initial=0.0))
        if not known and (index == rounds - 1 or (settled and moved_m < SETTLED_M)):
            global_step = 0.0 * global_step  # what is left of a way is not gone: equations are those at the solution
            break
        knots, values = knots + step, values + global_step
        linear = linearise(problem, knots, values)
        if known and moved_m < NEAR_M:
            break
    return Estimate(problem, knots, values, covariance, shares, weights, linear, for_globals, for_knots, global_step)
