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
from quadlog.following.lookahead import FuzzyLookahead
from quadlog.locomotion.robot import ROBOTS
from quadlog.locomotion.walker import WalkerSettings
from quadlog.simulation.course_walk import walk_course
from quadlog.simulation.courses import line
from quadlog.simulation.ground import undulating
from quadlog.simulation.quadruped_model import quadruped_model
from quadlog.simulation.walking_robot import WalkingRobot

ROUNDS, MEASURED_S = 3, 10.0


class Stopwatch:
    """Stands in for a method and keeps how long each call of it took."""

    def __init__(self, owner: Any, name: str) -> None:
        self._call, self.us = getattr(owner, name), []
        setattr(owner, name, self)

    def __call__(self, *arguments: Any) -> Any:
        """The call itself."""
        began_ns = time.perf_counter_ns()
        result = self._call(*arguments)
        self.us.append((time.perf_counter_ns() - began_ns) / 1000)
        return result

    @property
    def times_us(self) -> NDArray[np.float64]:
        """(N,) of all calls."""
        return np.array(self.us)


def measure(_: Path) -> Iterator[Figure]:
    """A walk on 3 cm of undulation at 500 Hz of simulation and whole-body control, and its parts."""
    factors = [_real_time_factor() for _ in range(ROUNDS)]
    robot = _robot()
    floor_us = _steps_us(robot)
    floor = f"floor: MuJoCo's steps alone, {robot.tick_s * 1e6 / floor_us:.0f} x"
    yield Figure("walk at 500 Hz, real-time factor, one core", max(factors), "x", 15, at_least=True, floor=floor)
    robot = _robot()
    walker = robot.walker
    watched = {
        "mpc": Stopwatch(walker.mpc, "solve"),
        "wbc": Stopwatch(walker.wbc, "step"),
        "legs": Stopwatch(walker.stride, "step"),
        "read": Stopwatch(robot._quadruped, "read"),
    }
    force_qps = [Stopwatch(qp, "solve") for qp in walker.wbc._qps]
    robot.walk(round(MEASURED_S / robot.tick_s), 0.6, 0.0)
    qp_us = np.concatenate([each.times_us for each in force_qps])
    mpc_us = watched["mpc"].times_us
    yield Figure("MPC, build and solve, 95 %", float(np.percentile(mpc_us, 95)) / 1000, "ms", 0.2)
    yield Figure("whole-body control's QP, 95 %", float(np.percentile(qp_us, 95)) / 1000, "ms", 0.02)
    ticks = len(watched["wbc"].us)
    for name, title in (("read", "dynamics"), ("wbc", "whole-body control"), ("legs", "legs"), ("mpc", "MPC")):
        yield Figure(f"of a tick: {title}", float(watched[name].times_us.sum()) / ticks, "us")
    yield Figure("of a tick: MuJoCo's steps", floor_us, "us")


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


def _steps_us(robot: WalkingRobot) -> float:
    """Microseconds of a tick in MuJoCo itself, the torques held."""
    model, data = robot.model.model, mujoco.MjData(robot.model.model)
    data.qpos[:] = robot.model.standing_at(0.0, 0.0, 0.0)
    began = time.perf_counter()
    for _ in range(500):
        mujoco.mj_step(model, data)
    return (time.perf_counter() - began) / 500 * 1e6
