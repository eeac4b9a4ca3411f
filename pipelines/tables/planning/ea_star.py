"""The table planning-ea: how far from obstacles EA* stays, by how many rings, and what that costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import bellman_ford

from quadlog.mapping.inflation import inflate_square
from quadlog.pipelines.tables.intervals import claim, share_interval
from quadlog.pipelines.tables.pictures import drawn
from quadlog.pipelines.tables.planning.planner_walks import HELD_OUT_SEED, HONEST, PAPER, PRESETS, Preset
from quadlog.planning.path import turning
from quadlog.planning.planners.ea_star import LEVEL_CHARGE, SAME_LEVEL, ClearanceAStar, EAStar, danger_levels
from quadlog.planning.protocol import Bool, Cell, Cells, Planner
from quadlog.planning.registry import make_planner
from quadlog.planning.search.grid_steps import FIRST_DIAGONAL, STEP_COL, STEP_COST, STEP_ROW
from quadlog.results.numbers import count
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, TablePicture
from quadlog.results.view import Layer, Lines, Raster, Scene, extent_of, look
from quadlog.simulation.worlds.scenes import SCENES
from quadlog.simulation.worlds.world import CELL_M, World

RINGS = (1, 2, 3)
CLAIMED = "Claimed: more than with one ring less."
SHOWN = {"single-obstacle": "square of 1.6 m", "passage": "passage of 1.5 m", "complex": "complex scene"}
"""Scenes of quadlog.simulation.worlds.scenes, and what the table calls them."""
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
        before = np.inf
        for name, planner in planners_of(preset).items():
            clearance, length = _path_rows(f"{preset.name}, {called}", name, planner, world)
            if scene == "single-obstacle" and name.startswith("ea_star"):
                clearance = claim(clearance.quantity, before, clearance.ours, None, f"{clearance.note} {CLAIMED}")
            before = clearance.ours
            rows += [clearance, length]
    text = (
        f"Each planner plans once over the whole scene, by the rules: {preset.rules}. Obstacles are not grown: that is "
        "what the rings are for. Clearance in cells: rows or columns to the nearest obstacle cell, whichever is more, "
        "so that 1 is beside it. The paper prints pictures, and says of Fig. 19, which extends its obstacle by 1, 2 "
        "and 3 cells, that the distance between robot and obstacle increases: that is judged, from A* to one ring and "
        "from one ring to the next."
    )
    return RowGroup(f"Figs 19 to 21, preset {preset.name}", text, tuple(rows))


def _path_rows(where: str, name: str, planner: Planner, world: World) -> tuple[PaperRow, PaperRow]:
    """Clearance and length of one path."""
    plan = planner.plan(world.occupied, *ends_of(world))
    length_m, turn_rad = turning(plan.cells * CELL_M)
    cells = float(clearance_cells(world.occupied, plan.cells))
    note = f"{clearance_m(world.occupied, plan.cells):.2f} m from centre to rim."
    turn = f"Turns by {turn_rad:.1f} rad in all."
    return (
        PaperRow(f"{where}: clearance, {name} (cells)", cells, note=note),
        PaperRow(f"{where}: length, {name} (m)", round(length_m, 9), note=turn),
    )


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


AROUND_M = 1.6


def way_scene(name: str, form: str, preset: Preset) -> Scene:
    """A scene from above, with the ways of A* and of EA* by one form and each number of rings."""
    world, planners = SCENES[name](), planners_of(preset)
    chosen = {"A*": preset.baseline} | {f"n = {n}": f"{form}, n = {n}" for n in RINGS}
    plans = {label: planners[of].plan(world.occupied, *ends_of(world)) for label, of in chosen.items()}
    ways = {label: world.window.centre_of(plan.cells) for label, plan in plans.items()}
    left, bottom = world.window.origin_m.tolist()
    cells = np.where(world.occupied, 1.0, np.nan)
    layers: list[Layer] = [Raster("obstacle", "wall", cells, (left, bottom), world.window.cell_m, 0.0, 1.0)]
    for number, (label, way) in enumerate(ways.items()):
        layers.append(Lines(label, first=np.array([0, len(way)]), x=way[:, 0], y=way[:, 1], **look(number)))
    every = np.concatenate(list(ways.values()))
    return Scene(layers, extent_of((every[:, 0], every[:, 1]), margin=AROUND_M))


PASSAGE_CELLS = 15
NARROWED_BY = (0, 3, 5, 6)
"""Cells of growth that leave 15, 9, 5 and 3 cells of the passage open."""
GROWN = "obstacles grown by n cells, astar"


def passage_group() -> RowGroup:
    """How narrow a passage may be, for rings and for obstacles that are grown by as much."""
    rows = [
        PaperRow(f"narrowest passage left open, n = {n}, {name} (cells)", float(narrowest(name, n)))
        for name in (*FORMS, GROWN)
        for n in RINGS
    ]
    widths = ", ".join(str(PASSAGE_CELLS - 2 * growth) for growth in NARROWED_BY)
    text = (
        f"The passage of 1.5 m, {PASSAGE_CELLS} cells, narrowed so that {widths} cells are left; there is no other "
        "way. Rings make a way dear and block none, not even of 3 cells, the narrowest tried. Obstacles that "
        "are grown by n cells instead close it."
    )
    return RowGroup("Fig. 20: the passage", text, tuple(rows))


def narrowest(name: str, rings: int) -> int:
    """The narrowest of the passages, in cells, through which one of FORMS with so many rings, or GROWN, has a way."""
    world = SCENES["passage"]()
    left_open = []
    for growth in NARROWED_BY:
        blocked = inflate_square(world.occupied, growth + (rings if name == GROWN else 0))
        planner = make_planner("astar") if name == GROWN else FORMS[name](rings=rings)
        if planner.plan(blocked, *ends_of(world)).found:
            left_open.append(PASSAGE_CELLS - 2 * growth)
    return min(left_open)


def telescoping_group() -> RowGroup:
    """The printed charges without the printed search: the cheapest way there is."""
    world = SCENES["single-obstacle"]()
    plain = make_planner("astar").plan(world.occupied, *ends_of(world)).cells
    paths = {"astar": plain}
    paths |= {f"cheapest way, n = {n}": cheapest_path(world.occupied, n, *ends_of(world)) for n in RINGS}
    measures: dict[str, Callable[[Cells], float]] = {
        "length (m)": lambda cells: round(turning(cells * CELL_M)[0], 9),
        "clearance (cells)": lambda cells: float(clearance_cells(world.occupied, cells)),
    }
    rows = [
        PaperRow(f"{name}: {measure}", of(cells)) for name, cells in paths.items() for measure, of in measures.items()
    ]
    text = (
        "The square again, with every step charged as eq. 13 prints it. But the cheapest way of all is looked for, by "
        "the algorithm of Bellman and Ford, which closes nothing."
    )
    return RowGroup("Eq. 13: what the charges are worth", text, tuple(rows))


def cheapest_path(occupied: Bool, rings: int, start: Cell, goal: Cell) -> Cells:
    """The path (L, 2) of least steps and printed charges, from start to goal (col, row)."""
    rows, cols = occupied.shape
    from_cell, to_cell, cost = _charged_steps(occupied, rings)
    graph = coo_array((cost, (from_cell, to_cell)), shape=(rows * cols, rows * cols)).tocsr()
    first, last = (row * cols + col for col, row in (start, goal))
    _, before = bellman_ford(graph, indices=first, return_predecessors=True)
    way = [last]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    return np.array([(cell % cols, cell // cols) for cell in reversed(way)], dtype=np.int32)


def _charged_steps(occupied: Bool, rings: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(from, to, cost) of every legal step between flat cells [Planning, eq. 13]."""
    walled = np.pad(occupied, 1, constant_values=True)
    levels = np.pad(danger_levels(occupied, rings).astype(np.int64), 1)
    row, col = np.nonzero(~walled)
    steps = []
    for k in range(8):
        to_row, to_col = row + STEP_ROW[k], col + STEP_COL[k]
        free = ~walled[to_row, to_col]
        if k >= FIRST_DIAGONAL:
            free &= ~walled[row, to_col] & ~walled[to_row, col]
        at, to = (row[free], col[free]), (to_row[free], to_col[free])
        rise = levels[to] - levels[at]
        # Thousandths of a straight step, in tenths.
        cost = STEP_COST[k] + (LEVEL_CHARGE * rise - SAME_LEVEL * (rise == 0)) / 100
        flat = [(each_row - 1) * occupied.shape[1] + each_col - 1 for each_row, each_col in (at, to)]
        steps.append((*flat, cost))
    from_cell, to_cell, cost = (np.concatenate(parts) for parts in zip(*steps, strict=True))
    return from_cell, to_cell, cost


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
        pictures=_pictures(),
        errata=ERRATA,
    )


def _pictures() -> tuple[TablePicture, ...]:
    return tuple(
        drawn(
            f"ways-{form}",
            "A complex scene from above, with the ways of A* and of EA* by one, two and three rings.",
            f"As Fig. 21, preset paper: {form}.",
            way_scene("complex", form, PAPER),
        )
        for form in FORMS
    )
