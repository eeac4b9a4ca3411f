"""Whole-body control: joint torques from tasks in a strict order and the MPC's forces [Tracking, eqs 33-44].

First the tasks give accelerations (`null_space`). They and the MPC's forces seldom agree on what the base does; a QP
shares the difference out between both (`force_qp`), and the joints' rows of the equations of motion give torques.
Coordinates are MuJoCo's: qvel (18,) = velocity in map (3), angular velocity IN THE BODY (3), joint speeds (12), and
mass matrix, bias and Jacobians go with them. Forces (4, 3) are the ground's on the feet, in map.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.control.locomotion.numba_record import Record
from quadlog.control.locomotion.wbc_kernels import (
    JOINTS,
    SIZE,
    ForceQp,
    QpStatus,
    before_qp,
    joint_torques,
    leg_torques,
)
from quadlog.messages import Float

Bool = NDArray[np.bool_]

_STATE = np.dtype(
    [
        ("rotation_body_to_map", "f8", (3, 3)),
        ("rpy", "f8", 3),
        ("position_m", "f8", 3),
        ("qvel", "f8", SIZE),
        ("feet_m", "f8", (4, 3)),
        ("foot_jacobians", "f8", (4, 3, SIZE)),
        ("foot_jacobian_rates", "f8", (4, 3)),
        ("mass_matrix", "f8", (SIZE, SIZE)),
        ("bias", "f8", SIZE),
        ("touches", "u1", 4),
    ],
    align=True,
)
_TARGETS = np.dtype(
    [
        ("rotation_body_to_map", "f8", (3, 3)),
        ("body", "f8", (5, 3)),
        ("feet", "f8", (3, 4, 3)),
        ("forces_n", "f8", (4, 3)),
        ("stance", "u1", 4),
    ],
    align=True,
)
_CONTROL = np.dtype(
    [
        ("task_gains", "f8", (3, 2)),
        ("weights", "f8", 2),
        ("joint_gains", "f8", 2),
        ("swing_force_gains", "f8", 2),
        ("limits_nm", "f8", JOINTS),
        ("pyramid", "f8", 3),
        ("weakest", "f8"),
        ("out", "f8", (SIZE, 3)),
        ("room", "f8", (5, SIZE, SIZE)),
        ("forces_n", "f8", (4, 3)),
        ("torques_nm", "f8", JOINTS),
        ("saturated", "u1", JOINTS),
    ],
    align=True,
)


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


class WholeBodyState(Record):
    """Where the robot is, and its dynamics there.

    rotation_body_to_map (3, 3), its angles rpy (3,), position_m (3,) of the base, qvel (18,); feet_m (4, 3) in map,
    foot_jacobians (4, 3, 18) and foot_jacobian_rates (4, 3), their change times qvel; mass_matrix (18, 18), bias (18,)
    of Coriolis forces and gravity; touches (4,): which feet are in contact with anything.
    """

    rotation_body_to_map: Float
    rpy: Float
    position_m: Float
    qvel: Float
    feet_m: Float
    foot_jacobians: Float
    foot_jacobian_rates: Float
    mass_matrix: Float
    bias: Float
    touches: Bool

    def __init__(self) -> None:
        super().__init__(_STATE)


class WholeBodyTargets(Record):
    """What is wanted, in map.

    rotation_body_to_map (3, 3): the body then lies on the ground and along the heading, and so do the sides and normals
    of the friction pyramids; body (5, 3): position, velocity, angular velocity, acceleration, angular acceleration;
    stance (4,): which feet stand; feet (3, 4, 3): positions, velocities and accelerations of the others; forces_n
    (4, 3): the MPC's.
    """

    rotation_body_to_map: Float
    body: Float
    feet: Float
    forces_n: Float
    stance: Bool

    def __init__(self) -> None:
        super().__init__(_TARGETS)


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


class WholeBodyControl(Record):
    """Whole-body control, tick after tick. `counts` says how often each status came up, `damped` how often no number.

    The tasks' order is Table 3's: contacts, rotation, translation, swing. The text has the same and counts from 1.
    """

    out: Float
    forces_n: Float
    torques_nm: Float
    saturated: Bool

    def __init__(self, settings: WbcSettings | None = None) -> None:
        super().__init__(_CONTROL)
        self.settings = settings = settings or WbcSettings()
        self.counts: Counter[QpStatus] = Counter()
        self.damped = 0
        record = self.record
        record["task_gains"] = settings.rotation_gains, settings.translation_gains, settings.swing_gains
        record["weights"] = settings.weight_acceleration, settings.weight_force
        record["joint_gains"], record["swing_force_gains"] = settings.joint_gains, settings.swing_force_gains
        record["limits_nm"], record["weakest"] = settings.torque_limit_nm, settings.weakest
        pyramid = settings.mu, settings.f_min_n, settings.f_max_n
        record["pyramid"] = pyramid
        self._qps = [ForceQp(feet, *pyramid) for feet in range(5)]
        self._qddot_cmd = self.out[:, 2]

    def step(self, state: WholeBodyState, targets: WholeBodyTargets) -> WbcCommand:
        """The command, whose arrays are overwritten by the next one."""
        qp = self._qps[int(np.count_nonzero(targets.stance))]
        records = state.record, targets.record, self.record
        weak, is_finite, is_answer = before_qp(*records, qp.hessian, qp.gradient, qp.response, qp.forces_n)
        if is_answer:
            stance_forces_n, status = qp.free_answer
        else:
            along_ground_n = targets.forces_n @ targets.rotation_body_to_map
            stance_forces_n, status = qp.solve(is_finite, along_ground_n, targets.stance)
        is_damped = not joint_torques(*records, qp.response, stance_forces_n)
        self.counts[status] += 1
        self.damped += is_damped
        return WbcCommand(self.torques_nm, self.forces_n, self._qddot_cmd, status, self.saturated, weak, is_damped)

    def mpc_only_torques(self, state: WholeBodyState, targets: WholeBodyTargets) -> tuple[Float, Bool]:
        """Torques (12,) without whole-body control, within the limits, and which were cut; both are overwritten.

        Feet in stance push by the MPC's forces and nothing else, so an error of the MPC shows that whole-body control
        would hide. Feet in swing are drawn to their curves by a spring, with their own leg's inertia fed forward. Legs
        carry their own weight.
        """
        leg_torques(state.record, targets.record, self.record)
        return self.torques_nm, self.saturated
