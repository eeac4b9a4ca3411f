"""The table following-lidar: every number by place, and pictures of single scans as both chains see them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import apply_transform
from quadlog.lidar.classified_scan import PointClass
from quadlog.messages import Float
from quadlog.pipelines.tables.following.lidar_scores import (
    FALSE_CELLS,
    HELD_OUT_SEED,
    MEASURES,
    METHODS,
    PLACES,
    UNCROPPED,
    WALLED,
    LidarScore,
    cell_group,
    crop_group,
    ground_group,
    outlier_group,
    pooled,
    score_all,
)
from quadlog.pipelines.tables.pictures import drawn
from quadlog.results.papers.table import PaperTable, TablePicture
from quadlog.results.plots import style
from quadlog.results.plots.scans import CLASS_COLOR
from quadlog.results.text.numbers import count
from quadlog.simulation.synthetic.labelled_scans import labelled_scans

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = dict(zip(METHODS, (style.TARGET, style.ROBOT), strict=True))
BAR = 0.38
VIEW_X_M, VIEW_Y_M = (-4.0, 7.0), (-3.2, 3.2)
SHOWN = (PointClass.CROPPED, PointClass.GROUND, PointClass.OBSTACLE, PointClass.OUTLIER)
"""In the order of drawing: what is rare lies on top."""


def draw_measures(scores: list[LidarScore]) -> Figure:
    """A panel per number: a bar per place and method, with its 95 % interval."""
    figure = style.new_figure(7.6)
    panels = figure.subplots(2, 3, sharey=True).ravel()
    for panel, measure in zip(panels, MEASURES, strict=True):
        for number, method in enumerate(METHODS):
            mine = [next(s for s in scores if (s.place, s.method) == (place, method)) for place in PLACES]
            ours, interval = zip(*(measure.of(score) for score in mine), strict=True)
            low, high = np.array(interval).T
            at = np.arange(len(PLACES)) + BAR * (number - 0.5)
            away = [ours - low, high - ours]
            panel.barh(at, ours, BAR, xerr=away, color=COLORS[method], ecolor=style.BLACK, label=method)
        panel.set_title(measure.name)
        panel.set_xlabel("cells per scan" if measure is FALSE_CELLS else "share (1)")
        panel.tick_params(axis="y", length=0)
        panel.locator_params(axis="x", nbins=4)
    panels[list(MEASURES).index(FALSE_CELLS)].set_xscale("symlog", linthresh=1.0)
    panels[0].set_yticks(range(len(PLACES)), list(PLACES.values()))
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(METHODS))
    return figure


def draw_scans(seed: int) -> Figure:
    """The first scan near each kind of wall from above, in base: a column per place; the truth, then each method."""
    figure = style.new_figure(8.4)
    panels = figure.subplots(1 + len(METHODS), len(WALLED), sharex=True, sharey=True)
    for column, place in zip(panels.T, WALLED, strict=True):
        (scan,) = labelled_scans(place, HELD_OUT_SEED + seed, 1)
        xyz_base_m = apply_transform(scan.transform_lidar_to_base, scan.xyz_lidar_m.astype(np.float64))
        labels = {"truth": scan.truth} | {name: method(scan).label for name, method in METHODS.items()}
        for panel, (name, label) in zip(column, labels.items(), strict=True):
            _draw_points(panel, xyz_base_m, label)
            panel.set_title(f"{PLACES[place]}: {name}")
            panel.set(xlim=VIEW_X_M, ylim=VIEW_Y_M, aspect="equal")
    for panel in panels[-1]:
        panel.set_xlabel("x forward (m)")
    for panel in panels[:, 0]:
        panel.set_ylabel("y left (m)")
    for shown in SHOWN:
        panels[0, 0].plot([], [], ".", color=CLASS_COLOR[shown.name.lower()], label=shown.name.lower())
    handles, names = panels[0, 0].get_legend_handles_labels()
    style.enlarge_dots(figure.legend(handles, names, loc="outside upper center", ncols=len(SHOWN)))
    return figure


def _draw_points(panel: Axes, xyz_base_m: Float, label: NDArray[np.uint8]) -> None:
    for shown in SHOWN:
        points = xyz_base_m[label == shown]
        panel.plot(points[:, 0], points[:, 1], ".", color=CLASS_COLOR[shown.name.lower()], markersize=1.2)
    panel.plot([0], [0], marker=(3, 0, -90), color=style.ROBOT, markersize=9, linestyle="none")


FULL_SCANS, FAST_SCANS = 60, 8


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast takes fewer scans of every place."""
    n_scans = FAST_SCANS if fast else FULL_SCANS
    scores = score_all(n_scans, seed)
    return PaperTable(
        name="following-lidar",
        title="Ground, outliers and obstacles of a 16-beam scan [Following]",
        caption="The paper prints pictures of its lidar chain and no number. Here both chains get the same simulated "
        "scans, in which the class of every point is known: `paper` as published (front half, statistical outliers, "
        "the largest plane is the ground), and `range_image`, quadlog's default, which gets the whole scan. Only the "
        "front half is judged, for both. Neither knows how the gait tilts the body in every other scan.",
        sizes=f"{count(n_scans)} scans of each of {len(PLACES)} places, every one with a layout and a pose of its own, "
        f"seed {seed}: scans drawn from seed {HELD_OUT_SEED + seed}, constants chosen on seed 100.",
        seed=seed,
        fast=fast,
        groups=(ground_group(scores), outlier_group(scores), cell_group(scores), crop_group(scores)),
        pictures=_pictures(scores, seed),
        errata=(_wall_erratum(scores),),
    )


def _wall_erratum(scores: list[LidarScore]) -> str:
    ground = {(score.place, score.method): pooled(score.ground) for score in scores}
    ahead, beside = ((ground[place, "paper"], ground[place, UNCROPPED]) for place in ("wall_ahead", "corridor"))
    return (
        "Near a wall the largest plane of the front half is the wall, not the floor, and the wall leaves the map. Of "
        f"the points that the published chain calls ground, {_percent(ahead[0].precision)} are ground with a wall "
        f"ahead and {_percent(beside[0].precision)} in a 2 m corridor. The crop to 180° does it with a wall ahead "
        f"({_percent(ahead[1].precision)} without it), not in the corridor ({_percent(beside[1].precision)})."
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _pictures(scores: list[LidarScore], seed: int) -> tuple[TablePicture, ...]:
    return (
        drawn(
            "measures",
            "Bars of both methods by place: ground precision and recall, outliers found, inliers lost, obstacle cells "
            "found, false cells.",
            "Both methods in every place, with 95 % intervals. More is better but for inliers lost and false cells, "
            "whose scale is logarithmic above one.",
            partial(draw_measures, scores),
        ),
        drawn(
            "scans",
            "Two scans from above, in a corridor and before a wall, coloured by true class and as each method has it.",
            "The first scan of the corridor and of the wall ahead. The published chain paints the nearest wall in the "
            "colour of the ground, and leaves out what lies behind the robot.",
            partial(draw_scans, seed),
        ),
    )
