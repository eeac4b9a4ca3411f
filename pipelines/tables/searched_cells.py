"""Rows of the table planning-2: cells that A* and IA* search on nine walks, by presets, leaders and counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.pipelines.tables.judging import compare, share_interval
from quadlog.pipelines.tables.planner_walks import (
    DENSITIES_PER_M2,
    HELD_OUT_SEED,
    HONEST,
    PAPER,
    PRESETS,
    Preset,
    Spent,
    forest_of,
    of_printed_runs,
    spend,
)
from quadlog.pipelines.tables.printed_planning import CELL_RATIO, CELL_RUNS, CELLS
from quadlog.planning.rules import TIES
from quadlog.results.paper_rows import PaperRow, RowGroup

CLAIMED = 5.0
"""[Planning] says that IA* is more than so many times as efficient."""
COUNTED = ("generated", "expanded", "touched")
_ONCE = {"generated": "it has been opened", "expanded": "it has been closed"}
EXTREMES: dict[str, Callable[..., Any]] = {"smallest": np.min, "median": np.median, "largest": np.max}
LEADERS = ("astar", "ia_star")
RIVALS = {PAPER.name: ("ia_star",), HONEST.name: ("ia_star", "mt_d_star_lite")}
OTHER_TIES = replace(PAPER, name="paper, ties to the smaller g", rules=replace(PAPER.rules, ties="smaller_g"))

Measured = dict[tuple[str, float, str], Spent]
"""By preset, trees per m² and who led."""


def measure_all(episodes: int, seed: int) -> Measured:
    """Every walk that the table rests on."""
    asked = [(preset, preset.leader) for preset in (*PRESETS, OTHER_TIES)]
    asked += [(HONEST, leader) for leader in LEADERS if leader != HONEST.leader]
    return {
        (preset.name, density, leader): _measure(preset, density, leader, episodes, seed)
        for preset, leader in asked
        for density in DENSITIES_PER_M2
    }


def _measure(preset: Preset, density: float, leader: str, episodes: int, seed: int) -> Spent:
    forests = [forest_of(density, number, preset, seed) for number in range(episodes)]
    return spend(forests, preset, RIVALS.get(preset.name, RIVALS[PAPER.name]), leader, seed)


def preset_group(preset: Preset, measured: Measured, seed: int) -> RowGroup:
    """Table 2 by one preset, in both forests."""
    rows: list[PaperRow] = []
    for density in DENSITIES_PER_M2:
        spent = measured[preset.name, density, preset.leader]
        where = f"{preset.name}, {density:g} trees/m²"
        rows += _ratio_rows(spent, where, seed)
        rows += _cell_rows(spent, where, preset is PAPER, seed)
        rows += [_median_row(spent, name, where) for name in RIVALS[preset.name] if name != "ia_star"]
        rows += _quality_rows(spent, where, preset.leader)
    text = (
        f"{preset.baseline} against ia_star by the rules: {preset.rules}; a cell counts once {_ONCE[preset.counted]}"
        f"; obstacles grown by 3 cells ({preset.dilation}). {preset.leader} leads the walk, one cell a replan, and all "
        "planners answer the same questions. Figures of nine runs: ours are the first nine, and the interval is where "
        f"95 % of the tables of nine drawn from all our runs have that figure. A walk that does not arrive is no run. "
        "Other intervals: bootstrap over the runs; shares of walks after Wilson."
    )
    return RowGroup(f"Table 2, preset {preset.name}", text, tuple(rows))


def _ratio_rows(spent: Spent, where: str, seed: int) -> list[PaperRow]:
    ratios = spent.ratios("ia_star")
    rows = []
    for name, statistic in EXTREMES.items():
        ours, interval = of_printed_runs(ratios, CELL_RUNS, statistic, _rng(seed))
        note = "The printed totals give it; printed as 5.5." if name == "smallest" else ""
        why_not = f"Of all {len(ratios)} runs: {ratios.min():.2f} to {ratios.max():.2f}."
        quantity = f"{where}: {name} ratio A*/IA* of nine runs (1)"
        rows.append(compare(quantity, float(statistic(CELL_RATIO)), 0.01, ours, interval, note, why_not))
    above = (ratios > CLAIMED).astype(np.float64)
    ours, interval = of_printed_runs(above, CELL_RUNS, np.mean, _rng(seed))
    note = f"{int(above.sum())} of all {len(above)} runs."
    quantity = f"{where}: share of nine runs with a ratio above {CLAIMED:g} (1)"
    rows.append(compare(quantity, float(np.mean(CELL_RATIO > CLAIMED)), 0.01, ours, interval, note))
    return rows


def _cell_rows(spent: Spent, where: str, is_judged: bool, seed: int) -> list[PaperRow]:
    rows = []
    for name, planner, printed in zip(("A*", "IA*"), (spent.comparison.baseline, "ia_star"), CELLS, strict=True):
        ours, interval = of_printed_runs(spent.cells(planner), CELL_RUNS, np.mean, _rng(seed))
        quantity = f"{where}: cells of {name} a run, mean of nine (1)"
        note = f"{spent.replans:.0f} replans a run."
        paper = float(printed.mean())
        if is_judged:
            why = f"The paper prints {paper / ours:.1f} times as many, and not how often it replans in a run."
            rows.append(compare(quantity, paper, 1.0, ours, interval, note, why))
        else:
            rows.append(PaperRow(quantity, ours, None, *interval, note=note))
    return rows


def _quality_rows(spent: Spent, where: str, leader: str) -> list[PaperRow]:
    share, interval = share_interval(spent.arrived, spent.walks)
    note = f"{spent.arrived} of {spent.walks}, led by {leader}."
    if spent.left_out:
        note += f" Ratios A*/IA* of those left out: {', '.join(f'{ratio:.2f}' for ratio in spent.left_out)}."
    rows = [PaperRow(f"{where}: share of walks that arrive (1)", share, None, *interval, note=note)]
    for row in spent.comparison.rows:
        if row.fallback_share is not None:
            rows.append(PaperRow(f"{where}: replans from scratch, {row.planner} (1)", row.fallback_share))
        if row.suboptimality_mean is not None:
            quantity = f"{where}: mean excess cost of a plan, {row.planner} (1)"
            rows.append(PaperRow(quantity, round(row.suboptimality_mean, 9)))
    return rows


def leader_group(measured: Measured) -> RowGroup:
    """The honest ratios by whose plans are walked."""
    rows = [
        _median_row(measured[HONEST.name, density, leader], name, f"{density:g} trees/m², led by {leader}")
        for density in DENSITIES_PER_M2
        for leader in LEADERS
        for name in RIVALS[HONEST.name]
    ]
    text = (
        "Whose plans are walked decides what is asked next. A* changes its mind between ways of one length, and "
        "MT-D* Lite with it, so that a robot led by either seldom leaves the tree that MT-D* Lite keeps; led by IA* it "
        "leaves it, and MT-D* Lite begins from scratch. Preset honest, medians over the runs. Intervals: bootstrap "
        "over the runs."
    )
    return RowGroup("Who leads", text, tuple(rows))


def counting_group(measured: Measured, seed: int) -> RowGroup:
    """The printed setting by what the paper leaves open."""
    rows = []
    for density in DENSITIES_PER_M2:
        for preset, ties in zip((PAPER, OTHER_TIES), TIES, strict=True):
            spent = measured[preset.name, density, preset.leader]
            for counted in COUNTED:
                where = f"{density:g} trees/m², ties to the {ties.replace('_', ' ')}, {counted} cells"
                rows.append(_median_row(spent.counting(counted, seed), "ia_star", where))
    text = (
        "Preset paper by what is called searched, and by which of two cells with the same f is taken first: opened "
        "(generated), closed (expanded), or every neighbour test (touched). Medians over the runs; the printed nine "
        f"have {np.median(CELL_RATIO):.2f}. Intervals: bootstrap over the runs."
    )
    return RowGroup("What the paper leaves open", text, tuple(rows))


def _median_row(spent: Spent, planner: str, where: str) -> PaperRow:
    row, ratios = spent.row(planner), spent.ratios(planner)
    assert row.ratio_expanded is not None
    note = f"{ratios.min():.2f} to {ratios.max():.2f} in {len(ratios)} runs"
    if row.fallback_share is not None:
        note += f", {100 * row.fallback_share:.0f} % of the replans from scratch"
    quantity = f"{where}: median ratio {spent.comparison.baseline}/{planner} (1)"
    return PaperRow(quantity, row.ratio_expanded, None, row.ratio_low, row.ratio_high, note=f"{note}.")


def _rng(seed: int) -> np.random.Generator:
    """The same draws for every row."""
    return np.random.default_rng([HELD_OUT_SEED + seed, CELL_RUNS, *b"runs"])
