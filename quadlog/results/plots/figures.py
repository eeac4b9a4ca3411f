"""The figures of a run, in the order of the report: file name, heading, caption, drawing function."""

from __future__ import annotations

import gc
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from quadlog.errors import WorkerDied
from quadlog.results.plots import style
from quadlog.results.plots.body import draw_body_torques
from quadlog.results.plots.control import (
    draw_commands,
    draw_displacement,
    draw_euler_angles,
    draw_lookahead,
    draw_posture,
    draw_torques,
    draw_tracking_error,
)
from quadlog.results.plots.planning import draw_expanded, draw_grid
from quadlog.results.plots.run_data import RunData
from quadlog.results.plots.scans import draw_scan, draw_scans
from quadlog.results.plots.trajectory import describe_trajectory, draw_terrain, draw_trajectory
from quadlog.results.plots.uwb_position import draw_uwb_error, draw_uwb_geometry
from quadlog.results.plots.uwb_ranges import draw_ranges, draw_residuals, draw_uwb_links

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Plot:
    """name: stem of the file; alt: text for readers who cannot see the picture; caption: how to read it.

    simulated: caption for a simulated walk, if it differs. chart: what the interactive chart shows in place of the
    picture, if it differs from it. describe: what this run's picture, or its chart, shows, put before the caption.
    """

    name: str
    title: str
    alt: str
    caption: str
    draw: Callable[[RunData], Figure | None]
    simulated: str = ""
    chart: str = ""
    describe: Callable[[RunData, bool], str] | None = None

    def captions(self, run: RunData) -> tuple[str, str]:
        """The captions of this run's picture and of its chart."""
        picture = self.simulated if run.simulated and self.simulated else self.caption
        both = picture, self.chart or picture
        if self.describe is None:
            return both
        first, second = (
            f"{self.describe(run, is_chart)} {text}" for is_chart, text in zip((False, True), both, strict=True)
        )
        return first.strip(), second.strip()


PLOTS = (
    Plot(
        "trajectory",
        "Trajectory over the map",
        "Paths of robot, target and re-simulated walk drawn over the occupancy map, from above.",
        "",
        draw_trajectory,
        "As in [Tracking, Figs 11, 16, 21].",
        describe=describe_trajectory,
    ),
    Plot(
        "ranges",
        "UWB ranges",
        "Range to every anchor over time for each tag, and below it the residual of each anchor over time.",
        "Measured ranges, and their residuals (range − predicted, d_i − |p − a_i| of Gauss–Newton trilateration "
        "[Following]) at the smoothed track. Orange crosses: late by more than three standard deviations, most likely "
        "without line of sight.",
        draw_ranges,
        chart="Measured ranges of each tag, and their residuals (range − predicted, d_i − |p − a_i| of Gauss–Newton "
        "trilateration [Following]) at the smoothed track, a colour for each anchor. Residuals above the line came "
        "late by more than three standard deviations, most likely without line of sight (NLOS).",
    ),
    Plot(
        "residuals",
        "Range residuals per anchor",
        "Histogram of range residuals for each anchor, with its median, spread and share of late ranges.",
        "How the residuals of each anchor, over all tags, are spread [Following, Figs 9–10]. The bias that was "
        "subtracted is already taken out (UWB links has it): a median off zero is what is left of it, a tail to the "
        "right is NLOS. Spread is the interquartile range / 1.349; the outermost bins hold everything beyond them.",
        draw_residuals,
    ),
    Plot(
        "uwb_links",
        "UWB links side by side",
        "For each anchor and tag: quantiles of its residuals, its estimated bias, and its share of late ranges.",
        "One colour for each tag. Top: residuals at the smoothed track, the applied bias taken out: median, middle "
        "half (thick) and middle 90 % (thin). Middle: the constant bias of each link, found from this log alone; "
        "hollow where it was not applied. Bottom: share of ranges late by more than three standard deviations.",
        draw_uwb_links,
    ),
    Plot(
        "uwb_geometry",
        "UWB geometry and fixes",
        "Dilution of precision over the map from above, with anchors, fixes and some of their 95 % ellipses.",
        "The darker, the worse the anchors' directions tell a position there: a fix's standard deviation is that of a "
        "range times HDOP, sqrt(trace((Σ u uᵀ)⁻¹)). Each orange ellipse should hold the tag's true place in 95 of 100 "
        "cases; it knows the noise of ranges, not a bias left in. The robot's track is of its base, fixes are of tags.",
        draw_uwb_geometry,
    ),
    Plot(
        "uwb_error",
        "UWB error against the reference",
        "Distance of UWB fixes and of the track from the reference over time, with the 95 % bound each claims.",
        "How far fixes and track of each tag on the robot are from where the reference puts that tag, lever arm "
        "included. Dashed: how far the claimed 95 % ellipse reaches in the direction of the error, as a running "
        "median. Fewer than 95 % within it means that the claim is too narrow: errors that persist, such as a bias.",
        draw_uwb_error,
        chart="How far fixes and track of each tag on the robot are from where the reference puts that tag, lever arm "
        "included, and how far the claimed 95 % ellipse of the track reaches in the direction of the error. More than "
        "5 % of the track above it means that the claim is too narrow: errors that persist, such as a bias.",
    ),
    Plot(
        "scan",
        "One scan, by class",
        "Points of one lidar scan from above and from the side, coloured as ground, obstacle, outlier or left out.",
        "What the filter made of one scan: isolated points, ground, and obstacles [Following]. Grey points lie out of "
        "the field of view. Above all points; below those between the dotted lines, seen from the right.",
        draw_scan,
    ),
    Plot(
        "scans",
        "Points per scan",
        "Number of ground, obstacle and outlier points in each scan over time.",
        "How many points of each scan the filter called what [Following]. Between the coloured area and the black line "
        "lie the points outside the field of view.",
        draw_scans,
        chart="How many points of each scan the filter called what [Following]. The valid points that are neither "
        "ground nor obstacle nor outlier lie outside the field of view.",
    ),
    Plot(
        "terrain",
        "Terrain",
        "Height map of the ground, seen from above.",
        "Mean height of the points that the ground filter [Following] gave to the ground, in the frame of the map.",
        draw_terrain,
        "The ground that the simulated robot walked on.",
    ),
    Plot(
        "grid",
        "One map and its plan",
        "Occupancy grid at one instant with the window's edge, the robot's footprint, target and planned path.",
        "The occupancy grid at one instant, before dilation, as the planner got it [Following], with the path in cells "
        "and smoothed by the quadratic B-spline [Planning, eq. 14]. Left the whole window; the dotted square is shown "
        "on the right, where robot and cells are large enough to tell.",
        draw_grid,
    ),
    Plot(
        "expanded",
        "Cells expanded per replan",
        "Cells expanded and generated at each replan over time.",
        "What each replan cost the search, as [Planning, Fig. 18] shows it. Expanded cells were closed, generated "
        "cells ever opened. Circles mark replans that could not reuse the last path.",
        draw_expanded,
        chart="What each replan cost the search, as [Planning, Fig. 18] shows it. Expanded cells were closed, "
        "generated cells ever opened. Dots mark replans that could not reuse the last path.",
    ),
    Plot(
        "tracking_error",
        "Tracking error",
        "Distance of the re-simulated robot to its plan over time, as nearest, signed and timed distance.",
        "How far the re-simulated robot was from the plan active at each tick: to its nearest point, the same with a "
        "sign, and to where the plan was due at that instant [Tracking, eq. 45]. Dashed: the mean η (eq. 46); grey: "
        "± σ (eq. 47). A replay's reference is a plan held for as long as walking it takes; the robot follows newer "
        "ones.",
        draw_tracking_error,
        "How far the simulated robot was from its course at each tick: to the nearest point of it, the same with a "
        "sign, to where it was due at that instant, and in its direction [Tracking, eq. 45, Fig. 12]. Dashed: the mean "
        "η (eq. 46); grey: ± σ (eq. 47).",
        chart="How far the simulated robot was from its reference path at each tick: to its nearest point, the same "
        "with a sign, to where it was due at that instant, and in its direction [Tracking, eq. 45]; flat: the means η "
        "(eq. 46).",
    ),
    Plot(
        "displacement",
        "Displacement",
        "Place of the trunk's middle over time: forward, to the left, and height.",
        "Where the trunk's middle is, 2 s of rest included [Foot, Fig. 5].",
        draw_displacement,
    ),
    Plot(
        "euler_angles",
        "Euler angles",
        "Roll, pitch and yaw of the trunk over time.",
        "How the trunk is turned: roll positive with the left side up, pitch with the nose down, yaw to the left "
        "[Foot, Fig. 6].",
        draw_euler_angles,
    ),
    Plot(
        "lookahead",
        "Look-ahead",
        "Look-ahead distance of the pure pursuit over time, with its fuzzy gains where there are any.",
        "The look-ahead distance l = l₀ + λ_v k_v v² + λ_w k_w v [Tracking, eq. 17]; constant without fuzzy "
        "adaptation.",
        draw_lookahead,
    ),
    Plot(
        "commands",
        "Commands",
        "Commanded and reached forward speed and yaw rate over time, and the speed sideways of a robot that has one.",
        "What pure pursuit asked for [Tracking, eqs 15–16] and what the simulated robot did.",
        draw_commands,
    ),
    Plot(
        "posture",
        "Posture",
        "Pitch, roll and height of the body over time.",
        "How the body was held: pitch positive with the nose down, roll with the left side up; height of the trunk's "
        "centre above z = 0 of the map, ground included.",
        draw_posture,
    ),
    Plot(
        "torques",
        "Joint torques",
        "Joint torques of the four legs over time.",
        "Torque of every joint [Tracking, eqs 43–44]: a row for each leg (FL front left, FR front right, RL rear left, "
        "RR rear right), with hip, thigh and calf.",
        draw_torques,
    ),
    Plot(
        "body_torques",
        "Torques of the logged and the re-simulated body",
        "Bars of each joint's rms torque, with its peak, while its leg stands, while it swings, and at all times.",
        "Bars: root mean square of each joint's torque; lines end at its peak. Where both bodies walked at the same "
        "speeds, over those alone, each speed counted equally in both; else over the whole walk. A leg stands where "
        "its foot carries weight.",
        draw_body_torques,
    ),
)


def render_plots(run: RunData, names: Collection[str] | None = None) -> dict[str, bytes]:
    """The PNG of every figure whose data is there: name -> bytes, in the order of PLOTS. names: of these alone."""
    wanted = [plot.name for plot in PLOTS if names is None or plot.name in names]
    with _figures_collected():
        return {name: png for each in wanted for name, png in draw_plot(run, each).items()}


@contextmanager
def _figures_collected() -> Iterator[None]:
    """Frees the memory of figures, 5 MB each, which leave cycles, without searching what was loaded before for them."""
    gc.freeze()
    try:
        yield
    finally:
        gc.collect()
        gc.unfreeze()


def draw_plot(run: RunData, name: str) -> dict[str, bytes]:
    """The figure's PNG by its name; empty where the run lacks its data."""
    (plot,) = (each for each in PLOTS if each.name == name)
    png = style.render_png(partial(plot.draw, run))
    return {} if png is None else {name: png}


class SharedDrawing:
    """Figures drawn by this process and a helper, which starts at once while this process is busy with other work."""

    def __init__(self, run: RunData, helper: Executor | None = None) -> None:
        """helper: a single process, which runs tasks in order."""
        self._run = run
        submit = None if helper is None else helper.submit
        self._asked = {} if submit is None else {plot.name: submit(_draw_one, run.path, plot.name) for plot in PLOTS}

    def finish(self) -> dict[str, bytes]:
        """Draw what the helper has not started, from the last figure backwards; returns all, as render_plots does.

        Raises NotARun for damaged files.
        """
        if not self._asked:
            return render_plots(self._run)
        drawn: dict[str, bytes] = {}
        with _figures_collected():
            for name in reversed(self._asked):
                if not self._asked[name].cancel():
                    break  # the helper has started this one
                drawn |= draw_plot(self._run, name)
        for name, future in self._asked.items():
            if not future.cancelled():
                drawn |= self._drawn_by_helper(name, future)
        return {plot.name: drawn[plot.name] for plot in PLOTS if plot.name in drawn}

    def _drawn_by_helper(self, name: str, future: Future[dict[str, bytes]]) -> dict[str, bytes]:
        try:
            return future.result()
        except WorkerDied:
            return render_plots(self._run, [name])


@lru_cache(maxsize=1)
def _run_at(path: Path) -> RunData:
    """The run, read once by the helper for all its figures."""
    gc.freeze()  # what is loaded by now stays: figures are found among fewer objects
    return RunData(path)


def _draw_one(path: Path, name: str) -> dict[str, bytes]:
    return draw_plot(_run_at(path), name)
