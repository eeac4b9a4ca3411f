"""The map with all planners' paths, and the charts over replans, of one source: plain JSON for the page's scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float, Int
from quadlog.results.page.charts import ChartPanel, Line, panel_json
from quadlog.results.page.packing import NO_YAW, UNIT_M, UNIT_S, Packing
from quadlog.results.planner_comparison.shown_questions import ShownMap, ShownQuestions
from quadlog.results.plots.planner_comparison import LOG_DECADES
from quadlog.results.plots.style import thin_line

HUES = ("robot", "target", "plan", "resim", "note", "fix", "olive")
"""Colours of planners in their order, as .c0 and so on of sweep.css; further ones take the same again, dashed."""
FIRST_HUE = "text"
"""Colour of the first planner, the baseline: the one after HUES in sweep.css."""
MAX_CHART_POINTS = 1200
UNIT_US, UNIT_COST = 0.1, 0.01
"""What 1 stands for in the packed answers."""
NO_VALUE = -1

Columns = Mapping[str, NDArray[Any]]


class Asked:
    """The answers of a source's replans.parquet in the order of its questions: (Q,) of each planner."""

    def __init__(self, replans: Columns, planners: Sequence[str]) -> None:
        self._replans = replans
        order = np.lexsort((replans["replan"], replans["episode"]))
        self._rows = {name: order[replans["planner"][order] == name] for name in planners}
        self.planners = tuple(planners)
        self.episode = replans["episode"][self._rows[self.planners[0]]]
        self.replan = replans["replan"][self._rows[self.planners[0]]]

    def of(self, planner: str, column: str) -> NDArray[Any]:
        """(Q,) of one planner."""
        return self._replans[column][self._rows[planner]]

    def place(self, episode: int, replan: int) -> int:
        """Of a question in the order of all."""
        first, past = np.searchsorted(self.episode, [episode, episode + 1])
        return int(first + np.searchsorted(self.replan[first:past], replan))


def planner_hues(planners: Sequence[str]) -> list[dict[str, Any]]:
    """Name, colour and whether it is dashed of each planner's lines, in the map and in the charts alike."""
    first = [{"name": name, "color": FIRST_HUE, "hue": len(HUES), "dashed": False} for name in planners[:1]]
    return first + [
        {"name": name, "color": HUES[at % len(HUES)], "hue": at % len(HUES), "dashed": at >= len(HUES)}
        for at, name in enumerate(planners[1:])
    ]


def map_data(shown: ShownQuestions, asked: Asked, counted: str) -> dict[str, Any]:
    """All that planners/map.js needs; blocks are packed as page/player.py describes, for player_scene.js."""
    maps = list(dict.fromkeys(each.map for each in shown.questions))
    base = np.array([[each.col0, each.row0] for each in maps]).min(axis=0)
    places = np.array([asked.place(each.episode, each.replan) for each in shown.questions])
    first_with = [next(at for at, each in enumerate(shown.questions) if each.map is known) for known in maps]
    map_seconds = (places[first_with] + 1).astype(np.float64)
    ends = {
        name: _centres([getattr(each, name) for each in shown.questions], base, shown) for name in ("start", "goal")
    }
    grown = [each.grown or each.obstacles for each in maps] if any(each.grown for each in maps) else None
    answers = Packing()
    return {
        **_block(shown, maps, base, map_seconds, [each.obstacles for each in maps], ends, places),
        "grown": None if grown is None else _block(shown, maps, base, map_seconds, grown, {}, places),
        "hold": {"track": 0, "cloud": 0},
        "paths": [], "clouds": [], "contacts": [], "anchors": [], "body": None,
        "extent": _extent(shown, base, ends),
        "across": max(shown.shape) * shown.cell,
        "edge": shown.cell,
        "unit": shown.unit,
        "alone": shown.is_static,
        "planners": planner_hues(asked.planners),
        "number": answers.add_integers(places + 1),
        "episode": answers.add_integers(asked.episode[places] + 1),
        "replan": answers.add_integers(asked.replan[places] + 1),
        "last": answers.add_integers(np.bincount(asked.episode)[asked.episode[places]]),
        "questions": len(asked.episode),
        "episodes": len(np.unique(asked.episode)),
        "routes": [_routes(shown, asked, name, places, counted, base, answers) for name in asked.planners],
        "answers": {"lengths": answers.lengths, "packed": answers.finish()},
    }  # fmt: skip


def replan_chart(shown: ShownQuestions, asked: Asked, counted: str, group: str) -> dict[str, Any] | None:
    """Cells and time of every planner over the questions up to the last one shown; None for a single one.

    Of many questions those with the extremes of every line are drawn.
    """
    last = shown.questions[-1]
    count = len(asked.episode) if shown.is_static else int(np.searchsorted(asked.episode, last.episode + 1))
    if count < 2:
        return None
    of = {"cells": counted, "µs": "us"}
    values = {
        unit: [asked.of(name, column)[:count].astype(np.float64) for name in asked.planners]
        for unit, column in of.items()
    }
    lines = [each for all_of in values.values() for each in all_of]
    keep = np.unique(
        np.concatenate([thin_line(each, max(MAX_CHART_POINTS // shown.sources // len(lines), 8)) for each in lines])
    )
    number = keep + 1.0
    whats = {
        "cells": f"{'neighbours' if counted == 'touched' else 'cells'} {counted} per {word_for(shown)}",
        "µs": f"time per {word_for(shown)} (µs), median of the repeats",
    }
    hues = planner_hues(asked.planners)
    panels = [
        ChartPanel(
            whats[unit],
            [Line(hue["name"], hue["color"], number, each[keep]) for hue, each in zip(hues, mine, strict=True)],
        )
        for unit, mine in values.items()
    ]
    drawn = [each for each in map(panel_json, panels) if each is not None]
    for each, unit in zip(drawn, of, strict=False):
        each["log"] = _decades(values[unit])
        for line, hue in zip(each["lines"], hues, strict=False):
            line["dashed"] = hue["dashed"]
    return {"panels": drawn, "group": group, "axis": word_for(shown)}


def word_for(shown: ShownQuestions) -> str:
    """What a question is called."""
    return "query" if shown.is_static else "replan"


def _decades(lines: Sequence[Float]) -> str | None:
    """How time_charts.js scales an axis on which small values would vanish beside large ones; None for a linear one."""
    values = np.concatenate(lines)
    positive = values[values > 0]
    if not len(positive) or positive.max() <= 10**LOG_DECADES * positive.min():
        return None
    return "zero" if (values == 0).any() else "positive"


def _block(
    shown: ShownQuestions,
    maps: Sequence[ShownMap],
    base: Int,
    seconds: Float,
    layers: Sequence[bytes],
    ends: Mapping[str, Float],
    places: Int,
) -> dict[str, Any]:
    """One layer of the maps, with the tracks of goal and start where `ends` has them, as openScene reads them."""
    packing = Packing()
    looks = (("goal", "target", "target"), ("start", "start", "text"))
    tracks = [
        {"key": key, "run": "", "label": name, "color": color, "body": False,
         "t": packing.add((places + 1.0), UNIT_S), "x": packing.add(ends[name][:, 0], UNIT_M),
         "y": packing.add(ends[name][:, 1], UNIT_M), "yaw": packing.add_integers(np.full(len(places), NO_YAW)),
         "feet": packing.add_integers(np.empty(0, np.int64)), "lookahead": packing.add_integers(np.empty(0, np.int64))}
        for name, key, color in looks
        if name in ends
    ]  # fmt: skip
    # A coarser map, or one of a static source, is packed from its own corner on.
    corners = np.array([[each.col0, each.row0] for each in maps]) - (base if shown.is_static else 0)
    origin = np.zeros(2) if shown.is_static else -base * shown.cell
    windows = {
        "t": packing.add(seconds, UNIT_S),
        "column": packing.add_integers(corners[:, 0]),
        "row": packing.add_integers(corners[:, 1]),
        "rows": shown.shape[0],
        "columns": shown.shape[1],
        "cell": shown.cell * shown.step,
        "x": float(origin[0]),
        "y": float(origin[1]),
        "color": "text",
    }
    before = np.zeros(len(layers[0]), np.uint8)
    for layer in layers:
        bits = np.frombuffer(layer, np.uint8)
        packing.add_bytes((bits ^ before).tobytes())
        before = bits
    content = {"tracks": tracks, "windows": [windows], "lengths": packing.lengths, "packed": packing.finish()}
    return content if ends else content | {"paths": [], "clouds": [], "hold": {"track": 0, "cloud": 0}}


def _centres(cells: Any, base: Int, shown: ShownQuestions) -> Float:
    """(N, 2) centres of N cells, from the lower-left corner of all maps on."""
    centres: Float = (np.asarray(cells, dtype=np.float64).reshape(-1, 2) - base + 0.5) * shown.cell
    return centres


def _extent(shown: ShownQuestions, base: Int, ends: Mapping[str, Float]) -> list[float]:
    """Left, right, bottom, top of all starts, goals and paths; of a map that stands still, of all of it."""
    if shown.is_static:
        rows, columns = shown.shape
        side = shown.cell * shown.step
        return [0.0, columns * side, 0.0, rows * side]
    paths = [path for each in shown.questions for path in each.paths.values() if len(path)]
    points = np.concatenate([*ends.values(), *(_centres(path, base, shown) for path in paths)])
    (left, bottom), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return [left, right, bottom, top]


def _routes(
    shown: ShownQuestions, asked: Asked, name: str, places: Int, counted: str, base: Int, packing: Packing
) -> dict[str, int]:
    """Numbers of the columns with a planner's paths, cells from the corner of all maps on, and with its answers."""
    paths = [each.paths.get(name, np.empty((0, 2), np.int32)) for each in shown.questions]
    cells = np.concatenate(paths).astype(np.int64) - base
    found = asked.of(name, "found")[places]
    return {
        "first": packing.add_integers(np.cumsum([0, *map(len, paths)])),
        "x": packing.add_integers(cells[:, 0]),
        "y": packing.add_integers(cells[:, 1]),
        "found": packing.add_integers(found.astype(np.int64)),
        "cells": packing.add_integers(asked.of(name, counted)[places]),
        "us": packing.add_integers(_scaled(asked.of(name, "us")[places], UNIT_US)),
        "cost": packing.add_integers(np.where(found, _scaled(asked.of(name, "cost")[places], UNIT_COST), NO_VALUE)),
    }


def _scaled(values: NDArray[Any], unit: float) -> Int:
    """Whole numbers (N,), NO_VALUE for those that do not exist or do not fit."""
    scaled = np.asarray(values, dtype=np.float64) / unit
    fits = np.abs(scaled) < 2**30
    return np.where(fits, np.rint(np.where(fits, scaled, 0)), NO_VALUE).astype(np.int64)
