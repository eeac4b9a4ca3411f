"""Every method against the Cramér-Rao bound, by number of anchors, with and without late ranges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.judging import Interval, rms_interval, share_interval
from quadlog.pipelines.tables.uwb_site import (
    BOX_HIGH_M,
    BOX_LOW_M,
    BOX_WORDS,
    METHODS,
    RANGE_STD_M,
    STATIONS_M,
    cramer_rao,
    draw_ranges,
)
from quadlog.positioning.fixes import Fixes
from quadlog.positioning.trilateration import solve_fixes
from quadlog.results.paper_rows import PaperRow, RowGroup

ANCHORS = (3, 4, 5, 8)
CIRCLE_M, DISC_M = 5.0, 3.0
"""Four and more anchors stand evenly on a circle, tags anywhere in a disc inside it."""
NLOS_SHARE, NLOS_MEAN_M = 0.1, 0.5
CHI_SQUARE_95 = -2 * np.log(0.05)
"""A normal error in the plane has its squared Mahalanobis distance below this in 95 % of cases."""


@dataclass(frozen=True, slots=True)
class Score:
    """What one method makes of one kind of ranges. ratio: RMSE / bound; covered: share inside the 95 % ellipse."""

    anchors: int
    nlos: bool
    method: str
    bound_m: float
    ratio: float
    ratio_interval: Interval
    covered: float
    covered_interval: Interval
    n_unsolved: int
    n_fixes: int


def score_all(n_fixes: int, seed: int) -> list[Score]:
    """Scores of all methods on the same ranges, by number of anchors, first in line of sight, then with NLOS."""
    scores = []
    for n_anchors in ANCHORS:
        rng = np.random.default_rng([seed, 2, n_anchors])
        anchors_m, position_m = _draw_layout(n_anchors, n_fixes, rng)
        clear_m = draw_ranges(position_m, anchors_m, rng)
        late_m = rng.exponential(NLOS_MEAN_M, clear_m.shape) * (rng.random(clear_m.shape) < NLOS_SHARE)
        for nlos, range_m in ((False, clear_m), (True, clear_m + late_m)):
            for method in METHODS:
                fixes = solve_fixes(method, anchors_m, range_m, 0.0, RANGE_STD_M, np.inf)
                scores.append(_score(fixes, anchors_m, position_m, nlos, method))
    return scores


def efficiency_group(scores: list[Score], nlos: bool) -> RowGroup:
    """RMSE / bound of every method, in line of sight or with late ranges."""
    rows = []
    for n_anchors in ANCHORS:
        mine = [score for score in scores if score.anchors == n_anchors and score.nlos == nlos]
        where = f"{n_anchors} anchors" + (", NLOS" if nlos else "")
        if not nlos:
            rows.append(PaperRow(f"{where}: Cramér-Rao bound (m)", mine[0].bound_m))
        rows += [
            PaperRow(f"{where}: RMSE / bound, {each.method}", each.ratio, None, *each.ratio_interval, note=_note(each))
            for each in mine
        ]
    layout = (
        f"Three anchors are the paper's stations, tags anywhere in {BOX_WORDS}; more stand evenly on a circle of "
        f"{CIRCLE_M:g} m radius, tags anywhere in its inner {DISC_M:g} m. Range noise {RANGE_STD_M:g} m. "
    )
    errors = (
        f"One range in ten comes late by an exponential delay of {NLOS_MEAN_M:g} m on average; the bound is that "
        "without such ranges. With three anchors one epoch cannot tell which range is late. "
        if nlos
        else "RMSE over all places, against the root of the mean bound. "
    )
    title = "Against the Cramér-Rao bound, " + ("ranges partly late (NLOS)" if nlos else "line of sight")
    return RowGroup(title, layout + errors + "Intervals are analytic, as above.", tuple(rows))


def coverage_group(scores: list[Score]) -> RowGroup:
    """How often the truth lies inside the 95 % ellipse that a method reports, in line of sight."""
    rows = [
        PaperRow(
            f"{each.anchors} anchors: share of fixes inside their 95 % ellipse, {each.method}",
            each.covered,
            None,
            *each.covered_interval,
        )
        for each in scores
        if not each.nlos
    ]
    text = (
        "Line of sight; each method with the covariance it reports. An honest one gives 0.95. Intervals after Wilson."
    )
    return RowGroup("Honesty of the covariance", text, tuple(rows))


def _draw_layout(n_anchors: int, n_fixes: int, rng: np.random.Generator) -> tuple[Float, Float]:
    """Anchors (A, 3) and tag positions (N, 2), all at one height."""
    if n_anchors == len(STATIONS_M):
        return STATIONS_M, rng.uniform(BOX_LOW_M, BOX_HIGH_M, (n_fixes, 2))
    angle = 2 * np.pi * np.arange(n_anchors) / n_anchors
    anchors_m = CIRCLE_M * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n_anchors)])
    turn = rng.uniform(0, 2 * np.pi, n_fixes)
    # The root makes up for how little of a disc lies near its middle.
    radius_m = DISC_M * np.sqrt(rng.random((n_fixes, 1)))
    return anchors_m, radius_m * np.column_stack([np.cos(turn), np.sin(turn)])


def _score(fixes: Fixes, anchors_m: Float, position_m: Float, nlos: bool, method: str) -> Score:
    solved = fixes.solved
    error_m = fixes.position_m[solved] - position_m[solved]
    bound_m = float(np.sqrt(np.trace(cramer_rao(position_m[solved], anchors_m), axis1=1, axis2=2).mean()))
    rmse_m, (low_m, high_m) = rms_interval((error_m**2).sum(axis=1))
    whitened = np.linalg.solve(fixes.covariance_m2[solved], error_m[:, :, None])[:, :, 0]
    inside = (error_m * whitened).sum(axis=1) <= CHI_SQUARE_95
    covered, covered_interval = share_interval(int(inside.sum()), len(inside))
    return Score(
        anchors=len(anchors_m),
        nlos=nlos,
        method=method,
        bound_m=bound_m,
        ratio=rmse_m / bound_m,
        ratio_interval=(low_m / bound_m, high_m / bound_m),
        covered=covered,
        covered_interval=covered_interval,
        n_unsolved=int((~solved).sum()),
        n_fixes=len(solved),
    )


def _note(score: Score) -> str:
    unsolved = f"; {score.n_unsolved} of {score.n_fixes} epochs have no fix" if score.n_unsolved else ""
    return f"RMSE {score.ratio * score.bound_m:.3f} m{unsolved}."
