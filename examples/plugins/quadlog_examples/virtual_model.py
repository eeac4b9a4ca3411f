"""Virtual model control: springs and dampers hold the body where it should be, and pull feet in swing to their places.

The wrench that the springs ask for is shared among the feet that stand, by least squares; a leg's torques are then
those of the force on its foot, with gravity and Coriolis forces of its links fed forward.
"""

from __future__ import annotations

import numpy as np

from quadlog.control.locomotion.gait import Gait
from quadlog.control.locomotion.plugged import BodyState, BodyWanted
from quadlog.control.locomotion.robot import Robot
from quadlog.messages import GRAVITY_MPS2, Float

# Per kilogram of the robot: 1/s^2 and 1/s, so that small and large robots are held alike.
BODY, TURN = (30.0, 10.0), (80.0, 10.0)
SWING = (700.0, 25.0)  # of a foot, N/m and N s/m
# Two feet cannot give any wrench: what matters most of force along x, y, z, and of moment about these, per metre.
MATTERS = np.array([0.3, 0.3, 1.0, 10.0, 10.0, 3.0])
FRICTION = 0.6


class VirtualModel:
    """See quadlog.control.locomotion.plugged.Controller. It remembers nothing from one tick to the next."""

    def __init__(self, robot: Robot, gait: Gait) -> None:
        self._robot = robot

    def step(self, t_s: float, state: BodyState, wanted: BodyWanted) -> Float:
        """Torques (12,) for the state at t_s."""
        forces_n = self._stance_forces(state, wanted)
        swing = ~wanted.stance
        pull_n = SWING[0] * (wanted.feet_m - state.feet_m) + SWING[1] * (wanted.feet_mps - state.feet_mps)
        forces_n[swing] = -pull_n[swing]  # what the ground would have to push with
        torques_nm = state.bias[6:].copy()
        for leg in range(4):
            joints = slice(3 * leg, 3 * leg + 3)
            torques_nm[joints] -= state.foot_jacobians[leg][:, 6:][:, joints].T @ forces_n[leg]
        return torques_nm

    def _stance_forces(self, state: BodyState, wanted: BodyWanted) -> Float:
        """(4, 3) of the ground on the feet that stand, within friction; 0 of the others."""
        forces_n = np.zeros((4, 3))
        stance = np.flatnonzero(wanted.stance)
        if not len(stance):
            return forces_n
        # Wrench about base: force, then moment, which each foot's force gives by its lever arm.
        arms_m = state.feet_m[stance] - state.position_m
        wrench = np.concatenate([self._force(state, wanted), self._moment(state, wanted)])
        share = np.hstack([np.vstack([np.eye(3), skew(arm)]) for arm in arms_m])
        found_n = np.linalg.lstsq(MATTERS[:, None] * share, MATTERS * wrench, rcond=1e-3)[0].reshape(-1, 3)
        found_n[:, 2] = np.maximum(found_n[:, 2], 0.0)
        most_n = FRICTION * found_n[:, 2:]
        forces_n[stance] = np.hstack([np.clip(found_n[:, :2], -most_n, most_n), found_n[:, 2:]])
        return forces_n

    def _force(self, state: BodyState, wanted: BodyWanted) -> Float:
        away_m, slow_mps = wanted.position_m - state.position_m, wanted.velocity_mps - state.velocity_mps
        weight_n = np.array([0.0, 0.0, self._robot.mass_kg * GRAVITY_MPS2])
        return weight_n + self._robot.mass_kg * (BODY[0] * away_m + BODY[1] * slow_mps)

    def _moment(self, state: BodyState, wanted: BodyWanted) -> Float:
        """In map; roll and pitch are small, so that angles differ by turns about the heading's own axes."""
        turn_rad = (wanted.rpy_rad - state.rpy_rad + np.pi) % (2 * np.pi) - np.pi
        cos, sin = np.cos(state.rpy_rad[2]), np.sin(state.rpy_rad[2])
        heading = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        omega = state.rotation_body_to_map @ state.angular_radps
        slow_radps = np.array([0.0, 0.0, wanted.yaw_rate_radps]) - omega
        inertia = heading @ self._robot.inertia_kgm2 @ heading.T
        arm_m = state.rotation_body_to_map @ self._robot.centre_of_mass_m
        weight = np.cross(arm_m, [0.0, 0.0, self._robot.mass_kg * GRAVITY_MPS2])
        return weight + inertia @ (TURN[0] * heading @ turn_rad + TURN[1] * slow_radps)


def skew(arm_m: Float) -> Float:
    """(3, 3): times a force it is the moment of that force at the end of arm_m (3,)."""
    x, y, z = arm_m.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
