"""From a wanted speed and yaw rate to joint torques: gait, footholds, MPC and, unless left out, whole-body control."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from quadlog.compiled import inlined, kernel
from quadlog.control.locomotion.body_reference import BodyReference, WantedMotion, follow
from quadlog.control.locomotion.gait import GAITS, Bool, Stride, advance
from quadlog.control.locomotion.mpc import Mpc, MpcSettings
from quadlog.control.locomotion.mpc_model import STATES
from quadlog.control.locomotion.robot import Robot
from quadlog.control.locomotion.wbc import WbcSettings, WholeBodyControl, WholeBodyState, WholeBodyTargets
from quadlog.messages import Float


@dataclass(frozen=True, slots=True)
class WalkerSettings:
    """gait: of GAITS. swing and aside_m: as Stride has them. whole_body: False pushes by the MPC's forces alone.

    mass_error: share by which the MPC is wrong.
    turning_share: of the standing robot's inertia, what the MPC takes to turn with the trunk: shanks and feet stay
    where they stand. With all of it the MPC asks for half as much moment again as is needed; without whole-body control
    that tips the robot over.
    mpc_every_s: how often forces are planned again; besides, whenever another set of feet carries.
    """

    gait: str = "trot"
    clearance_m: float = 0.09
    swing: str = "quintic"
    aside_m: float = 0.0
    whole_body: bool = True
    mpc_every_s: float = 0.03
    mass_error: float = 0.0
    turning_share: float = 0.6
    mpc: MpcSettings = field(default_factory=MpcSettings)
    wbc: WbcSettings = field(default_factory=WbcSettings)


class Walker:
    """The controller of one robot, tick after tick."""

    def __init__(self, robot: Robot, settings: WalkerSettings, state: WholeBodyState) -> None:
        self.settings = settings
        self._robot = robot
        curve = settings.swing, settings.aside_m
        self.stride = Stride(robot, GAITS[settings.gait], settings.clearance_m, state.feet_m, *curve)
        # The plane lies under the feet's centres.
        height_m = robot.standing_height_m - robot.foot_radius_m
        self.reference = BodyReference(state.position_m, float(state.rpy[2]), height_m)
        inertia_kgm2 = settings.turning_share * robot.inertia_kgm2
        self.mpc = Mpc(robot.mass_kg * (1 + settings.mass_error), inertia_kgm2, settings.mpc)
        self.wbc = WholeBodyControl(settings.wbc)
        self._targets = WholeBodyTargets()
        self._centre_m = robot.centre_of_mass_m
        self._due_s = 0.0
        horizon = settings.mpc.horizon
        self._ahead, self._contacts = np.zeros((horizon, STATES)), np.zeros((horizon, 4), dtype=np.bool_)
        self._arms_m = np.zeros((horizon, 4, 3))

    def step(self, t_s: float, dt_s: float, state: WholeBodyState, wanted: WantedMotion) -> tuple[Float, Bool]:
        """Torques (12,) for the tick at t_s, within the limits, and which were cut; both are overwritten by the next.

        Up to the whole body's targets it is one compiled function; then, when they are due, come the MPC's forces, and
        whole-body control, with a compiled function on either side of its QP.
        """
        targets = self._targets
        records = state.record, self.stride.record, self.reference.record, targets.record
        changed = _aim(t_s, dt_s, wanted.speed_mps, wanted.yaw_rate_radps, *records)
        if changed or t_s >= self._due_s:
            self._plan_forces(t_s, state)
            self._due_s = t_s + self.settings.mpc_every_s
        if not self.settings.whole_body:
            return self.wbc.mpc_only_torques(state, targets)
        command = self.wbc.step(state, targets)
        return command.torques_nm, command.saturated

    def _plan_forces(self, t_s: float, state: WholeBodyState) -> None:
        settings, stride = self.settings.mpc, self.stride
        rotation = state.rotation_body_to_map
        offset_m = rotation @ self._centre_m
        omega = rotation @ state.qvel[3:6]
        (wx, wy, wz), (x, y, z) = omega.tolist(), offset_m.tolist()
        turning_mps = np.array([wy * z - wz * y, wz * x - wx * z, wx * y - wy * x])
        now = np.concatenate([state.rpy, state.position_m + offset_m, omega, state.qvel[:3] + turning_mps])
        self.reference.ahead(settings.dt_s, self._ahead)
        self._ahead[:, 3:6] += self._targets.rotation_body_to_map @ self._centre_m
        # The linear model's yaw must not jump where the angle does.
        self._ahead[:, 2] += now[2] - self._ahead[0, 2] + _wrapped(self._ahead[0, 2] - now[2])
        stride.contacts_ahead(t_s, settings.dt_s, self._contacts)
        # Lever arms start at the body's real place: a reference ahead of it would tilt the robot. They are those of the
        # middle of each step, because forces hold for a whole step; the states ahead are those of the steps' ends.
        to_middle_m = now[3:6] - self._ahead[0, 3:6] + 0.5 * settings.dt_s * self.reference.velocity_mps
        self._arms_m[:] = self._feet_ahead_m() - (self._ahead[:, None, 3:6] + to_middle_m)
        # The reference lies on the ground and along the heading: so do the sides of the friction pyramids.
        ground_to_map = self._targets.rotation_body_to_map
        solution = self.mpc.solve(now, self._ahead, self._arms_m, self._contacts, ground_to_map)
        self._targets.forces_n[:] = solution.forces_n

    def _feet_ahead_m(self) -> Float:
        """(N, 4, 3) where each foot stands in each step: where it is, where it is landing, or a stride farther on."""
        stride = self.stride
        stride_m = self.reference.velocity_mps * GAITS[self.settings.gait].period_s
        # A foot that stands now is a stride on once it has been in the air.
        has_left = ~np.logical_and.accumulate(self._contacts, axis=0) & stride.stands
        feet_m = np.where(stride.stands[:, None], stride.contacts_m, stride.landings_m)
        return feet_m + has_left[:, :, None] * stride_m


@kernel
def _aim(t_s, dt_s, speed, yaw_rate, state, stride, reference, targets):  # type: ignore[no-untyped-def]
    """Reference and legs go on to t_s and say what is wanted; True when another set of feet carries than before."""
    now, legs, body, to = state[0], stride[0], reference[0], targets[0]
    place, yaw, velocity = now.position_m, now.rpy[2], now.qvel[:3]
    follow(reference, dt_s, speed, yaw_rate, place, yaw, legs.plane)
    changed = advance(stride, t_s, dt_s, now.feet_m, now.touches, place, yaw, velocity, body.velocity_mps, yaw_rate)
    _rotate(body.rpy, to.rotation_body_to_map)
    to.body[2, 2] = yaw_rate
    for axis in range(3):
        to.body[0, axis], to.body[1, axis] = body.position_m[axis], body.velocity_mps[axis]
    for leg in range(4):
        to.stance[leg] = legs.stands[leg]
        for order in range(3):
            for axis in range(3):
                to.feet[order, leg, axis] = legs.swing[order, leg, axis]
    return changed


@inlined
def _rotate(rpy: Float, rotation: Float) -> None:
    """Writes (3, 3) body to map of roll, pitch, yaw."""
    cr, cp, cy = math.cos(rpy[0]), math.cos(rpy[1]), math.cos(rpy[2])
    sr, sp, sy = math.sin(rpy[0]), math.sin(rpy[1]), math.sin(rpy[2])
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = -sp, cp * sr, cp * cr


def _wrapped(angle_rad: float) -> float:
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
