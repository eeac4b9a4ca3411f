"""The table planning-1: lengths of routes that robots really walked, each led by its own planner."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quadlog.control.following.path import nearest_on_path
from quadlog.control.following.pure_pursuit import pure_pursuit
from quadlog.geometry import arc_lengths
from quadlog.mapping.inflation import INFLATIONS
from quadlog.messages import Float
from quadlog.pipelines.tables.intervals import (
    bootstrap_ratio,
    bootstrap_statistic,
    compare_samples,
    not_comparable,
    share_interval,
)
from quadlog.pipelines.tables.pictures import drawn
from quadlog.pipelines.tables.planning.claims import (
    COHERENCE,
    Coherence,
    coherence_of,
    coherence_rows,
    collision_rows,
    collision_text,
)
from quadlog.pipelines.tables.planning.planner_walks import (
    DENSITIES_PER_M2,
    HELD_OUT_SEED,
    LENGTH_M,
    LENGTH_RUNS,
    PAPER,
    PRESETS,
    READINGS,
    TIME_S,
    Preset,
    forest_of,
)
from quadlog.planning.protocol import Planner
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import Replanner, ReplanSettings
from quadlog.results.numbers import count
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, TablePicture
from quadlog.results.view import Layer, Lines, Raster, Scene, extent_of
from quadlog.results.view import look as color_of
from quadlog.simulation.robot.unicycle_robot import unicycle_step
from quadlog.simulation.worlds.replanning_walk import (
    MOST_REPLANS,
    PATIENCE,
    Outcome,
    ReplanInstant,
    WorldWalk,
    look,
    walk_world,
)
from quadlog.simulation.worlds.world import SPEED_MPS, World, body_clearance, occupied_centres

# The robot's size is printed [Planning, section 4]. How it follows is not: these are ours, and no figure chose them.
BODY_M = (1.1, 0.5)
LOOKAHEAD_M, MAX_YAW_RATE_RADPS = 0.5, 1.5
TICK_S, TICKS_PER_REPLAN = 0.07, 5
"""A replan each 0.35 s, in which the robot walks one cell."""
AT_GOAL_M = 0.1


@dataclass(frozen=True, slots=True)
class PursuedWalk:
    """path_xy_m (T, 2) and yaw_rad (T,) in map, a tick apart, the last within AT_GOAL_M of the goal if it arrived.

    clearance_m: the least between body and obstacles, <= 0 where they touched.
    """

    path_xy_m: Float
    yaw_rad: Float
    clearance_m: float
    arrived: bool

    @property
    def length_m(self) -> float:
        """Of the way really walked."""
        return float(arc_lengths(self.path_xy_m)[-1])

    @property
    def duration_s(self) -> float:
        """From start to goal."""
        return (len(self.yaw_rad) - 1) * TICK_S

    @property
    def turning_radpm(self) -> float:
        """Changes of heading, left and right alike, for each metre."""
        return float(np.abs(np.diff(np.unwrap(self.yaw_rad))).sum()) / self.length_m


def pursue(world: World, planner: Planner, most_replans: int = MOST_REPLANS) -> PursuedWalk:
    """Walk from the world's start, looking at the goal, until there, stuck or out of replans; see walk_world.

    The goal must stand still.
    """
    replanner = Replanner(planner, ReplanSettings(world.dilation_m, world.dilation, stop_short_m=0.0))
    goal_m = world.goal.at(0)
    to_goal_m = goal_m - world.start_xy_m
    pose = (float(world.start_xy_m[0]), float(world.start_xy_m[1]), math.atan2(to_goal_m[1], to_goal_m[0]))
    path_m: Float = np.empty((0, 2))
    walked: list[Float] = []
    waited = 0
    while waited <= PATIENCE and len(walked) < most_replans:
        here_m = np.array(pose[:2])
        t_ns = round(1e9 * len(walked) * TICKS_PER_REPLAN * TICK_S)
        instant = look(world, here_m, t_ns)
        path = replanner.replan(t_ns, instant.window, instant.occupied, here_m, goal_m).path
        if path is not None:
            path_m = path.smooth_xy_m
        rows = _follow(pose, path_m, instant, world.speed_mps)
        there = np.flatnonzero(np.hypot(*(rows[:, :2] - goal_m).T) <= AT_GOAL_M)
        if len(there):
            return _walk([*walked, rows[: there[0] + 1]], arrived=True)
        # The last one is the next replan's first.
        walked.append(rows[:-1])
        x, y, yaw = rows[-1, :3].tolist()
        waited = 0 if (x, y) != pose[:2] else waited + 1
        pose = x, y, yaw
    return _walk(walked, arrived=False)


def _follow(pose: tuple[float, float, float], path_m: Float, instant: ReplanInstant, speed_mps: float) -> Float:
    """Ticks along a path (K, 2) until the next replan: pose and clearance, (TICKS_PER_REPLAN + 1, 4), the first now."""
    centres_m = occupied_centres(instant.occupied, instant.window)
    rows = np.empty((TICKS_PER_REPLAN + 1, 4))
    x, y, yaw = pose
    for row in rows:
        row[:3] = x, y, yaw
        row[3] = body_clearance(x, y, yaw, *BODY_M, centres_m, instant.window.cell_m)
        if len(path_m):
            near = nearest_on_path(path_m, x, y)
            command = pure_pursuit(x, y, yaw, path_m, near, LOOKAHEAD_M, speed_mps, MAX_YAW_RATE_RADPS)
            x, y, yaw = unicycle_step(x, y, yaw, command.v_mps, command.yaw_rate_radps, TICK_S)
    return rows


def _walk(walked: list[Float], arrived: bool) -> PursuedWalk:
    rows = np.concatenate(walked)
    return PursuedWalk(rows[:, :2], rows[:, 2], float(rows[:, 3].min()), arrived)


NAMES = ("A*", "IA*")


@dataclass(frozen=True, slots=True)
class Pair:
    """A* and IA*, in this order, each on its own way through one forest.

    pursued: as a robot walks it. grid_m: length cell by cell, NaN where it did not arrive. coherence: of the plans of
    that walk.
    """

    pursued: tuple[PursuedWalk, PursuedWalk]
    grid_m: tuple[float, float]
    coherence: tuple[Coherence, Coherence]

    @property
    def arrived(self) -> bool:
        """Whether both came to the goal."""
        return all(walk.arrived for walk in self.pursued)


Pairs = dict[tuple[str, float], list[Pair]]
"""By preset and trees per m²."""


def walk_all(walks: int, seed: int) -> Pairs:
    """Both planners through every forest."""
    return {
        (preset.name, density): [_walk_both(preset, density, number, seed) for number in range(walks)]
        for preset in PRESETS
        for density in DENSITIES_PER_M2
    }


def _walk_both(preset: Preset, density: float, number: int, seed: int) -> Pair:
    world = forest_of(density, number, preset, seed)
    (astar, astar_walk), (ia_star, ia_star_walk) = (
        (pursue(world, make_planner(name, preset.rules)), walk_world(world, make_planner(name, preset.rules)))
        for name in (preset.baseline, preset.ia_star)
    )
    return Pair(
        (astar, ia_star),
        (_grid_length_m(astar_walk), _grid_length_m(ia_star_walk)),
        (coherence_of(astar_walk), coherence_of(ia_star_walk)),
    )


def _grid_length_m(walk: WorldWalk) -> float:
    return float(arc_lengths(walk.path_xy_m)[-1]) if walk.outcome is Outcome.ARRIVED else math.nan


def length_group(preset: Preset, pairs: Pairs, seed: int) -> RowGroup:
    """Table 1 by one preset, in both forests."""
    rows: list[PaperRow] = []
    for density in DENSITIES_PER_M2:
        walked = pairs[preset.name, density]
        whole = [pair for pair in walked if pair.arrived]
        rows += _rows(whole, f"{preset.name}, {density:g} trees/m²", seed)
    text = (
        f"{preset.baseline} and {preset.ia_star}, where {READINGS[preset.ia_star]}, rules {preset.rules}; obstacles "
        f"grown by 3 cells ({preset.dilation}). Each leads its own walk through the same forests. A kinematic robot "
        f"follows the smoothed path by pure pursuit, looking {LOOKAHEAD_M:g} m ahead at {SPEED_MPS:g} m/s and no more "
        f"than {MAX_YAW_RATE_RADPS:g} rad/s, and replans each {TICK_S * TICKS_PER_REPLAN:g} s; lengths are those of "
        "the way it really walks. That speed is the mean speed of A* in Table 1, the rest is our choice. The scatter "
        "of the printed ten walks counts as well as that of ours. Intervals: bootstrap over all walks; shares after "
        "Wilson."
    )
    return RowGroup(f"Table 1, preset {preset.name}", text, tuple(rows))


def _rows(pairs: list[Pair], where: str, seed: int) -> list[PaperRow]:
    length_m = _of(pairs, lambda walk: walk.length_m)
    time_s = _of(pairs, lambda walk: walk.duration_s)
    set_by = "Set by how far our goals are away."
    rows = _mean_rows(length_m, LENGTH_M, f"{where}: length, mean", "m", set_by, seed)
    ratio, printed = length_m[1] / length_m[0], LENGTH_M[1] / LENGTH_M[0]
    what = f"{where}: length of IA* over that of A*, mean (1)"
    rows.append(compare_samples(what, printed, ratio, np.mean, _rng(seed), 1.0))
    quantity = f"{where}: length: share of walks in which IA* is shorter (1)"
    is_so, printed_so = (ratio < 1).astype(np.float64), (printed < 1).astype(np.float64)
    note = f"{int(is_so.sum())} of {len(is_so)}."
    rows.append(compare_samples(quantity, printed_so, is_so, np.mean, _rng(seed), 0.5, note))
    rows += _time_rows(time_s, where, seed)
    for at, name in enumerate(NAMES):
        turning = _of(pairs, lambda walk: walk.turning_radpm)[at]
        ours, interval = bootstrap_ratio(turning, np.ones(len(turning)), _rng(seed))
        rows.append(PaperRow(f"{where}: turning, {name} (rad/m)", ours, None, *interval))
    return rows + _grid_rows(pairs, where, seed)


def _mean_rows(ours: Float, printed: Float, what: str, unit: str, why: str, seed: int) -> list[PaperRow]:
    rows = []
    for at, name in enumerate(NAMES):
        mean, interval = bootstrap_statistic(ours[at], np.mean, _rng(seed))
        rows.append(not_comparable(f"{what}, {name} ({unit})", float(printed[at].mean()), mean, interval, why))
    return rows


def _time_rows(time_s: Float, where: str, seed: int) -> list[PaperRow]:
    """Not comparable: how the printed robot loses time by turning is not published."""
    why = (
        f"Ours walks at {SPEED_MPS:g} m/s throughout and loses nothing by turning; the printed robot is not published."
    )
    ratio, printed = time_s[1] / time_s[0], TIME_S[1] / TIME_S[0]
    mean, interval = bootstrap_statistic(ratio, np.mean, _rng(seed))
    share, share_range = share_interval(int((ratio > 1).sum()), len(ratio))
    what = f"{where}: time of IA* over that of A*, mean (1)"
    slower = f"{where}: time: share of walks in which IA* is slower (1)"
    return [
        *_mean_rows(time_s, TIME_S, f"{where}: time, mean", "s", why, seed),
        not_comparable(what, _mean(printed), mean, interval, why),
        not_comparable(slower, _mean(printed > 1), share, share_range, why),
    ]


def claim_groups(pairs: Pairs, seed: int) -> tuple[RowGroup, RowGroup]:
    """What is claimed in words of collisions and of coherence, by every preset in both forests."""
    collisions: list[PaperRow] = []
    coherences: list[PaperRow] = []
    for preset in PRESETS:
        for density in DENSITIES_PER_M2:
            where, walked = f"{preset.name}, {density:g} trees/m²", pairs[preset.name, density]
            touched = np.array([[walk.clearance_m <= 0 for walk in pair.pursued] for pair in walked])
            arrived = np.array([pair.pursued[1].arrived for pair in walked])
            collisions += collision_rows(touched, arrived, where, _rng(seed))
            coherences += coherence_rows([pair.coherence for pair in walked], where, _rng(seed))
    return (
        RowGroup("Arrives with no collision", collision_text(BODY_M), tuple(collisions)),
        RowGroup("Coherence of the paths [Planning, Fig. 5]", COHERENCE, tuple(coherences)),
    )


def _grid_rows(pairs: list[Pair], where: str, seed: int) -> list[PaperRow]:
    grid_m = np.array([pair.grid_m for pair in pairs]).T
    grid_m = grid_m[:, np.isfinite(grid_m).all(axis=0)]
    ratio = grid_m[1] / grid_m[0]
    mean, interval = bootstrap_ratio(ratio, np.ones(len(ratio)), _rng(seed))
    shorter = int((ratio < 1).sum())
    share, share_range = share_interval(shorter, len(ratio))
    what = f"{where}, cell by cell without smoothing"
    note = "Of the cells' centres, one cell a replan."
    return [
        PaperRow(f"{what}: length of IA* over that of A*, mean (1)", mean, None, *interval, note=note),
        PaperRow(
            f"{what}: share of walks in which IA* is shorter (1)",
            share,
            None,
            *share_range,
            note=f"{shorter} of {len(ratio)}.",
        ),
    ]


def _of(pairs: list[Pair], figure: Callable[[PursuedWalk], float]) -> Float:
    """(2, W) of A* and of IA*."""
    return np.array([[figure(walk) for walk in pair.pursued] for pair in pairs]).T


def _mean(values: Float) -> float:
    return float(np.mean(values))


def _rng(seed: int) -> np.random.Generator:
    """The same draws for every row."""
    return np.random.default_rng([HELD_OUT_SEED + seed, LENGTH_RUNS, *b"walks"])


def route_scene(pair: Pair, preset: Preset, density: float, seed: int) -> Scene:
    """The first pair of walks through a forest, from above."""
    world = forest_of(density, 0, preset, seed)
    grown = INFLATIONS[world.dilation](world.occupied, world.dilation_m / world.window.cell_m)
    left, bottom = world.window.origin_m.tolist()
    layers: list[Layer] = [
        Raster(label, color, np.where(cells, 1.0, np.nan), (left, bottom), world.window.cell_m, 0.0, 1.0)
        for cells, color, label in ((grown, "soft", "growth"), (world.occupied, "cell", "trunk"))
    ]
    for number, (name, walk) in enumerate(zip(NAMES, pair.pursued, strict=True)):
        way = walk.path_xy_m
        label = f"{name}, {walk.length_m:.2f} m"
        layers.append(Lines(label, first=np.array([0, len(way)]), x=way[:, 0], y=way[:, 1], **color_of(number)))
    every = np.concatenate([walk.path_xy_m for walk in pair.pursued])
    return Scene(layers, extent_of((every[:, 0], every[:, 1]), margin=1.0))


FULL_WALKS, FAST_WALKS = 40, LENGTH_RUNS


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast walks as often as the paper and no more."""
    walks = FAST_WALKS if fast else FULL_WALKS
    pairs = walk_all(walks, seed)
    groups = (
        *(length_group(preset, pairs, seed) for preset in PRESETS),
        *claim_groups(pairs, seed),
    )
    return PaperTable(
        name="planning-1",
        title="Lengths and times of the ways of A* and IA* [Planning, Table 1]",
        caption="Two robots walk through the same forest to the same goal, one led by A*, one by IA*. Who walks "
        "farther, and who longer? The paper prints ten pairs of walks of a simulated quadruped in a forest of its own. "
        "Ours stand at random, 0.1 or 0.2 trees to a square metre, with goals 15 to 25 m away, and a kinematic robot "
        "walks.",
        sizes=f"{count(walks)} walks of each planner through each forest and preset, seed {seed}, drawn from seed "
        f"{HELD_OUT_SEED + seed}.",
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


def _picture(pairs: Pairs, seed: int) -> TablePicture:
    density = DENSITIES_PER_M2[-1]
    return drawn(
        "routes",
        "A walk through a forest: the way that A* led and the one that IA* led.",
        f"As Figs 16 and 17: the first walk of preset paper among {density:g} trees/m², as walked.",
        route_scene(pairs[PAPER.name, density][0], PAPER, density, seed),
    )
