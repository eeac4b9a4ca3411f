"""Figures as PNG, PDF or SVG and scenes as films, by matplotlib: one renderer of all panels and one of all scenes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import AbstractContextManager
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
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator
from matplotlib.transforms import Bbox, offset_copy

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
ROW_IN, LETTER_IN, EDGE_IN = 0.21, 0.078, 0.06
"""Height of a row of a panel with rows or of a legend, width of a letter in names of rows, margin of what stands above.
"""
LEAST, DECADES = 0.4, 300
"""Of a panel's height; an axis that spans less has ticks at 1, 2 and 5."""
STROKE_IN, DENSE, SEEN, FAINT = 1 / 48, 4.0, 0.14, 0.03
"""Curves of more samples in a stroke's width are drawn as the range, mean and rms of each stroke where a range is
more than such a share of the curve's, and of the panel's.
"""
MOST_CELLS = 800
"""Across a picture."""
MAX_POINTS = 20_000
"""Of a cloud of points; more look the same."""
FONTS = {"sans": ["DejaVu Sans"], "serif": ["STIXGeneral", "DejaVu Sans"]}
"""Those that come with matplotlib; the last one has the signs of legends."""
_STYLE: dict[Any, Any] = {
    "axes.edgecolor": "#6e6e6e", "axes.spines.top": False, "axes.spines.right": False,
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
    drawing: view.Drawing, to: Format = "png", width_in: float = WIDTH_IN, point_size: float = POINT_SIZE,
    height_in: float | None = None, font: Literal["sans", "serif"] = "sans",
) -> bytes:  # fmt: skip
    """The drawing without a title, as wide as given: the same bytes for the same data and version of matplotlib.

    height_in: of the whole, which is higher where panels would be lower than LEAST of their own height; None: that.
    """
    content = io.BytesIO()
    with styled(point_size, font):
        picture = picture_of(drawing, width_in, point_size, height_in)
        picture.savefig(content, format=to, dpi=PIXELS / width_in, **_SAVED[to])
    return content.getvalue()


def styled(point_size: float, font: Literal["sans", "serif"] = "sans") -> AbstractContextManager[None]:
    """Matplotlib's settings for pictures."""
    return rc_context({**_STYLE, "font.size": point_size, "font.family": FONTS[font]})


def picture_of(drawing: view.Drawing, width_in: float, point_size: float, height_in: float | None = None) -> Picture:
    """As render, a figure of matplotlib's, to be made within `styled`."""
    picture, text = Picture(figsize=(width_in, 1.0)), point_size / POINT_SIZE
    FigureCanvasAgg(picture)
    if isinstance(drawing, view.Scene):
        _draw_whole(picture, drawing, _write_legend(picture, _scene_words(drawing), text), text, height_in)
    else:
        _draw_panels(picture, drawing, _write_legend(picture, _words(drawing), text), text, height_in)
    return picture


def _draw_panels(
    picture: Picture, panels: Sequence[view.Panel], legend_in: float, text: float, height_in: float | None
) -> None:
    """Panels below the legend, one below the other with one x axis, each with its quantity above it."""
    letters = max((len(name) for panel in panels for name in panel.rows), default=0)
    left_in, wide_in = text * max(LEFT_IN, 0.15 + LETTER_IN * letters), picture.get_figwidth()
    sizes_in = [text * ROW_IN * len(of.rows) if of.rows else LANE_IN if of.lane else PANEL_IN for of in panels]
    fixed_in = legend_in + text * (ABOVE_IN * len(panels) + BELOW_IN)
    if height_in is not None:
        sizes_in = [of * max((height_in - fixed_in) / sum(sizes_in), LEAST) for of in sizes_in]
    top_in = height_in = fixed_in + sum(sizes_in)
    picture.set_figheight(height_in)
    top_in, first, inside_in = height_in - legend_in, None, wide_in - left_in - RIGHT_IN
    for panel, panel_in in zip(panels, sizes_in, strict=True):
        top_in -= ABOVE_IN * text + panel_in
        box = (left_in / wide_in, top_in / height_in, inside_in / wide_in, panel_in / height_in)
        axes = first = picture.add_axes(box, sharex=first)
        above_in = top_in + panel_in + 0.06 * text
        picture.text(EDGE_IN / wide_in, above_in / height_in, panel.what, color=view.COLORS["text"])
        _draw_panel(axes, panel, inside_in)
        axes.xaxis.set_visible(panel is panels[-1])  # ticks take most of the time
    axes.set_xlabel(panels[-1].x)


def _ranges(series: view.Series, stroke: float, span: float | None) -> list[view.Series]:
    """A dense curve as the band from the least to the largest value of each stroke, this long on x, and mean ± rms.

    Others, and those with small ranges for a panel of this span, as they are; without one all dense ones are ranges.
    """
    known = np.flatnonzero(np.isfinite(series.x) & np.isfinite(series.y))
    strokes = max(int(np.ptp(series.x[known]) / stroke), 1) if len(known) else 1
    if series.style in ("points", "band") or len(known) <= DENSE * strokes:
        return [series]
    edges = np.linspace(series.x[known[0]], series.x[known[-1]], strokes + 1)
    at = np.minimum(np.searchsorted(edges, series.x[known], side="right") - 1, strokes - 1)
    first, y = np.flatnonzero(np.diff(at, prepend=-1)), series.y[known]
    low, high, mean, rms = np.full((4, strokes), np.nan)  # NaN in gaps
    low[at[first]], high[at[first]] = np.minimum.reduceat(y, first), np.maximum.reduceat(y, first)
    samples = np.diff(first, append=len(y))
    mean[at[first]] = np.add.reduceat(y, first) / samples
    rms[at[first]] = np.sqrt(np.add.reduceat((y - mean[at]) ** 2, first) / samples)
    if np.nanmean(high - low) <= (0.0 if span is None else max(SEEN * np.ptp(y), FAINT * span)):
        return [series]
    x = (edges[1:] + edges[:-1]) / 2
    bands = [replace(series, x=x, y=y, upper=of, style="band") for y, of in ((low, high), (mean - rms, mean + rms))]
    return [*bands, replace(series, x=x, y=mean, style="line")]


Words = Sequence[tuple[str, str, str]]
"""Glyph, colour and text of each of what stands in a legend."""


def _words(panels: Sequence[view.Panel]) -> Words:
    """The curves of all panels that need names; of merged runs their colours, then what their dashes and signs are."""
    runs, curves = [], []
    for panel in (of for of in panels if not of.rows and (of.lane or len({one.label for one in of.series}) > 1)):
        named = [(one, *one.label.rpartition(": ")[::2]) for one in panel.series]
        runs += [(LINES[0], one.color, run) for one, run, _ in named if run]
        several = len({label for *_, label in named}) > 1
        curves += [(_glyph(one), "soft" if run else one.color, name) for one, run, name in named if several or not run]
    return list(dict.fromkeys([*runs, *curves]))


def _glyph(of: Any) -> str:
    return GLYPHS.get(getattr(of, "style", getattr(of, "shape", ""))) or LINES[of.variant % 4]


def _scene_words(scene: view.Scene) -> Words:
    """The layers that a picture of the whole time shows."""
    left, right, bottom, top = scene.extent
    named: list[Any] = [
        of for of in scene.layers if isinstance(of, view.Marks) and not (of.hidden or of.shape == "ring")
    ]
    named += [of for of in scene.layers if isinstance(of, view.Track) and of.values is None]
    named += [of for of in scene.layers if isinstance(of, view.Lines) and (of.seconds is None or of.shown)]
    there = (of for of in named if ((left < of.x) & (of.x < right) & (bottom < of.y) & (of.y < top)).any())
    return list(dict.fromkeys((_glyph(of), of.color, of.label) for of in there))


def _write_legend(picture: Picture, words: Words, text: float) -> float:
    """The words in rows that fit, below the upper edge; returns the height of all (in).

    Artists alone, since matplotlib's legend takes longer than the curves.
    """
    x_in, y_in = EDGE_IN, 0.1 * text
    for glyph, color, word in words:
        sign, name = (picture.text(0, 1, of, va="center") for of in (glyph, word))
        sign.set_color(view.COLORS[color])
        long_in = 0.13 * text + name.get_window_extent().width / picture.dpi
        if x_in > EDGE_IN and x_in + long_in > picture.get_figwidth() - EDGE_IN:
            x_in, y_in = EDGE_IN, y_in + ROW_IN * text
        for artist, at_in in ((sign, x_in), (name, x_in + 0.13 * text)):
            artist.set_transform(offset_copy(picture.transFigure, picture, at_in, -y_in))
        x_in += long_in + 0.12 * text
    return y_in + 0.1 * text if words else 0.0


def _draw_panel(axes: Axes, panel: view.Panel, wide_in: float) -> None:
    left, right, bottom, top = view.extent_of(*((one.x, one.y) for one in panel.series), margin=0.0)
    stroke = (right - left or 1.0) * STROKE_IN / wide_in
    for span in (np.inf if panel.rows else top - bottom, None):  # if one curve has to, all dense ones do
        drawn = [one for series in panel.series for one in _ranges(series, stroke, span)]
        if len(drawn) == len(panel.series):
            break
    for series in drawn:
        _draw_series(axes, series, bool(panel.rows))
    upright, soft = axes.get_xaxis_transform(), view.COLORS["soft"]
    axes.vlines(panel.marks, 0, 1, soft, ":", transform=upright, linewidth=0.6)
    notes = ["range, mean ± rms"] if len(drawn) > len(panel.series) else []
    if panel.robust:
        low, high, beyond = view.robust_limits(panel)
        axes.set_ylim(low, high)
        notes += [f"{beyond} beyond"] if beyond else []
    elif panel.zero:
        axes.set_ylim(bottom=0)
    above: Any = {"xytext": (0, 3), "textcoords": "offset points", "ha": "right", "fontsize": "small"}
    axes.annotate(", ".join(notes), (1, 1), xycoords="axes fraction", **above)
    if panel.rows:
        axes.set_yticks(range(len(panel.rows)), panel.rows)
        axes.set_ylim(len(panel.rows) - 0.5, -0.5)
    if panel.mark:
        axes.annotate(panel.mark, (panel.marks[0], 1), (3, -1), upright, "offset points", va="top", color=soft)
    if panel.log or panel.log_x:
        axis = axes.xaxis if panel.rows or panel.log_x else axes.yaxis
        axes.set(**{f"{axis.axis_name}scale": "log"})
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < DECADES * low else (1,)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
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
        dash = "-" if in_rows else DASHES[series.variant % 4]
        axes.plot(series.x, series.y, dash, linewidth=3 if in_rows else None, **look)


def _draw_whole(picture: Picture, scene: view.Scene, legend_in: float, text: float, height_in: float | None) -> None:
    """The whole time of a scene below the legend and the scale of a track's colours."""
    left, right, bottom, top = scene.extent
    left_in, below_in, width_in = LEFT_IN * text, BELOW_IN * text, picture.get_figwidth()
    wide_in = width_in - left_in - RIGHT_IN
    scales = [of.values[0] for of in scene.layers if isinstance(of, view.Track) and of.values is not None]
    above_in = max(legend_in, 0.1 * text) + 2 * ROW_IN * text * len(scales)
    high_in = float(np.clip(wide_in * (top - bottom) / (right - left), 0.3 * wide_in, 1.1 * width_in))
    high_in = high_in if height_in is None else max(height_in - below_in - above_in, 0.3)
    height_in = below_in + high_in + above_in
    picture.set_figheight(height_in)
    axes = picture.add_axes((left_in / width_in, below_in / height_in, wide_in / width_in, high_in / height_in))
    more = max((right - left) / wide_in, (top - bottom) / high_in) / 2
    x, y, across, along = (left + right) / 2, (bottom + top) / 2, more * wide_in, more * high_in
    draw_scene(axes, replace(scene, extent=(x - across, x + across, y - along, y + along)))
    axes.locator_params("x", nbins=6)
    if scales:
        y, thick = (below_in + high_in + 0.08 * text) / height_in, 0.09 * text / height_in
        place = picture.add_axes((0.45, y, 0.55 - RIGHT_IN / width_in, thick))
        picture.colorbar(axes.collections[-1], place, orientation="horizontal", ticklocation="top")
        picture.text(EDGE_IN / width_in, y, scales[0], color=view.COLORS["text"])
    _write_names(axes, scene)


SIDES = np.array([(x, y) for x in (1, 0, -1) for y in (1, 0, -1) if x or y])


def _write_names(axes: Axes, scene: view.Scene) -> None:
    """The name of each named mark on the side of it where it covers least; none where it would cover another."""
    taken, covered = list[Bbox](), np.zeros((0, 2))
    for layer in scene.layers:
        if isinstance(layer, view.Raster):
            row, column = np.nonzero(np.isfinite(layer.values))
            cells = np.array(layer.origin) + layer.cell * (np.column_stack([column, row]) + 0.5)
            covered = np.concatenate([covered, axes.transData.transform(cells)])

    def cost(box: Bbox) -> float:
        outside = not (axes.bbox.contains(*box.min) and axes.bbox.contains(*box.max))
        return box.count_contains(covered) + 1e6 * (box.count_overlaps(taken) + outside)

    gap = axes.figure.dpi / 14
    for layer in (layer for layer in scene.layers if isinstance(layer, view.Marks)):
        points = axes.transData.transform(np.column_stack([layer.x, layer.y]))
        for name, point in zip(layer.names, points, strict=False):
            if axes.bbox.contains(*point):
                written = axes.text(0, 0, name, ha="center", va="center", **_haloed(view.COLORS[layer.color]))
                size = np.array(written.get_window_extent().size)
                corners = point - size / 2 + (size / 2 + gap) * SIDES
                box = min((Bbox.from_bounds(*corner, *size) for corner in corners), key=cost)
                taken.append(box)
                x, y = axes.transData.inverted().transform(box.get_points().mean(axis=0))
                written.set(position=(x, y), visible=cost(box) < 1e6)


def _haloed(color: Any) -> dict[str, Any]:
    return {"color": color, "path_effects": [withStroke(linewidth=2, foreground="white")], "zorder": 5}


def draw_scene(axes: Axes, scene: view.Scene, instant: float | None = None) -> None:
    """The layers at an instant; without one, whole tracks and some of the plans."""
    left, right, bottom, top = scene.extent
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel=scene.axes[0], ylabel=scene.axes[1])
    axes.set_aspect("equal")
    for layer in scene.layers:
        _draw(layer, axes, instant)


def _draw(layer: view.Layer, axes: Axes, instant: float | None) -> None:
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
            _draw_lines(axes, layer, lines, 1.0 if instant is None else 0.7, DASHES[layer.variant % 4])
        case view.Marks():
            if not layer.hidden:
                _draw_marks(axes, layer, instant)
        case view.Track():
            _draw_track(axes, layer, instant)


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
    shades = [to_rgba(view.COLORS[layer.color], alpha) for alpha in (0.16, 0.85)]
    colors = LinearSegmentedColormap.from_list("fade", shades)
    axes.imshow(shown, colors, origin="lower", extent=extent, vmin=layer.low, vmax=layer.high, zorder=0.7)
    axes.set(xlim=limits[0], ylim=limits[1])  # imshow resets them


def _draw_lines(
    axes: Axes, layer: view.Lines | view.Marks, lines: Sequence[view.Array], width: float, dash: str = "-"
) -> None:
    if len(lines):
        look = {"colors": view.COLORS[layer.color], "linestyles": dash, "linewidths": width}
        over = 2.6 if dash != "-" else 2.0  # tracks, which lie on dashed lines, are solid
        axes.add_collection(LineCollection(list(lines), label=layer.label, zorder=over, **look))


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


def _draw_track(axes: Axes, track: view.Track, instant: float | None) -> None:
    """The whole of it, in the colours of its values if it has some; at an instant its past, and faintly the rest."""
    color, dash = view.COLORS[track.color], DASHES[track.variant % 4]
    if track.values is not None:
        ends = np.column_stack([track.x, track.y])
        steps = np.stack([ends[:-1], ends[1:]], axis=1)
        colored = {"array": track.values[1][1:], "cmap": "viridis", "linewidths": 2.2}
        axes.add_collection(LineCollection([*steps], zorder=2.5, **colored))
        return
    past = len(track.x) if instant is None else int(np.searchsorted(track.seconds, instant, side="right"))
    axes.plot(track.x[:past], track.y[:past], dash, zorder=2.5, color=color, lw=1.8, label=track.label)
    if instant is not None:
        axes.plot(track.x[past:], track.y[past:], dash, zorder=1.4, color=color, lw=0.8, alpha=0.3)
        if past and np.isfinite(track.x[past - 1]):
            place, at = (track.x[past - 1], track.y[past - 1]), (7, 7 if track.color in view.CYCLE[:2] else -14)
            axes.annotate(track.label, place, at, "data", "offset points", annotation_clip=True, **_haloed(color))
    _draw_body(axes, track, instant)


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
    """The walk as .gif or .mp4: at most MOST_FRAMES frames, evenly over its time. Still layers are drawn once."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    moving = [layer for layer in scene.layers if getattr(layer, "seconds", None) is not None]
    still = replace(scene, layers=[layer for layer in scene.layers if layer not in moving])
    left, right, bottom, top = scene.extent
    start, end = scene.span or (0.0, 0.0)
    with styled(POINT_SIZE):
        picture = Picture(figsize=(6.4, float(np.clip(6.4 * (top - bottom) / (right - left), 3, 8))))
        FigureCanvasAgg(picture)
        axes = picture.subplots(gridspec_kw={"left": 0.09, "right": 0.99, "bottom": 0.1, "top": 0.94})
        draw_scene(axes, still, start)
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
