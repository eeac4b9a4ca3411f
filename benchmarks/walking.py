"""Walking: how fast the simulated quadruped walks, and where a tick of 2 ms goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Figure
from quadlog.control.following.lookahead import FuzzyLookahead
from quadlog.control.locomotion import walker
from quadlog.control.locomotion.mpc_model import in_pyramid
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.control.locomotion.wbc_kernels import free_minimum
from quadlog.simulation.course_walk import line, walk_course
from quadlog.simulation.robot.height_field import undulating
from quadlog.simulation.robot.model import quadruped_model
from quadlog.simulation.robot.walking_robot import WalkingRobot

ROUNDS, MEASURED_S, QP_TICKS = 3, 10.0, 3000


class Stopwatch:
    """Stands in for a function until it is stopped, and keeps how long each call of it took."""

    def __init__(self, owner: Any, name: str) -> None:
        self._owner, self._name, self._call, self.us = owner, name, getattr(owner, name), []
        setattr(owner, name, self)

    def __call__(self, *arguments: Any) -> Any:
        """The call itself."""
        began_ns = time.perf_counter_ns()
        result = self._call(*arguments)
        self.us.append((time.perf_counter_ns() - began_ns) / 1000)
        return result

    def stop(self) -> NDArray[np.float64]:
        """Puts the function back: (N,) microseconds of all calls."""
        setattr(self._owner, self._name, self._call)
        return np.array(self.us)


def measure(_: Path) -> Iterator[Figure]:
    """A walk on 3 cm of undulation at 500 Hz of simulation and whole-body control, and its parts."""
    factors = [_real_time_factor() for _ in range(ROUNDS)]
    robot = _robot()
    control = robot.walker
    watched = {
        "step1": Stopwatch(mujoco, "mj_step1"),
        "step2": Stopwatch(mujoco, "mj_step2"),
        "read": Stopwatch(robot._quadruped, "read"),
        "legs": Stopwatch(walker, "_aim"),
        "mpc": Stopwatch(control.mpc, "solve"),
        "wbc": Stopwatch(control.wbc, "step"),
    }
    ticks = round(MEASURED_S / robot.tick_s)
    robot.walk(ticks, 0.6, 0.0)
    us = {name: watch.stop() for name, watch in watched.items()}
    of_tick = {name: float(each.sum()) / ticks for name, each in us.items()}
    steps_us = of_tick["step1"] + of_tick["step2"]
    floor = f"floor: MuJoCo's steps alone, {robot.tick_s * 1e6 / steps_us:.0f} x"
    yield Figure("walk at 500 Hz, real-time factor, one core", max(factors), "x", 15, at_least=True, floor=floor)
    yield Figure("MPC, build and solve, 95 %", float(np.percentile(us["mpc"], 95)) / 1000, "ms", 0.2)
    qp_us, asked = _qp_us(robot)
    share = f"a solver runs at {asked:.1%} of ticks, where a force comes to its limits"
    yield Figure("whole-body control's QP, 95 %", float(np.percentile(qp_us, 95)) / 1000, "ms", 0.02, floor=share)
    yield Figure("of a tick: MuJoCo's steps", steps_us, "us")
    yield Figure("of a tick: dynamics", of_tick["read"] - of_tick["step1"], "us")
    for name, title in (("legs", "reference and legs"), ("mpc", "MPC"), ("wbc", "whole-body control")):
        yield Figure(f"of a tick: {title}", of_tick[name], "us")


def _robot() -> WalkingRobot:
    model = quadruped_model(ROBOTS["tracking"], undulating(0.03, seed=0))
    robot = WalkingRobot(model, WalkerSettings(), line().start_pose, np.random.default_rng(0))
    robot.walk(200, 0.3, 0.0)
    return robot


def _real_time_factor() -> float:
    model = quadruped_model(ROBOTS["tracking"], undulating(0.03, seed=0))
    robot = WalkingRobot(model, WalkerSettings(), line().start_pose, np.random.default_rng(0))
    began = time.perf_counter()
    walk_course(line(), robot, FuzzyLookahead(), 1.5, 50.0)
    return robot.t_s / (time.perf_counter() - began)


def _qp_us(robot: WalkingRobot) -> tuple[NDArray[np.float64], float]:
    """Microseconds that each tick's QP takes by itself, and the share of ticks at which a solver runs."""
    control, us, asked = robot.walker, [], 0
    settings, targets = control.settings.wbc, control._targets
    for _ in range(QP_TICKS):
        robot.walk(1, 0.6, 0.0)
        qp = control.wbc._qps[int(targets.stance.sum())]
        began_ns = time.perf_counter_ns()
        free_minimum(qp.hessian, qp.gradient, qp.forces_n)
        if not in_pyramid(qp.forces_n, settings.mu, settings.f_min_n, settings.f_max_n, 0.0):
            qp.solve(True, targets.forces_n, targets.stance)
            asked += 1
        us.append((time.perf_counter_ns() - began_ns) / 1000)
    return np.array(us), asked / QP_TICKS
