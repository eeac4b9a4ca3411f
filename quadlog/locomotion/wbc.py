"""Whole-body control: joint torques from tasks in a strict order and the MPC's forces [Tracking, eqs 33-44].

First the tasks give accelerations (`null_space`). They and the MPC's forces seldom agree on what the base does; a QP
shares the difference out between both (`force_qp`), and the joints' rows of the equations of motion give torques.
Coordinates are MuJoCo's: qvel (18,) = velocity in map (3), angular velocity IN THE BODY (3), joint speeds (12), and
mass matrix, bias and Jacobians go with them. Forces (4, 3) are the ground's on the feet, in map.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.locomotion.force_qp import ForceQp, QpStatus
from quadlog.locomotion.wbc_terms import JOINTS, SIZE, commands, force_cost, joint_torques, leg_torques
from quadlog.messages import Float

Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class WbcSettings:
    """Gains, weights and limits.

    Feedback (k_p in 1/s^2, k_d in 1/s) of the tasks; joint PD in N m/rad and N m s/rad; swing_force in N/m and N s/m,
    for a leg in swing without whole-body control. Weights of squared base acceleration and squared force beside what
    tasks and MPC ask for. torque_limit_nm: one for all, or (12,). weakest: see `null_space.prioritised`; legs bent by
    less than 15 degrees come below the default.
    """

    rotation_gains: tuple[float, float] = (80.0, 8.0)
    translation_gains: tuple[float, float] = (60.0, 8.0)
    swing_gains: tuple[float, float] = (350.0, 30.0)
    joint_gains: tuple[float, float] = (20.0, 0.8)
    swing_force_gains: tuple[float, float] = (700.0, 25.0)
    weight_acceleration: float = 0.1
    weight_force: float = 1.0
    mu: float = 0.6
    f_min_n: float = 0.0
    f_max_n: float = 150.0
    torque_limit_nm: float | tuple[float, ...] = 33.5
    weakest: float = 0.02

    def __post_init__(self) -> None:
        """Refuses what would make the QP empty or not strictly convex, and limits that are none."""
        gains = (self.rotation_gains, self.translation_gains, self.swing_gains, self.joint_gains)
        for pair in (*gains, self.swing_force_gains):
            if len(pair) != 2 or not all(0 <= gain < np.inf for gain in pair):
                raise ValueError(f"gains {pair} are not two finite numbers >= 0")
        for name in ("weight_force", "mu", "f_max_n", "weakest"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} {getattr(self, name)} is not finite and > 0")
        if not 0 <= self.weight_acceleration < np.inf:
            raise ValueError(f"weight_acceleration {self.weight_acceleration} is not finite and >= 0")
        if not 0 <= self.f_min_n <= self.f_max_n:
            raise ValueError(f"f_min_n {self.f_min_n} is not within 0..f_max_n")
        limits = np.atleast_1d(self.torque_limit_nm)
        if limits.shape not in ((1,), (JOINTS,)) or not (limits > 0).all():
            raise ValueError(f"torque_limit_nm {self.torque_limit_nm} is not one or {JOINTS} numbers > 0")

    @cached_property
    def torque_limits_nm(self) -> Float:
        """(12,) for each joint."""
        return np.broadcast_to(np.asarray(self.torque_limit_nm, dtype=np.float64), JOINTS).copy()


class WholeBodyState(NamedTuple):
    """Where the robot is, and its dynamics there; a tuple, because it is made at every tick, like the next two.

    rotation_body_to_map (3, 3), position_m (3,) of the base, qvel (18,); feet_m (4, 3) in map, foot_jacobians
    (4, 3, 18) and foot_jacobian_rates (4, 3), their change times qvel; mass_matrix (18, 18), bias (18,) of Coriolis
    forces and gravity. All float64 and contiguous.
    """

    rotation_body_to_map: Float
    position_m: Float
    qvel: Float
    feet_m: Float
    foot_jacobians: Float
    foot_jacobian_rates: Float
    mass_matrix: Float
    bias: Float


class WholeBodyTargets(NamedTuple):
    """What is wanted, in map.

    rotation_body_to_map (3, 3); body (5, 3): position, velocity, angular velocity, acceleration, angular acceleration;
    feet (3, 4, 3): positions, velocities and accelerations of the feet, of which only those in swing count.
    """

    rotation_body_to_map: Float
    body: Float
    feet: Float


class WbcCommand(NamedTuple):
    """Joint torques (12,) within their limits, the forces (4, 3) and accelerations (18,) they go with.

    saturated (12,): the torques that the limits cut. weak_tasks: how many tasks are met weakly, a leg being straight.
    is_damped: the input held what is no number; the torques only damp the joints.
    """

    torques_nm: Float
    forces_n: Float
    qddot_cmd: Float
    status: QpStatus
    saturated: Bool
    weak_tasks: int
    is_damped: bool


class WholeBodyControl:
    """Whole-body control, tick after tick. `counts` says how often each status came up, `damped` how often no number.

    The tasks' order is Table 3's: contacts, rotation, translation, swing. The text has the same and counts from 1.
    """

    def __init__(self, settings: WbcSettings | None = None) -> None:
        self.settings = settings = settings or WbcSettings()
        self.counts: Counter[QpStatus] = Counter()
        self.damped = 0
        self._weakest = float(settings.weakest)
        self._task_gains = np.array([settings.rotation_gains, settings.translation_gains, settings.swing_gains], float)
        self._weights = np.array([settings.weight_acceleration, settings.weight_force], float)
        self._joint_gains = np.array(settings.joint_gains, float)
        self._limits = settings.torque_limits_nm
        self._qps = [ForceQp(feet, settings.mu, settings.f_min_n, settings.f_max_n) for feet in range(5)]
        self._room = np.empty((5, SIZE, SIZE))
        self._out = np.empty((SIZE, 3))

    def step(self, state: WholeBodyState, targets: WholeBodyTargets, stance: Bool, mpc_forces_n: Float) -> WbcCommand:
        """The command for feet in stance (4,), the others in swing, and the MPC's forces (4, 3)."""
        out = self._out
        weak = commands(
            state.rotation_body_to_map,
            state.position_m,
            state.qvel,
            state.feet_m,
            state.foot_jacobians,
            state.foot_jacobian_rates,
            stance,
            targets.rotation_body_to_map,
            targets.body,
            targets.feet,
            self._task_gains,
            self._weakest,
            out,
            self._room,
        )
        qp = self._qps[int(np.count_nonzero(stance))]
        is_finite = force_cost(
            state.mass_matrix,
            state.bias,
            state.foot_jacobians,
            stance,
            out,
            mpc_forces_n,
            self._weights,
            qp.hessian,
            qp.gradient,
            qp.response,
        )
        stance_forces_n, status = qp.solve(is_finite, mpc_forces_n, stance)
        forces_n, torques_nm, saturated = np.empty((4, 3)), np.empty(JOINTS), np.empty(JOINTS, dtype=np.bool_)
        is_finite = joint_torques(
            state.mass_matrix,
            state.bias,
            state.foot_jacobians,
            stance,
            state.qvel,
            out,
            qp.response,
            stance_forces_n,
            self._joint_gains,
            self._limits,
            forces_n,
            torques_nm,
            saturated,
        )
        self.counts[status] += 1
        self.damped += not is_finite
        return WbcCommand(torques_nm, forces_n, out[:, 2].copy(), status, saturated, weak, not is_finite)


def mpc_only_torques(
    state: WholeBodyState, targets: WholeBodyTargets, stance: Bool, mpc_forces_n: Float, settings: WbcSettings
) -> tuple[Float, Bool]:
    """Torques (12,) without whole-body control, within the limits, and which were cut.

    Feet in stance push by the MPC's forces and nothing else, so an error of the MPC shows that whole-body control
    would hide. Feet in swing are drawn to their curves by a spring, with their own leg's inertia fed forward. Legs
    carry their own weight.
    """
    torques_nm, saturated = np.empty(JOINTS), np.empty(JOINTS, dtype=np.bool_)
    leg_torques(
        state.mass_matrix,
        state.bias,
        state.foot_jacobians,
        state.foot_jacobian_rates,
        state.qvel,
        state.feet_m,
        stance,
        mpc_forces_n,
        targets.feet,
        np.array(settings.swing_force_gains, float),
        float(settings.weakest),
        settings.torque_limits_nm,
        torques_nm,
        saturated,
    )
    return torques_nm, saturated
