"""The table planning-1: [Planning]'s Table 1, lengths and times of the ways that A* and IA* lead."""

from __future__ import annotations

from functools import partial

from quadlog.pipelines.tables.planner_walks import DENSITIES_PER_M2, HELD_OUT_SEED, PAPER, PRESETS
from quadlog.pipelines.tables.printed_planning import LENGTH_M, LENGTH_RUNS, TIME_S
from quadlog.pipelines.tables.route_lengths import Pairs, length_group, walk_all
from quadlog.pipelines.tables.route_pictures import SHOWN, draw_routes
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import count, render_png

FULL_WALKS, FAST_WALKS = 40, LENGTH_RUNS


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast walks as often as the paper and no more."""
    walks = FAST_WALKS if fast else FULL_WALKS
    pairs = walk_all(walks, seed)
    groups = tuple(length_group(preset, pairs, seed) for preset in PRESETS)
    return PaperTable(
        name="planning-1",
        title="Lengths and times of the ways of A* and IA* [Planning, Table 1]",
        caption="Two robots walk through the same forest to the same goal, one led by A*, one by IA*. Who walks "
        "farther, and who longer? The paper prints ten pairs of walks of a simulated quadruped in a forest of its own. "
        "Ours stand at random, 0.1 or 0.2 trees to a square metre, with goals 15 to 25 m away, and a kinematic robot "
        "walks.",
        sizes=f"{count(walks)} walks of each planner through each forest and preset, seed {seed}, drawn from seed "
        f"{HELD_OUT_SEED + seed}; the first "
        f"{LENGTH_RUNS} stand beside the printed {LENGTH_RUNS}.",
        seed=seed,
        fast=fast,
        groups=groups,
        pictures=(_picture(pairs, seed),),
        errata=(_length_erratum(pairs), _time_erratum()),
    )


def _time_erratum() -> str:
    speed_mps = LENGTH_M / TIME_S
    return (
        f"The times cannot be measured again: the printed lengths and times make {speed_mps.min():.2f} to "
        f"{speed_mps.max():.2f} m/s, which the paper puts down to turning, but neither the robot's gait nor how it is "
        "steered is published. Ours walks at an even speed, so its times are its lengths; how much it turns is given "
        "instead."
    )


def _length_erratum(pairs: Pairs) -> str:
    words = []
    for preset in PRESETS:
        every = [pair for density in DENSITIES_PER_M2 for pair in pairs[preset.name, density] if pair.arrived]
        pursued = sum(pair.pursued[1].length_m < pair.pursued[0].length_m for pair in every)
        on_grid = sum(pair.grid_m[1] < pair.grid_m[0] for pair in every)
        words.append(f"{pursued} of {len(every)} walks, cell by cell in {on_grid} (preset {preset.name})")
    return (
        "That IA* leads a shorter way holds for what is walked, not for what is planned: no plan is shorter than that "
        "of an A* with a heuristic that is no larger than the way. On the grid it leads a longer way as a rule; once "
        "its path is smoothed and followed, a shorter one. As walked, IA* is shorter in "
        f"{'; in '.join(words)}."
    )


def _picture(pairs: Pairs, seed: int) -> Picture:
    density = DENSITIES_PER_M2[-1]
    png = render_png(partial(draw_routes, pairs[PAPER.name, density], PAPER, density, seed))
    assert png is not None
    return Picture(
        "routes",
        f"{SHOWN} walks through a forest: the way that A* led and the one that IA* led, beside the straight line.",
        f"As Figs 16 and 17: the first {SHOWN} walks of preset paper among {density:g} trees/m², as walked. Up and "
        "down is enlarged.",
        png,
    )
