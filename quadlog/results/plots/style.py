"""Style of all figures: size, fonts, colours that colour-blind readers can distinguish, reproducible PNG bytes.

Figures are made through the object-oriented interface and the Agg canvas, so
drawing needs no display and leaves no global state behind.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float, Int

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_RGB = 2  # colour type: 8 bits each of red, green and blue
_LEVEL = 1


def to_png(rgb: NDArray[np.uint8]) -> bytes:
    """The PNG of a picture (rows, columns, 3), without metadata."""
    rows, columns, _ = rgb.shape
    filtered = np.zeros((rows, 1 + 3 * columns), np.uint8)  # each row begins with its filter: 0, none
    filtered[:, 1:] = rgb.reshape(rows, 3 * columns)
    header = struct.pack(">IIBBBBB", columns, rows, 8, _RGB, 0, 0, 0)
    # isal takes a tenth of the time, but its output is not always the same for the same pixels.
    pixels = zlib.compress(filtered.tobytes(), _LEVEL)
    return SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", pixels) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


# Okabe & Ito's palette. One meaning per colour in all figures.
BLACK, GREY, LIGHT = "#1a1a1a", "#6e6e6e", "#d9d9d9"
ROBOT = "#0072B2"  # blue: the logged robot
TARGET = "#D55E00"  # vermillion: what is followed
PLAN = "#009E73"  # green: planned paths
RESIM = "#CC79A7"  # pink: the re-simulated walk
FIX = "#56B4E9"  # sky: raw measurements
NOTE = "#E69F00"  # orange: what deserves a second look
COLORS = {"robot": ROBOT, "target": TARGET, "plan": PLAN, "resim": RESIM, "note": NOTE, "fix": FIX}
COLORS |= {"text": BLACK, "olive": "#8a7a00"}
"""By name; report.css has one of each for light and for dark."""
SERIES = tuple(COLORS.values())
ERROR_COLORS = ("#5AA9DC", "#1F6FA8", "#7A3B9A", "#B3003C")
"""Of classes of an error, from small to large; report.css has one of each for light and for dark."""


def error_classes(error_m: Float) -> tuple[NDArray[np.int64], list[str]]:
    """The class (N,) of each error, 0 to 3, -1 where it is NaN; and the classes' labels.

    The limits are 1, 2 and 3 times a round number, so that about 95 % of the errors lie below the last.
    """
    known = error_m[np.isfinite(error_m)]
    third_m = max(float(np.percentile(known, 95)) / 3 if len(known) else 0.0, 1e-3)
    power = 10.0 ** np.floor(np.log10(third_m))
    step_m = power * next(each for each in (1, 2, 3, 5, 10) if each * power >= third_m * (1 - 1e-9))
    limits_m = step_m * np.arange(1, 4)
    of = np.where(np.isfinite(error_m), np.searchsorted(limits_m, np.nan_to_num(error_m)), -1)
    return of.astype(np.int64), [*(f"≤ {limit:.3g} m" for limit in limits_m), f"> {limits_m[-1]:.3g} m"]


WIDTH_IN = 8.0
DPI = 150  # 1200 px wide: sharp on dense screens, and text is still 13 px when shown 800 px wide
MAX_HEIGHT_IN = 12.0  # a page
ABOVE_GRID = 0.7  # zorder of images: over the grid lines, under everything else

# What a stack of panels keeps free in inches: left for tick labels and a label, right, below, and between columns;
# and how far a label is from its panel.
LEFT_IN, RIGHT_IN, BELOW_IN, BESIDE_IN, LABEL_IN = 0.9, 0.15, 0.55, 0.16, 0.68

_STYLE = {
    "figure.dpi": DPI,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same glyphs everywhere
    "font.size": 10.0,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # finding a free place takes longer than drawing the title
    "axes.labelsize": 10.0,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "xtick.color": BLACK,
    "ytick.color": BLACK,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "image.interpolation": "nearest",
    "lines.linewidth": 1.4,
    "lines.markersize": 3.0,
    "path.simplify": True,
    "agg.path.chunksize": 20000,
}


def new_figure(height_in: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """An empty figure of the common width; constrained layout keeps labels apart, and is half the time of drawing."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, min(height_in, MAX_HEIGHT_IN)), dpi=DPI, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def new_stack(rows: int, row_in: float, above_in: float = 0.36, columns: int = 1) -> tuple[Figure, NDArray[Any]]:
    """A figure and its panels (rows, columns) in fixed places. All share x; where there are columns, all share y.

    row_in: height of a row, of which above_in is kept free over each panel for a legend or a title. For panels whose
    labels are known to fit; it is drawn in half the time that constrained layout takes.
    """
    shrink = min(1.0, MAX_HEIGHT_IN / (rows * row_in + BELOW_IN))
    height_in = shrink * (rows * row_in + BELOW_IN)
    panel_in = shrink * row_in - above_in
    wide_in = (WIDTH_IN - LEFT_IN - RIGHT_IN - (columns - 1) * BESIDE_IN) / columns
    figure = new_figure(height_in, layout=None)
    places = {
        "left": LEFT_IN / WIDTH_IN,
        "right": 1 - RIGHT_IN / WIDTH_IN,
        "bottom": 1 - (rows * (panel_in + above_in)) / height_in,
        "top": 1 - above_in / height_in,
        "hspace": above_in / panel_in,
        "wspace": BESIDE_IN / wide_in,
    }
    panels: NDArray[Any] = figure.subplots(
        rows, columns, squeeze=False, sharex=True, sharey=columns > 1, gridspec_kw=places
    )
    for panel in panels.flat:
        fix_labels(panel, wide_in, panel_in)
    return figure, panels


def fix_labels(panel: Axes, wide_in: float, high_in: float) -> None:
    """Labels of a panel of this size where tick labels leave room; matplotlib would measure each tick to find it."""
    panel.yaxis.set_label_coords(-LABEL_IN / wide_in, 0.5)
    panel.xaxis.set_label_coords(0.5, -0.62 * BELOW_IN / high_in)


def render_png(draw: Callable[[], Figure | None]) -> bytes | None:
    """The PNG that `draw` makes, or None. It does not depend on the user's matplotlibrc, and has no date or version."""
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with matplotlib.style.context(["default", _STYLE]):
        figure = draw()
        if figure is None:
            return None
        # `savefig` would draw twice, the first time for the layout alone.
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        return to_png(np.asarray(canvas.buffer_rgba())[:, :, :3])  # type: ignore[no-untyped-call]


def thin_points(count: int, limit: int) -> Int:
    """Indices (<= limit,) spread evenly over count points."""
    if count <= limit:
        return np.arange(count, dtype=np.int64)
    return np.linspace(0, count - 1, limit).astype(np.int64)


def thin_line(values: Float, limit: int = 2400) -> Int:
    """Indices of a line's points to draw: the extremes of limit/2 equal stretches, so that no peak is lost."""
    values = np.asarray(values, dtype=np.float64)
    count = len(values)
    if count <= limit:
        return np.arange(count, dtype=np.int64)
    edges = np.linspace(0, count, limit // 2 + 1).astype(np.int64)[:-1]
    # A stretch's lowest and highest value, found through a sort within stretches; NaN counts as neither.
    stretch = np.searchsorted(edges, np.arange(count), side="right") - 1
    low = np.lexsort((np.where(np.isfinite(values), values, np.inf), stretch))[edges]
    high = np.lexsort((-np.where(np.isfinite(values), values, -np.inf), stretch))[edges]
    return np.unique(np.concatenate([low, high, [0, count - 1]]))


def legend_above(axes: Axes, columns: int = 4) -> None:
    """A legend above the axes, where it hides no data; none if there are no labels."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        axes.legend(
            handles,
            labels,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=columns,
            borderaxespad=0.2,
            handlelength=1.6,
            columnspacing=1.4,
        )
        enlarge_dots(axes.get_legend())


def ring(axes: Axes, x: NDArray[Any], y: NDArray[Any]) -> None:
    """Rings around points of replans from scratch."""
    look: dict[str, Any] = {"color": TARGET, "markersize": 4.5, "markerfacecolor": "none", "markeredgewidth": 1.1}
    axes.plot(x, y, "o", label="from scratch", **look)


def mark_on_axis(axes: Axes, seconds: Float, label: str, size: float) -> None:
    """Crosses on the time axis, at seconds (N,)."""
    zero = np.zeros(len(seconds))
    axes.plot(seconds, zero, "x", color=BLACK, markersize=size, clip_on=False, label=label)


def enlarge_dots(legend: Legend | None) -> None:
    """Enlarge dots of two pixels, whose colour cannot be seen in a legend."""
    from matplotlib.lines import Line2D

    for handle in legend.legend_handles if legend is not None else ():
        if isinstance(handle, Line2D) and handle.get_marker() == ".":
            handle.set_markersize(9)
            handle.set_alpha(1)
