"""Figures as PNG, PDF or SVG and scenes as films, by matplotlib: one renderer of all panels and one of all scenes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from functools import singledispatch
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure as Picture
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import LogFormatter, StrMethodFormatter

from quadlog.results.scenes import outline_95
from quadlog.results.view import (
    COLORS,
    Array,
    Drawing,
    Ellipses,
    Layer,
    Lines,
    Marks,
    Panel,
    Raster,
    Scene,
    Series,
    Track,
    Windows,
    robust_limits,
    thin_evenly,
)

Format = Literal["png", "pdf", "svg"]

LEVELS = ("#5AA9DC", "#1F6FA8", "#7A3B9A", "#B3003C")
DASHES = ("-", "--", ":", "-.")
MARKERS = {"dot": ".", "triangle": "^", "cross": "x", "star": "*"}
WIDTH_IN = 8.0
POINT_SIZE = 9.0
PANEL_IN, LANE_IN, ABOVE_IN, BELOW_IN, LEFT_IN, RIGHT_IN = 1.35, 0.55, 0.34, 0.48, 0.72, 0.12
ROW_IN, LETTER_IN = 0.21, 0.078
"""Height of a row of a panel with rows or of a legend, and width of a letter."""
MOST_CELLS = 800
"""Across a picture."""
MOST_PERIODS = 24
"""Of an oscillating curve that a picture shows one by one."""
MAX_POINTS = 20_000
"""Of a cloud of points; more look the same."""
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "axes.edgecolor": "#6e6e6e", "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "axes.axisbelow": True, "grid.color": "#e8e8e8", "legend.frameon": False,
    "lines.linewidth": 1.2, "image.interpolation": "nearest", "agg.path.chunksize": 20_000, "svg.hashsalt": "quadlog",
    "pdf.fonttype": 42,
}  # fmt: skip
_NO_DATE: dict[str, dict[str, Any]] = {
    "png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}
}  # fmt: skip


def render(drawing: Drawing, to: Format = "png", width_in: float = WIDTH_IN, point_size: float = POINT_SIZE) -> bytes:
    """The drawing without a title, as wide as given: the same bytes for the same data and version of matplotlib."""
    sizes: dict[Any, Any] = {"font.size": point_size, "legend.fontsize": 0.9 * point_size, "axes.titlesize": point_size}
    with rc_context({**_STYLE, **sizes}):
        scale = width_in / WIDTH_IN, point_size / POINT_SIZE
        picture = _scene_picture(drawing, *scale) if isinstance(drawing, Scene) else _panel_picture(drawing, *scale)
        content = io.BytesIO()
        picture.savefig(content, format=to, dpi=150, metadata=_NO_DATE[to])
    return content.getvalue()


def _panel_picture(panels: Sequence[Panel], wide: float, text: float) -> Picture:
    """Panels one below the other over one x axis; a quantity stands above its panel, beside or above the legend."""
    heights_in = [
        text * ROW_IN * len(panel.rows) if panel.rows else LANE_IN if panel.lane else PANEL_IN for panel in panels
    ]
    width_in, below_in = WIDTH_IN * wide, BELOW_IN * text
    room = int((width_in - LEFT_IN * text - RIGHT_IN) / (LETTER_IN * text))
    legends = [_legend_shape(panel, room) for panel in panels]
    aboves_in = [text * (ABOVE_IN + ROW_IN * rows) for rows, _ in legends]
    height_in = sum(heights_in) + sum(aboves_in) + below_in
    picture = Picture(figsize=(width_in, height_in))
    FigureCanvasAgg(picture)
    top_in, first = height_in, None
    for panel, panel_in, above_in, legend in zip(panels, heights_in, aboves_in, legends, strict=True):
        top_in -= above_in + panel_in
        letters = max((len(name) for panel in panels for name in panel.rows), default=0)
        left_in = text * max(LEFT_IN, 0.15 + LETTER_IN * letters)
        box = (left_in, top_in, width_in - left_in - RIGHT_IN, panel_in)
        scaled = tuple(np.array(box) / [width_in, height_in, width_in, height_in])
        axes = picture.add_axes(scaled, sharex=first)
        first = first or axes
        _draw_panel(axes, panel, legend[1], title_pad=3 + 72 * ROW_IN * text * legend[0])
        axes.tick_params(labelbottom=panel is panels[-1])
    axes.set_xlabel(panels[-1].x)
    return picture


def _legend_shape(panel: Panel, room: int) -> tuple[int, int]:
    """Rows of the legend below the quantity, 0 where both fit side by side in so many letters, and columns."""
    widths = [] if panel.rows or panel.lane else [len(series.label) + 5 for series in panel.series]
    if len(panel.what) + sum(widths) <= room:
        return 0, max(1, len(widths))
    columns = max(1, room // max(widths, default=1))
    return -(-len(widths) // columns), columns


def _draw_panel(axes: Axes, panel: Panel, columns: int, title_pad: float) -> None:
    for series in panel.series:
        banded = panel.period_s and len(series.x) and np.ptp(series.x) > MOST_PERIODS * panel.period_s
        _draw_series(axes, banded_by(series, panel.period_s) if banded else series, bool(panel.rows))
    for x in panel.marks.tolist():
        axes.axvline(x, color=COLORS["soft"], linewidth=0.6, linestyle=":")
    if panel.robust:
        low, high, beyond = robust_limits(panel)
        axes.set_ylim(low, high)
        if beyond:
            axes.text(1, 1, f"{beyond} beyond", transform=axes.transAxes, ha="right", va="top", fontsize="small")
    elif panel.zero:
        axes.set_ylim(bottom=0)
    if panel.log:
        _set_log(axes, "x" if panel.rows else "y")
    axes.set_title(panel.what, loc="left", pad=title_pad)
    if panel.rows:
        axes.set_yticks(range(len(panel.rows)), panel.rows)
        axes.set_ylim(len(panel.rows) - 0.5, -0.5)
    elif not panel.lane:
        legend = axes.legend(
            loc="lower right", bbox_to_anchor=(1, 1), ncols=columns, borderaxespad=0.1, handlelength=1.4
        )
        _enlarge(legend)


def banded_by(series: Series, period: float) -> Series:
    """The band from the least to the largest value in each period of x."""
    starts = np.flatnonzero(np.diff(np.floor(series.x / period), prepend=-np.inf))
    low, high = (edge.reduceat(series.y, starts) for edge in (np.fmin, np.fmax))
    return replace(series, x=series.x[starts], y=low, upper=high, style="band")


def _set_log(axes: Axes, which: Literal["x", "y"]) -> None:
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(LogFormatter())


def _draw_series(axes: Axes, series: Series, in_rows: bool) -> None:
    color, look = COLORS[series.color], dict[str, Any]()
    if series.style == "band" and series.upper is not None:
        axes.fill_between(series.x, series.y, series.upper, color=color, alpha=0.25, linewidth=0, label=series.label)
    elif series.style == "points":
        keep = thin_evenly(len(series.x), MAX_POINTS)
        size = 1.8 if not in_rows else 4 if series.variant else 7
        face = "none" if series.variant else color
        look = {"markersize": size, "markeredgewidth": 0.5, "markerfacecolor": face}
        axes.plot(series.x[keep], series.y[keep], "o", color=color, label=series.label, **look)
    else:
        step = "steps-post" if series.style == "steps" else "default"
        look = {"color": color, "drawstyle": step, "label": series.label, "linewidth": 3 if in_rows else None}
        axes.plot(series.x, series.y, "-" if in_rows else DASHES[series.variant % 4], **look)


def _enlarge(legend: Any) -> None:
    """Points of two pixels get a visible size in the legend."""
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D) and handle.get_marker() in ("o", "."):
            handle.set_markersize(6)


def _scene_picture(scene: Scene, wide: float, text: float) -> Picture:
    """The whole time of a scene with a legend above it, and a scale to the right of each raster with a unit."""
    left, right, bottom, top = scene.extent
    scales = [layer for layer in scene.layers if isinstance(layer, Raster) and layer.unit]
    width_in, left_in, scale_in = WIDTH_IN * wide, LEFT_IN * text, 0.9 * text
    wide_in = width_in - left_in - RIGHT_IN - scale_in * len(scales)
    high_in = float(np.clip(wide_in * (top - bottom) / (right - left), 0.3 * wide_in, 1.1 * width_in))
    picture = Picture(figsize=(width_in, 1.0))
    FigureCanvasAgg(picture)
    axes = picture.subplots()
    draw_scene(axes, scene)
    handles, labels = axes.get_legend_handles_labels()
    columns = max(1, round(4 * wide / text))
    above_in = text * (0.1 + 0.19 * -(-len(handles) // columns))
    below_in = BELOW_IN * text
    height_in = below_in + high_in + above_in
    picture.set_size_inches(width_in, height_in)
    axes.set_position((left_in / width_in, below_in / height_in, wide_in / width_in, high_in / height_in))
    for place, layer in enumerate(scales):
        at_in = left_in + wide_in + 0.1 + scale_in * place
        beside = (at_in / width_in, below_in / height_in, 0.15 / width_in, high_in / height_in)
        shown = ScalarMappable(Normalize(layer.low, layer.high), _ramp(layer))
        picture.colorbar(shown, cax=picture.add_axes(beside), label=f"{layer.label} ({layer.unit})")
    if handles:
        where = {"bbox_to_anchor": (-0.02, 1), "ncols": columns, "borderaxespad": 0.2}
        _enlarge(axes.legend(handles, labels, loc="lower left", **where))
    return picture


def draw_scene(axes: Axes, scene: Scene, instant: float | None = None) -> None:
    """The layers at an instant; without one, whole tracks and some of the plans."""
    left, right, bottom, top = scene.extent
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel=scene.axes[0], ylabel=scene.axes[1])
    axes.set_aspect("equal")
    for layer in scene.layers:
        _draw(layer, axes, scene, instant)


@singledispatch
def _draw(layer: Any, _axes: Axes, _scene: Scene, _instant: float | None) -> None:
    raise TypeError(type(layer))


@_draw.register
def _(layer: Raster, axes: Axes, _scene: Scene, _instant: float | None) -> None:
    limits = axes.get_xlim(), axes.get_ylim()
    side = max(1, int(np.ceil(np.ptp(limits[0]) / (MOST_CELLS * layer.cell))))
    values, cell = _in_blocks(layer.values, side), side * layer.cell
    rows, columns = values.shape
    x, y = layer.origin
    extent = (x, x + columns * cell, y, y + rows * cell)
    shown = np.ma.masked_invalid(values)
    axes.imshow(shown, _ramp(layer), origin="lower", extent=extent, vmin=layer.low, vmax=layer.high, zorder=0.7)
    axes.set(xlim=limits[0], ylim=limits[1])  # imshow resets them


def _in_blocks(values: Array, side: int) -> Array:
    """Blocks of side × side cells, each as its largest value, so that nothing vanishes from a small picture."""
    if side == 1:
        return values
    padded = np.pad(values, [(0, -length % side) for length in values.shape], constant_values=np.nan)
    rows, columns = (length // side for length in padded.shape)
    return np.fmax.reduce(np.fmax.reduce(padded.reshape(rows, side, columns, side), axis=3), axis=1)


def _ramp(layer: Raster) -> Colormap | str:
    if layer.ramp == "fade":
        return LinearSegmentedColormap.from_list("fade", ["#ffffff", COLORS[layer.color]])
    return layer.ramp


@_draw.register
def _(layer: Windows, axes: Axes, scene: Scene, instant: float | None) -> None:
    at = -1 if instant is None else int(np.searchsorted(layer.seconds, instant, side="right")) - 1
    if at >= 0:
        cells = np.where(layer.maps.occupied(at), 1.0, np.nan)
        x, y = layer.maps.origin_m[at].tolist()
        _draw(Raster("", layer.color, cells, (x, y), layer.maps.cell_m, 0.0, 1.0), axes, scene, None)


@_draw.register
def _(layer: Lines, axes: Axes, _scene: Scene, instant: float | None) -> None:
    chosen: Array = np.arange(len(layer.first) - 1)
    if layer.seconds is not None and instant is not None:
        chosen = np.flatnonzero(layer.seconds <= instant)[-1:]
    elif layer.seconds is not None:
        chosen = chosen[thin_evenly(len(chosen), layer.shown)] if layer.shown else chosen[:0]
    points = np.column_stack([layer.x, layer.y])
    lines = [points[layer.first[k] : layer.first[k + 1]] for k in chosen]
    if lines:
        look = {"colors": COLORS[layer.color], "linestyles": DASHES[layer.variant % 4], "linewidths": 1.0}
        axes.add_collection(LineCollection(lines, label=layer.label, zorder=2, **look))


@_draw.register
def _(layer: Marks, axes: Axes, _scene: Scene, instant: float | None) -> None:
    if layer.hidden or not len(layer.x):
        return
    keep: Array = np.arange(len(layer.x))
    if instant is not None and layer.seconds is not None and layer.until is not None:
        keep = np.flatnonzero((layer.seconds <= instant) & (instant < layer.until))
    dense, color = layer.shape == "dot", COLORS[layer.color]
    keep = keep[thin_evenly(len(keep), MAX_POINTS)]
    if layer.shape == "circle" and layer.radius is not None:
        for k in keep.tolist():
            axes.add_patch(Circle((layer.x[k], layer.y[k]), layer.radius[k], fill=False, edgecolor=color, zorder=2))
        return
    size, alpha, zorder = (2, 0.6, 1.5) if dense else (7, 1.0, 3)
    look: dict[str, Any] = {"markersize": size, "alpha": alpha, "zorder": zorder}
    axes.plot(layer.x[keep], layer.y[keep], MARKERS[layer.shape], color=color, label=layer.label, **look)
    for name, x, y in zip(layer.names, layer.x, layer.y, strict=False):
        axes.annotate(name, (x, y), (6, -3), textcoords="offset points", annotation_clip=True, color=color)


@_draw.register
def _(layer: Ellipses, axes: Axes, _scene: Scene, instant: float | None) -> None:
    at = _row(layer.seconds, layer.x, instant) if instant is not None and not layer.hidden else None
    if at is not None:
        rows = slice(at, at + 1)
        x, y = outline_95(layer.x[rows], layer.y[rows], layer.xx[rows], layer.xy[rows], layer.yy[rows])
        axes.plot(x[0], y[0], color=COLORS[layer.color], linewidth=0.9, zorder=2)


@_draw.register
def _(layer: Track, axes: Axes, scene: Scene, instant: float | None) -> None:
    color = COLORS[layer.color]
    if layer.trail:
        wide = 0.9 if layer.shape == "none" else 1.8
        dash = DASHES[layer.variant % 4]
        axes.plot(layer.x, layer.y, dash, zorder=2.5, color=color, linewidth=wide, label=layer.label)
    if layer.level is not None and instant is None:
        _draw_levels(axes, layer, scene.levels)
    if layer.shape == "none" or (layer.shape == "dot" and instant is None):
        return
    row = _row(layer.seconds, layer.x, instant)
    if row is None:
        return
    x, y, yaw = layer.x[row], layer.y[row], np.nan if layer.yaw is None else layer.yaw[row]
    if layer.shape == "body" and scene.body is not None and np.isfinite(yaw):
        along = np.array([np.cos(yaw), np.sin(yaw)])
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.array(scene.body) / 2
        placed = corners @ np.array([along, [-along[1], along[0]]]) + (x, y)
        axes.add_patch(Polygon(placed, facecolor=color, edgecolor="white", alpha=0.8, zorder=4))
        nose = (x, y) + 0.7 * scene.body[0] * along
        axes.plot([x, nose[0]], [y, nose[1]], color=color, zorder=4)
    else:
        mark = "*" if layer.shape == "star" else "o"
        axes.plot(x, y, mark, color=color, markersize=7, markeredgecolor="white", zorder=4)


def _draw_levels(axes: Axes, track: Track, levels: Sequence[str]) -> None:
    """The track in colours by its error."""
    for level, words in enumerate(levels):
        there = np.asarray(track.level == level)
        there[1:] |= there[:-1]  # as far as the next pose, so that the line has no holes
        x, y = (np.where(there, values, np.nan) for values in (track.x, track.y))
        axes.plot(x, y, color=LEVELS[level], linewidth=3, label=f"{track.label}, error {words}", zorder=2.4)


def _row(seconds: Array, x: Array, instant: float | None) -> int | None:
    """The last row that is not later and has a position; without an instant the last one of all."""
    if instant is None:
        rows = np.flatnonzero(np.isfinite(x))
        return int(rows[-1]) if len(rows) else None
    at = int(np.searchsorted(seconds, instant, side="right")) - 1
    return at if at >= 0 and np.isfinite(x[at]) else None


MOST_FRAMES = 240
FRAMES_PER_S = 12


def film(scene: Scene, path: Path) -> None:
    """The scene as .gif or .mp4: at most MOST_FRAMES frames, evenly over its time. Still layers are drawn once."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    moving = [layer for layer in scene.layers if _moves(layer)]
    left, right, bottom, top = scene.extent
    start, end = scene.span
    with rc_context({**_STYLE, "font.size": POINT_SIZE}):
        picture = Picture(figsize=(6.4, float(np.clip(6.4 * (top - bottom) / (right - left), 3, 8))))
        FigureCanvasAgg(picture)
        axes = picture.subplots(gridspec_kw={"left": 0.09, "right": 0.99, "bottom": 0.1, "top": 0.94})
        draw_scene(axes, replace(scene, layers=[layer for layer in scene.layers if not _moves(layer)]))
        writer = (PillowWriter if path.suffix == ".gif" else FFMpegWriter)(fps=FRAMES_PER_S)
        with writer.saving(picture, str(path), dpi=100):
            frames = min(MOST_FRAMES, max(2, int((end - start) * FRAMES_PER_S)))
            for instant in np.linspace(start, end, frames).tolist():
                still = set(axes.get_children())
                for layer in moving:
                    _draw(layer, axes, scene, instant)
                axes.set_title(f"{instant:.1f} s", loc="left")
                writer.grab_frame()
                for artist in set(axes.get_children()) - still:
                    artist.remove()


def _moves(layer: Layer) -> bool:
    timed = isinstance(layer, Lines | Marks) and layer.seconds is not None
    return timed or isinstance(layer, Windows | Track | Ellipses)
