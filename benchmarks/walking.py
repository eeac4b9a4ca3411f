"""Walking: how fast the simulated quadruped walks at 500 Hz of simulation and whole-body control."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.figures import Figure
from quadlog.control.following.lookahead import FuzzyLookahead
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.control.settings import PursuitSettings
from quadlog.simulation.course_walk import line, walk_course
from quadlog.simulation.robot.height_field import undulating
from quadlog.simulation.robot.model import quadruped_model
from quadlog.simulation.robot.walking_robot import WalkingRobot

ROUNDS = 3


def measure(_: Path) -> Iterator[Figure]:
    """A walk on 3 cm of undulation; the best of some rounds."""
    factor = max(_real_time_factor(_robot()) for _ in range(ROUNDS))
    yield Figure("walk at 500 Hz, real-time factor, one core", factor, "x", 15, at_least=True)


def _robot() -> WalkingRobot:
    model = quadruped_model(ROBOTS["tracking"], undulating(0.03, seed=0))
    return WalkingRobot(model, WalkerSettings(), line().start_pose, np.random.default_rng(0))


def _real_time_factor(robot: WalkingRobot) -> float:
    began = time.perf_counter()
    walk_course(line(), robot, FuzzyLookahead(PursuitSettings()), 1.5)
    return robot.t_s / (time.perf_counter() - began)
