"""Rows of the table following-2: cells that A* and IA* search while a robot follows a person."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from quadlog.pipelines.tables.judging import share_interval
from quadlog.pipelines.tables.person_ahead import AHEAD_M, follow_world
from quadlog.pipelines.tables.planner_walks import DENSITIES_PER_M2, HONEST, PAPER, PRESETS, Preset, Spent, spend
from quadlog.results.paper_rows import PaperRow, RowGroup
from quadlog.simulation.planning_scenes import SCENES

CLAIMED = 5.0
"""[Following]: A* traverses more than so many times as many cells. The figures of its Table 2 are lost."""
WHY_NOT = "Round an obstacle a way leads away from its goal, and IA* keeps none of the steps that do."
SITES = {"static-obstacles": "static obstacles", "dynamic-obstacle": "a dynamic obstacle"}
"""Scenes of quadlog.simulation.planning_scenes, and what the table calls them."""
RIVALS = {PAPER.name: ("ia_star",), HONEST.name: ("ia_star", "mt_d_star_lite")}
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
            measured[preset.name, called] = spend([world], preset, RIVALS[preset.name], preset.leader, seed)
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
    return spend(worlds, preset, RIVALS[preset.name], preset.leader, seed, cells_per_replan)


def preset_group(preset: Preset, measured: Measured) -> RowGroup:
    """The claim by one preset, on the site and in the forests."""
    rows: list[PaperRow] = []
    for where in (*SITES.values(), *map(forest_name, DENSITIES_PER_M2)):
        spent = measured[preset.name, where]
        rows += [_ratio_row(spent, name, f"{preset.name}, {where}") for name in RIVALS[preset.name]]
        rows += _cell_rows(spent, f"{preset.name}, {where}")
    text = (
        f"{preset.baseline} against the others, rules {preset.rules}, counting {preset.counted} cells; obstacles grown "
        f"by 3 cells ({preset.dilation}), led by {preset.leader}, one cell a replan. More than {CLAIMED:g} times "
        f"reproduces where the ratio, or its interval, lies above {CLAIMED:g}. Either site is one walk, from which "
        "nothing is drawn. Intervals: bootstrap over the walks, of the median; shares of walks after Wilson."
    )
    return RowGroup(f"Table 2, preset {preset.name}", text, tuple(rows))


def _ratio_row(spent: Spent, planner: str, where: str) -> PaperRow:
    """Only A* over IA* is claimed."""
    row, ratios = spent.row(planner), spent.ratios(planner)
    assert row.ratio_expanded is not None
    is_drawn = len(ratios) > 1
    low, high = (row.ratio_low, row.ratio_high) if is_drawn else (None, None)
    quantity = f"{where}: {'median ' if is_drawn else ''}ratio {spent.comparison.baseline}/{planner} (1)"
    note = f"{ratios.min():.1f} to {ratios.max():.1f} in {len(ratios)} walks." if is_drawn else ""
    if planner != "ia_star":
        return PaperRow(quantity, row.ratio_expanded, None, low, high, note=note)
    reproduces = max(row.ratio_expanded, high or 0.0) > CLAIMED
    if reproduces and min(row.ratio_expanded, CLAIMED if low is None else low) < CLAIMED:
        note = f"{note} The interval holds less than {CLAIMED:g} as well."
    if not reproduces:
        note = f"{note} {WHY_NOT}"
    claim = f"Claimed: more than {CLAIMED:g}."
    return PaperRow(quantity, row.ratio_expanded, CLAIMED, low, high, reproduces, " ".join([claim, *note.split()]))


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
            row, ratios = spent.row("ia_star"), spent.ratios("ia_star")
            assert row.ratio_expanded is not None
            quantity = f"{preset.name}, {called}: median ratio A*/IA* (1)"
            note = f"{ratios.min():.1f} to {ratios.max():.1f} in {len(ratios)} walks."
            rows.append(PaperRow(quantity, row.ratio_expanded, None, row.ratio_low, row.ratio_high, note=note))
    text = (
        f"The walks through {usual}, the first half of them where a setting differs. The farther the person is ahead, "
        "the more A* searches, while IA* goes on from the end of its old path; the more the robot walks between "
        "replans, the more there is to go on with. Neither is printed. Intervals: bootstrap over the walks."
    )
    return RowGroup("What the ratio hangs on", text, tuple(rows))
