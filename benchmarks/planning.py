"""Planning: A* against its peers, and whether an incremental planner saves time as well as cells."""

from __future__ import annotations

import importlib.util
import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Figure
from quadlog.metrics.intervals import median_interval
from quadlog.planning.protocol import Bool, Cell
from quadlog.planning.query import Query, make_query
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import compile_planner
from quadlog.planning.search.grid_steps import STEP_COL, STEP_ROW
from quadlog.simulation.worlds.replanning_walk import walk_world
from quadlog.simulation.worlds.scenes import forest_world

QUERIES, ROUNDS = 60, 5
FOLLOWED = ("astar", "ia_star", "mt_d_star_lite")
DENSITIES_PER_M2 = (0.1, 0.2, 0.3)
SWEEP_CELLS, SWEEP_EPISODES = (40, 80, 160, 320, 640), 8
Walk = list[Query]


def measure(_: Path) -> Iterator[Figure]:
    """Single queries first, then walks."""
    yield from _throughput()
    yield from _peers()
    yield from _following()
    yield from _sweep()


def random_map(size: int, density: float, seed: int) -> Bool:
    """Cells blocked at random."""
    return np.random.default_rng(seed).random((size, size)) < density


def street_map(size: int, seed: int) -> Bool:
    """Blocks of houses between streets 4 to 12 cells wide, a tenth of the streets closed somewhere, and squares."""
    rng = np.random.default_rng(seed)
    blocked = np.ones((size, size), dtype=bool)
    for axis in (0, 1):
        at = 2
        while at < size:
            width = int(rng.integers(4, 13))
            streets = blocked if axis == 0 else blocked.T
            streets[at : at + width] = False
            at += width + int(rng.integers(16, 56))
    for _ in range(size // 32):
        row, col = rng.integers(0, size, 2)
        blocked[row : row + 30, col : col + 30] = False
    for _ in range(size // 10):
        row, col = rng.integers(0, size, 2)
        blocked[row : row + 14, col : col + 14] = True
    return blocked


def queries(blocked: Bool, count: int, seed: int) -> list[tuple[Cell, Cell]]:
    """Starts and goals that are joined and at least half the map apart."""
    rng, planner = np.random.default_rng(seed), make_planner("astar")
    rows, cols = np.nonzero(~blocked)
    found: list[tuple[Cell, Cell]] = []
    while len(found) < count:
        a, b = rng.integers(len(rows), size=2)
        start, goal = (int(cols[a]), int(rows[a])), (int(cols[b]), int(rows[b]))
        if math.dist(start, goal) >= blocked.shape[0] / 2 and planner.plan(blocked, start, goal).found:
            found.append((start, goal))
    return found


def seconds(run: Callable[[], object]) -> float:
    """The fastest of some rounds, which other processes disturbed least."""
    times = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return min(times)


def _throughput() -> Iterator[Figure]:
    """Expansions per second on 512 by 512 cells; the floor is what visiting every cell's eight neighbours takes."""
    planner = make_planner("astar")
    compile_planner(planner)
    for title, blocked in {
        "20 % blocked": random_map(512, 0.2, 1),
        "35 % blocked": random_map(512, 0.35, 2),
        "streets": street_map(512, 3),
    }.items():
        asked = queries(blocked, QUERIES, 4)
        expanded = sum(planner.plan(blocked, *ends).expanded for ends in asked)
        taken = seconds(lambda asked=asked, blocked=blocked: [planner.plan(blocked, *ends) for ends in asked])
        yield Figure(
            f"astar, 512 x 512, {title}: million expansions/s", expanded / taken / 1e6, "M/s", 12, at_least=True
        )


def _peers() -> Iterator[Figure]:
    """Median time of a query over pyastar2d's, whose problem is easier: a diagonal step costs 1 and cuts corners."""
    if importlib.util.find_spec("pyastar2d") is None or importlib.util.find_spec("networkx") is None:
        return
    import pyastar2d

    planner = make_planner("astar")
    for title, blocked, limit in (
        ("random 200 x 200", random_map(200, 0.2, 5), 0.9),
        ("streets 1024 x 1024", street_map(1024, 6), 0.4),
    ):
        asked = queries(blocked, QUERIES, 7)
        weights = np.where(blocked, np.inf, 1.0).astype(np.float32)
        ours = [seconds(lambda e=ends, b=blocked: planner.plan(b, *e)) for ends in asked]
        theirs = [
            seconds(lambda e=ends, w=weights: pyastar2d.astar_path(w, e[0][::-1], e[1][::-1], allow_diagonal=True))
            for ends in asked
        ]
        median, peer = statistics.median(ours), statistics.median(theirs)
        floor = f"{median * 1e6:.0f} us; pyastar2d {peer * 1e6:.0f} us for an easier problem"
        yield Figure(f"astar / pyastar2d, {title}", median / peer, "x", limit, floor=floor)
    yield from _networkx()


def _networkx() -> Iterator[Figure]:
    import networkx

    planner, blocked = make_planner("astar"), random_map(200, 0.2, 5)
    graph = networkx.Graph()
    padded = np.pad(blocked, 1, constant_values=True)
    for row, col in np.argwhere(~blocked).tolist():
        for dcol, drow in zip(STEP_COL.tolist(), STEP_ROW.tolist(), strict=True):
            beside = padded[row + 1, col + 1 + dcol] or padded[row + 1 + drow, col + 1]
            if not (padded[row + 1 + drow, col + 1 + dcol] or (dcol and drow and beside)):
                graph.add_edge((col, row), (col + dcol, row + drow), weight=14 if dcol and drow else 10)

    def octile(a: Cell, b: Cell) -> int:
        across, along = abs(a[0] - b[0]), abs(a[1] - b[1])
        return 10 * max(across, along) + 4 * min(across, along)

    ratios = []
    for ends in queries(blocked, 10, 8):
        began = time.perf_counter()
        networkx.astar_path_length(graph, *ends, heuristic=octile)
        ratios.append((time.perf_counter() - began) / seconds(lambda e=ends: planner.plan(blocked, *e)))
    yield Figure("networkx / astar, random 200 x 200", statistics.median(ratios), "x", 40, at_least=True)


def forest_walks(density_per_m2: float, window_cells: int, episodes: int, seed: int) -> list[Walk]:
    """Queries along walks through forests, led by A*, with the goal beyond the window."""
    walks = []
    for number in range(episodes):
        rng = np.random.default_rng([seed, number])
        world = forest_world(density_per_m2, rng, window_cells=window_cells)
        asked = [
            make_query(at.window, at.occupied, at.robot_xy_m, at.goal_xy_m, world.dilation_m, world.dilation)
            for at in walk_world(world, make_planner("astar")).instants
        ]
        walks.append([query for query in asked if isinstance(query, Query)])
    return walks


def times_us(name: str, walks: Sequence[Walk]) -> list[NDArray[np.float64]]:
    """Per walk, the least time of each replan over some rounds."""
    planner = make_planner(name)
    compile_planner(planner)
    best = [np.full(len(walk), np.inf) for walk in walks]
    for _ in range(ROUNDS):
        for walk, least in zip(walks, best, strict=True):
            planner.reset()
            window = walk[0].window
            for i, query in enumerate(walk):
                shift, window = window.shift_to(query.window), query.window
                began_ns = time.perf_counter_ns()
                planner.plan(query.blocked, query.start, query.goal, shift)
                least[i] = min(least[i], (time.perf_counter_ns() - began_ns) / 1000)
    return best


def _following() -> Iterator[Figure]:
    for density in DENSITIES_PER_M2:
        walks = forest_walks(density, 200, 4, 9)
        median = {name: float(np.median(np.concatenate(times_us(name, walks)))) for name in FOLLOWED}
        where = f"200 x 200, {density:g} trees/m2"
        floor = f"{median['ia_star']:.1f} and {median['astar']:.1f} us"
        yield Figure(
            f"ia_star / astar, median replan, {where}", median["ia_star"] / median["astar"], "x", 1, floor=floor
        )
        yield Figure(f"mt_d_star_lite, median replan, {where}", median["mt_d_star_lite"] / 1000, "ms", 1)


def _sweep() -> Iterator[Figure]:
    """From which size of window on it saves time: A*'s time over the planner's, the median over walks."""
    for size in SWEEP_CELLS:
        walks = forest_walks(0.2, size, SWEEP_EPISODES, 10)
        total = {name: np.array([each.sum() for each in times_us(name, walks)]) for name in FOLLOWED}
        for name in FOLLOWED[1:]:
            ratios = total["astar"] / total[name]
            low, high = median_interval(ratios) or (math.nan, math.nan)
            floor = f"95 %: {low:.2f} to {high:.2f} over {len(walks)} walks"
            yield Figure(f"time of astar / {name}, window {size} x {size}", float(np.median(ratios)), "x", floor=floor)
