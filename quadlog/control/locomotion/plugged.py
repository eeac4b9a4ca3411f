"""Controllers of plug-ins: their interface, and the checking of the torques they return.

A plug-in takes the place of MPC and whole-body control. Pure pursuit, gait and footholds stay quadlog's own, so that
all controllers follow the same commands. Legs are FL, FR, RL, RR, each with hip, thigh and calf; joint 3 * leg + k.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from quadlog.control.locomotion.body_reference import BodyReference
from quadlog.control.locomotion.gait import Gait, Stride
from quadlog.control.locomotion.numba_record import Bool
from quadlog.control.locomotion.robot import Robot
from quadlog.control.locomotion.wbc import WholeBodyState
from quadlog.messages import Float
from quadlog.plugins import Plugin


@dataclass(frozen=True, slots=True)
class BodyState:
    """The robot at a tick, as its estimator knows it; a controller may keep or change these arrays.

    position_m (3,) of base in map; rotation_body_to_map (3, 3) and its angles rpy_rad (3,), R = Rz Ry Rx; velocity_mps
    (3,) in map, angular_radps (3,) IN BASE. joints_rad, joint_rates_radps (12,): all zero is a leg straight down; the
    hip turns about base's x axis, thigh and calf about its y axis. contacts (4,): which feet touch anything. feet_m
    (4, 3): the feet's centres in map.

    Dynamics in the coordinates qvel (18,) = velocity_mps, angular_radps, joint_rates_radps:
    mass_matrix @ acceleration + bias = [0, torques] + sum of foot_jacobians[i].T @ (force on foot i in map).
    mass_matrix (18, 18), bias (18,) of Coriolis forces and gravity, foot_jacobians (4, 3, 18), foot_jacobian_rates
    (4, 3): their change times qvel.
    """

    position_m: Float
    rotation_body_to_map: Float
    rpy_rad: Float
    velocity_mps: Float
    angular_radps: Float
    joints_rad: Float
    joint_rates_radps: Float
    contacts: Bool
    feet_m: Float
    mass_matrix: Float
    bias: Float
    foot_jacobians: Float
    foot_jacobian_rates: Float

    @property
    def qvel(self) -> Float:
        """(18,) the coordinates of the dynamics."""
        return np.concatenate([self.velocity_mps, self.angular_radps, self.joint_rates_radps])

    @property
    def feet_mps(self) -> Float:
        """(4, 3) velocities of the feet in map."""
        return self.foot_jacobians @ self.qvel


@dataclass(frozen=True, slots=True)
class BodyWanted:
    """What the robot should do at a tick.

    forward_mps, left_mps, yaw_rate_radps: the twist commanded in the heading's frame, changing no faster than
    `walker.ACCELERATION_MPS2`. position_m, rpy_rad, velocity_mps (3,): where base should be in map by these, parallel
    to the ground under the feet and height_m above the plane of their centres.
    stance (4,): which feet should carry, by the gait and by what has landed; phase (4,): 0 to 1 of the stance or swing
    that the gait is in. feet_m, feet_mps, feet_mps2 (4, 3): the way of the others in map; landings_m (4, 3): where each
    foot is to stand next.
    """

    forward_mps: float
    left_mps: float
    yaw_rate_radps: float
    height_m: float
    position_m: Float
    rpy_rad: Float
    velocity_mps: Float
    stance: Bool
    phase: Float
    feet_m: Float
    feet_mps: Float
    feet_mps2: Float
    landings_m: Float


class Controller(Protocol):
    """What an entry point of the group `quadlog.controllers` names: a class; each walk has its own.

    robot: masses, lengths, limits and how it stands; gait: period, duty and offsets of the legs.
    """

    def __init__(self, robot: Robot, gait: Gait) -> None: ...

    def step(self, t_s: float, state: BodyState, wanted: BodyWanted) -> Float:
        """Torques (12,) in N m, held for a tick of 2 ms. t_s: since the robot stood, rising by a tick each time.

        What exceeds a joint's limit is cut, and counts in torque_saturation_share.
        """
        ...


class CheckedController:
    """A controller of a plug-in for one walk. What it raises, and torques that are none, become a QuadlogError."""

    def __init__(self, plugin: Plugin, kind: type[Controller], robot: Robot, gait: Gait) -> None:
        self._plugin = plugin
        with plugin.doing("be made"):
            self._controller = kind(robot, gait)

    def step(self, t_s: float, state: BodyState, wanted: BodyWanted) -> tuple[Float, float]:
        """The plug-in's torques (12,), finite, and the seconds that it took, without these checks."""
        with self._plugin.doing("step"):
            began_s = time.perf_counter()
            given = self._controller.step(t_s, state, wanted)
            took_s = time.perf_counter() - began_s
        with self._plugin.doing("give torques"):
            torques_nm: NDArray[Any] = np.asarray(given)
        if torques_nm.shape != (12,) or torques_nm.dtype.kind not in "fiu":
            raise self._plugin.unusable(f"its torques are {torques_nm.dtype} {torques_nm.shape}, not numbers (12,)")
        if not np.isfinite(torques_nm).all():
            raise self._plugin.unusable(f"its torques at {t_s:.3f} s are not finite: {torques_nm.tolist()}")
        return torques_nm.astype(np.float64), took_s


def state_of(state: WholeBodyState) -> BodyState:
    """A copy for a plug-in: the next tick overwrites the record."""
    now = state.record[0].copy()
    qvel, dynamics = now["qvel"], ("mass_matrix", "bias", "foot_jacobians", "foot_jacobian_rates")
    pose = now["position_m"], now["rotation_body_to_map"], now["rpy"]
    moves = qvel[:3], qvel[3:6], now["joints_rad"], qvel[6:]
    return BodyState(*pose, *moves, now["touches"].astype(np.bool_), now["feet_m"], *(now[name] for name in dynamics))


def wanted_of(twist: Float, reference: BodyReference, stride: Stride) -> BodyWanted:
    """The same of what is wanted; twist (3,): forward, left, yaw rate."""
    body, legs = reference.record[0].copy(), stride.record[0].copy()
    forward_mps, left_mps, yaw_rate_radps = twist.tolist()
    feet_m, feet_mps, feet_mps2 = legs["swing"]
    way = float(body["height_m"]), body["position_m"], body["rpy"], body["velocity_mps"]
    steps = legs["stands"].astype(np.bool_), legs["phase"], feet_m, feet_mps, feet_mps2, legs["landings_m"]
    return BodyWanted(forward_mps, left_mps, yaw_rate_radps, *way, *steps)


def plugged_controller(plugin: Plugin | None) -> Callable[[Robot, Gait], CheckedController] | None:
    """What makes a plug-in's controller for a walk; None without one. Raises QuadlogError for what is no controller."""
    if plugin is None:
        return None
    found = plugin.load()
    if not isinstance(found, type) or not callable(getattr(found, "step", None)):
        raise plugin.unusable(f"is no controller: {type(found).__name__} without step(), or no class")
    return lambda robot, gait: CheckedController(plugin, found, robot, gait)
