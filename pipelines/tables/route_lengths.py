"""Rows of the table planning-1: how long the ways of A* and IA* are, and how long a robot takes for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.judging import bootstrap_ratio, compare, share_interval
from quadlog.pipelines.tables.planner_walks import (
    DENSITIES_PER_M2,
    HELD_OUT_SEED,
    PRESETS,
    Preset,
    forest_of,
    of_printed_runs,
)
from quadlog.pipelines.tables.printed_planning import LENGTH_M, LENGTH_RUNS, TIME_S
from quadlog.pipelines.tables.pursued_walks import (
    LOOKAHEAD_M,
    MAX_YAW_RATE_RADPS,
    TICK_S,
    TICKS_PER_REPLAN,
    PursuedWalk,
    pursue,
)
from quadlog.planning.polyline import arc_lengths
from quadlog.planning.registry import make_planner
from quadlog.results.paper_rows import PaperRow, RowGroup
from quadlog.simulation.planning_walk import Outcome, WorldWalk, walk_world
from quadlog.simulation.planning_worlds import SPEED_MPS

NAMES = ("A*", "IA*")


@dataclass(frozen=True, slots=True)
class Pair:
    """A* and IA*, in this order, each on its own way through one forest.

    pursued: as a robot walks it. grid_m: length cell by cell, NaN where it did not arrive.
    """

    pursued: tuple[PursuedWalk, PursuedWalk]
    grid_m: tuple[float, float]

    @property
    def arrived(self) -> bool:
        """Whether both came to the goal."""
        return all(walk.arrived for walk in self.pursued)


Pairs = dict[tuple[str, float], list[Pair]]
"""By preset and trees per m²."""


def walk_all(walks: int, seed: int) -> Pairs:
    """Both planners through every forest."""
    return {
        (preset.name, density): [_walk_both(preset, density, number, seed) for number in range(walks)]
        for preset in PRESETS
        for density in DENSITIES_PER_M2
    }


def _walk_both(preset: Preset, density: float, number: int, seed: int) -> Pair:
    world = forest_of(density, number, preset, seed)
    first, second = (
        (pursue(world, make_planner(name, preset.rules)), walk_world(world, make_planner(name, preset.rules)))
        for name in (preset.baseline, "ia_star")
    )
    return Pair((first[0], second[0]), (_grid_length_m(first[1]), _grid_length_m(second[1])))


def _grid_length_m(walk: WorldWalk) -> float:
    return float(arc_lengths(walk.path_xy_m)[-1]) if walk.outcome is Outcome.ARRIVED else math.nan


def length_group(preset: Preset, pairs: Pairs, seed: int) -> RowGroup:
    """Table 1 by one preset, in both forests."""
    rows: list[PaperRow] = []
    for density in DENSITIES_PER_M2:
        walked = pairs[preset.name, density]
        whole = [pair for pair in walked if pair.arrived]
        rows += _rows(whole, len(walked), f"{preset.name}, {density:g} trees/m²", seed)
    text = (
        f"{preset.baseline} and ia_star, rules {preset.rules}; obstacles grown by 3 cells ({preset.dilation}). Each "
        f"leads its own walk through the same forests. A kinematic robot follows the smoothed path by pure pursuit, "
        f"looking {LOOKAHEAD_M:g} m ahead at {SPEED_MPS:g} m/s and no more than {MAX_YAW_RATE_RADPS:g} rad/s, and "
        f"replans each {TICK_S * TICKS_PER_REPLAN:g} s; lengths are those of the way it really walks. That speed "
        "is the mean speed of A* in Table 1, the rest is our choice. Figures of ten walks: ours are the first ten, and "
        "the interval is where 95 % of the tables of ten drawn from all our walks have that figure. Other intervals: "
        "bootstrap over the walks; shares that are not of ten walks after Wilson."
    )
    return RowGroup(f"Table 1, preset {preset.name}", text, tuple(rows))


def _rows(pairs: list[Pair], set_out: int, where: str, seed: int) -> list[PaperRow]:
    length_m = _of(pairs, lambda walk: walk.length_m)
    time_s = _of(pairs, lambda walk: walk.duration_s)
    set_by = "Set by how far our goals are away."
    rows = _mean_rows(length_m, LENGTH_M, f"{where}: length, mean of ten", "m", set_by, seed)
    rows += _ratio_rows(length_m, LENGTH_M, f"{where}: length", "shorter", seed)
    rows += _mean_rows(time_s, TIME_S, f"{where}: time, mean of ten", "s", f"{set_by} At {SPEED_MPS:g} m/s.", seed)
    why_not = "Ours walks at an even speed and loses nothing by turning; the printed robot is not published."
    rows += _ratio_rows(time_s, TIME_S, f"{where}: time", "slower", seed, why_not)
    for at, name in enumerate(NAMES):
        turning = _of(pairs, lambda walk: walk.turning_radpm)[at]
        ours, interval = bootstrap_ratio(turning, np.ones(len(turning)), _rng(seed))
        rows.append(PaperRow(f"{where}: turning, {name} (rad/m)", ours, None, *interval))
    for at, name in enumerate(NAMES):
        touched = int(sum(pair.pursued[at].clearance_m <= 0 for pair in pairs))
        share, interval = share_interval(touched, len(pairs))
        note = f"{touched} of {len(pairs)}; {set_out} set out."
        rows.append(
            PaperRow(f"{where}: share of walks that touch a trunk, {name} (1)", share, None, *interval, note=note)
        )
    return rows + _grid_rows(pairs, where, seed)


def _mean_rows(ours: Float, printed: Float, what: str, unit: str, note: str, seed: int) -> list[PaperRow]:
    """Not judged: the forests decide."""
    rows = []
    for at, name in enumerate(NAMES):
        mean, interval = of_printed_runs(ours[at], LENGTH_RUNS, np.mean, _rng(seed))
        rows.append(PaperRow(f"{what}, {name} ({unit})", mean, float(printed[at].mean()), *interval, note=note))
    return rows


def _ratio_rows(ours: Float, printed: Float, what: str, rather: str, seed: int, why_not: str = "") -> list[PaperRow]:
    """IA* over A*, and how often it is shorter or slower."""
    ratio, printed_ratio = ours[1] / ours[0], printed[1] / printed[0]
    mean, interval = of_printed_runs(ratio, LENGTH_RUNS, np.mean, _rng(seed))
    rows = [
        compare(
            f"{what} of IA* over that of A*, mean of ten (1)", _mean(printed_ratio), 1e-3, mean, interval, "", why_not
        )
    ]
    is_so, printed_so = ((each < 1) if rather == "shorter" else (each > 1) for each in (ratio, printed_ratio))
    share, share_interval_ = of_printed_runs(is_so.astype(np.float64), LENGTH_RUNS, np.mean, _rng(seed))
    note = f"{int(is_so.sum())} of all {len(is_so)}."
    quantity = f"{what}: share of ten walks in which IA* is {rather} (1)"
    return [*rows, compare(quantity, _mean(printed_so), 0.1, share, share_interval_, note, why_not)]


def _grid_rows(pairs: list[Pair], where: str, seed: int) -> list[PaperRow]:
    grid_m = np.array([pair.grid_m for pair in pairs]).T
    grid_m = grid_m[:, np.isfinite(grid_m).all(axis=0)]
    ratio = grid_m[1] / grid_m[0]
    mean, interval = bootstrap_ratio(ratio, np.ones(len(ratio)), _rng(seed))
    shorter = int((ratio < 1).sum())
    share, share_range = share_interval(shorter, len(ratio))
    what = f"{where}, cell by cell without smoothing"
    note = "Of the cells' centres, one cell a replan."
    return [
        PaperRow(f"{what}: length of IA* over that of A*, mean (1)", mean, None, *interval, note=note),
        PaperRow(
            f"{what}: share of walks in which IA* is shorter (1)",
            share,
            None,
            *share_range,
            note=f"{shorter} of {len(ratio)}.",
        ),
    ]


def _of(pairs: list[Pair], figure: Callable[[PursuedWalk], float]) -> Float:
    """(2, W) of A* and of IA*."""
    return np.array([[figure(walk) for walk in pair.pursued] for pair in pairs]).T


def _mean(values: Float) -> float:
    return float(np.mean(values))


def _rng(seed: int) -> np.random.Generator:
    """The same draws for every row."""
    return np.random.default_rng([HELD_OUT_SEED + seed, LENGTH_RUNS, *b"walks"])
