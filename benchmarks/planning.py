"""Planning: A* against its peers, and whether an incremental planner saves time as well as cells."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Figure
from quadlog.planning.protocol import Bool, Cell
from quadlog.planning.query import Query
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import Asker
from quadlog.simulation.worlds.replanning_walk import asked_at, walk_world
from quadlog.simulation.worlds.scenes import forest_world

QUERIES, ROUNDS = 60, 5
FOLLOWED = ("astar", "ia_star", "mt_d_star_lite")
FOREST_WALKS = ((0.1, 200, 4), (0.2, 200, 4), (0.3, 200, 4), (0.2, 40, 8), (0.2, 640, 8))
"""Trees per m2, cells of the window, walks."""
Walk = list[Query]


def measure(_: Path) -> Iterator[Figure]:
    """Single queries first, then walks."""
    yield from _throughput()
    yield from _following()


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
    """Expansions per second, and the median time of a query over pyastar2d's.

    Its problem is easier: a diagonal step costs 1 and cuts corners.
    """
    import pyastar2d

    planner = Asker(make_planner("astar")).planner  # compiled
    for title, blocked in {"20 % blocked": random_map(512, 0.2, 1), "streets": street_map(512, 3)}.items():
        ends = queries(blocked, QUERIES, 4)
        expanded = sum(planner.plan(blocked, *each).expanded for each in ends)
        taken = seconds(lambda ends=ends, blocked=blocked: [planner.plan(blocked, *each) for each in ends])
        name = f"astar, 512 x 512, {title}: million expansions/s"
        yield Figure(name, expanded / taken / 1e6, "M/s", 12, at_least=True)
    peers = {
        "random 200 x 200": (random_map(200, 0.2, 5), 0.6),
        "random 512 x 512": (random_map(512, 0.2, 1), 0.85),
        "streets 1024 x 1024": (street_map(1024, 6), 0.3),
    }
    for title, (blocked, limit) in peers.items():
        weights = np.where(blocked, np.inf, 1.0).astype(np.float32)
        own_s, other_s = [], []
        for start, goal in queries(blocked, QUERIES, 7):
            own_s.append(seconds(partial(planner.plan, blocked, start, goal)))
            their = partial(pyastar2d.astar_path, weights, start[::-1], goal[::-1], allow_diagonal=True)
            other_s.append(seconds(their))
        median, peer = statistics.median(own_s), statistics.median(other_s)
        floor = f"{median * 1e6:.0f} us; pyastar2d {peer * 1e6:.0f} us for an easier problem"
        yield Figure(f"astar / pyastar2d, {title}", median / peer, "x", limit, floor=floor)


def forest_walks(density_per_m2: float, window_cells: int, episodes: int, seed: int) -> list[Walk]:
    """Queries along walks through forests, led by A*, with the goal beyond the window."""
    walks = []
    for number in range(episodes):
        rng = np.random.default_rng([seed, number])
        world = forest_world(density_per_m2, rng, window_cells=window_cells)
        asked = [asked_at(at, world) for at in walk_world(world, make_planner("astar")).instants]
        walks.append([query for query in asked if isinstance(query, Query)])
    return walks


def times_us(name: str, walks: Sequence[Walk]) -> list[NDArray[np.float64]]:
    """Per walk, the least time of each replan over some rounds."""
    asker = Asker(make_planner(name))
    best = [np.full(len(walk), np.inf) for walk in walks]
    for _ in range(ROUNDS):
        for walk, least in zip(walks, best, strict=True):
            asker.forget()
            for i, query in enumerate(walk):
                least[i] = min(least[i], asker.ask(query)[1])
    return best


def _following() -> Iterator[Figure]:
    """By density of trees, then by size of the window: A*'s time over the planner's, the median over walks."""
    for density, size, episodes in FOREST_WALKS:
        walks = forest_walks(density, size, episodes, 9)
        us = {name: times_us(name, walks) for name in FOLLOWED}
        total = {name: np.array([each.sum() for each in us[name]]) for name in FOLLOWED}
        median = {name: float(np.median(np.concatenate(us[name]))) for name in FOLLOWED}
        for name in FOLLOWED[1:]:
            where = f"{size} x {size}, {density:g} trees/m2"
            floor = f"a replan takes {median[name]:.1f} and {median['astar']:.1f} us"
            yield Figure(
                f"time of {name} / astar, {where}", float(np.median(total[name] / total["astar"])), "x", floor=floor
            )
