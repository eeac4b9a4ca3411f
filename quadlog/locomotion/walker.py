"""From a wanted speed and yaw rate to joint torques: gait, footholds, MPC and, unless left out, whole-body control."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from quadlog.locomotion.body_reference import BodyReference, WantedMotion
from quadlog.locomotion.centroidal import STATES
from quadlog.locomotion.gait import GAITS
from quadlog.locomotion.mpc import Mpc, MpcSettings
from quadlog.locomotion.robot import Robot
from quadlog.locomotion.stride import Bool, Stride
from quadlog.locomotion.wbc import WbcSettings, WholeBodyControl, WholeBodyState, WholeBodyTargets, mpc_only_torques
from quadlog.messages import Float

# Of the standing robot's inertia, the share that turns with the trunk: shanks and feet stay where they stand. With all
# of it the MPC asks for half as much moment again as is needed; without whole-body control that tips the robot over.
TURNING_SHARE = 0.6


@dataclass(frozen=True, slots=True)
class WalkerSettings:
    """gait: of GAITS. whole_body: False pushes by the MPC's forces alone. mass_error: share by which the MPC is wrong.

    mpc_every_s: how often forces are planned anew; besides, whenever another set of feet carries.
    """

    gait: str = "trot"
    clearance_m: float = 0.09
    whole_body: bool = True
    mpc_every_s: float = 0.03
    mass_error: float = 0.0
    mpc: MpcSettings = field(default_factory=MpcSettings)
    wbc: WbcSettings = field(default_factory=WbcSettings)


class Walker:
    """The controller of one robot, tick after tick."""

    def __init__(
        self, robot: Robot, settings: WalkerSettings, state: WholeBodyState, rpy: tuple[float, float, float]
    ) -> None:
        self.settings = settings
        self._robot = robot
        self.stride = Stride(robot, GAITS[settings.gait], settings.clearance_m, state.feet_m)
        # The plane lies under the feet's centres.
        height_m = robot.standing_height_m - robot.foot_radius_m
        self.reference = BodyReference(state.position_m, rpy[2], height_m)
        self.mpc = Mpc(robot.mass_kg * (1 + settings.mass_error), TURNING_SHARE * robot.inertia_kgm2, settings.mpc)
        self.wbc = WholeBodyControl(settings.wbc)
        self._centre_m = robot.centre_of_mass_m
        self._due_s = 0.0
        self._forces_n: Float = np.zeros((4, 3))
        horizon = settings.mpc.horizon
        self._ahead, self._contacts = np.zeros((horizon, STATES)), np.zeros((horizon, 4), dtype=np.bool_)
        self._arms_m = np.zeros((horizon, 4, 3))
        self._body: Float = np.zeros((5, 3))
        self._rotation: Float = np.eye(3)

    @property
    def forces_n(self) -> Float:
        """(4, 3) that the MPC wants of the ground."""
        return self._forces_n

    def step(
        self,
        t_s: float,
        dt_s: float,
        state: WholeBodyState,
        rpy: tuple[float, float, float],
        touches: Bool,
        wanted: WantedMotion,
    ) -> tuple[Float, Bool]:
        """Torques (12,) for the tick at t_s, within the limits, and which of them were cut."""
        reference, stride = self.reference, self.stride
        reference.step(dt_s, wanted, state.position_m, rpy[2], stride.plane)
        changed = stride.step(
            t_s,
            dt_s,
            state.feet_m,
            touches,
            state.position_m,
            rpy[2],
            state.qvel[:3],
            reference.velocity_mps,
            wanted.yaw_rate_radps,
        )
        if changed or t_s >= self._due_s:
            self._plan_forces(t_s, state, rpy)
            self._due_s = t_s + self.settings.mpc_every_s
        body = self._body
        body[0], body[1], body[2, 2] = reference.position_m, reference.velocity_mps, reference.yaw_rate_radps
        _rotate(reference.rpy, self._rotation)
        targets = WholeBodyTargets(self._rotation, body, stride.swing)
        if not self.settings.whole_body:
            return mpc_only_torques(state, targets, stride.stands, self._forces_n, self.settings.wbc)
        command = self.wbc.step(state, targets, stride.stands, self._forces_n)
        return command.torques_nm, command.saturated

    def _plan_forces(self, t_s: float, state: WholeBodyState, rpy: tuple[float, float, float]) -> None:
        settings, stride = self.settings.mpc, self.stride
        rotation = state.rotation_body_to_map
        offset_m = rotation @ self._centre_m
        omega = rotation @ state.qvel[3:6]
        (wx, wy, wz), (x, y, z) = omega.tolist(), offset_m.tolist()
        turning_mps = np.array([wy * z - wz * y, wz * x - wx * z, wx * y - wy * x])
        now = np.concatenate([rpy, state.position_m + offset_m, omega, state.qvel[:3] + turning_mps])
        self.reference.ahead(settings.dt_s, self._ahead)
        _rotate(self.reference.rpy, self._rotation)
        self._ahead[:, 3:6] += self._rotation @ self._centre_m
        # The linear model's yaw must not jump where the angle does.
        self._ahead[:, 2] += now[2] - self._ahead[0, 2] + _wrapped(self._ahead[0, 2] - now[2])
        stride.contacts_ahead(t_s, settings.dt_s, self._contacts)
        # From where the body is, not from where it should be: a reference ahead of it would tilt the robot. And as it
        # is amid each step, for whose length the forces hold; the states ahead are those of the steps' ends.
        to_middle_m = now[3:6] - self._ahead[0, 3:6] + 0.5 * settings.dt_s * self.reference.velocity_mps
        self._arms_m[:] = self._feet_ahead_m() - (self._ahead[:, None, 3:6] + to_middle_m)
        self._forces_n = self.mpc.solve(now, self._ahead, self._arms_m, self._contacts).forces_n

    def _feet_ahead_m(self) -> Float:
        """(N, 4, 3) where each foot stands in each step: where it is, where it is landing, or a stride farther on."""
        stride = self.stride
        stride_m = self.reference.velocity_mps * GAITS[self.settings.gait].period_s
        # A foot that stands now is a stride on once it has been in the air.
        has_left = ~np.logical_and.accumulate(self._contacts, axis=0) & stride.stands
        feet_m = np.where(stride.stands[:, None], stride.contacts_m, stride.landings_m)
        return feet_m + has_left[:, :, None] * stride_m


@njit(cache=True, error_model="numpy")
def _rotate(rpy: Float, rotation: Float) -> None:
    """Writes (3, 3) body to map of roll, pitch, yaw."""
    cr, cp, cy = math.cos(rpy[0]), math.cos(rpy[1]), math.cos(rpy[2])
    sr, sp, sy = math.sin(rpy[0]), math.sin(rpy[1]), math.sin(rpy[2])
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = -sp, cp * sr, cp * cr


def _wrapped(angle_rad: float) -> float:
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
