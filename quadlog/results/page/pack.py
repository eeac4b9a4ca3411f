"""Drawings for the page's scripts: columns and cells in one deflated block, and a description that refers to it.

A column is stored as whole numbers of a unit, each as its difference from the one before: 0 for no value, else the
zigzag code of the difference plus 1, in four planes of bytes, lowest first, so that small steps make long runs of
zeros. Cells follow the columns. templates/unpack.js reads it. What is more than the
limits below is thinned, with a note.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from quadlog.results import view
from quadlog.results.text import count

DIGITS = 1e4
"""A curve's span is divided into at least so many steps: finer than a pixel."""
UNITS = dict.fromkeys(("seconds", "until", "marks", "x", "y", "along", "cross", "aside"), 1e-3)
UNITS |= {"yaw": 1e-4, "first": 1.0}
"""Of instants (s), positions (m or cells), angles (rad) and counts; others get a power of ten by their span."""
MOST_SAMPLES, MOST_POSES, MOST_LINES, MOST_LINE_POINTS, MOST_MARKS = 400_000, 9000, 1200, 200_000, 30_000
MOST_MAP_BYTES = 8 << 20
"""Of the maps of one scene, a bit a cell, before they are deflated."""
LARGEST = 2**30


class Pack:
    """Drawings by name, on their way into one page."""

    def __init__(self) -> None:
        self.charts: dict[str, Any] = {}
        self.scenes: dict[str, Any] = {}
        self._columns: list[tuple[int, float, float]] = []
        self._known: dict[bytes, int] = {}
        self._parts: list[bytes] = []
        self._cells: list[bytes] = []
        self._notes: dict[str, None] = {}
        self._instants: list[float] = []

    def __bool__(self) -> bool:
        return bool(self.charts or self.scenes)

    @property
    def thinned(self) -> str:
        """What was thinned for the page, as a sentence; empty for nothing."""
        return f"Thinned for this page: {'; '.join(self._notes)}." if self._notes else ""

    def add(self, name: str, drawing: view.Drawing, group: str = "run") -> None:
        """Add a drawing. Drawings of a group share a clock."""
        if isinstance(drawing, view.Scene):
            self.scenes[name] = self._scene(drawing) | {"group": group}
        else:
            self.charts[name] = {"group": group, "panels": [self._panel(panel) for panel in drawing]}

    def finish(self) -> dict[str, Any]:
        """All that the page's scripts need, as plain JSON."""
        packed = zlib.compress(b"".join([*self._parts, *self._cells]), 6)
        sizes, text = [len(content) for content in self._cells], base64.b64encode(packed).decode()
        drawings = {"charts": self.charts, "scenes": self.scenes, "gap_s": view.GAP_S}
        return drawings | {"columns": self._columns, "cells": sizes, "packed": text}

    def _column(self, values: view.Array, unit: float | None = None) -> int:
        """The number of a column; equal ones are stored once. unit: None for a power of ten by the span."""
        values = np.asarray(values, float)
        known = np.isfinite(values)
        finite = values[known]
        least, span = (float(finite.min()), float(np.ptp(finite))) if len(finite) else (0.0, 0.0)
        if unit is None:
            unit = 10.0 ** np.floor(np.log10(span or abs(least) or 1.0)) / DIGITS
        unit = max(unit, 10.0 ** np.ceil(np.log10(span / LARGEST))) if span > 0 else unit
        offset = least if abs(least) / unit > LARGEST else 0.0
        counts = np.rint((finite - offset) / unit).astype(np.int64)
        steps = counts - np.concatenate([[0], counts[:-1]])[: len(counts)]
        codes = np.zeros(len(values), np.int64)
        codes[known] = ((steps << 1) ^ (steps >> 63)) + 1
        content = codes.astype("<u4").view(np.uint8).reshape(-1, 4).T.tobytes()
        key = content + np.array([unit, offset]).tobytes()
        if key not in self._known:
            self._known[key] = len(self._columns)
            self._columns.append((len(values), float(unit), offset))
            self._parts.append(content)
        return self._known[key]

    def _bytes(self, content: bytes) -> int:
        self._cells.append(content)
        return len(self._cells) - 1

    def _thin(self, length: int, most: int, what: str, seconds: view.Array | None = None) -> view.Array:
        """Indices of at most `most` of so many things, and of those of moments, with a note if some are left out."""
        kept = view.thin_evenly(length, most)
        if len(kept) == length:
            return kept
        if seconds is not None:
            at = np.searchsorted(seconds, self._instants, side="right") - 1
            kept = np.union1d(kept, at[at >= 0])
        self._notes[f"{count(len(kept))} of {count(length)} {what}"] = None
        return kept

    def _described(self, of: Any, keep: view.Array | None = None) -> dict[str, Any]:
        """The fields of a drawing's part: arrays (N,) as numbers of columns with the rows kept, others as they are."""
        found, units = {}, {} if isinstance(of, view.Series) else UNITS
        for name in (each.name for each in fields(of)):
            value = getattr(of, name)
            if isinstance(value, np.ndarray) and value.ndim == 1:
                value = self._column(value if keep is None else value[keep], units.get(name))
            if value is not None and name not in ("values", "maps"):
                found["t" if name == "seconds" else name] = value
        return found

    def _panel(self, panel: view.Panel) -> dict[str, Any]:
        series = [
            self._described(of, self._thin(len(of.x), MOST_SAMPLES, f"samples of {of.label}")) for of in panel.series
        ]
        low, high, beyond = view.robust_limits(panel)
        limits = {"limits": (low, high), "beyond": beyond} if panel.robust else {}
        return self._described(panel) | {"series": series} | limits

    def _scene(self, scene: view.Scene) -> dict[str, Any]:
        self._instants = [moment.seconds for moment in scene.moments]
        layers = [{"kind": type(layer).__name__.lower(), **self._layer(layer)} for layer in scene.layers]
        moments = [asdict(moment) for moment in scene.moments]
        return self._described(scene) | {"layers": layers, "moments": moments, "span": scene.span}

    def _layer(self, layer: view.Layer) -> dict[str, Any]:
        match layer:
            case view.Raster():
                share = (layer.values - layer.low) / ((layer.high - layer.low) or 1.0)
                # 0 for none, 1 to 255 from low to high.
                codes = np.where(np.isfinite(share), 1 + np.rint(254 * np.clip(np.nan_to_num(share), 0, 1)), 0)
                shape = dict(zip(("rows", "columns"), codes.shape, strict=True))
                return self._described(layer) | shape | {"cells": self._bytes(codes.astype(np.uint8).tobytes())}
            case view.Windows():
                return self._windows(layer)
            case view.Lines():
                return self._lines(layer)
            case view.Track():
                return self._track(layer)
        return self._described(layer, self._thin(len(layer.x), MOST_MARKS, layer.label))

    def _windows(self, layer: view.Windows) -> dict[str, Any]:
        """Maps as bits along x, each as its exclusive or with the map before.

        Column and row of a cell are taken modulo the window's size, so that a cell that stays in a sliding window
        keeps its bit.
        """
        maps, (rows, columns) = layer.maps, layer.maps.shape
        width = (columns + 7) // 8
        chosen = self._thin(len(maps), max(1, MOST_MAP_BYTES // (rows * width)), "maps", layer.seconds)
        before, parts = np.zeros((rows, width), np.uint8), []
        for index in chosen.tolist():
            column, row = maps.corner[index].tolist()
            bits = np.packbits(np.roll(maps.occupied(index), (row % rows, column % columns), (0, 1)), axis=1)
            parts.append((bits ^ before).tobytes())
            before = bits
        place = {"origin": (maps.origin_m[0] - maps.corner[0] * maps.cell_m).tolist(), "cell": maps.cell_m}
        corner = {"column": self._column(maps.corner[chosen, 0], 1), "row": self._column(maps.corner[chosen, 1], 1)}
        shape = {"rows": rows, "columns": columns, "cells": self._bytes(b"".join(parts))}
        return self._described(layer, chosen) | place | corner | shape

    def _lines(self, layer: view.Lines) -> dict[str, Any]:
        most, ends = MOST_POSES if layer.measured else MOST_LINES, layer.first
        chosen = self._thin(len(ends) - 1, most, f"lines of {layer.label}", layer.seconds)
        points = max(8, MOST_LINE_POINTS // max(len(chosen), 1))
        rows = [ends[k] + view.thin_evenly(ends[k + 1] - ends[k], points) for k in chosen]
        every = np.concatenate([np.empty(0, int), *rows])
        seconds = None if layer.seconds is None else layer.seconds[chosen]
        first = np.cumsum([0, *map(len, rows)])
        return self._described(replace(layer, first=first, x=layer.x[every], y=layer.y[every], seconds=seconds))

    def _track(self, track: view.Track) -> dict[str, Any]:
        """Poses with all gaps and the rows beside them; yaw unwrapped: between two poses it takes the shorter turn."""
        gaps, yaw = np.flatnonzero(np.isnan(track.x)), track.yaw
        beside = np.clip([gaps - 1, gaps, gaps + 1], 0, len(track.x) - 1)
        kept = np.union1d(self._thin(len(track.x), MOST_POSES, f"positions of {track.label}"), beside)
        if yaw is not None:
            yaw = np.where(np.isnan(yaw), np.nan, np.unwrap(np.nan_to_num(yaw)))
        return self._described(replace(track, yaw=yaw), kept)
