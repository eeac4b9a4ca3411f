"""What a robot could have known: the batch over the last few seconds, and what earlier ranges say of the globals."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.batch.robust import lateness_weights, link_windows
from quadlog.positioning.batch.solve import Estimate, Problem, refine
from quadlog.positioning.batch.spline import Timeline
from quadlog.positioning.batch.tracking import (
    KNOT_S,
    LONGEST_GAP_S,
    STAMP_STD_S,
    Body,
    Starts,
    find_jumps,
    track_of,
)

STEP_S = 0.1
"""Ranges so close together are used at once, when the last of them has come."""
WINDOW_S = 3.0
"""With 2 s tracks of 8 ranges/s err by up to 5 % more."""
ROUNDS = 5
"""At most, of each step; one is enough where the last one was near."""
LASTS_S, LASTS_WORTH_S = 0.3, 3.0
"""How long errors of a link are taken to last before the log shows it, and how many seconds that guess is worth."""
BLOCK_S = 1.0


@dataclass(frozen=True, slots=True)
class Known:
    """What was known of a body after each of S steps, at t_s (S,).

    known (R,): the ranges with which there is a pose. state (S, 2D), covariance (S, 2D, 2D): of the pose and its rate
    then; values (S, M): of the globals. restarts_s: when it was found that the body had been carried away. last: the
    estimate in the end, of the last few seconds.
    """

    body: Body
    known: np.ndarray
    t_s: Float
    state: Float
    covariance: Float
    values: Float
    restarts_s: Float
    last: Estimate

    def poses(self, t_s: Float, *, before: bool = False) -> tuple[Float, Float, Float]:
        """Coordinates and rates (N, D) at instants (N,), and covariances (N, 2D, 2D), from what was known then.

        before: without a step at the instant itself.
        """
        at = self.steps(t_s, before=before)
        size, ahead_s = len(self.body.axes), t_s - self.t_s[at]
        pose, rate = self.state[at, :size], self.state[at, size:]
        density = np.array([each.density for each in self.body.axes.motions])
        move, shaken = np.tile(np.eye(2 * size), (len(at), 1, 1)), np.zeros((len(at), 2 * size, 2 * size))
        own = np.arange(size)
        move[:, own, size + own] = ahead_s[:, None]
        shaken[:, own, own] = ahead_s[:, None] ** 3 / 3 * density
        shaken[:, own, size + own] = shaken[:, size + own, own] = ahead_s[:, None] ** 2 / 2 * density
        shaken[:, size + own, size + own] = ahead_s[:, None] * density
        covariance = move @ self.covariance[at] @ move.transpose(0, 2, 1) + shaken
        return pose + ahead_s[:, None] * rate, rate, covariance

    def steps(self, t_s: Float, *, before: bool = False) -> Int:
        """(N,) the last step until each of the instants."""
        last: Int = (np.searchsorted(self.t_s, t_s, side="left" if before else "right") - 1).clip(0)
        return last

    def track(self, t_s: Float, t_ns: Int, tag: int | None) -> Track:
        """Of a tag, or of the body's origin, at t_ns (N,), which are t_s."""
        pose, rate, covariance = self.poses(t_s)
        excess = 1 + STAMP_STD_S**2 * (rate[:, :2] ** 2).sum(axis=1) / np.trace(covariance[:, :2, :2], axis1=1, axis2=2)
        size = pose.shape[1]
        covariance[:, :size, :size] += STAMP_STD_S**2 * rate[:, :, None] * rate[:, None, :]
        return track_of(self.body, t_ns, (pose, rate, covariance), excess, tag)

    def of_ranges(self) -> tuple[Float, Float, Float]:
        """For each of the body's ranges (R,): residual by the pose that was known with it, weight, and its squared
        innovation, by what was known before it, over the variance that this should have.
        """
        problem, slots, size = self.last.problem, self.body.ranges.single(), len(self.body.axes)
        std_m, found = problem.range_std_m, []
        for before in (False, True):
            pose, _, covariance = self.poses(slots.t_s, before=before)
            values = self.values[self.steps(slots.t_s, before=before)]
            predicted_m, slope, _, _ = problem.model.predict(slots, pose, np.zeros(values.shape[1]))
            residual_m = slots.range_m - predicted_m - values[np.arange(len(values)), slots.link]
            variance_m2 = std_m**2 + np.einsum("ni,nij,nj->n", slope, covariance[:, :size, :size], slope)
            found.append((residual_m, variance_m2))
        (residual_m, _), (innovation_m, variance_m2) = found
        order, weight = np.lexsort((slots.t_s, slots.link)), np.empty(len(residual_m))
        windows = link_windows(slots.t_s[order], slots.link[order])
        weight[order] = lateness_weights(windows, residual_m[order], std_m)
        return residual_m, weight, weight * innovation_m**2 / variance_m2 / max(float(weight.mean()), 1e-3)

    def biases_at(self, t_s: Float) -> Float:
        """(N, L) of all links as they were known at instants (N,), zero before the first step."""
        known: Float = self.values[self.steps(t_s), : self.body.ranges.n_links]
        return np.where(t_s[:, None] >= self.t_s[0], known, 0.0)

    def biases(self) -> tuple[Float, Float]:
        """Of all links (L,) as they are known in the end, and their std."""
        n = self.body.ranges.n_links
        return self.values[-1, :n], np.sqrt(np.diag(self.last.covariance)[:n])


class _Step(NamedTuple):
    """What was known at t_s: the last knot (2D,) with its covariance, values of the globals, and see Problem.past."""

    t_s: float
    state: Float
    covariance: Float
    values: Float
    past: tuple[Float, Float, Float]


class _Follower:
    """Follows a body, range by range."""

    def __init__(self, body: Body, starts: Starts) -> None:
        self.body, self.starts = body, starts
        self.found = [(cut_s, cut_s) for cut_s in body.cuts_s.tolist()]
        self.steps: list[_Step] = []
        self.block, self.squares, self.information = 0, 0.0, 0.0

    estimate: Estimate | None = None

    def follow(self) -> Known:
        """Step by step: at the first range of each STEP_S, which is known then."""
        t_s = self.body.ranges.t_s
        segment = np.append(0, np.cumsum(np.diff(t_s) > LONGEST_GAP_S))
        begin_s = t_s[np.append(True, np.diff(segment) > 0)]
        start = np.searchsorted(self.starts.t_s, begin_s).clip(max=len(self.starts.t_s) - 1)
        known = t_s >= self.starts.t_s[start][segment]
        number = np.floor(t_s[known] / STEP_S) + segment[known]
        for now_s in t_s[known][np.flatnonzero(np.diff(number, prepend=-1))].tolist():
            estimate = self.estimate = self._step(now_s)
            covariance = estimate.for_knots.last_covariance(estimate.covariance)
            self.steps.append(_Step(now_s, estimate.knots[-1].ravel(), covariance, estimate.values, estimate.past()))
        known_s, state, covariance, values = (np.array(each) for each in list(zip(*self.steps, strict=True))[:4])
        restarts_s = np.array([known_s for known_s, _ in self.found])
        return Known(self.body, known, known_s, state, covariance, values, restarts_s, estimate)

    def _step(self, now_s: float) -> Estimate:
        """The window until now, solved again where the body turns out to have been carried away.

        Of what came before it, what that said of the globals is kept.
        """
        ranges, begun = self.body.ranges, bisect_right(self.steps, now_s - WINDOW_S, key=lambda step: step.t_s)
        before = self.steps[begun - 1] if begun else None
        since_s = before.t_s if before else -np.inf
        rows = slice(*np.searchsorted(ranges.t_s, [since_s, now_s], side="right"))
        known = int(np.searchsorted(self.starts.t_s, now_s, side="right"))
        starts = Starts(self.starts.t_s[:known], self.starts.pose[:known])
        while True:
            cuts_s = np.unique([cut_s for known_s, cut_s in self.found if known_s <= now_s])
            problem = replace(self.body, ranges=ranges.rows(rows), cuts_s=cuts_s).problem()
            if before:
                problem = replace(problem, past=before.past)
            knots = self._guess(problem.timeline, starts)
            values_now = problem.mean if self.estimate is None else self.estimate.values
            estimate = refine(problem, knots, values_now, self._lasts(problem), ROUNDS)
            jumps_s = cuts_s[:0] if self.body.yaw else np.setdiff1d(find_jumps(estimate, starts), cuts_s)
            if len(jumps_s) == 0:
                break
            self.found += [(now_s, cut_s) for cut_s in jumps_s.tolist()]
        if before and since_s >= (self.block + 1) * BLOCK_S:
            self.block = int(since_s / BLOCK_S)
            self._take(estimate, since_s + BLOCK_S)
        return estimate

    def _take(self, estimate: Estimate, until_s: float) -> None:
        """Sums of residuals over the first second of a window show how many ranges of a link share an error."""
        slots, std_m = estimate.problem.slots, estimate.problem.range_std_m
        mine = slots.range_t_s < until_s
        information = estimate.weights.globals[mine] / std_m**2
        sums = np.bincount(slots.range_link[mine], estimate.linear.residual_m[mine] * information)
        heard = int(np.count_nonzero(sums))
        free = max(heard - len(estimate.problem.model.axes), 1) / max(heard, 1)
        self.squares += float((sums**2).sum()) / free
        self.information += float(information.sum())

    def _lasts(self, problem: Problem) -> float:
        """How many ranges of a link share an error, by the log so far, and a guess before it shows it."""
        slots, timeline = problem.slots, problem.timeline
        span_s = max(float(np.diff(timeline.t_s)[timeline.connected].sum()), KNOT_S)
        rate_hz = len(slots.range_m) / len(np.unique(slots.link)) / span_s
        guess = LASTS_WORTH_S * len(slots.range_m) / span_s / problem.range_std_m**2
        expected = guess * max(1.0, LASTS_S * rate_hz) + self.squares
        return float(max(1.0, expected / (guess + self.information)))

    def _guess(self, timeline: Timeline, starts: Starts) -> Float:
        """Knots going on from the last estimate, or from starts where a segment is new."""
        size, before = len(self.body.axes), self.estimate
        axes = [0, 1] if self.body.axes.yaw is None else [0, 1, self.body.axes.yaw]
        knots, first_s = np.zeros((len(timeline), 2, size)), timeline.t_s[timeline.firsts]
        if before is not None:
            pose, rate = before.at(timeline.t_s)
            ahead_s = (timeline.t_s - before.problem.timeline.t_s[-1]).clip(0.0)
            knots = np.stack([pose + ahead_s[:, None] * rate, rate], axis=1)
            old_s = before.problem.timeline.t_s[before.problem.timeline.firsts]
            new = np.abs(first_s[:, None] - old_s).min(axis=1) > 1e-6
            new[0] = first_s[0] > before.problem.timeline.t_s[-1]
            first_s = first_s[new]
        for each_s in first_s:
            new = timeline.t_s >= each_s
            since = starts.t_s >= min(each_s, starts.t_s[-1])
            knots[new] = 0.0
            knots[np.ix_(new, [0], axes)] = Starts(starts.t_s[since], starts.pose[since]).at(timeline.t_s[new])[
                :, None, : len(axes)
            ]
        return knots


def follow(body: Body, starts: Starts) -> Known:
    """The track of a body as it was known at each instant, of R > 0 ranges from its first start on.

    starts, and where the body was carried away, count from their own instants on; of a single tag that is looked for.
    """
    return _Follower(body, starts).follow()
