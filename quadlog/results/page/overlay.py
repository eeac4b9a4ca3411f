"""The interactive charts of two runs laid over each other: a quantity a panel, a colour for each run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.messages import Float
from quadlog.results.compare.common_clock import CommonClock
from quadlog.results.page.charts import ChartPanel, Line, over_time, run_panels, trajectory_chart
from quadlog.results.player.two_scenes import OF_BOTH, RUN_COLORS, TARGET_OF_BOTH
from quadlog.results.plots.run_data import RunData

MOST_QUANTITIES = 3
"""A panel with more quantities, such as the residuals of eight anchors, is drawn once for each run instead."""
_SAME = "the same in A and B"
_BESIDE = ("target", "reference", "course")
"""Walks that are not the robot's."""


def overlaid_charts(a: RunData, b: RunData, clock: CommonClock) -> dict[str, Any]:
    """The charts of both runs by name of the figure, as plain JSON. Raises NotARun for damaged tables."""
    of_a, of_b = run_panels(a), run_panels(b)
    apart = robots_apart(a, b) if clock.is_shared else None
    charts = {"trajectory": _trajectories(trajectory_chart(a), trajectory_chart(b))}
    panels = {name: list(overlaid_panels(of_a[name], of_b[name])) for name in of_a}
    if apart is not None and apart[1].any():
        panels["displacement"].insert(0, ChartPanel("from A to B (m)", [Line("distance", OF_BOTH, *apart)]))
    charts |= {name: over_time(each) for name, each in panels.items()}
    return {name: chart for name, chart in charts.items() if chart is not None}


def robots_apart(a: RunData, b: RunData) -> tuple[Float, Float] | None:
    """How far the simulated robots were apart (N,), with seconds (N,); None where they share no instant."""
    of_a, of_b = a.table("control"), b.table("control")
    if of_a is None or of_b is None:
        return None
    t_ns, in_a, in_b = np.intersect1d(of_a["t_ns"], of_b["t_ns"], return_indices=True)
    apart_m = np.hypot(*(of_a[name][in_a] - of_b[name][in_b] for name in ("x_m", "y_m")))
    known = np.isfinite(apart_m)
    return (a.seconds(t_ns[known]), apart_m[known]) if known.any() else None


def is_alike(chart: dict[str, Any]) -> bool:
    """Whether a chart over time of overlaid_charts is the same in both runs."""
    return "panels" in chart and all(panel["what"].endswith(_SAME) for panel in chart["panels"])


def overlaid_panels(a: Sequence[ChartPanel], b: Sequence[ChartPanel]) -> Iterator[ChartPanel]:
    """Panels with the lines of both runs; a panel that is the same in both is drawn once."""
    both = [{panel.what: panel for panel in panels} for panels in (a, b)]
    for what in dict.fromkeys(panel.what for panel in (*a, *b)):
        one, other = (panels.get(what, ChartPanel(what, ())) for panels in both)
        if _are_alike(one.lines, other.lines):
            yield ChartPanel(f"{what}: {_SAME}", one.lines)
        elif len({line.color for line in (*one.lines, *other.lines)}) > MOST_QUANTITIES:
            yield from (
                ChartPanel(f"{what}: {run}", panel.lines) for run, panel in zip(RUN_COLORS, (one, other), strict=True)
            )
        else:
            yield from _by_quantity(what, one.lines, other.lines)


def _by_quantity(what: str, a: Sequence[Line], b: Sequence[Line]) -> Iterator[ChartPanel]:
    """A panel for each colour of the lines: a quantity has one, and so has its mean."""
    colors = list(dict.fromkeys(line.color for line in (*a, *b)))
    for color in colors:
        lines = []
        for (run, (of_run, _)), mine in zip(RUN_COLORS.items(), (a, b), strict=True):
            same = [line for line in mine if line.color == color]
            names = [run, *(f"{run}, {line.label}" for line in same[1:])]
            lines += [replace(line, label=name, color=of_run) for name, line in zip(names, same, strict=False)]
        quantity = next(line.label for line in (*a, *b) if line.color == color)
        yield ChartPanel(f"{what}: {quantity}" if len(colors) > 1 else what, lines)


def _are_alike(a: Sequence[Line], b: Sequence[Line]) -> bool:
    return len(a) == len(b) and all(
        one.label == other.label
        and np.array_equal(one.seconds, other.seconds)
        and np.array_equal(one.values, other.values, equal_nan=True)
        for one, other in zip(a, b, strict=True)
    )


def _trajectories(a: dict[str, Any] | None, b: dict[str, Any] | None) -> dict[str, Any] | None:
    """Both walks on one map, what is alike once; without plans, which the player shows."""
    charts = [{} if each is None else each for each in (a, b)]
    if not any(charts):
        return None
    walks: list[list[dict[str, Any]]] = [[_place(walk) for walk in chart.get("walks", [])] for chart in charts]
    named = [
        walk | {"label": f"A and B: {walk['label']}", "color": TARGET_OF_BOTH if walk["label"] == "target" else OF_BOTH}
        for walk in walks[0]
        if walk in walks[1]
    ]
    for run, mine, others in (("A", walks[0], walks[1]), ("B", walks[1], walks[0])):
        main = next((walk["label"] for walk in reversed(mine) if walk["label"] not in _BESIDE), "")
        named += [
            walk | {"label": f"{run}: {walk['label']}", "color": RUN_COLORS[run][walk["label"] != main]}
            for walk in mine
            if walk not in others
        ]
    one, other = charts

    def together(name: str) -> list[Any]:
        mine = one.get(name) or []
        return [*mine, *(each for each in other.get(name) or [] if each not in mine)]

    fixes = one.get("fixes") if one.get("fixes") == other.get("fixes") else None
    beside = {name: together(name) for name in ("anchors", "around", "walls")}
    return {"walks": named, "fixes": fixes, "plans": [], "errors": [], **beside}


def _place(walk: dict[str, Any]) -> dict[str, Any]:
    """A walk without the classes of its error, which would hide the colour of the run."""
    return {name: value for name, value in walk.items() if name != "classes"}
