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
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure as Picture
from matplotlib.transforms import offset_copy

from quadlog.results import view

Format = Literal["png", "pdf", "svg"]

DASHES = ("-", "--", ":", "-.")
LINES = "━╍┅┉"
GLYPHS = {"dot": "●", "triangle": "▲", "cross": "✕", "ring": "○", "points": "●", "band": "■"}
"""Of lines by variant, and of shapes, as the page's legends have them."""
MARKERS = {"dot": ".", "triangle": "^", "cross": "x"}
WIDTH_IN = 8.0
POINT_SIZE = 9.0
PANEL_IN, LANE_IN, ABOVE_IN, BELOW_IN, LEFT_IN, RIGHT_IN = 1.35, 0.55, 0.34, 0.48, 0.72, 0.12
ROW_IN, LETTER_IN = 0.21, 0.078
"""Height of a row of a panel with rows or of a legend, and width of a letter."""
MOST_CELLS = 800
"""Across a picture."""
MAX_POINTS = 20_000
"""Of a cloud of points; more look the same."""
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "axes.edgecolor": "#6e6e6e", "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "axes.axisbelow": True, "grid.color": "#e8e8e8", "legend.frameon": False,
    "lines.linewidth": 1.2, "image.interpolation": "nearest", "agg.path.chunksize": 20_000, "svg.hashsalt": "quadlog",
    "pdf.fonttype": 42,
}  # fmt: skip
_SAVED: dict[str, dict[str, Any]] = {
    # Most of a picture's time is compression.
    "png": {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": 1}},
    "pdf": {"metadata": {"CreationDate": None}}, "svg": {"metadata": {"Date": None}},
}  # fmt: skip
PIXELS = 960
"""Width of a PNG, whatever its width on paper."""


def render(
    drawing: view.Drawing, to: Format = "png", width_in: float = WIDTH_IN, point_size: float = POINT_SIZE
) -> bytes:
    """The drawing without a title, as wide as given: the same bytes for the same data and version of matplotlib."""
    sizes: dict[Any, Any] = {"font.size": point_size}
    with rc_context({**_STYLE, **sizes}):
        scale = width_in / WIDTH_IN, point_size / POINT_SIZE
        made = _scene_picture if isinstance(drawing, view.Scene) else _panel_picture
        picture, content = made(drawing, *scale), io.BytesIO()  # type: ignore[arg-type]
        picture.savefig(content, format=to, dpi=PIXELS / width_in, **_SAVED[to])
    return content.getvalue()


def _panel_picture(panels: Sequence[view.Panel], wide: float, text: float) -> Picture:
    """Panels one below the other over one x axis; a quantity stands above its panel, beside or above the legend."""
    letters = max((len(name) for panel in panels for name in panel.rows), default=0)
    width_in, left_in = WIDTH_IN * wide, text * max(LEFT_IN, 0.15 + LETTER_IN * letters)
    inside_in = width_in - left_in - RIGHT_IN
    room = int(inside_in / (LETTER_IN * text))
    words = [_words(panel) for panel in panels]
    aboves_in = [text * (ABOVE_IN + ROW_IN * _flow(each, room)[-1][0]) for each in words]
    heights_in = [text * ROW_IN * len(of.rows) if of.rows else LANE_IN if of.lane else PANEL_IN for of in panels]
    top_in = height_in = sum(heights_in) + sum(aboves_in) + BELOW_IN * text
    picture, first = Picture(figsize=(width_in, height_in)), None
    FigureCanvasAgg(picture)
    for panel, panel_in, above_in, written in zip(panels, heights_in, aboves_in, words, strict=True):
        top_in -= above_in + panel_in
        box = (left_in / width_in, top_in / height_in, inside_in / width_in, panel_in / height_in)
        axes = first = picture.add_axes(box, sharex=first)
        _draw_panel(axes, panel)
        _write_above(axes, written, room, text)
        axes.xaxis.set_visible(panel is panels[-1])  # ticks take most of the time
    axes.set_xlabel(panels[-1].x)
    return picture


Words = Sequence[tuple[str, str, str]]
"""Glyph, colour and text of each of what stands above axes."""


def _words(panel: view.Panel) -> Words:
    """The quantity, and where curves need them their names."""
    named = [] if panel.rows or panel.lane or len(panel.series) < 2 else panel.series
    return [("", "text", panel.what), *((_glyph(of), of.color, of.label) for of in named)]


def _glyph(of: Any) -> str:
    return GLYPHS.get(getattr(of, "style", getattr(of, "shape", ""))) or LINES[of.variant % 4]


def _flow(words: Words, room: int) -> list[tuple[int, int]]:
    """Row, and letters before, of each of these words in rows of so many letters."""
    places, row, at = [], 0, 0
    for glyph, _, text in words:
        length = len(text) + 3 * bool(glyph)
        row, at = (row + 1, 0) if at and at + length > room else (row, at)
        places.append((row, at))
        at += length + 3
    return places


def _write_above(axes: Axes, words: Words, room: int, text: float) -> None:
    """The words in rows above the axes: of artists alone, since matplotlib's legend takes longer than the curves."""
    places = _flow(words, room)
    for (glyph, color, word), (row, before) in zip(words, places, strict=True):
        high_in = text * (0.06 + ROW_IN * (places[-1][0] - row))
        for shown, ink, letters in ((glyph, color, 0), (word, "text", 2.5 * bool(glyph))):
            if shown:
                x_in = LETTER_IN * text * (before + letters)
                at = offset_copy(axes.transAxes, axes.figure, x_in, high_in)  # type: ignore[arg-type]
                axes.text(0, 1, shown, transform=at, color=view.COLORS[ink])


def _draw_panel(axes: Axes, panel: view.Panel) -> None:
    for series in panel.series:
        _draw_series(axes, series, bool(panel.rows))
    upright, soft = axes.get_xaxis_transform(), view.COLORS["soft"]
    axes.vlines(panel.marks, 0, 1, soft, ":", transform=upright, linewidth=0.6)
    if panel.robust:
        low, high, beyond = view.robust_limits(panel)
        axes.set_ylim(low, high)
        if beyond:
            axes.text(1, 1, f"{beyond} beyond", transform=axes.transAxes, ha="right", va="top", fontsize="small")
    elif panel.zero:
        axes.set_ylim(bottom=0)
    if panel.rows:
        axes.set_yticks(range(len(panel.rows)), panel.rows)
        axes.set_ylim(len(panel.rows) - 0.5, -0.5)
    if panel.mark:
        axes.annotate(panel.mark, (panel.marks[0], 1), (3, -1), upright, "offset points", va="top", color=soft)
    if panel.log or panel.log_x:
        axes.set(**{"xscale" if panel.rows or panel.log_x else "yscale": "log"})
    elif not panel.rows:
        axes.locator_params(nbins=5)


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


def _scene_picture(scene: view.Scene, wide: float, text: float) -> Picture:
    """The whole time of a scene with a legend above it."""
    left, right, bottom, top = scene.extent
    width_in, left_in, below_in = WIDTH_IN * wide, LEFT_IN * text, BELOW_IN * text
    wide_in = width_in - left_in - RIGHT_IN
    high_in = float(np.clip(wide_in * (top - bottom) / (right - left), 0.3 * wide_in, 1.1 * width_in))
    picture = Picture(figsize=(width_in, 1.0))
    FigureCanvasAgg(picture)
    axes = picture.subplots()
    draw_scene(axes, scene)
    drawn = axes.get_legend_handles_labels()[1]
    words = [(_glyph(of), of.color, of.label) for of in scene.layers if of.label in drawn]
    room = max(1, int(wide_in / (LETTER_IN * text)))
    rows = _flow(words, room)[-1][0] + 1 if words else 0
    height_in = below_in + high_in + text * (0.1 + ROW_IN * rows)
    picture.set_size_inches(width_in, height_in)
    axes.set_position((left_in / width_in, below_in / height_in, wide_in / width_in, high_in / height_in))
    _write_above(axes, words, room, text)
    return picture


def draw_scene(axes: Axes, scene: view.Scene, instant: float | None = None) -> None:
    """The layers at an instant; without one, whole tracks and some of the plans."""
    left, right, bottom, top = scene.extent
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel=scene.axes[0], ylabel=scene.axes[1])
    axes.set_aspect("equal")
    for layer in scene.layers:
        _draw(layer, axes, instant)


def _draw(layer: view.Layer, axes: Axes, instant: float | None) -> None:
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
            lines = [points[layer.first[k] : layer.first[k + 1]] for k in chosen]
            _draw_lines(axes, layer, lines, 1.0, DASHES[layer.variant % 4])
        case view.Marks():
            if not layer.hidden:
                _draw_marks(axes, layer, instant)
        case view.Track():
            look: dict[str, Any] = {"zorder": 2.5, "color": color, "lw": 1.8, "label": layer.label}
            axes.plot(layer.x, layer.y, DASHES[layer.variant % 4], **look)
            _draw_body(axes, layer, instant)


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
        axes.add_collection(LineCollection(list(lines), label=layer.label, zorder=2, **look))


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


def _draw_body(axes: Axes, track: view.Track, instant: float | None) -> None:
    """At the last row that is not later, if it has a position; without an instant at the last one that has."""
    known = np.flatnonzero(np.isfinite(track.x) if instant is None else track.seconds <= instant)
    if not len(known) or not np.isfinite(track.x[known[-1]]):
        return
    row = known[-1]
    yaw = np.nan if track.yaw is None else track.yaw[row]
    mark: Any = (3, 0, np.degrees(yaw) - 90) if track.shape == "body" and np.isfinite(yaw) else "o"
    look: dict[str, Any] = {"color": view.COLORS[track.color], "markersize": 10, "markeredgecolor": "white"}
    axes.plot(track.x[row], track.y[row], marker=mark, zorder=4, **look)


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
                    _draw(layer, axes, instant)
                axes.set_title(f"{instant:.1f} s", loc="left")
                writer.grab_frame()
                for artist in set(axes.get_children()) - kept:
                    artist.remove()
