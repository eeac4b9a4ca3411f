"""The table following-2: cells searched while a robot follows a person through forests and along a known walk."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from quadlog.geometry import arc_lengths
from quadlog.mapping.inflation import INFLATIONS
from quadlog.messages import Float
from quadlog.metrics.intervals import FEWEST_VALUES
from quadlog.pipelines.tables.intervals import bootstrap_ratio, judge_claim, share_interval
from quadlog.pipelines.tables.pictures import drawn
from quadlog.pipelines.tables.planning.planner_walks import (
    DENSITIES_PER_M2,
    HELD_OUT_SEED,
    HONEST,
    PAPER,
    PAPER_END,
    PRESETS,
    READINGS,
    Preset,
    Spent,
    first_run_panel,
    forest_of,
    ratio_panel,
    spend,
)
from quadlog.planning.planners.astar import AStar
from quadlog.planning.registry import make_planner
from quadlog.results.numbers import count
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, TablePicture, Verdict
from quadlog.simulation.worlds.replanning_walk import Outcome, walk_world
from quadlog.simulation.worlds.scenes import FOLLOWING_CELLS, SCENES
from quadlog.simulation.worlds.world import GROWTH_M, WaypointTrack, World, occupied_centres

# None of these is printed. The site of Figs 14 and 15 has room for a person 4 m ahead.
AHEAD_M, SPEED_MPS = 4.0, 0.6
ASIDE_M, TURN_EACH_M = 2.0, 4.0


def follow_world(density_per_m2: float, number: int, preset: Preset, seed: int, ahead_m: float = AHEAD_M) -> World:
    """A held-out forest whose goal is a person, ahead_m of way before a robot that is as fast.

    The person strolls to the forest's goal over places up to ASIDE_M beside the straight line, one for each
    TURN_EACH_M of it, round the growth of trees, and stands there in the end.
    """
    world = forest_of(density_per_m2, number, preset, seed, FOLLOWING_CELLS)
    rng = np.random.default_rng([HELD_OUT_SEED + seed, number, *b"stroll"])
    way_m = _stroll(world, rng)
    arc_m = arc_lengths(way_m)
    first = min(int(np.searchsorted(arc_m, ahead_m)), len(arc_m) - 1)
    t_ns = np.rint(1e9 * (arc_m[first:] - arc_m[first]) / SPEED_MPS).astype(np.int64)
    return replace(world, goal=WaypointTrack(t_ns, way_m[first:]), speed_mps=SPEED_MPS)


def _stroll(world: World, rng: np.random.Generator) -> Float:
    """(L, 2) cells' centres in map from start to goal; a place that cannot be reached is left out."""
    # Grown alike for all presets, so that the person takes the same way in all.
    blocked = INFLATIONS["square"](world.occupied, world.dilation_m / world.window.cell_m)
    planner = AStar()
    cells = [np.asarray(world.window.cell_of(world.start_xy_m[None]), dtype=np.int32)]
    for place_m in _places(world.start_xy_m, world.goal.at(0), rng):
        (col, row), (to_col, to_row) = cells[-1][-1].tolist(), world.window.cell_of(place_m).tolist()
        cells.append(planner.plan(blocked, (col, row), (to_col, to_row)).cells[1:])
        if not len(cells[-1]):
            cells.pop()
    return world.window.centre_of(np.concatenate(cells))


def _places(start_m: Float, goal_m: Float, rng: np.random.Generator) -> Float:
    """(K, 2) in map, the goal last."""
    along_m = goal_m - start_m
    length_m = float(np.hypot(*along_m))
    left = np.array([-along_m[1], along_m[0]]) / length_m
    count = int(length_m // TURN_EACH_M)
    share = np.arange(1, count + 1) / (count + 1)
    aside_m = rng.uniform(-ASIDE_M, ASIDE_M, size=count)
    return np.concatenate([start_m + share[:, None] * along_m + aside_m[:, None] * left, goal_m[None]])


CLAIMED = 5.0
"""[Following]: A* traverses more than so many times as many cells. The figures of its Table 2 are lost."""
WHY_NOT = "Round an obstacle a way leads away from its goal, and IA* keeps none of the steps that do."
SITES = {"static-obstacles": "static obstacles", "dynamic-obstacle": "a dynamic obstacle"}
"""Scenes of quadlog.simulation.worlds.scenes, and what the table calls them."""
READERS = ("ia_star", "ia_star_end")
RIVALS = {HONEST.name: (*READERS, "mt_d_star_lite")}
"""Beside the baseline; by the other presets both readings of IA*."""
SETTINGS = {"2 m ahead": (2.0, 1), "8 m ahead": (8.0, 1), "a replan each 3 cells": (AHEAD_M, 3)}
"""(metres ahead, cells a replan) beside what is usual, AHEAD_M and 1."""

Measured = dict[tuple[str, str], Spent]
"""By preset and by where."""


def measure_all(walks: int, seed: int) -> Measured:
    """Everything that the table rests on."""
    measured: Measured = {}
    for preset in PRESETS:
        for scene, called in SITES.items():
            world = replace(SCENES[scene](), dilation=preset.dilation)
            measured[preset.name, called] = spend(
                [world], preset, RIVALS.get(preset.name, READERS), preset.leader, seed
            )
        for density in DENSITIES_PER_M2:
            measured[preset.name, forest_name(density)] = _follow(preset, density, walks, seed)
        for setting, (ahead_m, cells_per_replan) in SETTINGS.items():
            half = math.ceil(walks / 2)
            measured[preset.name, setting] = _follow(preset, DENSITIES_PER_M2[0], half, seed, ahead_m, cells_per_replan)
    return measured


def forest_name(density_per_m2: float) -> str:
    """What the table calls a forest."""
    return f"{density_per_m2:g} trees/m²"


def _follow(
    preset: Preset, density: float, walks: int, seed: int, ahead_m: float = AHEAD_M, cells_per_replan: int = 1
) -> Spent:
    worlds = [follow_world(density, number, preset, seed, ahead_m) for number in range(walks)]
    return spend(worlds, preset, RIVALS.get(preset.name, READERS), preset.leader, seed, cells_per_replan)


def preset_group(preset: Preset, measured: Measured) -> RowGroup:
    """The claim by one preset, on the site and in the forests."""
    rows: list[PaperRow] = []
    for where in (*SITES.values(), *map(forest_name, DENSITIES_PER_M2)):
        spent = measured[preset.name, where]
        rivals = RIVALS.get(preset.name, READERS)
        rows += [_ratio_row(spent, name, preset, where) for name in rivals]
        rows += _cell_rows(spent, f"{preset.name}, {where}")
    text = (
        f"{preset.baseline} against the others, rules {preset.rules}, counting {preset.counted} cells; obstacles grown "
        f"by 3 cells ({preset.dilation}), led by {preset.leader}, one cell a replan. In ia_star "
        f"{READINGS['ia_star']}; in ia_star_end {READINGS['ia_star_end']}. More than {CLAIMED:g} times reproduces "
        f"where the interval lies above {CLAIMED:g}; either site is one walk, from which nothing is drawn. Intervals: "
        "bootstrap over the walks, of the median; shares of walks after Wilson."
    )
    return RowGroup(f"Table 2, preset {preset.name}", text, tuple(rows))


def _ratio_row(spent: Spent, planner: str, preset: Preset, where: str) -> PaperRow:
    """Only A* over IA* is claimed, by the preset's reading. Fewer than FEWEST_VALUES walks are too few to tell."""
    row, ratios = spent.row(planner), spent.ratios(planner)
    assert row.ratio_expanded is not None
    is_drawn = len(ratios) > 1
    interval = (row.ratio_low, row.ratio_high) if is_drawn else None
    low, high = interval or (None, None)
    quantity = f"{preset.name}, {where}: {'median ' if is_drawn else ''}ratio {spent.comparison.baseline}/{planner} (1)"
    note = f"{ratios.min():.1f} to {ratios.max():.1f} in {len(ratios)} walks." if is_drawn else ""
    if planner != preset.ia_star:
        return PaperRow(quantity, row.ratio_expanded, None, low, high, note=note)
    verdict = Verdict.UNDECIDED
    if where in SITES.values() or (is_drawn and len(ratios) >= FEWEST_VALUES):
        assert low is None or high is not None
        verdict = judge_claim(CLAIMED, row.ratio_expanded, None if low is None or high is None else (low, high))
    why_not = WHY_NOT if planner == "ia_star" and verdict is Verdict.NO else ""
    note = " ".join(filter(None, [f"Claimed: more than {CLAIMED:g}.", note, why_not]))
    return PaperRow(quantity, row.ratio_expanded, CLAIMED, low, high, verdict, note, f"> {CLAIMED:g}")


def _cell_rows(spent: Spent, where: str) -> list[PaperRow]:
    rows = [
        PaperRow(f"{where}: cells a replan, {row.planner} (1)", _a_replan(spent, row.planner))
        for row in spent.comparison.rows
    ]
    rows += [
        PaperRow(f"{where}: replans from scratch, {row.planner} (1)", row.fallback_share)
        for row in spent.comparison.rows
        if row.fallback_share is not None
    ]
    rows += [
        PaperRow(f"{where}: mean excess cost of a plan, {row.planner} (1)", round(row.suboptimality_mean, 9))
        for row in spent.comparison.rows
        if row.suboptimality_mean is not None and row.planner in READERS
    ]
    if spent.walks > 1:
        share, interval = share_interval(spent.arrived, spent.walks)
        note = f"{spent.arrived} of {spent.walks}."
        rows.append(PaperRow(f"{where}: share of walks that arrive (1)", share, None, *interval, note=note))
    return rows


def _a_replan(spent: Spent, planner: str) -> float:
    return float(np.sum(spent.cells(planner))) / spent.comparison.rows[0].replans


def setting_group(measured: Measured) -> RowGroup:
    """What else the ratio hangs on."""
    usual = forest_name(DENSITIES_PER_M2[0])
    rows = []
    for preset in PRESETS:
        for setting in (usual, *SETTINGS):
            spent = measured[preset.name, setting]
            called = f"{AHEAD_M:g} m ahead, a replan each cell" if setting == usual else setting
            row, ratios = spent.row(preset.ia_star), spent.ratios(preset.ia_star)
            assert row.ratio_expanded is not None
            quantity = f"{preset.name}, {called}: median ratio A*/IA* (1)"
            note = f"{ratios.min():.1f} to {ratios.max():.1f} in {len(ratios)} walks."
            low, high = (row.ratio_low, row.ratio_high) if len(ratios) > 1 else (None, None)
            rows.append(PaperRow(quantity, row.ratio_expanded, None, low, high, note=note))
    text = (
        f"The walks through {usual}, the first half of them where a setting differs. The farther the person is ahead, "
        "the more A* searches, while IA* goes on from the end of its old path; the more the robot walks between "
        "replans, the more there is to go on with. Neither is printed. Intervals: bootstrap over the walks."
    )
    return RowGroup("What the ratio hangs on", text, tuple(rows))


WHERE = {0.0: "Fig. 17, without obstacles", **{each: f"Fig. 18, {each:g} trees/m²" for each in DENSITIES_PER_M2}}
"""Trees to a square metre, and what the table calls them."""


@dataclass(frozen=True, slots=True)
class Followed:
    """One walk behind a person. mean_m, most_m: straight to the person, at the replans.

    clear_m: the least from the robot's centre to the edge of an obstacle, inf without any.
    """

    arrived: bool
    mean_m: float
    most_m: float
    clear_m: float


def follow(world: World) -> Followed:
    """Led by IA* as the paper's robot is."""
    walk = walk_world(world, make_planner(PAPER.leader, PAPER.rules))
    away_m = np.array([np.hypot(*(each.goal_xy_m - each.robot_xy_m)) for each in walk.instants])
    centres_m = occupied_centres(world.occupied, world.window)
    clear_m = np.inf
    if len(centres_m):
        clear_m = float(cKDTree(centres_m).query(walk.path_xy_m)[0].min()) - world.window.cell_m / 2
    return Followed(walk.outcome is Outcome.ARRIVED, float(away_m.mean()), float(away_m.max()), clear_m)


def person_group(walks: int, seed: int) -> RowGroup:
    """Both figures in numbers, of which the paper prints none."""
    rows: list[PaperRow] = []
    for number, (density, where) in enumerate(WHERE.items()):
        followed = [follow(follow_world(density, each, PAPER, seed)) for each in range(walks)]
        rows += _rows(followed, where, np.random.default_rng([HELD_OUT_SEED + seed, number, *b"person"]))
    text = (
        f"Following a person who walks {AHEAD_M:g} m of way ahead, without and with obstacles, as the paper shows "
        f"outdoors in pictures. Preset paper, led by {PAPER.leader}, one cell a replan; obstacles grow by "
        f"{GROWTH_M:g} m, which the robot's centre keeps off. The person stands still in the end, and there a walk "
        "ends. Intervals: bootstrap over the walks; shares of walks after Wilson."
    )
    return RowGroup("Figs 17 and 18: behind a person", text, tuple(rows))


def _rows(followed: list[Followed], where: str, rng: np.random.Generator) -> list[PaperRow]:
    arrived = sum(each.arrived for each in followed)
    share, interval = share_interval(arrived, len(followed))
    rows = [
        PaperRow(
            f"{where}: share of walks that come to the person (1)",
            share,
            None,
            *interval,
            note=f"{arrived} of {len(followed)}.",
        )
    ]
    columns = {
        "distance to the person, mean (m)": [each.mean_m for each in followed],
        "largest distance to the person, mean over the walks (m)": [each.most_m for each in followed],
        "least distance to an obstacle, mean over the walks (m)": [each.clear_m for each in followed],
    }
    for called, values in columns.items():
        if np.isfinite(values).all():
            rows.append(_mean_row(f"{where}: {called}", np.array(values), rng))
    return rows


def _mean_row(quantity: str, values: Float, rng: np.random.Generator) -> PaperRow:
    mean, interval = bootstrap_ratio(values, np.ones(len(values)), rng)
    return PaperRow(quantity, mean, None, *interval, note=f"{values.min():.2f} to {values.max():.2f}.")


FULL_WALKS, FAST_WALKS = 40, FEWEST_VALUES


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast takes fewer walks."""
    walks = FAST_WALKS if fast else FULL_WALKS
    measured = measure_all(walks, seed)
    return PaperTable(
        name="following-2",
        title="Cells that A* and incremental A* search behind a person [Following, Table 2]",
        caption=f"A robot follows a person among obstacles on a map of {FOLLOWING_CELLS} by {FOLLOWING_CELLS} cells of "
        f"0.1 m. The figures of the table are lost; its text says that A* visits more than {CLAIMED:g} times the cells "
        "of incremental A*, which is IA* here. Two walks on the site of 5 m, where the person waits behind what stands "
        f"or crosses there, and walks through forests, where the person strolls {AHEAD_M:g} m ahead at "
        f"{SPEED_MPS:g} m/s. All but the map and the site is our choice.",
        sizes=f"{count(walks)} walks in each forest, half as many in each other setting, seed {seed}, "
        f"drawn from seed {HELD_OUT_SEED + seed}.",
        seed=seed,
        fast=fast,
        groups=(
            *(preset_group(preset, measured) for preset in PRESETS),
            setting_group(measured),
            person_group(walks, seed),
        ),
        pictures=_pictures(measured),
        errata=(_waypoint_erratum(measured),),
    )


def _waypoint_erratum(measured: Measured) -> str:
    """Which of the two readings the claim points to."""
    words, sites_above = [], {}
    for preset in (PAPER, PAPER_END):
        on_site = [measured[preset.name, site].row(preset.ia_star).ratio_expanded or 0.0 for site in SITES.values()]
        walks = np.concatenate(
            [measured[preset.name, forest_name(density)].ratios(preset.ia_star) for density in DENSITIES_PER_M2]
        )
        sites_above[preset.ia_star] = sum(ratio > CLAIMED for ratio in on_site)
        above = f"above {CLAIMED:g} in {int((walks > CLAIMED).sum())} of {len(walks)} walks through forests"
        sites = " and ".join(f"{ratio:.1f}" for ratio in on_site)
        words.append(f"{preset.ia_star} has ratios of {sites} on the two sites, and {above}")
    best = max(sites_above, key=sites_above.__getitem__)
    points = f"it points to {best}" if len(set(sites_above.values())) > 1 else "it points to neither"
    return (
        'The waypoint "searched out from the end vertex" may be the cell of least f, or the one that is reached from '
        f"the end while f falls. Each leading its own walks by preset paper, {'; '.join(words)}. The paper claims more "
        f"than {CLAIMED:g} on such sites: {points}."
    )


def _pictures(measured: Measured) -> tuple[TablePicture, ...]:
    lines = {
        f"{name}, {preset.name}, {density:g}/m²": (measured[preset.name, forest_name(density)], name)
        for preset in PRESETS
        for density in DENSITIES_PER_M2
        for name in (preset.ia_star, *RIVALS.get(preset.name, ())[2:])
    }
    sparse = measured[PAPER.name, forest_name(DENSITIES_PER_M2[0])]
    title = f"cells opened: the first walk, {DENSITIES_PER_M2[0]:g} trees/m², preset paper"
    return (
        drawn(
            "ratios",
            "Ratios of cells, A* over IA* and over MT-D* Lite, walk by walk with medians, by both presets in both "
            "forests.",
            "Each dot a walk; bars: the median over the walks and its 95 % interval; trees to a square metre. Each "
            "preset has its own A* below it.",
            [ratio_panel(lines, {}, "Cells of A* over cells of a planner, walk by walk")],
        ),
        drawn(
            "cells",
            "Cells opened in each replan of one walk behind a person, IA* far below A*.",
            "IA* peaks where it has to plan from scratch.",
            [first_run_panel(sparse, title)],
        ),
    )
