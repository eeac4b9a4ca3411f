"""The table following-uwb: ranges, coordinates and estimators, with pictures of the site and of the bounds."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.following.uwb_estimators import (
    ANCHORS,
    EstimatorScore,
    coverage_group,
    efficiency_group,
    prior_group,
    score_all,
    tracking_group,
)
from quadlog.pipelines.tables.following.uwb_ranges import (
    METHODS,
    STATIONS_M,
    StandingTag,
    coordinate_group,
    distance_group,
    height_group,
    range_group,
    stand_all,
    truth_group,
)
from quadlog.pipelines.tables.pictures import drawn
from quadlog.positioning.fix.dilution import CHI2_95
from quadlog.results.papers.table import PaperTable, TablePicture
from quadlog.results.plots import style
from quadlog.results.text.numbers import count

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN_FIXES = 400
HALF_WIDTH_M = 0.42
COLORS = dict(zip(METHODS, (style.GREY, style.PLAN, style.TARGET, style.ROBOT, style.NOTE), strict=True))
MARKERS = dict(zip(METHODS, "s^Do*", strict=True))
LABELS = {"paper": "fixes of the paper's method", "gauss_newton": "fixes of Gauss-Newton"}


def draw_site(standing: list[StandingTag]) -> Figure:
    """Stations and tags from above; below, the fixes around each tag."""
    figure = style.new_figure(10.0)
    panels = figure.subplot_mosaic([["site", "site"], ["left", "right"]], height_ratios=[1.2, 1.0])
    _draw_stations(panels["site"], standing)
    for name, each in zip(("left", "right"), standing, strict=True):
        _draw_fixes(panels[name], each)
    handles, labels = panels["left"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def draw_efficiency(scores: list[EstimatorScore]) -> Figure:
    """RMSE / bound by number of anchors, one panel in line of sight, one with NLOS."""
    figure = style.new_figure(4.4)
    panels = figure.subplots(1, 2)
    for panel, nlos, title in zip(panels, (False, True), ("line of sight", "ranges partly late (NLOS)"), strict=True):
        for number, method in enumerate(METHODS):
            mine = [score for score in scores if score.nlos == nlos and score.method == method]
            place = np.arange(len(ANCHORS)) + 0.13 * (number - 2)
            ratio = np.array([score.ratio for score in mine])
            low, high = np.array([score.ratio_interval for score in mine]).T
            panel.errorbar(
                place,
                ratio,
                yerr=[ratio - low, high - ratio],
                fmt=MARKERS[method],
                color=COLORS[method],
                markersize=6,
                capsize=2,
                linewidth=1.0,
                label=method,
            )
        panel.axhline(1.0, color=style.BLACK, linewidth=1.0, linestyle="--")
        panel.set_xticks(range(len(ANCHORS)), [str(n) for n in ANCHORS])
        panel.set_xlabel("anchors (count)")
        panel.set_title(title)
    panels[0].set_ylabel("RMSE / Cramér-Rao bound (1)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(METHODS))
    return figure


def _draw_stations(axes: Axes, standing: list[StandingTag]) -> None:
    axes.plot(STATIONS_M[:, 0], STATIONS_M[:, 1], "^", color=style.BLACK, markersize=9, label="stations")
    for number, (x_m, y_m, _) in enumerate(STATIONS_M, start=1):
        axes.annotate(str(number), (x_m, y_m), xytext=(8, -4), textcoords="offset points")
    for each, color in zip(standing, (style.PLAN, style.RESIM), strict=True):
        tag = each.tag
        axes.plot(*tag.true_m, "o", color=color, markersize=6, label=f"{tag.name}, from its distances")
        axes.plot(*tag.printed_m, "x", color=color, markersize=9, markeredgewidth=2, label=f"{tag.name}, as printed")
        axes.plot(*_ellipse(np.array(tag.true_m), each.bound_m2), color=color, linewidth=1.2)
    axes.plot([], [], color=style.GREY, linewidth=1.2, label="95 % ellipse of the bound")
    _equal_axes(axes, (-0.6, 6.6), (-2.8, 2.8))
    style.legend_above(axes, columns=3)


def _draw_fixes(axes: Axes, each: StandingTag) -> None:
    true_m = np.array(each.tag.true_m)
    for method, width in (("paper", 3.5), ("gauss_newton", 1.5)):
        fix_m = each.fix_m[method][np.isfinite(each.fix_m[method]).all(axis=1)]
        some = style.thin_points(len(fix_m), SHOWN_FIXES)
        axes.plot(fix_m[some, 0], fix_m[some, 1], ".", color=COLORS[method], markersize=3, alpha=0.4)
        spread = _ellipse(fix_m.mean(axis=0), np.cov(fix_m.T))
        axes.plot(*spread, color=COLORS[method], linewidth=width, label=LABELS[method])
    axes.plot(
        *_ellipse(true_m, each.bound_m2), color=style.BLACK, linewidth=1.0, linestyle="--", label="Cramér-Rao bound"
    )
    axes.plot(*true_m, "+", color=style.BLACK, markersize=12, markeredgewidth=2)
    axes.set_title(f"{each.tag.name} tag ({each.tag.coordinate_figure})")
    _equal_axes(axes, *((middle_m - HALF_WIDTH_M, middle_m + HALF_WIDTH_M) for middle_m in each.tag.true_m))


def _ellipse(middle_m: Float, covariance_m2: Float) -> Float:
    """(2, N) the line around 95 % of a normal distribution."""
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = np.sqrt(CHI2_95) * np.vstack([np.cos(angle), np.sin(angle)])
    line: Float = middle_m[:, None] + np.linalg.cholesky(covariance_m2) @ circle
    return line


def _equal_axes(axes: Axes, x_m: tuple[float, float], y_m: tuple[float, float]) -> None:
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(x_m)
    axes.set_ylim(y_m)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


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
        pictures=_pictures(standing, scores),
        errata=ERRATA,
    )


def _pictures(standing: list[StandingTag], scores: list[EstimatorScore]) -> tuple[TablePicture, ...]:
    return (
        drawn(
            "site",
            "Stations and tags from above, and below it the fixes around each tag with 95 % ellipses.",
            "Above: the stations, the tags where the printed distances put them (dots) and where the paper prints them "
            "(crosses). Below: some of the fixes that the paper's method and a direct fit make of the same ranges, "
            "with the ellipses that hold 95 % of each.",
            partial(draw_site, standing),
        ),
        drawn(
            "efficiency",
            "RMSE over the Cramér-Rao bound for each method by number of anchors, in line of sight and with NLOS.",
            "RMSE over the Cramér-Rao bound, with 95 % intervals; one is the best that any unbiased fix can do. With "
            "three anchors the three linear methods coincide. Note the two scales.",
            partial(draw_efficiency, scores),
        ),
    )
