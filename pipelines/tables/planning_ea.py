"""planning-ea: how far from an obstacle EA* stays, by how many rings [Planning, Fig. 19]."""

from __future__ import annotations

from scipy import ndimage

from quadlog.pipelines.tables.claims import Change, Claim, Figures, Group, Study, StudyTable, grid
from quadlog.pipelines.tables.judge import EXACT, beyond, rests
from quadlog.pipelines.tables.planning_2 import FAST_PRESETS, PRESETS
from quadlog.planning.planners.ea_star import EAStar
from quadlog.planning.protocol import Bool, Cells, Planner
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds.scenes import SCENES

RINGS = (0, 1, 2, 3)
"""Of danger round each obstacle; without any it is A*."""


def plan_once(preset: str, rings: int) -> Figures:
    """Clearance of the way over the whole of the scene."""
    of, world = PRESETS[preset], SCENES["single-obstacle"]()
    planner: Planner = EAStar(of.rules, rings=rings) if rings else make_planner(of.baseline, of.rules)
    (col, row), (to_col, to_row) = (
        world.window.cell_of(place_m).tolist() for place_m in (world.start_xy_m, world.goal.at(0))
    )
    plan = planner.plan(world.occupied, (col, row), (to_col, to_row))
    return {"clearance_cells": float(clearance_cells(world.occupied, plan.cells))}


def clearance_cells(occupied: Bool, cells: Cells) -> int:
    """The least Chebyshev distance of a path (L, 2) from an obstacle: 1 where it passes beside one."""
    away = ndimage.distance_transform_cdt(~occupied, metric="chessboard")
    return int(away[cells[:, 1], cells[:, 0]].min())


BY_RINGS = rests(beyond(0.0), "By construction: rings make cells dear whose distance is that of a ring.")


def claimed_rows(preset: str) -> list[Claim]:
    """The claim on the square: the distance increases with every ring."""
    where = {"preset": preset}
    return [
        Change(
            f"{preset}, square of 1.6 m: clearance, n = {n} less n = {n - 1} (cells)",
            "clearance_cells",
            where,
            BY_RINGS,
            EXACT,
            of=f"clearance with {n} rings",
            part={"rings": n},
            whole={"rings": n - 1},
            pair=("preset",),
        )
        for n in RINGS[1:]
    ]


def table(fast: bool, seed: int) -> StudyTable:
    """The same for every seed, and with fast."""
    del fast, seed
    return StudyTable(
        title="Clearance that EA* keeps [Planning, Fig. 19]",
        caption="EA* makes cells near obstacles dear, so that a way keeps off them and narrow passages stay open. How "
        "far off does it keep, with one, two and three rings? n = 0 is A*. The square has the printed size. Presets: "
        "`paper` with the printed heuristic, `honest` with one that never overrates steps.",
        sizes="One way per planner; nothing is drawn, and no seed changes it.",
        study=Study(plan_once, grid(preset=FAST_PRESETS, rings=RINGS)),
        groups=[
            Group(
                "Fig. 19: claims",
                "The paper prints pictures, and says of the square, as its obstacle is extended by 1, 2 and 3 cells, "
                "that the distance between robot and obstacle increases. Ours: rows or columns to the nearest obstacle "
                "cell, whichever is more, over the whole scene; obstacles are not grown.",
                [row for preset in FAST_PRESETS for row in claimed_rows(preset)],
            ),
        ],
    )
