"""The walks of the table foot-drift: symmetric and asymmetric robots, with and without y(t), many at a time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from quadlog.config_control import Simulation
from quadlog.messages import Float
from quadlog.pipelines.engine.cores import cores
from quadlog.pipelines.engine.local_pool import LocalPool
from quadlog.pipelines.simulation.trot import trot_metrics, trot_once

NS = 1_000_000_000
SYMMETRIC = "symmetric"
AHEAD, BEHIND = "2.4 kg ahead, right", "1.2 kg behind, left"
ROBOTS: dict[str, dict[str, float]] = {
    SYMMETRIC: {},
    "symmetric, 0.3 m high": {"height_m": 0.3},
    "1.2 kg ahead, right": {"payload_kg": 1.2, "payload_x_m": 0.15, "payload_y_m": -0.1},
    AHEAD: {"payload_kg": 2.4, "payload_x_m": 0.15, "payload_y_m": -0.1},
    BEHIND: {"payload_kg": 1.2, "payload_x_m": -0.15, "payload_y_m": 0.1},
    "left legs 30 % heavier": {"leg_mass_spread": 0.3},
    "left hips 20 mm ahead": {"hip_offset_m": 0.02},
    "some of each": {
        "payload_kg": 0.6,
        "payload_x_m": 0.1,
        "payload_y_m": -0.05,
        "leg_mass_spread": 0.1,
        "hip_offset_m": -0.01,
    },
}
"""By what the table calls them: keys of [simulation.trot]. Chosen on CHOOSING_SEEDS, two of them to drift as far as the
paper's robot does."""
CHOOSING_SEEDS = (100, 101)
"""Whatever is chosen, is chosen on these."""
FIRST_SEED, SEEDS_PER_TABLE = 5000, 100
"""Where seeds that are reported start, and how many a table may take."""


def reported_seeds(count: int, seed: int) -> range:
    """The walks' seeds of a table's seed; those of two tables' seeds have none in common."""
    assert count <= SEEDS_PER_TABLE
    first = FIRST_SEED + SEEDS_PER_TABLE * seed
    return range(first, first + count)


@dataclass(frozen=True, slots=True)
class Curve:
    """What swings as: k of eq. 12, None for the baseline; lateral and shape as [simulation.trot] has them."""

    k: float | None
    lateral: str = "alternating"
    shape: str = "parabola"


BASELINE = Curve(None)
DERIVED = Curve(175.0)
"""As the paper derives it, k being ours: 10 mm aside."""
EASED = Curve(175.0, shape="eased")
ALTERNATING = (Curve(350.0), DERIVED, Curve(88.0))
SAME_SIDE = tuple(Curve(k, "same") for k in (-350.0, -700.0, 700.0, 350.0))


@dataclass(frozen=True, slots=True)
class Task:
    """One walk of one of ROBOTS."""

    robot: str
    curve: Curve
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Drifted:
    """What is kept of a walk: metrics by name, the peak of y(t), and y_m, yaw_rad (T,) at t_s (T,)."""

    figures: dict[str, float]
    peak_m: float
    t_s: Float
    y_m: Float
    yaw_rad: Float


Drifts = dict[Task, Drifted]


def walk_all(tasks: Iterable[Task]) -> Drifts:
    """Each walk once, on as many cores as there are."""
    todo = list(dict.fromkeys(tasks))
    workers = min(cores(), len(todo))
    if workers <= 1:
        return {task: walk_task(task) for task in todo}
    # Compiled once, here: the workers find it in the cache.
    first = walk_task(todo[0])
    with LocalPool(workers) as pool:
        return dict(zip(todo, [first, *pool.map(walk_task, todo[1:])], strict=True))


def walk_task(task: Task) -> Drifted:
    """One walk, as `quadlog simulate trot-32s` has it."""
    curve, simulation = task.curve, settings(task.robot, task.curve)
    trotted = trot_once(simulation, "baseline" if curve.k is None else "3d-curve", task.seed)
    walk = trotted.walk
    figures = {name: metric.value for name, metric in trot_metrics(trotted).items() if name != "realtime_factor"}
    y_m, yaw_rad = walk.position_m[:, 1].copy(), np.unwrap(walk.rpy_rad[:, 2])
    return Drifted(figures, trotted.planned.peak_m, walk.t_ns / NS, y_m, yaw_rad)


def settings(robot: str, curve: Curve) -> Simulation:
    """[simulation] of a robot and a curve."""
    trot: dict[str, object] = {**ROBOTS[robot], "lateral": curve.lateral, "lateral_shape": curve.shape}
    if curve.k is not None:
        trot["foot_curve_k"] = curve.k
    return Simulation.model_validate({"trot": trot})


def choose(drifts: Drifts, robot: str, curves: Iterable[Curve]) -> Curve:
    """The curve with which a robot turns least on CHOOSING_SEEDS."""

    def turns(curve: Curve) -> float:
        rates = [drifts[Task(robot, curve, seed)].figures["yaw_rate_degps"] for seed in CHOOSING_SEEDS]
        return float(np.mean(np.abs(rates)))

    return min(curves, key=turns)
