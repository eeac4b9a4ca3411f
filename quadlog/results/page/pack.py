"""Drawings for the page's scripts: columns and cells in one deflated block, and a description that refers to it.

A column is stored as whole numbers of a unit, each as its difference from the one before: 0 for no value, else the
zigzag code of the difference plus 1, in four planes of bytes, lowest first, so that small steps make long runs of
zeros. Cells follow the columns. templates/unpack.js reads it. Curves keep every sample; only what follows is thinned.
"""

from __future__ import annotations

import base64
import zlib
from functools import singledispatchmethod
from typing import Any

import numpy as np

from quadlog.results.numbers import count
from quadlog.results.view import (
    Array,
    Drawing,
    Ellipses,
    Lines,
    Link,
    Marks,
    Panel,
    Raster,
    Scene,
    Series,
    Track,
    Windows,
    thin_evenly,
)

DIGITS = 1e4
"""A curve's span is divided into at least so many steps: finer than a pixel."""
SECOND, PLACE, ANGLE = 1e-3, 1e-3, 1e-4
"""Units of instants (s), positions (m or cells) and angles (rad)."""
POSE_S = 0.04
"""Positions more often are more than a screen shows, which interpolates between them."""
MOST_SAMPLES, MOST_POSES, MOST_LINES, MOST_LINE_POINTS, MOST_MARKS = 400_000, 9000, 1200, 200_000, 12_000
MOST_MAP_BYTES = 8 << 20
"""Of the maps of one scene, a bit a cell, before they are deflated."""
NEAR_S = 1.0
"""All marks within this time of a moment are kept."""
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
        self._notes: list[str] = []
        self._instants = np.empty(0)  # of the moments of the scene

    def __bool__(self) -> bool:
        return bool(self.charts or self.scenes)

    @property
    def thinned(self) -> str:
        """What was thinned for the page, as a sentence; empty for nothing."""
        return f"Thinned for this page: {'; '.join(self._notes)}." if self._notes else ""

    def add(self, name: str, drawing: Drawing, group: str = "run") -> None:
        """Add a drawing. Drawings of a group share a clock."""
        if isinstance(drawing, Scene):
            self.scenes[name] = self._scene(drawing) | {"group": group}
        else:
            self.charts[name] = {"group": group, "panels": [self._panel(panel) for panel in drawing]}

    def finish(self) -> dict[str, Any]:
        """All that the page's scripts need, as plain JSON."""
        packed = zlib.compress(b"".join([*self._parts, *self._cells]), 6)
        return {
            "charts": self.charts,
            "scenes": self.scenes,
            "columns": self._columns,
            "cells": [len(content) for content in self._cells],
            "packed": base64.b64encode(packed).decode(),
        }

    def _column(self, values: Array, unit: float | None = None) -> int:
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

    def _thin(self, length: int, most: int, what: str, seconds: Array | None = None) -> Array:
        """Indices of about `most` of so many things, with a note if some are left out: never those near a moment."""
        if length <= most:
            return np.arange(length)
        kept = thin_evenly(length, most)
        if seconds is not None and len(self._instants):
            after = np.searchsorted(self._instants, seconds).clip(1, len(self._instants)) - 1
            both = self._instants[np.minimum([after, after + 1], len(self._instants) - 1)]
            kept = np.union1d(kept, np.flatnonzero(np.abs(seconds - both).min(axis=0) <= NEAR_S))
        self._note(f"{count(len(kept))} of {count(length)} {what}")
        return kept

    def _note(self, text: str) -> None:
        if text not in self._notes:
            self._notes.append(text)

    def _panel(self, panel: Panel) -> dict[str, Any]:
        flags = {"zero": panel.zero, "log": panel.log, "lane": panel.lane, "robust": panel.robust}
        described = {
            "what": panel.what,
            "x": panel.x,
            "rows": list(panel.rows),
            **flags,
            "marks": self._column(panel.marks, SECOND),
        }
        return described | {"series": [self._series(series) for series in panel.series]}

    def _series(self, series: Series) -> dict[str, Any]:
        keep = self._thin(len(series.x), MOST_SAMPLES, f"samples of {series.label}")
        look = {"label": series.label, "color": series.color, "style": series.style, "variant": series.variant}
        columns = {"x": self._column(series.x[keep]), "y": self._column(series.y[keep])}
        if series.upper is not None:
            columns["upper"] = self._column(series.upper[keep])
        return look | columns

    def _scene(self, scene: Scene) -> dict[str, Any]:
        self._instants = np.sort([moment.seconds for moment in scene.moments])
        described = {
            "layers": [self._layer(layer) for layer in scene.layers],
            "extent": scene.extent,
            "unit": scene.unit,
            "axes": scene.axes,
            "step": scene.step,
            "near": scene.near,
            "body": scene.body,
            "levels": list(scene.levels),
            "activity": [{"label": row.label, "spans": row.spans, "events": row.events} for row in scene.activity],
        }
        return described | ({"span": scene.span} if scene.moves else {})

    @singledispatchmethod
    def _layer(self, layer: Any) -> dict[str, Any]:
        raise TypeError(type(layer))

    @_layer.register
    def _(self, layer: Raster) -> dict[str, Any]:
        """Values as bytes: 0 for none, 1 to 255 from low to high."""
        share = (layer.values - layer.low) / ((layer.high - layer.low) or 1.0)
        codes = np.where(np.isfinite(share), 1 + np.rint(254 * np.clip(np.nan_to_num(share), 0, 1)), 0)
        rows, columns = codes.shape
        place = {"x": layer.origin[0], "y": layer.origin[1], "cell": layer.cell, "rows": rows, "columns": columns}
        scale = {"low": layer.low, "high": layer.high, "unit": layer.unit, "ramp": layer.ramp}
        return _look(layer, "raster") | place | scale | {"cells": self._bytes(codes.astype(np.uint8).tobytes())}

    @_layer.register
    def _(self, layer: Windows) -> dict[str, Any]:
        """Maps as bits along x, each as its exclusive or with the map before.

        Column and row of a cell are taken modulo the window's size, so that a cell that stays in a sliding window
        keeps its bit.
        """
        maps, (rows, columns) = layer.maps, layer.maps.shape
        width = (columns + 7) // 8
        chosen = self._thin(len(maps), max(1, MOST_MAP_BYTES // (rows * width)), "maps")
        before, parts = np.zeros((rows, width), np.uint8), []
        for index in chosen.tolist():
            column, row = maps.corner[index].tolist()
            bits = np.packbits(np.roll(maps.occupied(index), (row % rows, column % columns), (0, 1)), axis=1)
            parts.append((bits ^ before).tobytes())
            before = bits
        corner = {"column": self._column(maps.corner[chosen, 0], 1), "row": self._column(maps.corner[chosen, 1], 1)}
        x, y = (maps.origin_m[0] - maps.corner[0] * maps.cell_m).tolist()
        place = {"x": x, "y": y, "cell": maps.cell_m, "rows": rows, "columns": columns}
        times = {"t": self._column(layer.seconds[chosen], SECOND), "cells": self._bytes(b"".join(parts))}
        return _look(layer, "windows") | place | corner | times

    @_layer.register
    def _(self, layer: Lines) -> dict[str, Any]:
        chosen = self._thin(len(layer.first) - 1, MOST_LINES, f"lines of {layer.label}")
        most = max(8, MOST_LINE_POINTS // max(len(chosen), 1))
        rows = [np.arange(layer.first[k], layer.first[k + 1]) for k in chosen]
        rows = [of[thin_evenly(len(of), most)] for of in rows]
        every = np.concatenate([np.empty(0, int), *rows])
        first = {"first": self._column(np.cumsum([0, *map(len, rows)]), 1)}
        times = {} if layer.seconds is None else {"t": self._column(layer.seconds[chosen], SECOND)}
        return _look(layer, "lines") | first | self._place(layer, every) | times

    @_layer.register
    def _(self, layer: Marks) -> dict[str, Any]:
        middle = None if layer.seconds is None or layer.until is None else (layer.seconds + layer.until) / 2
        keep = self._thin(len(layer.x), MOST_MARKS, layer.label, middle)
        columns = self._place(layer, keep)
        if layer.seconds is not None and layer.until is not None:
            columns |= {"t": self._column(layer.seconds[keep], SECOND)}
            columns |= {"until": self._column(layer.until[keep], SECOND)}
        if layer.radius is not None:
            columns["radius"] = self._column(layer.radius[keep], PLACE)
        how = {"shape": layer.shape, "names": list(layer.names), "hidden": layer.hidden}
        return _look(layer, "marks") | how | columns

    @_layer.register
    def _(self, layer: Link) -> dict[str, Any]:
        keep = self._poses(layer.seconds, layer.x, layer.label)
        ends = {"to_x": self._column(layer.to_x[keep], PLACE), "to_y": self._column(layer.to_y[keep], PLACE)}
        times = {"t": self._column(layer.seconds[keep], SECOND)}
        return _look(layer, "link") | times | self._place(layer, keep) | ends

    @_layer.register
    def _(self, layer: Ellipses) -> dict[str, Any]:
        keep = self._thin(len(layer.seconds), MOST_MARKS, layer.label, layer.seconds)
        covariance = {name: self._column(getattr(layer, name)[keep]) for name in ("xx", "xy", "yy")}
        times = {"t": self._column(layer.seconds[keep], SECOND), "hidden": layer.hidden}
        return _look(layer, "ellipses") | times | self._place(layer, keep) | covariance

    @_layer.register
    def _(self, layer: Track) -> dict[str, Any]:
        keep = self._poses(layer.seconds, layer.x, layer.label)
        columns = {"t": self._column(layer.seconds[keep], SECOND)} | self._place(layer, keep)
        if layer.yaw is not None:
            yaw = layer.yaw[keep]
            turned = np.unwrap(np.nan_to_num(yaw))  # a straight line between two poses is then the shorter turn
            columns["yaw"] = self._column(np.where(np.isnan(yaw), np.nan, turned), ANGLE)
        for name in ("feet", "level"):
            if (values := getattr(layer, name)) is not None:
                columns[name] = self._column(values[keep], 1)
        return _look(layer, "track") | {"shape": layer.shape, "trail": layer.trail} | columns

    def _place(self, layer: Any, keep: Array) -> dict[str, int]:
        return {"x": self._column(layer.x[keep], PLACE), "y": self._column(layer.y[keep], PLACE)}

    def _poses(self, seconds: Array, x: Array, label: str) -> Array:
        """Rows of a track: one each POSE_S or less often, with the row before each gap and the gap."""
        if not len(seconds):
            return np.arange(0)
        step_s = max(POSE_S, float(seconds[-1] - seconds[0]) / MOST_POSES)
        slot = np.floor((seconds - seconds[0]) / step_s + 1e-6)
        gap = np.isnan(x)
        kept = np.append(True, np.diff(slot) > 0) | gap | np.append(gap[1:], False) | np.append(False, gap[:-1])
        kept[-1] = True
        if step_s > POSE_S:
            self._note(f"{label}: a position every {step_s:.2g} s")
        return np.flatnonzero(kept)


def _look(layer: Any, kind: str) -> dict[str, Any]:
    look = {"kind": kind, "label": layer.label, "color": layer.color}
    return look | ({"variant": layer.variant} if hasattr(layer, "variant") else {})
