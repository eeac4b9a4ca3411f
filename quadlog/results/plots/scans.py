"""What the filter made of the lidar: one scan's points by class, and how many there are of each over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# By the names that cloud_samples.npz gives its labels; a class quadlog learns later is drawn in black.
_CLASS_COLOR = {
    "invalid": style.LIGHT,
    "cropped": style.LIGHT,
    "outlier": style.NOTE,
    "ground": style.FIX,
    "obstacle": style.TARGET,
}
POINTS_SHOWN = 20000


def draw_scan(run: RunData) -> Figure | None:
    """The middle one of the saved scans from above and from the side, in metres of `base`, coloured by class."""
    samples, classes = run.cloud_samples
    full = [sample for sample in samples if np.isfinite(sample.xyz_m).all(axis=1).any()]
    if not full:
        return None
    sample = full[len(full) // 2]
    finite = np.isfinite(sample.xyz_m).all(axis=1)
    xyz_m, label = sample.xyz_m[finite].astype(np.float64), sample.label[finite]
    reach_m = _reach_m(xyz_m)
    figure = style.new_figure(8.6)
    top, side = figure.subplots(2, 1, height_ratios=[2.6, 1])
    for index, name in enumerate(classes):
        mine = np.flatnonzero(label == index)
        if not len(mine):
            continue
        points = xyz_m[mine[style.thin_points(len(mine), POINTS_SHOWN)]]
        color = _CLASS_COLOR.get(name.lower(), style.BLACK)
        top.plot(points[:, 0], points[:, 1], ".", color=color, markersize=2, label=f"{name} ({len(mine)})")
        side.plot(points[:, 0], points[:, 2], ".", color=color, markersize=2)
    top.plot([0], [0], marker=(3, 0, -90), color=style.ROBOT, markersize=11, linestyle="none", label="robot")
    top.set(
        xlim=(-reach_m, reach_m), ylim=(-reach_m * 0.66, reach_m * 0.66), xlabel="x forward (m)", ylabel="y left (m)"
    )
    side.set(xlim=(-reach_m, reach_m), xlabel="x forward (m)", ylabel="z up (m)")
    _limit_heights(side, xyz_m[:, 2])
    top.set_aspect("equal")
    seconds = float(run.seconds(np.array([sample.t_ns]))[0])
    figure.suptitle(
        f"scan at t = {seconds:.2f} s, in base: from above, and from the side (heights stretched)", **_TITLE
    )
    style.enlarge_dots(figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=5))
    return figure


def draw_scans(run: RunData) -> Figure | None:
    """Points per class per scan over time, stacked; scans without a ground plane are marked."""
    scans = run.table("scans")
    if scans is None:
        return None
    keep = style.thin_line(scans["n_valid"], 2000)
    seconds = run.seconds(scans["t_ns"])[keep]
    counts = {name: scans[f"n_{name}"][keep] for name in ("ground", "obstacle", "outlier")}
    figure = style.new_figure(3.2)
    axes = figure.subplots()
    colors = [_CLASS_COLOR[name] for name in counts]
    axes.stackplot(seconds, *counts.values(), labels=list(counts), colors=colors, linewidth=0)
    axes.plot(seconds, scans["n_valid"][keep], color=style.BLACK, linewidth=1.1, label="valid, before the crop")
    lost = ~scans["ground_found"][keep].astype(bool)
    if lost.any():
        axes.plot(
            seconds[lost],
            np.zeros(int(lost.sum())),
            "x",
            color=style.BLACK,
            markersize=5,
            clip_on=False,
            label=f"no ground found ({int((~scans['ground_found'].astype(bool)).sum())})",
        )
    axes.set(ylim=(0, None), xlabel="time (s)", ylabel="points per scan (count)")
    style.legend_above(axes, columns=5)
    return figure


_TITLE: dict[str, Any] = {"x": 0.01, "ha": "left", "fontsize": 10.5, "fontweight": "bold"}


def _reach_m(xyz_m: Float) -> float:
    """Half width of the view from above: nearly all points, at least 3 m."""
    return max(3.0, 1.05 * float(np.percentile(np.abs(xyz_m[:, :2]).max(axis=1), 98)))


def _limit_heights(side: Axes, z_m: NDArray[np.float64]) -> None:
    low_m, high_m = np.percentile(z_m, [0.5, 99.5])
    margin_m = max(0.2, 0.1 * float(high_m - low_m))
    side.set_ylim(float(low_m) - margin_m, float(high_m) + margin_m)
