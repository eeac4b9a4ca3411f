"""The table planning-ea: EA* of [Planning], Figs 19 to 21, as printed and with charges that add up."""

from __future__ import annotations

from functools import partial

from quadlog.pipelines.tables.clearance_pictures import draw_clearances
from quadlog.pipelines.tables.danger_charges import passage_group, telescoping_group
from quadlog.pipelines.tables.kept_clearance import crossing_group, scene_group
from quadlog.pipelines.tables.planner_walks import HELD_OUT_SEED, HONEST, PAPER
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import count, render_png

FULL_CROSSINGS, FAST_CROSSINGS = 1000, 100
ERRATA = (
    (
        "Eqs 12 and 13 charge a cell's danger on entering it and give it back on leaving, so along any way the charges "
        "add up to the danger of its last cell less that of its first: they telescope, and a detour is never cheaper. "
        "EA* makes its detours because its heuristic knows nothing of what will be given back, and what is closed "
        "stays closed. The cheapest way by the printed charges is A*'s, as measured. Charges that add up need no such "
        "luck: clearance_astar."
    ),
    (
        "The 0.02 that eq. 13 takes off for a step within a level does not telescope, but lengths in tens and "
        "fourteens differ by 2 or more, so that below 100 steps it only breaks ties."
    ),
    (
        "Eq. 10's min gives the cell three columns and one row from an obstacle the distance 1 and the highest danger. "
        "Rings are meant, at one Chebyshev distance each, and so it is done here."
    ),
    "Around eq. 13, eqs (11) and (12) mean (12) and (13), and what is said to grow linearly by (12) grows by (11).",
)


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed, which draws the starts and goals alone; fast draws a tenth of them."""
    crossings = FAST_CROSSINGS if fast else FULL_CROSSINGS
    return PaperTable(
        name="planning-ea",
        title="Clearance that EA* keeps [Planning, Figs 19 to 21]",
        caption="EA* makes cells near obstacles dear, so that a way keeps off them and narrow passages stay open. How "
        "far off does it keep, with one, two and three rings? `ea_star` as printed, `clearance_astar` with charges "
        "that add up along the way. The square and the passage have the printed sizes; the rest of the scenes is ours. "
        "Presets: `paper` with the printed heuristic, `honest` with one that never overrates the steps.",
        sizes=f"One way per planner and scene, {count(crossings)} ways round the square, seed {seed}, "
        f"drawn from seed {HELD_OUT_SEED + seed}.",
        seed=seed,
        fast=fast,
        groups=(
            scene_group(PAPER),
            scene_group(HONEST),
            crossing_group(crossings, seed),
            passage_group(),
            telescoping_group(),
        ),
        pictures=(_picture(),),
        errata=ERRATA,
    )


def _picture() -> Picture:
    png = render_png(partial(draw_clearances, PAPER))
    assert png is not None
    return Picture(
        "ways",
        "A square, a passage and a complex scene from above, with the ways of A* and of both forms of EA* by one, two "
        "and three rings.",
        "As Figs 19 to 21, preset paper: left as printed, right with charges that add up. A mark is a cell.",
        png,
    )
