"""Walks of the tracking tables: a course, its ground and disturbances drawn from a seed, many of them at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from quadlog.config import Config
from quadlog.following.lookahead import FuzzySettings
from quadlog.messages import Float
from quadlog.pipelines.engine.cores import cores
from quadlog.pipelines.engine.local_pool import LocalPool
from quadlog.pipelines.progress import Silent
from quadlog.pipelines.simulation.one_walk import SimulatedWalk, walk_once, warm_up
from quadlog.pipelines.simulation.walk_folder import walk_metrics
from quadlog.pipelines.simulation.where import find_course, make_ground
from quadlog.simulation.disturbances import DISTURBED

HELD_OUT_SEED = 2000
"""Seeds that are reported start here."""
CHOOSING_SEEDS = (100, 101)
"""Whatever is chosen, is chosen on these."""
SEEDS_PER_TABLE = 100
CONDITIONS = {"ideal": False, "disturbed": True}
"""What the tables call them, and whether `quadlog simulate --disturbed` is meant."""
NS = 1_000_000_000
CURVES = (
    *("x_m", "y_m", "ref_x_m", "ref_y_m", "heading_error_rad", "vx_mps", "yaw_rate_radps", "lookahead_m"),
    *("k_v", "k_w", "tau_00_nm", "tau_01_nm", "tau_02_nm"),
)
"""What the paper draws of a walk; torques are those of the front left leg."""


@dataclass(frozen=True, slots=True)
class Steering:
    """controller: as `quadlog simulate` has it. lookahead_m: l, or l0 of the fuzzy rules, the paper's unless given."""

    name: str
    controller: str
    lookahead_m: float = 2.0
    fuzzy: FuzzySettings | None = None


@dataclass(frozen=True, slots=True)
class Task:
    """One walk; terrain: as [simulation] has it. drawn: its curves are kept for a picture."""

    course: str
    terrain: str
    steering: Steering
    disturbed: bool
    seed: int
    drawn: bool = False

    @property
    def config(self) -> Config:
        """As a file of `quadlog simulate` would have it."""
        steering, fuzzy = self.steering, {}
        if steering.fuzzy is not None:
            fuzzy = asdict(steering.fuzzy)
            fuzzy |= {"lambda_v_s2_per_m": fuzzy.pop("lambda_v"), "lambda_w_s": fuzzy.pop("lambda_w")}
            assert fuzzy.pop("l0_m") == steering.lookahead_m
        given: dict[str, Any] = {
            "pursuit": {"lookahead_m": steering.lookahead_m, "fuzzy": fuzzy},
            "simulation": {
                "controller": steering.controller,
                "terrain": self.terrain,
                "disturbances": asdict(DISTURBED) if self.disturbed else {},
            },
            "results": {"frames": 0},
        }
        return Config.model_validate(given)


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What is kept of a walk: figures by name, one that does not apply is absent, and error_m (T,) at t_s (T,).

    curves: columns (T,) of control.parquet; none unless they are to be drawn.
    """

    figures: dict[str, float]
    t_s: Float
    error_m: Float
    curves: Mapping[str, Float] = field(default_factory=dict)

    def of(self, name: str) -> float:
        """A figure, NaN when it is absent."""
        return self.figures.get(name, math.nan)


def held_out_seeds(count: int, seed: int) -> range:
    """The walks' seeds of a table's seed; those of two tables' seeds have none in common."""
    assert count <= SEEDS_PER_TABLE
    first = HELD_OUT_SEED + SEEDS_PER_TABLE * seed
    return range(first, first + count)


def walk_all(tasks: Sequence[Task]) -> list[Tracked]:
    """The walks in the order of the tasks, on as many cores as there are."""
    # Compiled once, here: the workers find it in the cache.
    _warm_up(tasks[0])
    workers = min(cores(), len(tasks))
    if workers == 1:
        return [walk_task(task) for task in tasks]
    with LocalPool(workers) as pool:
        return list(pool.map(walk_task, tasks))


def walk_task(task: Task, most_s: float | None = None) -> Tracked:
    """One walk; most_s: stop after so long."""
    config = task.config
    course = find_course(task.course, config)
    ground = make_ground(task.course, course, config, task.seed)
    simulated = walk_once(course, config, ground, task.seed, most_s)
    walk, control = tracked(simulated), simulated.walk.control
    return replace(walk, curves={name: np.asarray(control[name]) for name in CURVES}) if task.drawn else walk


def tracked(simulated: SimulatedWalk) -> Tracked:
    """A walk's metrics, but for how fast it was simulated, and figures of its look-ahead and velocity."""
    control = simulated.walk.control
    metrics = walk_metrics(simulated)
    figures = {name: metric.value for name, metric in metrics.items() if name != "realtime_factor"}
    lookahead_m = control["lookahead_m"]
    figures |= {
        "lookahead_mean_m": float(np.mean(lookahead_m)),
        "lookahead_range_m": float(np.ptp(lookahead_m)),
        "x_error_rms_m": _rms(control["x_m"] - control["ref_x_m"]),
        "y_error_rms_m": _rms(control["y_m"] - control["ref_y_m"]),
        "speed_mean_mps": float(np.mean(control["vx_mps"])),
        "speed_std_mps": float(np.std(control["vx_mps"])),
        "yaw_rate_std_radps": float(np.std(control["yaw_rate_radps"])),
    }
    gains = {name: control[name] for name in ("k_v", "k_w") if name in control}
    figures |= {f"{name}_range": float(np.ptp(gain)) for name, gain in gains.items() if np.isfinite(gain).all()}
    t_ns = control["t_ns"]
    return Tracked(figures, (t_ns - t_ns[0]) / NS, np.asarray(control["error_m"], np.float64))


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _warm_up(task: Task) -> None:
    config = task.config
    course = find_course(task.course, config)
    warm_up(course, config, make_ground(task.course, course, config, task.seed), Silent().say)
