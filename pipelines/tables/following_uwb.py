"""The table following-uwb: [Following]'s positioning experiment, Figs 9 to 12, and what its ranges allow."""

from __future__ import annotations

from functools import partial

from quadlog.pipelines.tables.uwb_estimators import Score, coverage_group, efficiency_group, score_all
from quadlog.pipelines.tables.uwb_figures import StandingTag, coordinate_group, range_group, stand_all
from quadlog.pipelines.tables.uwb_pictures import draw_efficiency, draw_site
from quadlog.pipelines.tables.uwb_tracking import tracking_group
from quadlog.pipelines.tables.uwb_truths import distance_group, height_group, truth_group
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import count, render_png

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
            height_group(),
        ),
        pictures=_pictures(standing, scores),
        errata=ERRATA,
    )


def _pictures(standing: list[StandingTag], scores: list[Score]) -> tuple[Picture, ...]:
    site, efficiency = (render_png(partial(draw_site, standing)), render_png(partial(draw_efficiency, scores)))
    assert site is not None
    assert efficiency is not None
    return (
        Picture(
            "site",
            "Stations and tags from above, and below it the fixes around each tag with 95 % ellipses.",
            "Above: the stations, the tags where the printed distances put them (dots) and where the paper prints them "
            "(crosses). Below: some of the fixes that the paper's method and a direct fit make of the same ranges, "
            "with the ellipses that hold 95 % of each.",
            site,
        ),
        Picture(
            "efficiency",
            "RMSE over the Cramér-Rao bound for each method by number of anchors, in line of sight and with NLOS.",
            "RMSE over the Cramér-Rao bound, with 95 % intervals; one is the best that any unbiased fix can do. With "
            "three anchors the three linear methods coincide. Note the two scales.",
            efficiency,
        ),
    )
