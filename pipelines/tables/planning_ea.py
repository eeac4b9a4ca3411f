"""planning-ea: how far from obstacles EA* stays, by how many rings, and what that costs [Planning, Figs 19-21]."""

from __future__ import annotations

from scipy import ndimage

from quadlog.pipelines.tables.claims import Change, Claim, Group, Table
from quadlog.pipelines.tables.judge import EXACT, beyond, rests
from quadlog.pipelines.tables.searches import PRESETS
from quadlog.pipelines.tables.study import Figures, Study, grid
from quadlog.planning.path import turning
from quadlog.planning.planners.ea_star import ClearanceAStar, EAStar
from quadlog.planning.protocol import Bool, Cells, Planner
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds.scenes import SCENES
from quadlog.simulation.worlds.world import CELL_M

RINGS = (0, 1, 2, 3)
"""Of danger round each obstacle; without any it is A*."""
SHOWN = {
    "single-obstacle": "Fig. 19, square of 1.6 m",
    "passage": "Fig. 20, passage of 1.5 m",
    "complex": "Fig. 21, complex scene",
}
FORMS: dict[str, type[EAStar] | type[ClearanceAStar]] = {"ea_star": EAStar, "clearance_astar": ClearanceAStar}
USED = ("paper", "honest")


def plan_once(preset: str, scene: str, form: str, rings: int) -> Figures:
    """Clearance and length of the way over the whole of a scene."""
    of, world = PRESETS[preset], SCENES[scene]()
    planner: Planner = FORMS[form](of.rules, rings=rings) if rings else make_planner(of.baseline, of.rules)
    (col, row), (to_col, to_row) = (
        world.window.cell_of(place_m).tolist() for place_m in (world.start_xy_m, world.goal.at(0))
    )
    plan = planner.plan(world.occupied, (col, row), (to_col, to_row))
    length_m, turn_rad = turning(plan.cells * CELL_M)
    cells = float(clearance_cells(world.occupied, plan.cells))
    return {"clearance_cells": cells, "length_m": round(length_m, 9), "turn_rad": round(turn_rad, 9)}


def clearance_cells(occupied: Bool, cells: Cells) -> int:
    """The least Chebyshev distance of a path (L, 2) from an obstacle: 1 where it passes beside one."""
    away = ndimage.distance_transform_cdt(~occupied, metric="chessboard")
    return int(away[cells[:, 1], cells[:, 0]].min())


BY_RINGS = rests(beyond(0.0), "By construction: rings make cells dear whose distance is that of a ring.")


def claimed_rows(preset: str) -> list[Claim]:
    """The claim on the square: the distance increases with every ring."""
    where = {"preset": preset, "scene": "single-obstacle", "form": "ea_star"}
    return [
        Change(
            f"{preset}, square of 1.6 m: clearance, ea_star, n = {n} less n = {n - 1} (cells)",
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


def table(fast: bool, seed: int) -> Table:
    """The same for every seed, and with fast."""
    del fast, seed
    columns = {"clearance_cells": "clearance (cells)", "length_m": "length (m)", "turn_rad": "turning (rad)"}
    return Table(
        title="Clearance that EA* keeps [Planning, Figs 19 to 21]",
        caption="EA* makes cells near obstacles dear, so that a way keeps off them and narrow passages stay open. How "
        "far off does it keep, with one, two and three rings? `ea_star` as printed, `clearance_astar` with charges "
        "that add up along the way; n = 0 is A*. The square and the passage have the printed sizes; the rest of the "
        "scenes is ours. Presets: `paper` with the printed heuristic, `honest` with one that never overrates steps.",
        sizes="One way per planner and scene; nothing is drawn, and no seed changes it.",
        study=Study(plan_once, grid(preset=USED, scene=SHOWN, form=FORMS, rings=RINGS)),
        groups=[
            Group(
                "Fig. 19: claims",
                "The paper prints pictures, and says of the square, as its obstacle is extended by 1, 2 and 3 cells, "
                "that the distance between robot and obstacle increases.",
                [row for preset in USED for row in claimed_rows(preset)],
            ),
            Group(
                "Figs 19 to 21 in numbers",
                "Each planner plans once over the whole scene; obstacles are not grown. Clearance: rows or columns to "
                "the nearest obstacle cell, whichever is more, so that 1 is beside it.",
                [
                    Claim(
                        f"{preset}, {called}: {form}, n = {rings}, {what}",
                        column,
                        {"preset": preset, "scene": scene, "form": form, "rings": rings},
                        statistic=EXACT,
                    )
                    for preset in USED
                    for scene, called in SHOWN.items()
                    for form in FORMS
                    for rings in RINGS
                    for column, what in columns.items()
                ],
            ),
        ],
    )
