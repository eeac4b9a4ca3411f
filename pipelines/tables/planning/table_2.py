"""The table planning-2: cells that A* and IA* search on nine walks, by presets, leaders and counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.pipelines.tables.intervals import (
    bootstrap_statistic,
    compare,
    compare_samples,
    not_comparable,
    share_interval,
)
from quadlog.pipelines.tables.pictures import drawn
from quadlog.pipelines.tables.planning.planner_walks import (
    CELL_RATIO,
    CELL_RUNS,
    CELLS,
    DENSITIES_PER_M2,
    HELD_OUT_SEED,
    HONEST,
    PAPER,
    PAPER_END,
    PRESETS,
    PRINTED_RATIO,
    READINGS,
    Preset,
    Spent,
    extreme_row,
    first_run_panel,
    forest_of,
    ratio_panel,
    spend,
)
from quadlog.planning.rules import TIES
from quadlog.results.numbers import count
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, TablePicture, Verdict

CLAIMED = 5.0
"""[Planning] says that IA* is more than so many times as efficient."""
COUNTED = ("generated", "expanded", "touched")
_ONCE = {"generated": "it has been opened", "expanded": "it has been closed"}
LEADERS = ("astar", "ia_star", "ia_star_end")
READERS = ("ia_star", "ia_star_end")
RIVALS = {HONEST.name: (*READERS, "mt_d_star_lite")}
"""Beside the baseline; by the other presets both readings of IA*."""
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
    return spend(forests, preset, RIVALS.get(preset.name, READERS), leader, seed)


def preset_group(preset: Preset, measured: Measured, seed: int) -> RowGroup:
    """Table 2 by one preset, in both forests."""
    rows: list[PaperRow] = []
    for density in DENSITIES_PER_M2:
        spent = measured[preset.name, density, preset.leader]
        where = f"{preset.name}, {density:g} trees/m²"
        rows += _ratio_rows(spent, where, preset.ia_star, seed)
        rows += _cell_rows(spent, where, preset, seed)
        rivals = RIVALS.get(preset.name, READERS)
        rows += [_median_row(spent, name, where) for name in rivals if name != preset.ia_star]
        rows += _quality_rows(spent, where, preset.leader)
    text = (
        f"{preset.baseline} against {preset.ia_star}, where {READINGS[preset.ia_star]}, by the rules: {preset.rules}; "
        f"a cell counts once {_ONCE[preset.counted]}; obstacles grown by 3 cells ({preset.dilation}). {preset.leader} "
        "leads the walk, one cell a replan, and all planners answer the same questions. The scatter of the printed "
        "nine runs counts as well as that of ours. A walk that does not arrive is no run. Intervals: bootstrap over "
        "all runs; shares after Wilson."
    )
    return RowGroup(f"Table 2, preset {preset.name}", text, tuple(rows))


def _ratio_rows(spent: Spent, where: str, planner: str, seed: int) -> list[PaperRow]:
    ratios = spent.ratios(planner)
    smallest, largest = (
        extreme_row(f"{where}: {name} ratio A*/IA* of nine runs (1)", CELL_RATIO, ratios, small, CLAIMED, _rng(seed))
        for name, small in (("smallest", True), ("largest", False))
    )
    spread = f"{ratios.min():.2f} to {ratios.max():.2f} in {len(ratios)} runs."
    median = compare_samples(
        f"{where}: median ratio A*/IA* (1)", CELL_RATIO, ratios, np.median, _rng(seed), CLAIMED, spread
    )
    above = int((ratios > CLAIMED).sum())
    share, interval = share_interval(above, len(ratios))
    quantity = f"{where}: share of runs with a ratio above {CLAIMED:g} (1)"
    note = f"{above} of {len(ratios)} runs. Claimed of all."
    paper = float(np.mean(CELL_RATIO > CLAIMED))
    return [smallest, median, largest, compare(quantity, paper, 0.01, share, interval, note)]


def _cell_rows(spent: Spent, where: str, preset: Preset, seed: int) -> list[PaperRow]:
    rows = []
    for name, planner, printed in zip(("A*", "IA*"), (preset.baseline, preset.ia_star), CELLS, strict=True):
        ours, interval = bootstrap_statistic(spent.cells(planner), np.mean, _rng(seed))
        quantity = f"{where}: cells of {name} a run, mean (1)"
        why = f"{spent.replans:.0f} replans a run; the paper does not say how many it has, nor how long its runs are."
        rows.append(not_comparable(quantity, float(printed.mean()), ours, interval, why))
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


def reading_group(measured: Measured, seed: int) -> RowGroup:
    """What either reading of IA*'s waypoint gives, each leading its own walks, and to which the print points."""
    rows: list[PaperRow] = []
    for density in DENSITIES_PER_M2:
        for preset in (PAPER, PAPER_END):
            spent, where = (
                measured[preset.name, density, preset.leader],
                f"{density:g} trees/m², {preset.ia_star} leads",
            )
            ratios, row = spent.ratios(preset.ia_star), spent.row(preset.ia_star)
            assert row.suboptimality_mean is not None
            rows += [
                PaperRow(
                    f"{where}: least ratio (1)", float(ratios.min()), note=f"The paper's is {CELL_RATIO.min():.2f}."
                ),
                PaperRow(f"{where}: mean excess cost (1)", round(row.suboptimality_mean, 9)),
            ]
    text = (
        'The paper has the waypoint "searched out from the end vertex". Either planner takes it at its word in its own '
        f"way: in ia_star {READINGS['ia_star']}; in ia_star_end {READINGS['ia_star_end']}, so that it keeps detours "
        "that lead away from the goal. What follows has the figures of the table by both. Rows here: of all runs, "
        f"preset paper. {pointing(measured, seed)}"
    )
    return RowGroup("Which waypoint", text, tuple(rows))


def pointing(measured: Measured, seed: int) -> str:
    """To which reading the paper's numbers point, in words."""
    words: list[str] = []
    reproduced: dict[str, int] = {}
    for preset in (PAPER, PAPER_END):
        spent = [measured[preset.name, density, preset.leader] for density in DENSITIES_PER_M2]
        judged = [row for each in spent for row in _ratio_rows(each, "", preset.ia_star, seed)]
        reproduced[preset.ia_star] = sum(row.reproduces is Verdict.YES for row in judged)
        ratios = np.concatenate([each.ratios(preset.ia_star) for each in spent])
        words.append(
            f"by {preset.ia_star} {reproduced[preset.ia_star]} of the {len(judged)} figures of ratios below reproduce, "
            f"and {int((ratios > CLAIMED).sum())} of {len(ratios)} runs have a ratio above {CLAIMED:g}"
        )
    best = max(reproduced, key=reproduced.__getitem__)
    settled = f"points to {best}" if len(set(reproduced.values())) > 1 else "does not settle it"
    return f"{'; '.join(words)[0].upper()}{'; '.join(words)[1:]}. The print {settled}."


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


FULL_EPISODES, FAST_EPISODES = 40, CELL_RUNS


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast walks as often as the paper and no more."""
    episodes = FAST_EPISODES if fast else FULL_EPISODES
    measured = measure_all(episodes, seed)
    return PaperTable(
        name="planning-2",
        title="Cells that A* and IA* search [Planning, Table 2]",
        caption="A robot walks through a forest towards a goal 15 to 25 m away, sees a window of 40 by 40 cells of "
        "0.1 m and replans after every cell. How many cells does each planner search? The paper prints nine runs in a "
        "forest of its own. Its trees, its ties and what it counts are not printed: ours stand at random, 0.1 or 0.2 "
        "to a square metre. Preset `paper` takes the printed heuristic, preset `honest` an A* that spends as little as "
        "it can.",
        sizes=f"{count(episodes)} walks through each forest by each leader and rule, seed {seed}, drawn from seed "
        f"{HELD_OUT_SEED + seed}.",
        seed=seed,
        fast=fast,
        groups=(
            reading_group(measured, seed),
            *(preset_group(preset, measured, seed) for preset in PRESETS),
            leader_group(measured),
            counting_group(measured, seed),
        ),
        pictures=_pictures(measured),
        errata=(_floor_erratum(measured), _rounding_erratum()),
    )


def _floor_erratum(measured: Measured) -> str:
    spent = measured[PAPER.name, DENSITIES_PER_M2[0], PAPER.leader]
    by_count = [spent.counting(counted, 0).row("ia_star").ratio_expanded for counted in COUNTED]
    counts = ", ".join(f"{ratio:.1f} for {counted}" for ratio, counted in zip(by_count, COUNTED, strict=True))
    lows = [measured[PAPER.name, density, PAPER.leader].ratios("ia_star").min() for density in DENSITIES_PER_M2]
    sparse, dense = (f"{low:.2f} at {density:g} trees/m²" for low, density in zip(lows, DENSITIES_PER_M2, strict=True))
    return (
        "What searched counts, and how ties are broken, is not stated; nor are the trees. What is counted makes the "
        f"median ratio {counts} cells at {DENSITIES_PER_M2[0]:g} trees/m²; with this heuristic ties change next to "
        f"nothing. The printed runs all have {CELL_RATIO.min():.2f} or more. The least of ours by the same heuristic, "
        f"counting opened cells, is {sparse} and {dense}, where trees block the old route more often."
    )


def _rounding_erratum() -> str:
    cut = [
        f"{exact:.2f}, not {printed:g}, in run {run}"
        for run, (exact, printed) in enumerate(zip(CELL_RATIO, PRINTED_RATIO, strict=True), start=1)
        if round(exact, 2) != printed
    ]
    return f"Some printed ratios are cut off instead of rounded. The printed totals give {'; '.join(cut)}."


def _pictures(measured: Measured) -> tuple[TablePicture, ...]:
    lines = {
        f"{name}, {preset.name}, {density:g}/m²": (measured[preset.name, density, preset.leader], name)
        for preset in PRESETS
        for density in DENSITIES_PER_M2
        for name in (preset.ia_star, *RIVALS.get(preset.name, ())[2:])
    }
    printed = {"ia_star, as printed": CELL_RATIO}
    sparse = measured[PAPER.name, DENSITIES_PER_M2[0], PAPER.leader]
    title = f"cells opened: the first run, {DENSITIES_PER_M2[0]:g} trees/m², preset paper"
    return (
        drawn(
            "ratios",
            "Ratios of cells, A* over IA* and over MT-D* Lite, run by run with medians: as printed, and by both "
            "presets in both forests.",
            "Each dot a run; bars: the median over the runs and its 95 % interval; trees to a square metre. Each "
            "preset has its own A* below it.",
            [ratio_panel(lines, printed, "Cells of A* over cells of a planner, run by run")],
        ),
        drawn(
            "cells",
            "Cells opened in each replan of one walk, IA* far below A*.",
            "As Fig. 18: IA* peaks where it has to plan from scratch.",
            [first_run_panel(sparse, title)],
        ),
    )
