"""From a wanted speed and yaw rate to joint torques: gait, footholds, MPC and, unless left out, whole-body control."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from quadlog.compiled import inlined, kernel
from quadlog.control.locomotion.body_reference import BodyReference, follow, states_ahead
from quadlog.control.locomotion.force_qp import Pyramid
from quadlog.control.locomotion.gait import GAITS, Gait, Stride, advance, contact_schedule
from quadlog.control.locomotion.mpc import DT_S, HORIZON, STATES, Mpc
from quadlog.control.locomotion.plugged import CheckedController, state_of, wanted_of
from quadlog.control.locomotion.robot import Robot
from quadlog.control.locomotion.wbc import WholeBodyControl, WholeBodyState, WholeBodyTargets
from quadlog.control.settings import MpcSettings
from quadlog.messages import Float

# How fast commands may change: pure pursuit's jump where a path begins and bends.
ACCELERATION_MPS2, YAW_ACCELERATION_RADPS2 = 1.0, 4.0
TURNING_SHARE = 0.6
"""Of the standing robot's inertia, what the MPC takes to turn with the trunk, ours: shanks and feet stay where they
stand. With all of it the MPC asks for half as much moment again as is needed; without whole-body control that tips the
robot over, as fpm on the s-curve."""


@dataclass(frozen=True, slots=True)
class WalkerSettings:
    """gait: of GAITS. clearance_m: how high feet are lifted. whole_body: False pushes by the MPC's forces alone.

    mass_error: share by which the MPC is wrong.
    controller: makes that of a plug-in, whose torques take the place of the MPC's and of whole-body control.
    """

    gait: str = "trot"
    clearance_m: float = 0.09
    whole_body: bool = True
    mass_error: float = 0.0
    mpc: MpcSettings = field(default_factory=MpcSettings)
    controller: Callable[[Robot, Gait], CheckedController] | None = None


class Walker:
    """The controller of one robot, tick after tick.

    wanted (3,): the speeds ahead and to the left and the yaw rate that it is walking at. took_s: what the last tick's
    torques took, without gait and footholds, which all controllers have in common, and without checks of a plug-in's.
    """

    def __init__(self, robot: Robot, settings: WalkerSettings, state: WholeBodyState) -> None:
        self.settings = settings
        self.stride = Stride(robot, GAITS[settings.gait], settings.clearance_m, state.feet_m)
        # The plane lies under the feet's centres.
        height_m = robot.standing_height_m - robot.foot_radius_m
        self.reference = BodyReference(state.position_m, float(state.rpy[2]), height_m)
        mass_kg, inertia_kgm2 = robot.mass_kg * (1 + settings.mass_error), TURNING_SHARE * robot.inertia_kgm2
        self.mpc = Mpc(mass_kg, inertia_kgm2, Pyramid(settings.mpc, robot.mass_kg))
        self.wbc = WholeBodyControl(Pyramid(settings.mpc, robot.mass_kg), robot.torque_limit_nm)
        self.wanted: Float = np.zeros(3)
        self.took_s = 0.0
        self._plugged = None if settings.controller is None else settings.controller(robot, GAITS[settings.gait])
        self._targets = WholeBodyTargets()
        self._centre_m, self._due_s = robot.centre_of_mass_m, 0.0
        shapes = (STATES,), (HORIZON, STATES), (HORIZON, 4, 3)
        self._now, self._ahead, self._arms_m = (np.empty(shape) for shape in shapes)
        self._contacts = np.empty((HORIZON, 4), dtype=np.bool_)

    @property
    def counts(self) -> dict[str, int]:
        """How often forces were planned, how often friction limited a QP, and how often a solver failed.

        Nothing of a plug-in.
        """
        if self._plugged is not None:
            return {}
        qps = {"mpc": self.mpc.pyramid, "wbc": self.wbc.pyramid}
        limits = {f"{name}_{what}": getattr(of, what) for name, of in qps.items() for what in ("limited", "failed")}
        return {"mpc_solves": self.mpc.solves, **limits}

    @property
    def wanted_loads_n(self) -> Float:
        """(4,) what the MPC has the feet push with along the ground's normal; NaN of a plug-in, which says nothing."""
        targets = self._targets
        return targets.forces_n @ targets.rotation_body_to_map[:, 2] if self._plugged is None else np.full(4, np.nan)

    def step(self, t_s: float, dt_s: float, state: WholeBodyState, twist: tuple[float, float, float]) -> Float:
        """Torques (12,) for the tick at t_s, within the limits; overwritten by the next tick.

        twist: the speeds ahead and to the left and the yaw rate to walk at.
        Up to the whole body's targets it is one compiled function; then, when they are due, come the MPC's forces,
        looked ahead by another, and whole-body control, which leaves its compiled function only where friction limits
        the forces.
        """
        targets, wbc = self._targets, self.wbc
        records = state.record, self.stride.record, self.reference.record, targets.record
        changed = _aim(t_s, dt_s, twist, self.wanted, *records)
        if self._plugged is not None:
            given = state_of(state), wanted_of(self.wanted, self.reference, self.stride)
            torques_nm, self.took_s = self._plugged.step(t_s, *given)
            wbc.saturated[:] = abs(torques_nm) > wbc.limits_nm
            wbc.torques_nm[:] = np.clip(torques_nm, -wbc.limits_nm, wbc.limits_nm)
            return wbc.torques_nm
        began_s = time.perf_counter()
        if changed or t_s >= self._due_s:
            problem = self._now, self._ahead, self._arms_m, self._contacts
            _look_ahead(t_s, DT_S, self._centre_m, *records, *problem)
            targets.forces_n[:] = self.mpc.solve(*problem, targets.rotation_body_to_map)[0]
            self._due_s = t_s + DT_S
        torques_nm = wbc.step(state, targets) if self.settings.whole_body else wbc.mpc_only_step(state, targets)
        self.took_s = time.perf_counter() - began_s
        return torques_nm


@kernel
def _aim(t_s, dt_s, twist, wanted, state, stride, reference, targets):  # type: ignore[no-untyped-def]
    """Reference and legs go on to t_s and say what is wanted; True when another set of feet carries than before."""
    now, legs, body, to = state[0], stride[0], reference[0], targets[0]
    for k in range(3):
        most = (YAW_ACCELERATION_RADPS2 if k == 2 else ACCELERATION_MPS2) * dt_s
        wanted[k] += min(max(twist[k] - wanted[k], -most), most)
    place, yaw, velocity = now.position_m, now.rpy[2], now.qvel[:3]
    follow(reference, dt_s, wanted[0], wanted[2], place, yaw, legs.plane, wanted[1])
    changed = advance(stride, t_s, dt_s, now.feet_m, now.touches, place, yaw, velocity, body.velocity_mps, wanted[2])
    _rotate(body.rpy, to.rotation_body_to_map)
    to.body[2, 2] = wanted[2]
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


@kernel
def _look_ahead(t_s, dt_s, centre, state, stride, reference, targets, now, ahead, arms, contacts):  # type: ignore[no-untyped-def]
    """Writes what the MPC plans for: the state now (12,), those wanted ahead (N, 12), lever arms (N, 4, 3), contacts.

    centre (3,): of mass, in the body. A step's contacts are those in its middle, but for the first, which is the
    present. A foot stands where it is or is landing, and a stride farther on once it has been in the air.
    """
    body, legs, to = state[0], stride[0], reference[0]
    rotation, wanted, qvel = body.rotation_body_to_map, targets[0].rotation_body_to_map, body.qvel
    for i in range(3):
        now[i] = body.rpy[i]
        now[3 + i] = rotation[i, 0] * centre[0] + rotation[i, 1] * centre[1] + rotation[i, 2] * centre[2]
        now[6 + i] = rotation[i, 0] * qvel[3] + rotation[i, 1] * qvel[4] + rotation[i, 2] * qvel[5]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        now[9 + i] = qvel[i] + now[6 + j] * now[3 + k] - now[6 + k] * now[3 + j]
    states_ahead(reference, dt_s, ahead)
    contact_schedule(t_s + 0.5 * dt_s, dt_s, legs.period_s, legs.duty, legs.offsets, contacts)
    for axis in range(3):
        now[3 + axis] += body.position_m[axis]
        offset = wanted[axis, 0] * centre[0] + wanted[axis, 1] * centre[1] + wanted[axis, 2] * centre[2]
        # Lever arms start at the body's real place: a reference ahead of it would tilt the robot. They are those of the
        # middle of each step, because forces hold for a whole step; the states ahead are those of the steps' ends.
        to_middle = now[3 + axis] - ahead[0, 3 + axis] - offset + 0.5 * dt_s * to.velocity_mps[axis]
        for leg in range(4):
            contacts[0, leg] = legs.stands[leg]
            foot = legs.contacts_m[leg, axis] if legs.stands[leg] else legs.landings_m[leg, axis]
            stood = legs.stands[leg]
            for step in range(len(ahead)):
                if stood and not contacts[step, leg]:
                    foot, stood = foot + to.velocity_mps[axis] * legs.period_s, False
                arms[step, leg, axis] = foot - (ahead[step, 3 + axis] + offset + to_middle)
        for step in range(len(ahead)):
            ahead[step, 3 + axis] += offset
