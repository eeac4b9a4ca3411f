"""Survey of UWB anchors by a walk: where each one stands, how well that is known, and which the walk does not show.

Anchors enter the batch first where their own ranges single out one place (the idea of [Delama]); along the walk that
they correct, the others follow. Mirror images are solved as well and compared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.errors import AnchorsNotObserved
from quadlog.messages import Float, Int
from quadlog.positioning.anchor_survey import SurveyFaults
from quadlog.positioning.self_survey.batch import Batch, HeightPrior, OdometryPrior, SurveySolution
from quadlog.positioning.self_survey.frame import (
    FramedAnchors,
    find_faults,
    misplaced,
    place_in_frame,
    radius_95,
    relative_covariance,
)
from quadlog.positioning.self_survey.initial import anchor_candidates
from quadlog.positioning.self_survey.problem import SurveyProblem

FEWEST_RANGES = 30
LEAST_WAY_M = 3.0
LEAST_ACROSS_M = 0.15
"""A walk whose places scatter less than this about a line, rms, is a straight line."""
CLEAR_RATIO = 1.1
"""A place is singled out at once if the misfit of the next best one is larger by this factor."""
RIVAL_RATIO = 1.5
"""Places with a larger misfit than this are not tried once the walk is corrected."""
CLEAR_COST = 6.0
"""A mirror image is ruled out if its likelihood is smaller by exp(CLEAR_COST)."""
UNKNOWN_M = 1.0
"""An anchor counts as observed if its 95 % ellipse reaches no farther than this."""
WIDER = np.array([1.05, 1.05, 1.25])
"""Factors on the bounds of x, y and z for what is estimated and then taken as known: drift, spread and delay of ranges.

A height reacts to range errors many times as strongly.
"""
NORMAL_95 = 1.96
LATE_SHARE, PERSISTENCE, LOOSENESS = 0.4, 2.0, 4.0
"""Ranges that are late more often or err for longer than this may be those of a worse odometry: it is tried as well."""
MOST_DRIFT_M, MOST_DRIFT_RAD = 0.1, 0.1
"""With more random drift after 1 m of way the ranges contradict the odometry."""
FREER_GAIN = 0.5
"""The odometry is doubted if each range is likelier by exp(FREER_GAIN) where it drifts more than that."""
BLIND_SHARE = 0.8
"""A height is unobserved if its bound is still this share of the prior's."""


@dataclass(frozen=True, slots=True)
class SurveyedAnchor:
    """An anchor by its index: position_m (3,) and its covariance_m2 (3, 3), bias_m and its std, ranges and late ones.

    height_observed: whether its height is from ranges, not from the prior. why_not: why its place is not observed,
    "" if it is.
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
        bound: Float = NORMAL_95 * np.sqrt(np.diag(self.covariance_m2))
        return bound

    @property
    def radius_m(self) -> float:
        """How far the 95 % ellipse of x and y reaches."""
        return radius_95(self.covariance_m2)


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


def survey_anchors(problem: SurveyProblem, heights: HeightPrior, drift: OdometryPrior, known_m: Float) -> AnchorSurvey:
    """Places of all anchors, z above the floor; known_m (A, 2) has x and y of those that are known, NaN of the others.

    Two known anchors and more give the frame: the survey is turned and shifted so that they fit best. Without them it
    is base at the first pose. Raises AnchorsNotObserved where the walk shows none of the anchors.
    """
    _check_walk(problem)
    counts = np.bincount(problem.anchor, minlength=problem.n_anchors)
    heard = np.flatnonzero(counts >= FEWEST_RANGES)
    if len(heard) == 0:
        raise AnchorsNotObserved(
            f"no anchor has {FEWEST_RANGES} ranges near an odometry pose", "record ranges and odometry at the same time"
        )
    part, part_heights = problem.of_anchors(heard), _heights_of(heights, heard)
    batch = Batch(part, part_heights, drift)
    solution, clear_share = _likeliest(part, part_heights, drift)
    _check_odometry(solution)
    if clear_share < 0.5 and _mirrored(batch, solution).cost_above(solution) < CLEAR_COST:
        raise AnchorsNotObserved(
            "the walk and its mirror image fit the ranges equally well",
            "walk a loop or an L that turns by 90 degrees, several metres each way",
        )
    solution, ambiguous = _check_mirrors(batch, part_heights, solution)
    _check_odometry(solution)
    framed = place_in_frame(solution, drift, known_m[heard])
    anchors = _anchors(part, part_heights, solution, framed, heard, ambiguous)
    if not any(each.why_not == "" for each in anchors):
        raise AnchorsNotObserved(
            f"no anchor's place is known to {UNKNOWN_M:g} m: {anchors[0].why_not}",
            "walk a longer loop, nearer to the anchors and around them",
        )
    state = solution.state
    misplaced_m, mirrored = misplaced(solution.state.anchors_m, framed, known_m[heard])
    silent = tuple(_silent(int(index), int(counts[index])) for index in np.flatnonzero(counts < FEWEST_RANGES))
    return AnchorSurvey(
        anchors=tuple(sorted((*anchors, *silent), key=lambda each: each.index)),
        scale=state.scale,
        turn_scale=state.turn_scale,
        yaw_drift_radps=state.yaw_drift_radps,
        delay_s=state.delay_s,
        drift=state.drift,
        range_std_m=state.errors.std_m,
        way_m=problem.way_m,
        start=framed.start,
        aligned_to=framed.aligned_to,
        misplaced_m={int(heard[index]): off_m for index, off_m in misplaced_m.items()},
        mirrored=mirrored,
        faults=_of_all(find_faults(framed, known_m[heard]), heard),
    )


def _of_all(faults: SurveyFaults | None, heard: Int) -> SurveyFaults | None:
    """Faults of the anchors heard (B,), by their indices among all."""
    if faults is None:
        return None
    return SurveyFaults(
        tuple((int(heard[i]), int(heard[j])) for i, j in faults.swapped),
        shifted=tuple(replace(each, anchor=int(heard[each.anchor])) for each in faults.shifted),
    )


def _check_walk(problem: SurveyProblem) -> None:
    """Raises AnchorsNotObserved for a robot that hardly moves, and for a straight line."""
    remedy = "walk a loop or an L of 10 m and more, several metres each way"
    if problem.way_m < LEAST_WAY_M:
        raise AnchorsNotObserved(f"the robot walks {problem.way_m:.1f} m only", remedy)
    centred_m = problem.knots[:, :2] - problem.knots[:, :2].mean(axis=0)
    across_m = float(np.linalg.svd(centred_m, compute_uv=False)[-1] / np.sqrt(len(centred_m)))
    if across_m < LEAST_ACROSS_M:
        raise AnchorsNotObserved(
            f"the walk is a straight line to within {across_m:.2f} m, so every anchor has a mirror image", remedy
        )


def _heights_of(heights: HeightPrior, anchors: Int) -> HeightPrior:
    return HeightPrior(heights.mean_m[anchors], heights.std_m[anchors])


def _candidates(problem: SurveyProblem, heights: HeightPrior, knots: Float) -> list[tuple[Float, Float]]:
    """For each anchor the places (C, 4) that fit best locally along the knots (K, 3), and their misfits (C,)."""
    place_m, found = problem.tag_places(knots), []
    for anchor in range(problem.n_anchors):
        rows = problem.anchor == anchor
        expected = float(heights.mean_m[anchor]), float(heights.std_m[anchor])
        found.append(anchor_candidates(place_m[rows], problem.height_m[rows], problem.range_m[rows], *expected))
    return found


def _likeliest(problem: SurveyProblem, heights: HeightPrior, drift: OdometryPrior) -> tuple[SurveySolution, float]:
    """What `_solve` finds; from a looser odometry where the usual one makes the ranges bad, if that is likelier."""
    found = _solve(problem, heights, drift)
    solution = found[0]
    if solution.late.mean() > LATE_SHARE or solution.state.persistence > PERSISTENCE:
        looser = _solve(problem, heights, drift, LOOSENESS)
        if solution.range_cost - looser[0].range_cost > FREER_GAIN * len(problem.range_m):
            _check_odometry(looser[0])
        if looser[0].cost_above(solution) < 0:
            return looser
    return found


def _check_odometry(solution: SurveySolution) -> None:
    """Raises AnchorsNotObserved for ranges that fit the walk only if nearly any other fits as well."""
    drift_m, drift_rad = solution.state.drift
    if drift_m > MOST_DRIFT_M or drift_rad > MOST_DRIFT_RAD:
        raise AnchorsNotObserved(
            f"the ranges contradict the odometry: they fit only if it drifts by {drift_m:.2f} m and "
            f"{np.degrees(drift_rad):.0f} degrees after 1 m of way",
            "check its scale, the side to which it turns, its time stamps and x_m, y_m of the tag, or choose another "
            "by topics.position",
        )


def _solve(
    problem: SurveyProblem, heights: HeightPrior, drift: OdometryPrior, looseness: float = 1.0
) -> tuple[SurveySolution, float]:
    """The batch of all anchors, and the share of those with one clear place, which come first and correct the walk."""
    found = _candidates(problem, heights, problem.knots)
    clear = np.array([len(misfit) == 1 or misfit[1] > CLEAR_RATIO * misfit[0] for _, misfit in found])
    knots = problem.knots
    if clear.any() and not clear.all():
        first = np.flatnonzero(clear)
        batch = Batch(problem.of_anchors(first), _heights_of(heights, first), drift)
        places = np.array([found[index][0][0] for index in first])
        knots = batch.solve(batch.start(places[:, :3], places[:, 3], knots, looseness)).state.knots
        found = _candidates(problem, heights, knots)
    places = np.array([candidates[0] for candidates, _ in found])
    batch = Batch(problem, heights, drift)
    return batch.solve(batch.start(places[:, :3], places[:, 3], knots, looseness)), float(clear.mean())


def _mirrored(batch: Batch, solution: SurveySolution) -> SurveySolution:
    """The batch that starts with all anchors reflected at the main axis of the walk."""
    state = solution.state
    centre_m = state.knots[:, :2].mean(axis=0)
    _, _, axes = np.linalg.svd(state.knots[:, :2] - centre_m)
    anchors_m = state.anchors_m.copy()
    off_m = anchors_m[:, :2] - centre_m
    anchors_m[:, :2] -= 2 * (off_m @ axes[1])[:, None] * axes[1]
    start = replace(state, anchors_m=anchors_m, knots=batch.problem.knots)
    return batch.solve(start)


def _check_mirrors(
    batch: Batch, heights: HeightPrior, solution: SurveySolution
) -> tuple[SurveySolution, dict[int, str]]:
    """The solution with every anchor at the best of its places along the corrected walk, and those with a rival."""
    ambiguous: dict[int, str] = {}
    for anchor, (places, misfits) in enumerate(_candidates(batch.problem, heights, solution.state.knots)):
        now_m = solution.state.anchors_m[anchor, :2]
        for place in places[misfits < RIVAL_RATIO * misfits[0]]:
            if np.hypot(*(place[:2] - now_m)) < UNKNOWN_M:
                continue
            start = replace(solution.state, anchors_m=_with_row(solution.state.anchors_m, anchor, place[:3]))
            rival = batch.solve(start)
            apart_m = np.hypot(*(rival.state.anchors_m[anchor, :2] - now_m))
            above = rival.cost_above(solution)
            if apart_m < UNKNOWN_M / 2 or above > CLEAR_COST:
                continue
            if above < -CLEAR_COST:
                solution = rival
            else:
                ambiguous[anchor] = f"a place {apart_m:.1f} m away fits its ranges as well"
    return solution, ambiguous


def _with_row(anchors_m: Float, anchor: int, place_m: Float) -> Float:
    changed = anchors_m.copy()
    changed[anchor] = place_m
    return changed


def _anchors(
    problem: SurveyProblem,
    heights: HeightPrior,
    solution: SurveySolution,
    framed: FramedAnchors,
    index: Int,
    ambiguous: dict[int, str],
) -> list[SurveyedAnchor]:
    state, n = solution.state, problem.n_anchors
    wider = np.concatenate([np.tile(WIDER, n), np.full(len(framed.covariance) - 3 * n, WIDER[0])])
    covariance = wider[:, None] * framed.covariance * wider
    among = relative_covariance(covariance, framed.anchors_m, np.arange(n))
    counts = np.bincount(problem.anchor, minlength=n)
    late = np.bincount(problem.anchor, solution.late, minlength=n) / np.maximum(counts, 1)
    anchors = []
    for anchor in range(n):
        rows = slice(3 * anchor, 3 * anchor + 3)
        links = 3 * n + anchor + n * np.arange(problem.n_tags)
        block = covariance[rows, rows]
        surveyed = SurveyedAnchor(
            int(index[anchor]),
            framed.anchors_m[anchor],
            block,
            float(state.bias_m[:, anchor].mean()),
            float(np.sqrt(covariance[np.ix_(links, links)].mean())),
            int(counts[anchor]),
            float(late[anchor]),
            bool(np.sqrt(block[2, 2]) < BLIND_SHARE * heights.std_m[anchor]),
            ambiguous.get(anchor, ""),
        )
        reach_m = radius_95(among[rows, rows])
        if surveyed.why_not == "" and reach_m > UNKNOWN_M:
            surveyed = replace(surveyed, why_not=f"its place among the others is known to {reach_m:.1f} m only")
        anchors.append(surveyed)
    return anchors


def _silent(index: int, n_ranges: int) -> SurveyedAnchor:
    nowhere, unknown = np.full(3, np.nan), np.full((3, 3), np.nan)
    why = f"it has {n_ranges} ranges near an odometry pose, {FEWEST_RANGES} are needed"
    return SurveyedAnchor(index, nowhere, unknown, np.nan, np.nan, n_ranges, np.nan, False, why)
