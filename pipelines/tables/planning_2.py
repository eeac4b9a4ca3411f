"""The table planning-2: [Planning]'s Table 2, the cells that A* and IA* search on the same walks."""

from __future__ import annotations

from functools import partial

from quadlog.pipelines.tables.planner_pictures import draw_all_ratios, draw_first_run
from quadlog.pipelines.tables.planner_walks import DENSITIES_PER_M2, HELD_OUT_SEED, HONEST, PAPER
from quadlog.pipelines.tables.printed_planning import CELL_RATIO, CELL_RUNS, PRINTED_RATIO
from quadlog.pipelines.tables.searched_cells import (
    COUNTED,
    RIVALS,
    Measured,
    counting_group,
    leader_group,
    measure_all,
    preset_group,
)
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import count, render_png

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
        f"{HELD_OUT_SEED + seed}; the first "
        f"{CELL_RUNS} stand beside the printed {CELL_RUNS}.",
        seed=seed,
        fast=fast,
        groups=(
            preset_group(PAPER, measured, seed),
            preset_group(HONEST, measured, seed),
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


def _pictures(measured: Measured) -> tuple[Picture, ...]:
    lines = {
        f"{name}, {preset.name}, {density:g}/m²": (measured[preset.name, density, preset.leader], name)
        for preset in (PAPER, HONEST)
        for density in DENSITIES_PER_M2
        for name in RIVALS[preset.name]
    }
    printed = {"ia_star, as printed": CELL_RATIO}
    sparse = measured[PAPER.name, DENSITIES_PER_M2[0], PAPER.leader]
    ratios = render_png(partial(draw_all_ratios, lines, printed, "Cells of A* over cells of a planner, run by run"))
    title = f"The first run, {DENSITIES_PER_M2[0]:g} trees/m², preset paper"
    first = render_png(partial(draw_first_run, sparse, title))
    assert ratios is not None
    assert first is not None
    return (
        Picture(
            "ratios",
            "Ratios of cells, A* over IA* and over MT-D* Lite, run by run with medians: as printed, and by both "
            "presets in both forests.",
            "Each dot a run; bars: the median over the runs and its 95 % interval; trees to a square metre. Each "
            "preset has its own A* below it.",
            ratios,
        ),
        Picture(
            "cells",
            "Cells opened in each replan of one walk, A* in grey, IA* in blue and far below it.",
            "As Fig. 18: IA* peaks where it has to plan from scratch.",
            first,
        ),
    )
