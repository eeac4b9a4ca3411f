"""The table following-2: [Following]'s Table 2, the cells that A* and incremental A* visit behind a person."""

from __future__ import annotations

from functools import partial

from quadlog.pipelines.tables.followed_cells import (
    CLAIMED,
    RIVALS,
    Measured,
    forest_name,
    measure_all,
    preset_group,
    setting_group,
)
from quadlog.pipelines.tables.followed_person import person_group
from quadlog.pipelines.tables.person_ahead import AHEAD_M, SPEED_MPS
from quadlog.pipelines.tables.planner_pictures import draw_all_ratios, draw_first_run
from quadlog.pipelines.tables.planner_walks import DENSITIES_PER_M2, HELD_OUT_SEED, PAPER, PRESETS
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import count, render_png
from quadlog.simulation.planning_scenes import FOLLOWING_CELLS

FULL_WALKS, FAST_WALKS = 40, 3


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
    )


def _pictures(measured: Measured) -> tuple[Picture, ...]:
    lines = {
        f"{name}, {preset.name}, {density:g}/m²": (measured[preset.name, forest_name(density)], name)
        for preset in PRESETS
        for density in DENSITIES_PER_M2
        for name in RIVALS[preset.name]
    }
    ratios = render_png(partial(draw_all_ratios, lines, {}, "Cells of A* over cells of a planner, walk by walk"))
    sparse = measured[PAPER.name, forest_name(DENSITIES_PER_M2[0])]
    title = f"The first walk, {DENSITIES_PER_M2[0]:g} trees/m², preset paper"
    first = render_png(partial(draw_first_run, sparse, title))
    assert ratios is not None
    assert first is not None
    return (
        Picture(
            "ratios",
            "Ratios of cells, A* over IA* and over MT-D* Lite, walk by walk with medians, by both presets in both "
            "forests.",
            "Each dot a walk; bars: the median over the walks and its 95 % interval; trees to a square metre. Each "
            "preset has its own A* below it.",
            ratios,
        ),
        Picture(
            "cells",
            "Cells opened in each replan of one walk behind a person, A* in grey, IA* in blue and far below it.",
            "IA* peaks where it has to plan from scratch.",
            first,
        ),
    )
