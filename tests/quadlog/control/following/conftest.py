from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from quadlog.control.following.lookahead import LookaheadControl
from quadlog.control.following.pure_pursuit import PathFollower
from quadlog.simulation import course_walk
from quadlog.simulation.robot.unicycle_robot import unicycle_step


class Walk(NamedTuple):
    """A unicycle's walk: (T,) each, and whether it reached the end."""

    cross_track_m: np.ndarray
    progress_m: np.ndarray
    l_m: np.ndarray
    finished: bool


@pytest.fixture(scope="session")
def s_curve() -> np.ndarray:
    return course_walk.s_curve().path_m


@pytest.fixture(scope="session")
def walk() -> Callable[..., Walk]:
    """Walks a path by the follower and a look-ahead at 50 Hz, from its start along it unless told otherwise."""

    def walked(path: np.ndarray, control: LookaheadControl, speed_mps=0.5, pose=None, push=None, ticks=6000) -> Walk:
        follower = PathFollower(path)
        x, y, yaw = (*path[0], math.atan2(*(path[1] - path[0])[::-1])) if pose is None else pose
        rows = []
        for k in range(ticks):
            state = follower.step(x, y, yaw)
            if state.finished:
                return Walk(*np.array(rows).T, True)
            look = control.step(state.near.distance_m, 0.02, speed_mps)
            command = follower.pursue(x, y, yaw, state, look.l_m, speed_mps, 1.5)
            rows.append((state.near.distance_m, state.progress_m, look.l_m))
            x, y, yaw = unicycle_step(x, y, yaw, command.v_mps, command.yaw_rate_radps, 0.02)
            if push is not None:
                pushed_x, pushed_y = push(k)
                x, y = x + pushed_x, y + pushed_y
        return Walk(*np.array(rows).T, False)

    return walked
