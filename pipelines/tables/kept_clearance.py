"""Rows of the table planning-ea: how far from obstacles EA* stays, by how many rings, and what that costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from quadlog.pipelines.tables.judging import compare, share_interval
from quadlog.pipelines.tables.planner_walks import HELD_OUT_SEED, PRESETS, Preset
from quadlog.planning.clearance_astar import ClearanceAStar
from quadlog.planning.ea_star import EAStar
from quadlog.planning.polyline import turning
from quadlog.planning.protocol import Bool, Cell, Cells, Planner
from quadlog.planning.registry import make_planner
from quadlog.results.paper_rows import PaperRow, RowGroup
from quadlog.simulation.planning_scenes import SCENES
from quadlog.simulation.planning_worlds import CELL_M, World

RINGS = (1, 2, 3)
EXTENDED = "Extended by n cells, an obstacle lies n + 1 cells from the path."
SHOWN = {"single-obstacle": "square of 1.6 m", "passage": "passage of 1.5 m", "complex": "complex scene"}
"""Scenes of quadlog.simulation.planning_scenes, and what the table calls them."""
FORMS: dict[str, type[EAStar] | type[ClearanceAStar]] = {"ea_star": EAStar, "clearance_astar": ClearanceAStar}


def planners_of(preset: Preset) -> dict[str, Planner]:
    """A*, then both forms of EA* with every number of rings, by the name they have in the table."""
    forms = {f"{name}, n = {n}": form(preset.rules, rings=n) for name, form in FORMS.items() for n in RINGS}
    return {preset.baseline: make_planner(preset.baseline, preset.rules), **forms}


def ends_of(world: World) -> tuple[Cell, Cell]:
    """Start and goal (col, row) in the world's own window, where the whole of it is planned on."""
    (col, row), (goal_col, goal_row) = (
        world.window.cell_of(place_m).tolist() for place_m in (world.start_xy_m, world.goal.at(0))
    )
    return (col, row), (goal_col, goal_row)


def clearance_cells(occupied: Bool, cells: Cells) -> int:
    """The least Chebyshev distance of a path (L, 2) from an obstacle: 1 where it passes beside one."""
    away = ndimage.distance_transform_cdt(~occupied, metric="chessboard")
    return int(away[cells[:, 1], cells[:, 0]].min())


def clearance_m(occupied: Bool, cells: Cells) -> float:
    """The least distance of a path's centres from an obstacle: to the nearest centre, less half a cell."""
    away = ndimage.distance_transform_edt(~occupied)
    return (float(away[cells[:, 1], cells[:, 0]].min()) - 0.5) * CELL_M


def scene_group(preset: Preset) -> RowGroup:
    """Figs 19 to 21 by one preset."""
    rows: list[PaperRow] = []
    for scene, called in SHOWN.items():
        world = SCENES[scene]()
        for name, planner in planners_of(preset).items():
            rows += _path_rows(scene, f"{preset.name}, {called}", name, planner, world)
    text = (
        f"Each planner plans once over the whole scene, by the rules: {preset.rules}. Obstacles are not grown: that is "
        "what the rings are for. Clearance in cells: rows or columns to the nearest obstacle cell, whichever is more, "
        "so that 1 is beside it. The paper prints pictures, and of numbers only that Fig. 19 extends its obstacle by "
        "1, 2 and 3 cells."
    )
    return RowGroup(f"Figs 19 to 21, preset {preset.name}", text, tuple(rows))


def _path_rows(scene: str, where: str, name: str, planner: Planner, world: World) -> list[PaperRow]:
    plan = planner.plan(world.occupied, *ends_of(world))
    length_m, turn_rad = turning(plan.cells * CELL_M)
    cells = float(clearance_cells(world.occupied, plan.cells))
    quantity = f"{where}: clearance, {name} (cells)"
    note = f"{clearance_m(world.occupied, plan.cells):.2f} m from centre to rim."
    clearance = PaperRow(quantity, cells, note=note)
    if name.startswith("ea_star") and scene == "single-obstacle":
        clearance = compare(quantity, float(name[-1]) + 1, 1.0, cells, note=f"{note} {EXTENDED}")
    length = PaperRow(f"{where}: length, {name} (m)", round(length_m, 9), note=f"Turns by {turn_rad:.1f} rad in all.")
    return [clearance, length]


@dataclass(frozen=True, slots=True)
class Crossing:
    """A start and a goal (col, row) with the square between them."""

    start: Cell
    goal: Cell


def draw_crossings(world: World, count: int, rng: np.random.Generator) -> list[Crossing]:
    """So many starts and goals on free cells outside of all rings, the straight line between them over an obstacle."""
    rows, cols = world.occupied.shape
    away = ndimage.distance_transform_cdt(~world.occupied, metric="chessboard")
    crossings: list[Crossing] = []
    while len(crossings) < count:
        ends = rng.integers([0, 0], [cols, rows], size=(2, 2))
        line = np.rint(np.linspace(ends[0], ends[1], max(rows, cols) + 1)).astype(int)
        is_outside = (away[ends[:, 1], ends[:, 0]] > max(RINGS) + 1).all()
        if is_outside and world.occupied[line[:, 1], line[:, 0]].any():
            (col, row), (goal_col, goal_row) = ends.tolist()
            crossings.append(Crossing((col, row), (goal_col, goal_row)))
    return crossings


def crossing_group(count: int, seed: int) -> RowGroup:
    """The square of 1.6 m again, from anywhere to anywhere beyond it."""
    world = SCENES["single-obstacle"]()
    rng = np.random.default_rng([HELD_OUT_SEED + seed, *b"crossings"])
    crossings = draw_crossings(world, count, rng)
    rows = []
    for preset in PRESETS:
        for name, planner in planners_of(preset).items():
            if name == preset.baseline:
                continue
            kept = sum(_keeps_off(planner, world, crossing, int(name[-1])) for crossing in crossings)
            share, interval = share_interval(kept, count)
            quantity = f"{preset.name}: share of ways that keep off all rings, {name} (1)"
            rows.append(PaperRow(quantity, share, None, *interval, note=f"{kept} of {count}."))
    text = (
        "A picture shows one way. Here start and goal are drawn anywhere in the scene of the square, outside of all "
        "rings and so that the straight line between them is blocked. A way keeps off when it enters none of the n "
        "rings. Intervals after Wilson."
    )
    return RowGroup("The square from everywhere", text, tuple(rows))


def _keeps_off(planner: Planner, world: World, crossing: Crossing, rings: int) -> bool:
    plan = planner.plan(world.occupied, crossing.start, crossing.goal)
    return clearance_cells(world.occupied, plan.cells) > rings
