"""What a robot could have known: the batch over the last few seconds, and what earlier ranges say of the globals."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.batch.motion import Timeline, Track
from quadlog.positioning.batch.robust import USUAL_RANGES, USUAL_STD_M, lateness_weights, link_stds, link_windows
from quadlog.positioning.batch.solve import Estimate, Weights, solve, walking_clock
from quadlog.positioning.batch.tracking import KNOT_S, LONGEST_GAP_S, Body, Starts, Tracked, find_jumps

STEP_S = 0.1
"""Ranges so close together are used at once, when the last of them has come."""
WINDOW_S = 3.0
"""With 2 s tracks of 8 ranges/s err by up to 5 % more."""
ROUNDS = 5
"""At most, of each step; one is enough where the last one was near."""
FIRST_BACK_S, BACK_GROWTH, MOST_BACK_S = 2.0, 0.25, 60.0
"""So long after the first range, and again after so much more, the log until then, or so much, is solved as a batch:
windows show neither how long errors last nor whether paths are blocked, and never weigh again what is past."""
LASTS_S, LASTS_KNOWN_S = 0.6, 10.0
"""How long errors of a link are taken to last, and for how much of a log that counts."""
STANDING_SHARE = 0.5
"""By a clock that stops with the body: where it stands, up to so much of a window's ranges share an error."""
STAMP_STD_S = 0.08
"""How well the stamps of ranges are known: radios, drivers and references have clocks of their own, unknown to the
ranges. Real recordings were 0.08 and 0.11 s off; with 0.05 ellipses of real tracks 0.1 s off held 82 to 100 %."""


@dataclass(frozen=True, slots=True)
class Known:
    """What was known of a body after each of S steps, at t_s (S,).

    known (R,): the ranges with which there is a pose. state (S, 2D), covariance (S, 2D, 2D): of the pose and its rate
    then; values (S, M): of the globals; range_std_m (S,): of ranges in sight. restarts_s: when it was found that the
    body had been carried away. last: the estimate in the end, of the last few seconds. spread: as in Tracked.
    """

    body: Body
    known: np.ndarray
    t_s: Float
    state: Float
    covariance: Float
    values: Float
    range_std_m: Float
    restarts_s: Float
    last: Estimate
    spread: float = 1.0

    def poses(self, t_s: Float, *, before: bool = False) -> tuple[Float, Float, Float]:
        """Coordinates and rates (N, D), covariances (N, 2D, 2D), as known at (N,), before: without a step just then."""
        at = self._steps(t_s, before=before)
        size, n, ahead_s = len(self.body.axes), len(at), t_s - self.t_s[at]
        pose, rate = self.state[at, :size], self.state[at, size:]
        density = np.diag([each.density for each in self.body.axes.motions])
        powers = np.array([[ahead_s**3 / 3, ahead_s**2 / 2], [ahead_s**2 / 2, ahead_s]])
        move, noise = np.tile(np.eye(2 * size), (n, 1, 1)), np.einsum("abn,ij->naibj", powers, density)
        move[:, np.arange(size), np.arange(size) + size] = ahead_s[:, None]
        covariance = move @ self.covariance[at] @ move.transpose(0, 2, 1) + noise.reshape(move.shape)
        return pose + ahead_s[:, None] * rate, rate, covariance

    def _steps(self, t_s: Float, *, before: bool = False) -> Int:
        """(N,) the last step until each of the instants."""
        return (np.searchsorted(self.t_s, t_s, side="left" if before else "right") - 1).clip(0)

    def of_ranges(self) -> tuple[Float, Float, Float]:
        """(R,) residuals by the pose known with a range, weights, squared innovations over their due variance."""
        problem, slots, size = self.last.problem, self.body.ranges.single(), len(self.body.axes)
        found = []
        for before in (False, True):
            pose, _, covariance = self.poses(slots.t_s, before=before)
            at = self._steps(slots.t_s, before=before)
            values, std_m = self.values[at], self.range_std_m[at]
            predicted_m, slope, _, _ = problem.model.predict(slots, pose, np.zeros(values.shape[1]))
            residual_m = slots.range_m - predicted_m - values[np.arange(len(values)), slots.link]
            variance_m2 = std_m**2 + np.einsum("ni,nij,nj->n", slope, covariance[:, :size, :size], slope)
            found.append((residual_m, variance_m2))
        (residual_m, _), (innovation_m, variance_m2) = found
        order, weight = np.lexsort((slots.t_s, slots.link)), np.empty(len(residual_m))
        windows = link_windows(slots.t_s[order], slots.link[order])
        weight[order] = lateness_weights(windows, residual_m[order], std_m[order])
        return residual_m, weight, weight * innovation_m**2 / variance_m2 / max(float(weight.mean()), 1e-3)

    def biases(self) -> tuple[Float, Float]:
        """Of all links (L,) as they are known in the end, and their std."""
        n = self.body.ranges.n_links
        return self.values[-1, :n], np.sqrt(np.diag(self.last.covariance)[:n])

    def scale(self) -> tuple[float, float]:
        """None is estimated: a log so far shows it too badly."""
        return 0.0, 0.0

    def corrected(self, t_s: Float, range_m: Float) -> Float:
        """Ranges (N, L) of all links without biases and scale as they were known at instants (N,)."""
        n, known = self.body.ranges.n_links, t_s[:, None] >= self.t_s[0]
        return range_m - np.where(known, self.values[self._steps(t_s), :n], 0.0)


class _Step(NamedTuple):
    """What was known at t_s: the last knot (2D,) with its covariance, values of the globals, and see Problem.past."""

    t_s: float
    state: Float
    covariance: Float
    values: Float
    range_std_m: float
    past: tuple[Float, Float, Float] | None


class _Back(NamedTuple):
    """What looking back at t_s showed: see Problem.past; how long errors last; whether paths are blocked."""

    t_s: float
    past: tuple[Float, Float, Float] | None
    lasts_s: float
    blocked: bool | None


def follow(body: Body, starts: Starts) -> Known:
    """The track of a body as it was known at each instant, of R > 0 ranges from its first start on.

    Step by step, at the first range of each STEP_S; starts and cuts count from their own instants on.
    """
    t_s = body.ranges.t_s
    segment = np.append(0, np.cumsum(np.diff(t_s) > LONGEST_GAP_S))
    begin_s = t_s[np.append(True, np.diff(segment) > 0)]
    start = np.searchsorted(starts.t_s, begin_s).clip(max=len(starts.t_s) - 1)
    known = t_s >= starts.t_s[start][segment]
    number = np.floor(t_s[known] / STEP_S) + segment[known]
    steps, last, found = list[_Step](), None, [(cut_s, cut_s) for cut_s in body.cuts_s.tolist()]
    std_m, seen = body.settings.range_std_m or USUAL_STD_M, USUAL_RANGES
    back, due_s = _Back(np.inf, None, LASTS_S, None), t_s[0] + FIRST_BACK_S
    for now_s in t_s[known][np.flatnonzero(np.diff(number, prepend=-1))].tolist():
        if steps and now_s >= due_s:
            back = _look_back(body, now_s, steps, found)
            due_s = now_s + BACK_GROWTH * np.clip(now_s - t_s[0], 2 * FIRST_BACK_S, MOST_BACK_S)
        before = _before(steps, now_s - WINDOW_S)
        if before and back.t_s <= before.t_s < back.t_s + WINDOW_S:
            before = before._replace(past=back.past)
        own = replace(body, settings=replace(body.settings, range_std_m=std_m))
        last = _step(own, starts, now_s, (before, last, back), found)
        state, covariance = last.knots[-1].ravel(), last.knot_covariances[-1]
        steps.append(_Step(now_s, state, covariance, last.values, std_m, last.past()))
        if body.settings.range_std_m is None:
            # A range is in many windows.
            slots = last.problem.slots
            seen += int(np.count_nonzero(slots.range_t_s > now_s - STEP_S))
            prior = std_m, round(seen * WINDOW_S / STEP_S)
            std_m = float(np.median(link_stds(last.linear.residual_m, slots.range_link, slots.n_links, prior)))
    assert last is not None
    known_s, state, covariance, values, stds_m = (np.array(each) for each in list(zip(*steps, strict=True))[:5])
    restarts_s = np.array([each for each, _ in found])
    return Known(body, known, known_s, state, covariance, values, stds_m, restarts_s, last)


def _before(steps: list[_Step], t_s: float) -> _Step | None:
    """The last step until then."""
    begun = bisect_right(steps, t_s, key=lambda step: step.t_s)
    return steps[begun - 1] if begun else None


def _between(body: Body, before: _Step | None, now_s: float, found: list[tuple[float, float]]) -> Body:
    """With the ranges since a step until now, and the cuts that are known."""
    rows = slice(*np.searchsorted(body.ranges.t_s, [before.t_s if before else -np.inf, now_s], side="right"))
    cuts_s = np.unique([cut_s for known_s, cut_s in found if known_s <= now_s])
    return replace(body, ranges=body.ranges.rows(rows), cuts_s=cuts_s)


def _look_back(body: Body, now_s: float, steps: list[_Step], found: list[tuple[float, float]]) -> _Back:
    """The batch over what has come, from the poses that were known."""
    before, yaw = _before(steps, now_s - MOST_BACK_S), body.axes.yaw
    body, kept = _between(body, before, now_s, found), [0, 1] if yaw is None else [0, 1, yaw]
    starts = Starts(np.array([step.t_s for step in steps]), np.array([step.state[kept] for step in steps]))
    problem = replace(body.problem(), past=before.past if before else None)
    estimate = solve(problem, body.knots_from(starts, problem.timeline), steps[-1].values)
    span_s, n = problem.heard
    lasts_s = float(np.median(estimate.weights.lasts)) * span_s / n
    lasts_s = (LASTS_S * LASTS_KNOWN_S + lasts_s * span_s) / (LASTS_KNOWN_S + span_s)
    return _Back(now_s, estimate.past(), lasts_s, estimate.weights.blocked)


def _step(
    body: Body,
    starts: Starts,
    now_s: float,
    come: tuple[_Step | None, Estimate | None, _Back],
    found: list[tuple[float, float]],
) -> Estimate:
    """The window until now with what came before; solved again where the body was carried away, as noted in found."""
    before, last, back = come
    until = int(np.searchsorted(starts.t_s, now_s, side="right"))
    starts = Starts(starts.t_s[:until], starts.pose[:until])
    while True:
        part = _between(body, before, now_s, found)
        problem = replace(part.problem(), past=before.past if before else None)
        slots, timeline, cuts_s = problem.slots, problem.timeline, part.cuts_s
        knots, values = _guess(body, timeline, starts, last), last.values if last else problem.mean
        span_s, n = max(problem.heard[0], KNOT_S), problem.heard[1]
        walked_s, usual = float(walking_clock(timeline, knots)[-1]), back.lasts_s / span_s
        share = np.clip(back.lasts_s / max(walked_s, 1e-3), usual, max(STANDING_SHARE, usual))
        lasts = np.full(len(slots.range_m), max(1.0, share * n))
        noise = Weights(np.full(slots.n_links, body.settings.range_std_m), lasts, back.blocked)
        estimate = solve(problem, knots, values, noise, ROUNDS)
        jumps_s = cuts_s[:0] if body.yaw else np.setdiff1d(find_jumps(estimate, starts), cuts_s)
        if len(jumps_s) == 0:
            return estimate
        found += [(now_s, cut_s) for cut_s in jumps_s.tolist()]


def _guess(body: Body, timeline: Timeline, starts: Starts, last: Estimate | None) -> Float:
    """Knots going on from the last estimate, or from starts since then where a segment is new."""
    at_starts = body.knots_from(starts, timeline)
    if last is None:
        return at_starts
    old, begin_s = last.problem.timeline, timeline.t_s[0]
    pose, rate = old.sample(timeline.t_s).of(last.knots)
    ahead_s = (timeline.t_s - old.t_s[-1]).clip(0.0)
    knots = np.stack([pose + ahead_s[:, None] * rate, rate], axis=1)
    for first_s in timeline.t_s[timeline.firsts].tolist():
        is_cut = first_s > begin_s and np.abs(old.t_s[old.firsts] - first_s).min() > 1e-6
        if is_cut or first_s > old.t_s[-1]:
            new, since = timeline.t_s >= first_s, starts.t_s >= min(first_s, starts.t_s[-1])
            some = Starts(starts.t_s[since], starts.pose[since])
            knots[new] = body.knots_from(some, timeline)[new]
    return knots


def track_of(tracked: Tracked | Known, t_s: Float, t_ns: Int, tag: int | None) -> Track:
    """Of a tag, or the body's origin at its tags' mean height, at t_ns (N,), which are t_s; stamps are uncertain."""
    (pose, rate, covariance), ranges, axes = tracked.poses(t_s), tracked.body.ranges, tracked.body.axes
    size, n, lever_m, height_m = len(axes), len(t_ns), np.zeros(2), ranges.height_m.mean()
    if tag is not None:
        lever_m, height_m = ranges.lever_m[tag], ranges.height_m[tag]
    place_m, swing_m = axes.places(pose, np.broadcast_to(lever_m, (n, 2)))
    change = np.zeros((n, 2, size))
    change[:, 0, 0] = change[:, 1, 1] = 1.0
    if axes.yaw is not None:
        change[:, :, axes.yaw] = swing_m
    velocity_mps, back = np.einsum("nij,nj->ni", change, rate), change.transpose(0, 2, 1)
    own_m2, rates = change @ covariance[:, :size, :size] @ back, change @ covariance[:, size:, size:] @ back
    place_m2 = own_m2 + STAMP_STD_S**2 * velocity_mps[:, :, None] * velocity_mps[:, None, :]
    excess = tracked.spread * np.trace(place_m2, axis1=1, axis2=2) / np.trace(own_m2, axis1=1, axis2=2)
    z_m, z_std_m = np.full(n, float(height_m)), np.zeros(n)
    if axes.z is not None:
        z_m, z_std_m = z_m + pose[:, axes.z], np.sqrt(covariance[:, axes.z, axes.z])
    return Track(t_ns, place_m, velocity_mps, place_m2, rates, z_m, z_std_m, excess)
