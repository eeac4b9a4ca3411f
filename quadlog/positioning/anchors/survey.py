"""Survey of UWB anchors by a walk: where each one stands, how well that is known, and which the walk does not show.

Anchors, lasting errors of the odometry and the delay of the ranges are global unknowns of the batch [Nguyen]. Each
anchor starts where its ranges fit best, and is surveyed only where no rival place, as a mirror image, does [Delama].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.errors import AnchorsNotObserved
from quadlog.messages import Float, Int
from quadlog.positioning.anchors.check import SurveyFaults, find_faults
from quadlog.positioning.anchors.frame import misplaced, place_in_frame, relative_covariance
from quadlog.positioning.anchors.walk import Walk
from quadlog.positioning.batch.factors import Axes, RangeModel, Steps
from quadlog.positioning.batch.motion import Motion
from quadlog.positioning.batch.robust import USUAL_STD_M, sight_probabilities
from quadlog.positioning.batch.solve import Estimate, Problem, assemble, solve
from quadlog.positioning.ellipses import ellipse_95

FEWEST_RANGES = 30
LEAST_WAY_M = 3.0
LEAST_ACROSS_M = 0.15
"""A walk whose places scatter less than this about a line, rms, is a straight line."""
CLEAR_RATIO, RIVAL_RATIO = 1.1, 1.5
"""A place is singled out if the misfit of the next best one is larger by the first factor; those whose misfit is
larger by the second are not tried along the corrected walk."""
CLEAR_COST = 6.0
"""A mirror image is ruled out if its likelihood is smaller by exp(CLEAR_COST)."""
UNKNOWN_M = 1.0
"""An anchor counts as observed if its 95 % ellipse reaches no farther than this."""
NORMAL_95 = 1.96
MOST_DRIFT_M, MOST_DRIFT_RAD = 0.1, 0.1
"""With more random drift after 1 m of way the ranges contradict the odometry."""
MOST_SCALE_STD = 8.0
"""And if its turns are off by more: in std of what is usual."""
MOST_LATE = 0.7
"""Nor do ranges fit any places of which more count as NLOS: on simulated walks it is up to 0.55."""
BLIND_SHARE = 0.8
"""A height is unobserved if its bound is still this share of the prior's."""
BIAS_MEAN_M, COMMON_BIAS_STD_M, ANCHOR_BIAS_STD_M, LINK_BIAS_STD_M = 0.15, 0.15, 0.1, 0.05
"""Priors of biases: of all links together, of one anchor's, of one link's. Real sets have 0 to 0.4 m."""
DELAY_STD_S, ANYWHERE_M = 0.1, 300.0
"""How far the clocks of ranges and odometry may be apart; and an anchor from where the walk begins."""
DRIFT_SPREAD, LEAST_LOOSENESS, LARGEST_DRIFT = 1.4, 0.0625, 0.2
"""Std of the logarithm of the random drift: how well it is known before a log is seen. What is tried."""
LEAST_STD_M, MOST_STD_M = 0.05, 1.0
"""Bounds of the std of ranges in line of sight."""
LOOSE, LOOSE_YAW = 1.0, 10.0
"""Spectral density of the accelerations between knots. With 10 for x and y as well, the way between two knots is free
by 0.08 m, ranges there say little, and odometry seems to drift three times as much. Robots turn on the spot."""


@dataclass(frozen=True, slots=True)
class SurveyedAnchor:
    """An anchor by its index: position_m (3,) and its covariance_m2 (3, 3), bias_m and its std, ranges and late ones.

    height_observed: whether its height is from ranges, not from the prior. why_not: "" if its place is observed.
    """

    index: int
    position_m: Float
    covariance_m2: Float
    bias_m: float
    bias_std_m: float
    n_ranges: int
    late_share: float
    height_observed: bool
    why_not: str = ""

    @property
    def bound_m(self) -> Float:
        """(3,) half widths of the 95 % intervals of x, y and z."""
        return NORMAL_95 * np.sqrt(np.diag(self.covariance_m2))


@dataclass(frozen=True, slots=True)
class AnchorSurvey:
    """All anchors, and the odometry's errors: scales of way and turns, yaw drift, random drift (m, rad) after 1 m.

    delay_s: by how much the ranges' stamps are too early by the odometry's clock. way_m: length of the way. start
    (3,): x_m, y_m, yaw_rad of the first pose in the frame of the anchors; aligned_to: how many known anchors give
    that frame, 0 where the first pose does. misplaced_m: index -> distance of known anchors from their surveyed
    places, if larger than the bounds allow; mirrored: whether they fit the mirror image of the survey. faults: what is
    wrong with known anchors, by index; None where no single fault explains it.
    """

    anchors: tuple[SurveyedAnchor, ...]
    scale: float
    turn_scale: float
    yaw_drift_radps: float
    delay_s: float
    drift: tuple[float, float]
    range_std_m: float
    way_m: float
    start: Float
    aligned_to: int
    misplaced_m: dict[int, float]
    mirrored: bool
    faults: SurveyFaults | None


def survey_anchors(walk: Walk, known_m: Float) -> AnchorSurvey:
    """Places of all anchors, z above the floor; known_m (A, 2) has x and y of those that are known, NaN of the others.

    Two known anchors and more give the frame: the survey is turned and shifted so that they fit best. Without them it
    is base at the first pose. Raises AnchorsNotObserved where the walk shows none of the anchors.
    """
    _check_walk(walk)
    counts = np.bincount(walk.ranges.anchor, minlength=walk.ranges.n_anchors)
    heard = np.flatnonzero(counts >= FEWEST_RANGES)
    if len(heard) == 0:
        raise AnchorsNotObserved(
            f"no anchor has {FEWEST_RANGES} ranges near an odometry pose", "record ranges and odometry at the same time"
        )
    solution, ambiguous = _check_mirrors(_solve(walk.of_anchors(heard)))
    known_m, start_std = known_m[heard], np.array(solution.drift)[[0, 0, 1]]
    anchors_m, covariance, start = place_in_frame(solution.anchors_m, solution.covariance, known_m, start_std)
    anchors = _anchors(solution, anchors_m, covariance, heard, ambiguous)
    if all(each.why_not for each in anchors):
        raise AnchorsNotObserved(
            f"no anchor's place is known to {UNKNOWN_M:g} m: {anchors[0].why_not}",
            "walk a longer loop, nearer to the anchors and around them",
        )
    nowhere, unknown = np.full(3, np.nan), np.full((3, 3), np.nan)
    for index, n in [(index, n) for index, n in enumerate(counts.tolist()) if n < FEWEST_RANGES]:
        why = f"it has {n} ranges near an odometry pose, {FEWEST_RANGES} are needed"
        anchors.append(SurveyedAnchor(index, nowhere, unknown, np.nan, np.nan, n, np.nan, False, why))
    n_known = int(np.isfinite(known_m[:, 0]).sum())
    misplaced_m, mirrored = misplaced(anchors_m, covariance, known_m)
    scale, turn_scale, yaw_drift_radps, delay_s = solution.estimate.values[-4:].tolist()
    return AnchorSurvey(
        anchors=tuple(sorted(anchors, key=lambda each: each.index)),
        scale=1 / scale,
        turn_scale=turn_scale,
        yaw_drift_radps=-yaw_drift_radps,
        delay_s=delay_s,
        drift=solution.drift,
        range_std_m=float(solution.estimate.weights.std_m[0]),
        way_m=walk.way_m,
        start=start,
        aligned_to=n_known if n_known > 1 else 0,
        misplaced_m={int(heard[index]): off_m for index, off_m in misplaced_m.items()},
        mirrored=mirrored,
        faults=find_faults(anchors_m, covariance, known_m, heard),
    )


def _check_walk(walk: Walk) -> None:
    """Raises AnchorsNotObserved for a robot that hardly moves, and for a straight line."""
    remedy = "walk a loop or an L of 10 m and more, several metres each way"
    if walk.way_m < LEAST_WAY_M:
        raise AnchorsNotObserved(f"the robot walks {walk.way_m:.1f} m only", remedy)
    centred_m = walk.knots[:, 0, :2] - walk.knots[:, 0, :2].mean(axis=0)
    across_m = float(np.linalg.svd(centred_m, compute_uv=False)[-1] / np.sqrt(len(centred_m)))
    if across_m < LEAST_ACROSS_M:
        raise AnchorsNotObserved(
            f"the walk is a straight line to within {across_m:.2f} m, so every anchor has a mirror image", remedy
        )


def _check_odometry(solution: _Solution) -> None:
    """Raises AnchorsNotObserved for ranges that fit the walk badly, or only if it is far from what odometry says."""
    late = 1 - float(solution.estimate.weights.knots.mean())
    if late > MOST_LATE:
        raise AnchorsNotObserved(
            f"the ranges do not fit the walk: {late:.0%} of them count as NLOS wherever the anchors are placed",
            "check unit and scale of the ranges, or choose another odometry by topics.position",
        )
    drift_m, drift_rad = solution.drift
    turn_scale = float(solution.estimate.values[-3])
    off_std = abs(turn_scale - 1) / solution.walk.odometry.turn_scale_std
    if drift_m > MOST_DRIFT_M or drift_rad > MOST_DRIFT_RAD or off_std > MOST_SCALE_STD:
        raise AnchorsNotObserved(
            f"the ranges contradict the odometry: they fit only if it drifts by {drift_m:.2f} m and "
            f"{np.degrees(drift_rad):.0f} degrees after 1 m of way, and turns {turn_scale:.2f} times as far as it says",
            "check its scale, the side to which it turns, its time stamps and x_m, y_m of the tag, or choose another "
            "by topics.position",
        )


@dataclass(frozen=True, slots=True)
class _Solution:
    """With `looseness` times the usual random drift; globals: links' biases, anchors, both scales, drift, delay."""

    walk: Walk
    estimate: Estimate
    looseness: float

    @property
    def drift(self) -> tuple[float, float]:
        """In m and rad after 1 m of way."""
        drift_m, drift_rad = self.walk.odometry.drift
        return drift_m * self.looseness, drift_rad * self.looseness

    @property
    def anchors_m(self) -> Float:
        """(A, 3)."""
        return self.estimate.values[self.walk.ranges.n_links : -4].reshape(-1, 3)

    @property
    def covariance(self) -> Float:
        """(3A + TA, 3A + TA) of the anchors' x, y, z, then of the links' biases."""
        order = np.roll(np.arange(len(self.estimate.values) - 4), -self.walk.ranges.n_links)
        return self.estimate.covariance[np.ix_(order, order)]

    def with_anchors(self, anchors_m: Float, knots: Float) -> _Solution:
        """From other places (A, 3) and knots, all else being alike."""
        values = self.estimate.values.copy()
        values[self.walk.ranges.n_links : -4] = anchors_m.ravel()
        return replace(self, estimate=solve(self.estimate.problem, knots, values, warm=True))

    def cost_above(self, other: _Solution) -> float:
        """By how much -log of the likelihood exceeds another solution's, with the larger persistence for both."""
        lasts = np.maximum(self.estimate.weights.lasts, other.estimate.weights.lasts)
        return _misfit(self.estimate, lasts) - _misfit(other.estimate, lasts)


def _misfit(estimate: Estimate, lasts: Float) -> float:
    """-log of the likelihood, globals and knots integrated out [Laplace], of estimates whose errors last alike."""
    problem, slots, values = estimate.problem, estimate.problem.slots, estimate.values
    alike = replace(estimate.weights, lasts=lasts)
    arrow = assemble(problem, estimate.linear, alike, estimate.knots, values)[0]
    std_m = estimate.weights.std_m[slots.range_link]
    against = sight_probabilities(slots.range_t_s, slots.range_link, estimate.linear.residual_m, std_m)[2]
    cost = (against / lasts).sum() + problem.stress(estimate.knots).sum() / 2
    for each in problem.others:
        rows, weight = each.linearise(estimate.knots, values)
        cost += float((weight * rows.residual**2 - np.log(weight)).sum()) / 2
    prior, off = problem.prior_information[-1], values - problem.mean
    volume = 2 * np.log(arrow.chol[-1]).sum() + np.linalg.slogdet(arrow.reduced[0] + prior)[1]
    return float(cost + off @ prior @ off / 2 + volume / 2)


def _problem(walk: Walk, looseness: float, std_m: float) -> Problem:
    """The first knot stays where it is; looseness multiplies the usual drift, std_m is that of ranges in sight."""
    from scipy.linalg import block_diag  # slow to import

    ranges, odometry, timeline = walk.ranges, walk.odometry, walk.timeline
    n, n_anchors, n_tags = ranges.n_links, walk.ranges.n_anchors, len(ranges.lever_m)
    place = np.column_stack([np.zeros((n_anchors, 2)), walk.heights_m[0]])
    std = np.column_stack([np.full((n_anchors, 2), ANYWHERE_M), walk.heights_m[1]])
    same_anchor = np.tile(np.eye(n_anchors), (n_tags, n_tags))
    biases = COMMON_BIAS_STD_M**2 + ANCHOR_BIAS_STD_M**2 * same_anchor + LINK_BIAS_STD_M**2 * np.eye(n)
    lasting = [odometry.scale_std, odometry.turn_scale_std, odometry.yaw_drift_std_radps, DELAY_STD_S]
    mean = np.concatenate([np.full(n, BIAS_MEAN_M), place.ravel(), [1.0, 1.0, 0.0, 0.0]])
    prior = block_diag(biases, np.diag(np.square(np.append(std.ravel(), lasting))))
    pinned = Motion(LOOSE, start_std=1e-3, start_rate_std=2.0)
    axes = Axes((pinned, pinned, Motion(LOOSE_YAW, 0.5, 0.0, 1e-4, 2.0)), yaw=2)
    drift_m, drift_rad = (each * looseness for each in odometry.drift)
    first = len(mean) - 4
    variances = drift_m**2 * walk.drifting_m, drift_rad**2 * walk.drifting_m
    others = (Steps(timeline, walk.way, axes, (first, first + 2, first + 1), variances),)
    model, slots = RangeModel(axes, np.zeros((n_anchors, 3)), n, first + 3), ranges.slots(timeline.t_s)
    return Problem(timeline, model, slots, std_m, mean, prior[None], others, in_sight=True)


def _likeliest(walk: Walk, anchors_m: Float, knots: Float) -> _Solution:
    """From anchors (A, 3) and knots: with the likeliest random drift, one std more, and the std of ranges in sight."""
    step, found = np.log(2.0), list[_Solution]()
    loose = np.log(LEAST_LOOSENESS) + step * np.arange(20)
    loose = loose[np.exp(loose) * max(walk.odometry.drift) <= LARGEST_DRIFT]
    values = _problem(walk, 1.0, USUAL_STD_M).mean
    values[walk.ranges.n_links : -4] = anchors_m.ravel()
    for each in np.exp(loose).tolist():
        found.append(_Solution(walk, solve(_problem(walk, each, USUAL_STD_M), knots, values, warm=True), each))
        values, knots = found[-1].estimate.values, found[-1].estimate.knots
    lasts = np.median([each.estimate.weights.lasts for each in found], axis=0)
    costs = [_misfit(each.estimate, lasts) for each in found] + (loose / DRIFT_SPREAD) ** 2 / 2
    share = np.exp(costs.min() - costs) / np.exp(costs.min() - costs).sum()
    mean = float(share @ loose)
    usual = float(np.exp(mean + np.hypot(np.sqrt(share @ (loose - mean) ** 2), step / 2)))
    estimate = found[int(np.argmin(costs))].estimate
    sight, residual_m = estimate.weights.knots, estimate.linear.residual_m
    spread_m = np.sqrt(float(sight @ residual_m**2) / max(float(sight.sum()), 1.0))
    problem = _problem(walk, usual, float(np.clip(spread_m, LEAST_STD_M, MOST_STD_M)))
    return _Solution(walk, solve(problem, estimate.knots, estimate.values, warm=True), usual)


def _solve(walk: Walk) -> _Solution:
    """The batch from the best places along the walk as the odometry has it. Raises AnchorsNotObserved."""
    found = walk.candidates(walk.knots)
    solution = _likeliest(walk, np.array([places[0, :3] for places, _ in found]), walk.knots)
    _check_odometry(solution)
    clear = [len(misfit) == 1 or misfit[1] > CLEAR_RATIO * misfit[0] for _, misfit in found]
    if np.mean(clear) >= 0.5:
        return solution
    # All anchors reflected at the main axis of the walk.
    place_m, image_m = solution.estimate.knots[:, 0, :2], solution.anchors_m.copy()
    across = np.linalg.svd(place_m - place_m.mean(axis=0))[2][1]
    image_m[:, :2] -= 2 * ((image_m[:, :2] - place_m.mean(axis=0)) @ across)[:, None] * across
    if solution.with_anchors(image_m, walk.knots).cost_above(solution) < CLEAR_COST:
        raise AnchorsNotObserved(
            "the walk and its mirror image fit the ranges equally well",
            "walk a loop or an L that turns by 90 degrees, several metres each way",
        )
    return solution


def _check_mirrors(solution: _Solution) -> tuple[_Solution, dict[int, str]]:
    """The solution with every anchor at the best of its places along the corrected walk, and those with a rival."""
    ambiguous: dict[int, str] = {}
    for anchor, (places, misfits) in enumerate(solution.walk.candidates(solution.estimate.knots)):
        now_m = solution.anchors_m[anchor, :2]
        for place in places[misfits < RIVAL_RATIO * misfits[0]]:
            if np.hypot(*(place[:2] - now_m)) < UNKNOWN_M:
                continue
            anchors_m = solution.anchors_m.copy()
            anchors_m[anchor] = place[:3]
            rival = solution.with_anchors(anchors_m, solution.estimate.knots)
            apart_m = np.hypot(*(rival.anchors_m[anchor, :2] - now_m))
            above = rival.cost_above(solution)
            if apart_m < UNKNOWN_M / 2 or above > CLEAR_COST:
                continue
            if above < -CLEAR_COST:
                solution = rival
            else:
                ambiguous[anchor] = f"a place {apart_m:.1f} m away fits its ranges as well"
    return solution, ambiguous


def _anchors(
    solution: _Solution, anchors_m: Float, covariance: Float, index: Int, ambiguous: dict[int, str]
) -> list[SurveyedAnchor]:
    """The anchors heard (A,), by their numbers; covariance: as place_in_frame has it."""
    ranges, slots, n = solution.walk.ranges, solution.estimate.problem.slots, solution.walk.ranges.n_anchors
    bias_m = solution.estimate.values[: ranges.n_links].reshape(-1, n).mean(axis=0)
    among = relative_covariance(covariance, anchors_m, np.arange(n))
    counts, anchor_of = np.bincount(ranges.anchor, minlength=n), slots.range_link % n
    late = np.bincount(anchor_of, 1 - solution.estimate.weights.knots, n) / np.bincount(anchor_of, minlength=n)
    anchors = []
    for anchor, number in enumerate(index.tolist()):
        rows, links = slice(3 * anchor, 3 * anchor + 3), 3 * n + anchor + n * np.arange(len(ranges.lever_m))
        block, reach_m = covariance[rows, rows], float(ellipse_95(among[None, rows, rows])[0][0])
        unknown = f"its place among the others is known to {reach_m:.1f} m only" if reach_m > UNKNOWN_M else ""
        surveyed = SurveyedAnchor(
            number,
            anchors_m[anchor],
            block,
            float(bias_m[anchor]),
            float(np.sqrt(covariance[np.ix_(links, links)].mean())),
            int(counts[anchor]),
            float(late[anchor]),
            bool(np.sqrt(block[2, 2]) < BLIND_SHARE * solution.walk.heights_m[1, anchor]),
            ambiguous.get(anchor, unknown),
        )
        anchors.append(surveyed)
    return anchors
