"""Panels of an interactive chart as plain JSON: lines over time, thinned so that no peak is lost, and short numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadlog.messages import Float, Int
from quadlog.results.plots.style import thin_line

COLORS = ("robot", "target", "plan", "resim", "note", "fix", "text", "olive")
"""Names of colours; report.css has one of each for light and for dark."""

POINTS = 800
"""Of one line over the whole run: some two for each pixel of a phone, and the extremes between them."""

_DIGITS = 4
"""Numbers are rounded to so many digits of what their line spans: finer than a pixel."""
_TIME_DIGITS = 3


@dataclass(frozen=True, slots=True)
class Line:
    """seconds, values (N,): one line of a panel; points: drawn as points, which nothing joins."""

    label: str
    color: str
    seconds: Float
    values: Float
    points: bool = False


def panel(what: str, lines: Sequence[Line]) -> dict[str, Any] | None:
    """One panel, or None where no line has a value.

    what: what the panel shows, with its unit. Lines need not share their instants: a line has no value (None) at
    those of another; the page joins what is on both sides of it, except across a gap of the line's own.
    """
    lines = [line for line in lines if np.isfinite(line.values).any()]
    if not lines:
        return None
    if all(line.seconds is lines[0].seconds for line in lines):
        keep = np.unique(np.concatenate([_keep(line) for line in lines]))
        times, columns = lines[0].seconds[keep], [line.values[keep] for line in lines]
        joined = False
    else:
        times, columns = _merged(lines)
        joined = True
    return {
        "what": what,
        "joined": joined,
        "lines": [{"label": line.label, "color": line.color, "points": line.points} for line in lines],
        "seconds": [round(value, _TIME_DIGITS) for value in times.tolist()],
        "values": [rounded(column) for column in columns],
    }


def rounded(values: Float) -> list[float | None]:
    """Numbers with as many decimals as their span needs; None for one that is not finite."""
    finite = values[np.isfinite(values)]
    span = float(np.ptp(finite)) if len(finite) else 0.0
    size = span or (float(np.abs(finite).max()) if len(finite) else 0.0)
    digits = int(np.clip(_DIGITS - math.floor(math.log10(size)), 0, 12)) if size > 0 else 0
    short = np.round(values, digits) + 0.0
    return [value if math.isfinite(value) else None for value in short.tolist()]


def to_script_json(content: Any) -> str:
    """JSON that can stand inside <script type="application/json">: nothing in it ends the element or opens another.

    ASCII alone, so that the line separators that end a line of a script are escaped too.
    """
    text = json.dumps(content, separators=(",", ":"), sort_keys=True, allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _keep(line: Line) -> Int:
    return thin_line(line.values, POINTS)


def _merged(lines: Sequence[Line]) -> tuple[Float, list[Float]]:
    """All instants of all lines in order, and each line's values at them, NaN where it has none."""
    kept = [(line, _keep(line)) for line in lines]
    times = np.unique(np.concatenate([line.seconds[keep] for line, keep in kept]))
    columns = []
    for line, keep in kept:
        column = np.full(len(times), np.nan)
        column[np.searchsorted(times, line.seconds[keep])] = line.values[keep]
        columns.append(column)
    return times, columns
