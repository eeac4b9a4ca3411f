"""The table following-uwb: ranges, coordinates and estimators, with pictures of the site and of the bounds."""

from __future__ import annotations

from quadlog.pipelines.tables.following.uwb_estimators import (
    EstimatorScore,
    coverage_group,
    efficiency_group,
    prior_group,
    score_all,
    tracking_group,
)
from quadlog.pipelines.tables.following.uwb_ranges import (
    METHODS,
    coordinate_group,
    distance_group,
    height_group,
    range_group,
    stand_all,
    truth_group,
)
from quadlog.pipelines.tables.pictures import drawn
from quadlog.results.numbers import count
from quadlog.results.papers.table import PaperTable, TablePicture
from quadlog.results.view import Panel, Spread, forest, look


def efficiency_panels(scores: list[EstimatorScore]) -> list[Panel]:
    """RMSE / bound by number of anchors and method, one panel in line of sight, one with NLOS."""
    panels = []
    for nlos, title in ((False, "line of sight"), (True, "ranges partly late (NLOS)")):
        mine = sorted((score for score in scores if score.nlos == nlos), key=lambda score: score.anchors)
        rows = {
            f"{score.anchors} anchors, {score.method}": Spread(
                score.ratio, score.ratio_interval, color=look(list(METHODS).index(score.method))["color"]
            )
            for score in mine
        }
        panels.append(forest(f"RMSE / Cramér-Rao bound, {title}", rows, "ratio (1)", log=True, marks=[1.0]))
    return panels


FULL_FIXES, FAST_FIXES = 100_000, 10_000
FULL_RUNS, FAST_RUNS = 200, 30
ERRATA = (
    (
        "The printed tag coordinates, (0, 2.4) for the robot and (0, 0.8) for the person, contradict the printed "
        "distances. The x and y of both are transposed, and so is their order: robot (0.8, 0) and person (2.4, 0) fit."
    ),
    "The person's distance from station 3, printed as 3.55 m, should be 3.60 m.",
    (
        "The weighted least squares cannot change a fix from three stations: once one equation is subtracted from the "
        "others, two equations in two unknowns are left. What helps is a direct fit of the ranges."
    ),
    (
        "The circles are drawn from horizontal distances, but a tag at 0.6 m or 1.3 m measures slant ranges to "
        "stations at 1.2 m."
    ),
)


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast draws a tenth of the fixes."""
    n_fixes, n_runs = (FAST_FIXES, FAST_RUNS) if fast else (FULL_FIXES, FULL_RUNS)
    standing = stand_all(n_fixes, seed)
    scores = score_all(n_fixes, seed)
    return PaperTable(
        name="following-uwb",
        title="UWB positioning with three stations [Following, Figs 9 to 12]",
        caption="Two tags stand still among three stations. How far off are ranges and coordinates, and how far off "
        "need they be? Simulated, because the paper's ranges are not published.",
        sizes=f"{count(n_fixes)} fixes per tag and per number of anchors, {count(n_runs)} walks, seed {seed}.",
        seed=seed,
        fast=fast,
        groups=(
            truth_group(),
            distance_group(),
            range_group(standing),
            coordinate_group(standing),
            efficiency_group(scores, nlos=False),
            efficiency_group(scores, nlos=True),
            coverage_group(scores),
            tracking_group(n_runs, seed),
            prior_group(n_runs, seed),
            height_group(),
        ),
        pictures=_pictures(scores),
        errata=ERRATA,
    )


def _pictures(scores: list[EstimatorScore]) -> tuple[TablePicture, ...]:
    return (
        drawn(
            "efficiency",
            "RMSE over the Cramér-Rao bound for each method by number of anchors, in line of sight and with NLOS.",
            "RMSE over the Cramér-Rao bound, with 95 % intervals; one is the best that any unbiased fix can do. With "
            "three anchors the three linear methods coincide.",
            efficiency_panels(scores),
        ),
    )
