"""Figures as PNG, PDF or SVG and scenes as films, by matplotlib: one renderer of all panels and one of all scenes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.figure import Figure as Picture
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import LogFormatter, StrMethodFormatter

from quadlog.results import view

Format = Literal["png", "pdf", "svg"]

DASHES = ("-", "--", ":", "-.")
MARKERS = {"dot": ".", "triangle": "^", "cross": "x"}
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


def render(
    drawing: view.Drawing, to: Format = "png", width_in: float = WIDTH_IN, point_size: float = POINT_SIZE
) -> bytes:
    """The drawing without a title, as wide as given: the same bytes for the same data and version of matplotlib."""
    sizes: dict[Any, Any] = {"font.size": point_size, "legend.fontsize": 0.9 * point_size, "axes.titlesize": point_size}
    with rc_context({**_STYLE, **sizes}):
        scale = width_in / WIDTH_IN, point_size / POINT_SIZE
        made = _scene_picture if isinstance(drawing, view.Scene) else _panel_picture
        picture, content = made(drawing, *scale), io.BytesIO()  # type: ignore[arg-type]
        picture.savefig(content, format=to, dpi=150, metadata=_NO_DATE[to])
    return content.getvalue()


def _panel_picture(panels: Sequence[view.Panel], wide: float, text: float) -> Picture:
    """Panels one below the other over one x axis; a quantity stands above its panel, beside or above the legend."""
    letters = max((len(name) for panel in panels for name in panel.rows), default=0)
    width_in, left_in = WIDTH_IN * wide, text * max(LEFT_IN, 0.15 + LETTER_IN * letters)
    inside_in = width_in - left_in - RIGHT_IN
    legends = [_legend_shape(panel, int(inside_in / (LETTER_IN * text))) for panel in panels]
    aboves_in = [text * (ABOVE_IN + ROW_IN * rows) for rows, _ in legends]
    heights_in = [text * ROW_IN * len(of.rows) if of.rows else LANE_IN if of.lane else PANEL_IN for of in panels]
    top_in = height_in = sum(heights_in) + sum(aboves_in) + BELOW_IN * text
    picture, first = Picture(figsize=(width_in, height_in)), None
    FigureCanvasAgg(picture)
    for panel, panel_in, above_in, (rows, columns) in zip(panels, heights_in, aboves_in, legends, strict=True):
        top_in -= above_in + panel_in
        box = (left_in / width_in, top_in / height_in, inside_in / width_in, panel_in / height_in)
        axes = first = picture.add_axes(box, sharex=first)
        _draw_panel(axes, panel, columns, title_pad=3 + 72 * ROW_IN * text * rows)
        axes.tick_params(labelbottom=panel is panels[-1])
    axes.set_xlabel(panels[-1].x)
    return picture


def _legend_shape(panel: view.Panel, room: int) -> tuple[int, int]:
    """Rows of the legend below the quantity, 0 where both fit side by side in so many letters, and columns."""
    widths = [] if panel.rows or panel.lane else [len(series.label) + 5 for series in panel.series]
    if len(panel.what) + sum(widths) <= room:
        return 0, max(1, len(widths))
    columns = max(1, room // max(widths, default=1))
    return -(-len(widths) // columns), columns


def _draw_panel(axes: Axes, panel: view.Panel, columns: int, title_pad: float) -> None:
    for series in panel.series:
        if panel.period_s and len(series.x) and np.ptp(series.x) > MOST_PERIODS * panel.period_s:
            # The band from the least to the largest value in each period of x.
            starts = np.flatnonzero(np.diff(np.floor(series.x / panel.period_s), prepend=-np.inf))
            least, most = (edge.reduceat(series.y, starts) for edge in (np.fmin, np.fmax))
            series = replace(series, x=series.x[starts], y=least, upper=most, style="band")
        _draw_series(axes, series, bool(panel.rows))
    for x in panel.marks.tolist():
        axes.axvline(x, color=view.COLORS["soft"], linewidth=0.6, linestyle=":")
    if panel.robust:
        low, high, beyond = view.robust_limits(panel)
        axes.set_ylim(low, high)
        if beyond:
            axes.text(1, 1, f"{beyond} beyond", transform=axes.transAxes, ha="right", va="top", fontsize="small")
    elif panel.zero:
        axes.set_ylim(bottom=0)
    if panel.log:
        axis = axes.xaxis if panel.rows else axes.yaxis
        axes.set(**{"xscale" if panel.rows else "yscale": "log"})
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(LogFormatter())
    axes.set_title(panel.what, loc="left", pad=title_pad, y=1.0)  # a given y spares matplotlib a search
    if panel.rows:
        axes.set_yticks(range(len(panel.rows)), panel.rows)
        axes.set_ylim(len(panel.rows) - 0.5, -0.5)
    elif not panel.lane:
        where: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.1}
        _enlarge(axes.legend(ncols=columns, handlelength=1.4, **where))


def _draw_series(axes: Axes, series: view.Series, in_rows: bool) -> None:
    look: dict[str, Any] = {"color": view.COLORS[series.color], "label": series.label}
    if series.style == "band" and series.upper is not None:
        axes.fill_between(series.x, series.y, series.upper, alpha=0.25, linewidth=0, **look)
    elif series.style == "points":
        keep = view.thin_evenly(len(series.x), MAX_POINTS)
        size = 1.8 if not in_rows else 4 if series.variant else 7
        look |= {"markersize": size, "markeredgewidth": 0.5, "fillstyle": "none" if series.variant else "full"}
        axes.plot(series.x[keep], series.y[keep], "o", **look)
    else:
        step = "steps-post" if series.style == "steps" else "default"
        dash = "-" if in_rows else DASHES[series.variant % 4]
        axes.plot(series.x, series.y, dash, drawstyle=step, linewidth=3 if in_rows else None, **look)


def _enlarge(legend: Any) -> None:
    """Points of two pixels get a visible size in the legend."""
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D) and handle.get_marker() in ("o", "."):
            handle.set_markersize(6)


def _scene_picture(scene: view.Scene, wide: float, text: float) -> Picture:
    """The whole time of a scene with a legend above it, and a scale to the right of each raster with a unit."""
    left, right, bottom, top = scene.extent
    scales = [layer for layer in scene.layers if isinstance(layer, view.Raster) and layer.unit]
    width_in, left_in, scale_in, below_in = WIDTH_IN * wide, LEFT_IN * text, 0.9 * text, BELOW_IN * text
    wide_in = width_in - left_in - RIGHT_IN - scale_in * len(scales)
    high_in = float(np.clip(wide_in * (top - bottom) / (right - left), 0.3 * wide_in, 1.1 * width_in))
    picture = Picture(figsize=(width_in, 1.0))
    FigureCanvasAgg(picture)
    axes = picture.subplots()
    draw_scene(axes, scene)
    handles, labels = axes.get_legend_handles_labels()
    columns = max(1, round(4 * wide / text))
    height_in = below_in + high_in + text * (0.1 + 0.19 * -(-len(handles) // columns))
    picture.set_size_inches(width_in, height_in)
    axes.set_position((left_in / width_in, below_in / height_in, wide_in / width_in, high_in / height_in))
    for place, layer in enumerate(scales):
        at_in = left_in + wide_in + 0.1 + scale_in * place
        beside = (at_in / width_in, below_in / height_in, 0.15 / width_in, high_in / height_in)
        shown = ScalarMappable(Normalize(layer.low, layer.high), _shades(layer))
        picture.colorbar(shown, cax=picture.add_axes(beside), label=f"{layer.label} ({layer.unit})")
    if handles:
        where = {"bbox_to_anchor": (-0.02, 1), "ncols": columns, "borderaxespad": 0.2}
        _enlarge(axes.legend(handles, labels, loc="lower left", **where))
    return picture


def draw_scene(axes: Axes, scene: view.Scene, instant: float | None = None) -> None:
    """The layers at an instant; without one, whole tracks and some of the plans."""
    left, right, bottom, top = scene.extent
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel=scene.axes[0], ylabel=scene.axes[1])
    axes.set_aspect("equal")
    for layer in scene.layers:
        _draw(layer, axes, scene, instant)


def _draw(layer: view.Layer, axes: Axes, scene: view.Scene, instant: float | None) -> None:
    color = view.COLORS[layer.color]
    match layer:
        case view.Raster():
            _draw_cells(axes, layer)
        case view.Windows():
            at = -1 if instant is None else int(np.searchsorted(layer.seconds, instant, side="right")) - 1
            if at >= 0:
                cells = np.where(layer.maps.occupied(at), 1.0, np.nan)
                corner = tuple(layer.maps.origin_m[at].tolist())
                _draw_cells(axes, view.Raster("", layer.color, cells, corner, layer.maps.cell_m, 0.0, 1.0))
        case view.Lines():
            chosen: view.Array = np.arange(len(layer.first) - 1)
            if layer.seconds is not None and instant is not None:
                chosen = np.flatnonzero(layer.seconds <= instant)[-1:]
            elif layer.seconds is not None:
                chosen = chosen[view.thin_evenly(len(chosen), layer.shown)] if layer.shown else chosen[:0]
            points = np.column_stack([layer.x, layer.y])
            width = 3.0 if layer.wide else 1.0
            dash = DASHES[layer.variant % 4]
            _draw_lines(axes, layer, [points[layer.first[k] : layer.first[k + 1]] for k in chosen], width, dash)
        case view.Marks():
            if not layer.hidden:
                _draw_marks(axes, layer, instant)
        case view.Track():
            if layer.trail:
                look: dict[str, Any] = {"zorder": 2.5, "color": color, "lw": 1.8, "label": layer.label}
                axes.plot(layer.x, layer.y, DASHES[layer.variant % 4], **look)
            if layer.shape != "dot" or instant is not None:
                _draw_body(axes, layer, scene.body, instant)


def _draw_cells(axes: Axes, layer: view.Raster) -> None:
    limits = axes.get_xlim(), axes.get_ylim()
    side = max(1, int(np.ceil(np.ptp(limits[0]) / (MOST_CELLS * layer.cell))))
    # Blocks of side × side cells, each as its largest value, so that nothing vanishes from a small picture.
    padded = np.pad(layer.values, [(0, -length % side) for length in layer.values.shape], constant_values=np.nan)
    rows, columns = (length // side for length in padded.shape)
    values = np.fmax.reduce(np.fmax.reduce(padded.reshape(rows, side, columns, side), axis=3), axis=1)
    (x, y), cell = layer.origin, side * layer.cell
    extent = (x, x + columns * cell, y, y + rows * cell)
    shown = np.ma.masked_invalid(values)
    axes.imshow(shown, _shades(layer), origin="lower", extent=extent, vmin=layer.low, vmax=layer.high, zorder=0.7)
    axes.set(xlim=limits[0], ylim=limits[1])  # imshow resets them


def _shades(layer: view.Raster) -> LinearSegmentedColormap:
    return LinearSegmentedColormap.from_list(
        "fade", [to_rgba(view.COLORS[layer.color], alpha) for alpha in (0.16, 0.85)]
    )


def _draw_lines(
    axes: Axes, layer: view.Lines | view.Marks, lines: Sequence[view.Array], width: float, dash: str = "-"
) -> None:
    if len(lines):
        look = {"colors": view.COLORS[layer.color], "linestyles": dash, "linewidths": width}
        axes.add_collection(LineCollection(list(lines), label=layer.label, zorder=2.6 if width > 2 else 2, **look))


def _draw_marks(axes: Axes, layer: view.Marks, instant: float | None) -> None:
    keep: view.Array = np.arange(len(layer.x))
    if instant is not None and layer.seconds is not None and layer.until is not None:
        keep = np.flatnonzero((layer.seconds <= instant) & (instant < layer.until))
    elif layer.shape == "ring" and layer.seconds is not None:
        return
    keep, color = keep[view.thin_evenly(len(keep), MAX_POINTS)], view.COLORS[layer.color]
    if layer.along is not None and layer.cross is not None and layer.aside is not None:
        cos, sin = (turn(np.linspace(0, 2 * np.pi, 41)) for turn in (np.cos, np.sin))
        along, cross, aside, x, y = (of[keep, None] for of in (layer.along, layer.cross, layer.aside, layer.x, layer.y))
        _draw_lines(axes, layer, [*np.stack([x + along * cos, y + cross * cos + aside * sin], axis=-1)], 0.9)
        return
    size, alpha, zorder = (2, 0.6, 1.5) if layer.shape == "dot" else (7, 1.0, 3)
    look: dict[str, Any] = {"markersize": size, "alpha": alpha, "zorder": zorder}
    axes.plot(layer.x[keep], layer.y[keep], MARKERS[layer.shape], color=color, label=layer.label, **look)
    for name, x, y in zip(layer.names, layer.x, layer.y, strict=False):
        axes.annotate(name, (x, y), (6, -3), textcoords="offset points", annotation_clip=True, color=color)


def _draw_body(axes: Axes, track: view.Track, size: tuple[float, float] | None, instant: float | None) -> None:
    """At the last row that is not later, if it has a position; without an instant at the last one that has."""
    known = np.flatnonzero(np.isfinite(track.x) if instant is None else track.seconds <= instant)
    if not len(known) or not np.isfinite(track.x[known[-1]]):
        return
    row, color = known[-1], view.COLORS[track.color]
    x, y, yaw = track.x[row], track.y[row], np.nan if track.yaw is None else track.yaw[row]
    if track.shape == "body" and size is not None and np.isfinite(yaw):
        along = np.array([np.cos(yaw), np.sin(yaw)])
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.array(size) / 2
        placed = corners @ np.array([along, [-along[1], along[0]]]) + (x, y)
        axes.add_patch(Polygon(placed, facecolor=color, edgecolor="white", alpha=0.8, zorder=4))
        nose = (x, y) + 0.7 * size[0] * along
        axes.plot([x, nose[0]], [y, nose[1]], color=color, zorder=4)
    else:
        mark = "*" if track.shape == "star" else "o"
        axes.plot(x, y, mark, color=color, markersize=7, markeredgecolor="white", zorder=4)


MOST_FRAMES = 240
FRAMES_PER_S = 12


def film(scene: view.Scene, path: Path) -> None:
    """The scene as .gif or .mp4: at most MOST_FRAMES frames, evenly over its time. Still layers are drawn once."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    moving = [layer for layer in scene.layers if getattr(layer, "seconds", None) is not None]
    still = replace(scene, layers=[layer for layer in scene.layers if layer not in moving])
    left, right, bottom, top = scene.extent
    start, end = scene.span or (0.0, 0.0)
    with rc_context({**_STYLE, "font.size": POINT_SIZE}):
        picture = Picture(figsize=(6.4, float(np.clip(6.4 * (top - bottom) / (right - left), 3, 8))))
        FigureCanvasAgg(picture)
        axes = picture.subplots(gridspec_kw={"left": 0.09, "right": 0.99, "bottom": 0.1, "top": 0.94})
        draw_scene(axes, still)
        writer = (PillowWriter if path.suffix == ".gif" else FFMpegWriter)(fps=FRAMES_PER_S)
        with writer.saving(picture, str(path), dpi=100):
            frames = min(MOST_FRAMES, max(2, int((end - start) * FRAMES_PER_S)))
            for instant in np.linspace(start, end, frames).tolist():
                kept = set(axes.get_children())
                for layer in moving:
                    _draw(layer, axes, scene, instant)
                axes.set_title(f"{instant:.1f} s", loc="left")
                writer.grab_frame()
                for artist in set(axes.get_children()) - kept:
                    artist.remove()
