"""Lidar points by class: one scan, and the number of points of each class over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.messages import Float
from quadlog.results.plots import layout as places
from quadlog.results.plots import style
from quadlog.results.plots.layout import draw_body
from quadlog.results.plots.run_data import RunData
from quadlog.results.text.numbers import count, percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# By the class names of cloud_samples.npz; unknown classes are drawn in black.
CLASS_COLOR = {
    "invalid": style.LIGHT,
    "cropped": style.LIGHT,
    "outlier": style.NOTE,
    "ground": style.FIX,
    "obstacle": style.TARGET,
}
POINTS_SHOWN = 20000
_ON_TOP = "outlier"  # rare points must not be hidden by the many
STRIP_M = 2.0
"""Half width of the strip in the side view; a whole scan would hide itself."""

_HIGH_PER_WIDE = 0.66  # of the view from above
_SIDE_IN = 2.1  # height of the view from the side


def draw_scan(run: RunData) -> Figure | None:
    """The middle one of the saved scans from above, and a strip of it from the side, in `base`, coloured by class."""
    samples, classes = run.cloud_samples
    full = [sample for sample in samples if np.isfinite(sample.xyz_m).all(axis=1).any()]
    if not full:
        return None
    sample = full[len(full) // 2]
    finite = np.isfinite(sample.xyz_m).all(axis=1)
    xyz_m, label = sample.xyz_m[finite].astype(np.float64), sample.label[finite]
    in_strip = np.abs(xyz_m[:, 1]) <= STRIP_M
    figure, (top, side) = _new_views()
    for index, name in sorted(enumerate(classes), key=lambda each: each[1].lower() == _ON_TOP):
        mine = label == index
        if not mine.any():
            continue
        share = percent(float(mine.mean()))
        _draw_class(top, xyz_m[mine][:, [0, 1]], name, f"{name}: {count(int(mine.sum()))} ({share})")
        _draw_class(side, xyz_m[mine & in_strip][:, [0, 2]], name)
    _frame_views(top, side, xyz_m, xyz_m[in_strip])
    draw_body(top, (0.0, 0.0, 0.0), run.body_m())
    seconds = float(run.seconds(np.array([sample.t_ns]))[0])
    places.add_head(figure, top, f"scan at t = {seconds:.2f} s, {count(len(label))} points, in base")
    return figure


def draw_scans(run: RunData) -> Figure | None:
    """Points per class per scan over time, stacked; scans without a ground plane are marked."""
    scans = run.table("scans")
    if scans is None:
        return None
    keep = style.thin_line(scans["n_valid"], 2000)
    seconds = run.seconds(scans["t_ns"])[keep]
    counts = {name: scans[f"n_{name}"][keep] for name in ("ground", "obstacle", "outlier")}
    figure, grid = style.new_stack(1, 2.7)
    axes = grid[0, 0]
    colors = [CLASS_COLOR[name] for name in counts]
    axes.stackplot(seconds, *counts.values(), labels=list(counts), colors=colors, linewidth=0)
    axes.plot(seconds, scans["n_valid"][keep], color=style.BLACK, linewidth=1.1, label="valid, before the crop")
    lost = ~scans["ground_found"][keep].astype(bool)
    if lost.any():
        label = f"no ground found ({int((~scans['ground_found'].astype(bool)).sum())})"
        style.mark_on_axis(axes, seconds[lost], label, 5)
    axes.set(ylim=(0, None), xlabel="time (s)", ylabel="points per scan (count)")
    style.legend_above(axes, columns=5)
    return figure


def _new_views() -> tuple[Figure, list[Axes]]:
    """A figure with the panel from above over that from the side."""
    left_in, right_in = style.LEFT_IN, style.WIDTH_IN - style.RIGHT_IN
    side_in = style.BELOW_IN + _SIDE_IN
    top_in = side_in + places.TITLE_IN + style.BELOW_IN
    wide_in = right_in - left_in
    return places.new_panels(
        (left_in, right_in, top_in, top_in + _HIGH_PER_WIDE * wide_in), (left_in, right_in, style.BELOW_IN, side_in)
    )


def _draw_class(axes: Axes, points_m: Float, name: str, label: str | None = None) -> None:
    some = points_m[style.thin_points(len(points_m), POINTS_SHOWN)]
    color, size = CLASS_COLOR.get(name.lower(), style.BLACK), 4 if name.lower() == _ON_TOP else 2
    axes.plot(some[:, 0], some[:, 1], ".", color=color, markersize=size, label=label)


def _frame_views(top: Axes, side: Axes, xyz_m: Float, strip_m: Float) -> None:
    reach_m = _reach_m(xyz_m)
    along = {"xlim": (-reach_m, reach_m), "xlabel": "x forward (m)"}
    top.set(**along, ylim=(-_HIGH_PER_WIDE * reach_m, _HIGH_PER_WIDE * reach_m), ylabel="y left (m)", aspect="equal")
    top.set_title("from above")
    for edge_m in (-STRIP_M, STRIP_M):
        top.axhline(edge_m, color=style.GREY, linewidth=0.8, linestyle=":")
    side.set(**along, ylabel="z up (m)")
    side.set_title(f"from the side: the strip of ±{STRIP_M:g} m about the robot (heights stretched)")
    if len(strip_m):
        _limit_heights(side, strip_m[:, 2])


def _reach_m(xyz_m: Float) -> float:
    """Half width of the view from above: 98 % of the points, at least 3 m."""
    return max(3.0, 1.05 * float(np.percentile(np.abs(xyz_m[:, :2]).max(axis=1), 98)))


def _limit_heights(side: Axes, z_m: Float) -> None:
    low_m, high_m = np.percentile(z_m, [0.5, 99.5])
    margin_m = max(0.2, 0.1 * float(high_m - low_m))
    side.set_ylim(float(low_m) - margin_m, float(high_m) + margin_m)
