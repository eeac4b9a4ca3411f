"""What a figure shows, without how it is drawn: panels of curves, and scenes seen from above.

`page/pack.py` sends both to the browser, `mpl.py` draws them as pictures and films, `foxglove.py` reads scenes.
A gap in a curve or a track is a row of NaN, made by `break_gaps`: no renderer draws a line across it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.positioning.unlocated import MAX_UNMEASURED_NS

if TYPE_CHECKING:
    from quadlog.results.arrays import MapSequence
    from quadlog.results.run import Run

Array = NDArray[Any]

TIME = "time (s)"
GAP_S = MAX_UNMEASURED_NS * 1e-9
"""After a longer time without a sample the value is unknown."""
# The palette of Okabe and Ito, which colour-blind readers can tell apart; page/templates/app.css has the same names.
COLORS = {
    "robot": "#0072B2", "target": "#D55E00", "plan": "#009E73", "resim": "#CC79A7", "note": "#E69F00",
    "fix": "#56B4E9", "olive": "#8A7A00", "text": "#1A1A1A", "soft": "#8C8C8C", "wall": "#6E6E6E", "cell": "#1A1A1A",
    "bad": "#B3003C",
}  # fmt: skip
MOST_DOTS, MOST_COMPARED = 200, 4000
"""Of a row of a forest plot; samples of a curve beside those of other runs, whose own pages have all."""
CYCLE = ("robot", "target", "plan", "resim", "note", "fix", "olive", "text")
"""Colours of things that are many and alike (anchors, runs, planners); after these they repeat with another variant."""


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """What a legend lists, in a colour of COLORS."""

    label: str
    color: str


@dataclass(frozen=True, slots=True, eq=False)
class Series(Named):
    """A curve: x (N,) rising, y (N,).

    style: band fills between y and upper (N,). variant: 0 solid or filled, then dashed or hollow, and so on.
    events: each sample is of its own instant alone, and has no value at others.
    """

    x: Array
    y: Array
    style: Literal["line", "points", "band"] = "line"
    variant: int = 0
    upper: Array | None = None
    events: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Curves over one x axis. what: the quantity with its unit, as in "distance to the path (m)".

    zero: the y axis begins at 0. lane: a low panel, one of many alike. robust: the y axis spans
    the 1st to the 99th percentile with a margin, and the number of samples beyond is shown. marks: instants at which
    the meaning of the curves changes, drawn as vertical lines. rows: names of rows, from the top: y of a curve is then
    the number of a row. log: the axis of the values, x with rows and y without, is logarithmic. log_x: x is.
    mark: the name of the marks.
    """

    what: str
    series: Sequence[Series]
    x: str = TIME
    zero: bool = False
    lane: bool = False
    robust: bool = False
    marks: Array = field(default_factory=lambda: np.empty(0))
    rows: Sequence[str] = ()
    log: bool = False
    log_x: bool = False
    mark: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Raster(Named):
    """Still cells: values (rows, columns), NaN for none, row = y, pale at low. origin: lower-left corner."""

    values: Array
    origin: tuple[float, float]
    cell: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Windows(Named):
    """The occupied cells of a map sequence, each map shown from its instant, seconds (S,), until the next one's."""

    seconds: Array
    maps: MapSequence


@dataclass(frozen=True, slots=True, eq=False)
class Lines(Named):
    """Polylines with NaN in gaps; line k has the rows first[k] to first[k + 1] of x and y.

    seconds (K,): line k is shown from then until the next one's. shown: number of timed lines in a picture of the whole
    time; 0 for lines that only a single instant shows. measured: lines of two points, with their length beside the
    second one.
    """

    first: Array
    x: Array
    y: Array
    seconds: Array | None = None
    variant: int = 0
    shown: int = 12
    measured: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Marks(Named):
    """Points. seconds, until (N,): the time in which each is shown. names: written beside the points.

    along, cross, aside (N,): of rings instead of points, (x + along cos φ, y + cross cos φ + aside sin φ).
    hidden: switched off until the reader switches it on; left out of pictures.
    """

    x: Array
    y: Array
    shape: Literal["dot", "triangle", "cross", "ring"] = "dot"
    seconds: Array | None = None
    until: Array | None = None
    along: Array | None = None
    cross: Array | None = None
    aside: Array | None = None
    names: Sequence[str] = ()
    hidden: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Track(Named):
    """Something that moves: seconds (N,) rising; x, y (N,) NaN in gaps; yaw NaN where unknown.

    values: a quantity with its unit and its values (N,), which colour the track in pictures.
    """

    seconds: Array
    x: Array
    y: Array
    yaw: Array | None = None
    shape: Literal["body", "person"] = "body"
    variant: int = 0
    values: tuple[str, Array] | None = None


Layer = Raster | Windows | Lines | Marks | Track


@dataclass(frozen=True, slots=True)
class Moment:
    """An instant worth a look: what happens, and its value with its unit. name: of the metric it is the worst of.

    shows, hides: labels of layers that are on and off while it is open. line: x0, y0, x1, y1 of what has the value as
    its length, or of one point twice. ring: x, y, along, cross, aside of an ellipse about it, as of Marks.
    """

    seconds: float
    what: str
    value: str = ""
    name: str = ""
    shows: Sequence[str] = ()
    hides: Sequence[str] = ()
    line: Sequence[float] = ()
    ring: Sequence[float] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Layers, lowest first, in metres. extent: left, right, bottom, top of the first view; whole: of all there is.

    body: length and width of the robot in metres. activity: rows of the timeline, spans (start, end) with data.
    """

    layers: Sequence[Layer]
    extent: tuple[float, float, float, float]
    axes: tuple[str, str] = ("x (m)", "y (m)")
    body: tuple[float, float] | None = None
    whole: tuple[float, float, float, float] | None = None
    moments: Sequence[Moment] = ()
    activity: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last instant of the tracks; None for a scene without a time."""
        ends = [layer.seconds[[0, -1]].tolist() for layer in self.layers if isinstance(layer, Track)]
        return (min(first for first, _ in ends), max(last for _, last in ends)) if ends else None


Drawing = Sequence[Panel] | Scene


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of a run. name: stem of its file. caption: how to read it. make: returns None without the data.

    compared: also shown for several runs.
    """

    name: str
    title: str
    caption: str
    make: Callable[[Run], Drawing | None]
    compared: bool = True


def look(number: int) -> dict[str, Any]:
    """Colour and variant of the number-th of many alike, as keywords of Series, Lines and Track."""
    return {"color": CYCLE[number % len(CYCLE)], "variant": number // len(CYCLE)}


class Spread(NamedTuple):
    """A row of a forest plot: a value, its interval, and what it summarises, (N,) in any order."""

    value: float
    interval: tuple[float, float] | None = None
    dots: Array | Sequence[float] = ()
    color: str = "robot"


def forest(
    what: str, rows: Mapping[str, Spread], x: str, marks: Mapping[str, float] | None = None, log: bool = False
) -> Panel:
    """A row for each name: dots (at most MOST_DOTS), a bar for the interval, a large dot for the value.

    marks: a vertical line, by its name. log: x is logarithmic where all of it is positive.
    """
    series, named = list[Series](), dict(marks or {})
    for place, (name, of) in enumerate(rows.items()):
        dots = np.sort([dot for dot in of.dots if np.isfinite(dot)])
        dots = dots[thin_evenly(len(dots), MOST_DOTS)]
        shown: Any = ((dots, "points", 1), (np.array(of.interval or ()), "line", 0), ([of.value], "points", 0))
        for values, style, variant in (each for each in shown if len(each[0])):
            series.append(Series(name, of.color, np.asarray(values), np.full(len(values), place), style, variant))
    positive = log and all((one.x > 0).all() for one in series)
    at = np.array(list(named.values()), float)
    return Panel(what, series, x, marks=at, rows=list(rows), log=positive, mark=", ".join(named))


def break_gaps(seconds: Array, *columns: Array, longest_s: float = GAP_S) -> list[Array]:
    """Seconds (N,), rising, and columns (N,), with a row of NaN after the last row before each gap.

    A gap is longer than longest_s and than five median steps.
    """
    steps = np.diff(seconds)
    before = np.flatnonzero(in_gaps(steps, longest_s))
    times = np.insert(seconds, before + 1, seconds[before] + longest_s)
    return [times, *(np.insert(np.asarray(column, float), before + 1, np.nan) for column in columns)]


def in_gaps(steps_s: Array, longest_s: float = GAP_S) -> Array:
    """Which steps (N,) between rows are gaps: longer than longest_s and than five median ones."""
    return steps_s > (max(longest_s, 5 * float(np.median(steps_s))) if len(steps_s) else longest_s)


def rows_within(steps_s: Array, lasting_s: float) -> int:
    """How many steps (N,) between rows take so long, 1 at least: by their mean, as rounds of ranges come in bursts."""
    steps_s = steps_s[~in_gaps(steps_s)]
    return max(1, round(lasting_s / max(float(steps_s.mean()), 1e-9))) if len(steps_s) else 1


def thin_evenly(length: int, most: int) -> Array:
    """Indices of at most `most` of so many rows, the first and the last among them."""
    return np.arange(length) if length <= most else np.unique(np.linspace(0, length - 1, most).astype(int))


def robust_limits(panel: Panel) -> tuple[float, float, int]:
    """Limits of y from the 1st to the 99th percentile with a margin, 0 among them, and how many samples lie beyond."""
    values = np.concatenate([np.zeros(0), *(series.y for series in panel.series)])
    values = values[np.isfinite(values)]
    if not len(values):
        return -1.0, 1.0, 0
    low, high = np.percentile(values, [1, 99]).tolist()
    low, high = min(low, 0.0), max(high, 0.0)
    margin = 0.25 * ((high - low) or 1.0)
    low, high = 0.0 if panel.zero and low == 0 else low - margin, high + margin
    return low, high, int(((values < low) | (values > high)).sum())


def extent_of(*points: tuple[Array, Array], margin: float = 0.5) -> tuple[float, float, float, float]:
    """Left, right, bottom, top around the finite points (x, y), with a margin."""
    box = []
    for axis in (0, 1):
        values = np.concatenate([np.asarray(each[axis], float).ravel() for each in points])
        values = values[np.isfinite(values)] if np.isfinite(values).any() else np.zeros(1)
        box += [float(values.min()) - margin, float(values.max()) + margin]
    return box[0], box[1], box[2], box[3]


def merge_panels(runs: Mapping[str, Sequence[Panel]]) -> list[Panel]:
    """The panels of several runs over each other: a colour for each run, a variant for each of its curves.

    Curves that are alike in all runs are drawn once, in grey; a panel without others is left out.
    """
    merged, shown = dict[str, tuple[Panel, list[tuple[str, Series]]]](), list[Panel]()
    for name, panels in runs.items():
        for panel in panels:
            curves = [(name, of) for of in panel.series if of.style != "band"]
            merged.setdefault(panel.what, (panel, []))[1].extend(curves)
    for panel, found in merged.values():
        series = _over_each_other(found, [*runs], "x y")
        if any(of.color != "soft" for of in series):
            kept = [(of, thin_evenly(len(of.x), MOST_COMPARED)) for of in series]
            series = [replace(of, x=of.x[at], y=of.y[at]) for of, at in kept]
            shown.append(replace(panel, series=series, marks=np.empty(0)))
    return shown


def _over_each_other(
    found: Sequence[tuple[str, Any]], runs: Sequence[str], columns: str, brief: bool = False
) -> list[Any]:
    """Curves or tracks of runs in the colours of the runs, by their names: what all have alike once, in grey.

    brief: one of each run is called by the run alone.
    """
    of_label: dict[str, dict[str, Any]] = {}
    for name, one in found:
        of_label.setdefault(one.label, {})[name] = one
    shown, differing = list[Any](), list[str]()
    for label, of in of_label.items():
        first, *others = ([getattr(one, column) for column in columns.split()] for one in of.values())
        same = all(np.array_equal(*pair, equal_nan=True) for other in others for pair in zip(first, other, strict=True))
        if same and len(of) == len(runs) > 1:
            shown.append(replace(of[runs[0]], color="soft", variant=len(shown)))
        else:
            differing.append(label)
    for place, label in enumerate(differing):
        for name in (name for name in runs if name in of_label[label]):
            text = name if brief and len(differing) == 1 else f"{name}: {label}"
            shown.append(
                replace(of_label[label][name], label=text, color=look(runs.index(name))["color"], variant=place)
            )
    return shown


def merge_scenes(runs: Mapping[str, Scene]) -> Scene:
    """The tracks of several runs in one scene on the walls of the first, a colour for each run; those alike in grey."""
    first = next(iter(runs.values()))
    tracks = [(name, of) for name, scene in runs.items() for of in scene.layers if isinstance(of, Track)]
    walls = [layer for layer in first.layers if isinstance(layer, Raster)]
    boxes: Any = [(scene.extent[:2], scene.extent[2:]) for scene in runs.values()]
    layers = [*walls, *_over_each_other(tracks, [*runs], "seconds x y", brief=True)]
    return replace(first, layers=layers, extent=extent_of(*boxes, margin=0.0), moments=(), activity={})


def farthest_apart(scene: Scene) -> Moment | None:
    """The instant at which two runs' tracks of one thing, in a scene of several runs, are farthest apart."""
    found: list[tuple[float, float, str]] = []
    tracks = [layer for layer in scene.layers if isinstance(layer, Track) and layer.color != "soft"]
    for other in tracks[1:]:
        if other.shape != tracks[0].shape or other.variant != tracks[0].variant:
            continue
        x, y = (np.interp(other.seconds, tracks[0].seconds, of, np.nan, np.nan) for of in (tracks[0].x, tracks[0].y))
        apart_m = np.hypot(other.x - x, other.y - y)
        if np.isfinite(apart_m).any():
            at = int(np.nanargmax(apart_m))
            found.append((float(apart_m[at]), float(other.seconds[at]), f"{tracks[0].label} and {other.label}"))
    apart, seconds, which = max(found, default=(0.0, 0.0, ""))
    return Moment(seconds, f"farthest apart: {which}", f"{apart:.2f} m") if apart > 0 else None
