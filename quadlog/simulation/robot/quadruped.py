"""A simulated quadruped in MuJoCo: the state that controllers read at each tick, and the torques they apply."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from quadlog.compiled import inner, kernel
from quadlog.control.locomotion.wbc import BASE, SIZE, WholeBodyState
from quadlog.messages import Float
from quadlog.simulation.robot.model import QuadrupedModel


@inner
def foot_motion(position, rotation, qvel, first, joints, anchors, axes, foot, jacobian, rate):  # type: ignore[no-untyped-def]
    """Writes a foot's Jacobian (3, 18) and rate (3,), the change of the Jacobian times qvel.

    position (3,) and rotation (3, 3) of the trunk, qvel (18,) as `locomotion.wbc` has it. joints (3,): from the trunk
    down, which of anchors (J, 3) and axes (J, 3), in map; first: where in qvel they begin. foot (3,) in map.
    """
    point, end = _vector(position), _vector(foot)
    omega, alpha, acceleration = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for axis in range(3):
        along = rotation[0, axis], rotation[1, axis], rotation[2, axis]
        jacobian[axis, axis] = 1.0
        _put(_cross(along, _minus(end, point)), jacobian, 3 + axis)
        omega = _plus(omega, _times(qvel[3 + axis], along))
    # While qvel is constant, so is the trunk's velocity in map, and its angular velocity: what it changes by is itself.
    for k in range(3):
        anchor, along = _vector(anchors[joints[k]]), _vector(axes[joints[k]])
        _put(_cross(along, _minus(end, anchor)), jacobian, first + k)
        acceleration = _plus(acceleration, _carried(omega, alpha, _minus(anchor, point)))
        turn = _times(qvel[first + k], along)
        alpha, omega, point = _plus(alpha, _cross(omega, turn)), _plus(omega, turn), anchor
    acceleration = _plus(acceleration, _carried(omega, alpha, _minus(end, point)))
    rate[0], rate[1], rate[2] = acceleration


@inner
def _carried(omega, alpha, arm):  # type: ignore[no-untyped-def]
    """Acceleration of the end of a rotating arm relative to its start."""
    return _plus(_cross(alpha, arm), _cross(omega, _cross(omega, arm)))


@inner
def _vector(array):  # type: ignore[no-untyped-def]
    return array[0], array[1], array[2]


@inner
def _put(vector, matrix, column):  # type: ignore[no-untyped-def]
    matrix[0, column], matrix[1, column], matrix[2, column] = vector


@inner
def _plus(a, b):  # type: ignore[no-untyped-def]
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner
def _minus(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inner
def _times(factor, a):  # type: ignore[no-untyped-def]
    return factor * a[0], factor * a[1], factor * a[2]


@inner
def _cross(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


UNBIASED: Float = np.zeros(3)


class Quadruped:
    """The robot of a model, put on its feet at a place in map.

    read and act take turns. What read returns is the same each time, and overwritten by the next one.
    velocity_bias_mps (3,): error of the velocity in the qvel that its controller reads.
    """

    def __init__(
        self, model: QuadrupedModel, x_m: float, y_m: float, yaw_rad: float, velocity_bias_mps: Float = UNBIASED
    ) -> None:
        self.model, self._velocity_bias_mps = model, velocity_bias_mps
        self.data = mujoco.MjData(model.model)
        self.data.qpos[:] = model.standing_at(x_m, y_m, yaw_rad)
        # The leg of each geom, 4 for those of none.
        self._leg_of_geom = np.full(model.model.ngeom, 4)
        self._leg_of_geom[model.foot_geoms] = range(4)
        self._state, self._mass, self._force = WholeBodyState(), np.zeros((SIZE, SIZE)), np.zeros(6)
        # A robot of the user's may have its legs in another order.
        order = np.concatenate([np.arange(BASE), model.joint_qvel])
        self._places = order, model.model.dof_jntid[model.joint_qvel].reshape(4, 3), model.foot_sites
        # Views into MuJoCo's memory, which stays where it is: each costs more to make than to read.
        data = self.data
        self._views = (
            *(data.qpos, data.qvel, data.qfrc_bias, data.xmat[model.trunk_body].reshape(3, 3)),
            *(data.xanchor, data.xaxis, data.site_xpos),
        )
        self._push_n, self._ctrl, self._is_pushed = data.xfrc_applied[model.trunk_body, :3], data.ctrl, False

    def read(self) -> WholeBodyState:
        """Where the robot is now, and its dynamics there."""
        mujoco.mj_step1(self.model.model, self.data)
        mujoco.mj_fullM(self.model.model, self.data, self._mass)
        # A copy: the view's layout depends on how many contacts there are, and each would be compiled for.
        contacts = self._leg_of_geom, np.ascontiguousarray(self.data.contact.geom)
        _read(*self._views, self._mass, *self._places, *contacts, self._velocity_bias_mps, self._state.record)
        return self._state

    def act(self, torques_nm: Float, push_n: Float | None = None) -> None:
        """Hold the joint torques (12,) for one tick, and push the trunk by a force (3,) in map."""
        self._ctrl[:] = torques_nm
        if push_n is not None or self._is_pushed:
            self._push_n[:], self._is_pushed = 0.0 if push_n is None else push_n, push_n is not None
        mujoco.mj_step2(self.model.model, self.data)

    def foot_loads_n(self) -> Float:
        """(4,) normal force on each foot in the tick before; between act and read only, for read forgets forces."""
        loads = np.zeros(5)
        for i, pair in enumerate(self.data.contact.geom):
            mujoco.mj_contactForce(self.model.model, self.data, i, self._force)
            loads[self._leg_of_geom[pair].min()] += self._force[0]
        return loads[:4]


@kernel
def _read(  # type: ignore[no-untyped-def]
    qpos, qvel, bias, rotation, anchors, axes, sites_m, mass, order, joints, sites, leg_of_geom, contacts, error, state
):
    """Writes a state record, its joints in the order of quadlog's legs."""
    to = state[0]
    for axis in range(3):
        to.position_m[axis] = qpos[axis]
        for j in range(3):
            to.rotation_body_to_map[axis, j] = rotation[axis, j]
    to.rpy[0], to.rpy[1], to.rpy[2] = roll_pitch_yaw(rotation)
    for i in range(SIZE):
        to.qvel[i], to.bias[i] = qvel[order[i]], bias[order[i]]
        for j in range(SIZE):
            to.mass_matrix[i, j] = mass[order[i], order[j]]
    for i in range(BASE, SIZE):
        to.joints_rad[i - BASE] = qpos[order[i] + 1]  # a quaternion has a number more than its rate
    for axis in range(3):
        to.velocity_mps[axis] = qvel[axis]
        to.qvel[axis] += error[axis]
    for leg in range(4):
        to.touches[leg] = 0
    for contact in range(len(contacts)):
        for side in range(2):
            leg = leg_of_geom[contacts[contact, side]]
            if leg < 4:
                to.touches[leg] = 1
    for leg in range(4):
        for axis in range(3):
            to.feet_m[leg, axis] = sites_m[sites[leg], axis]
        motion = to.foot_jacobians[leg], to.foot_jacobian_rates[leg]
        foot_motion(qpos, rotation, to.qvel, BASE + 3 * leg, joints[leg], anchors, axes, to.feet_m[leg], *motion)


@inner
def roll_pitch_yaw(rotation: Float) -> tuple[float, float, float]:
    """Of a rotation body to map (3, 3) = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = math.asin(min(max(-rotation[2, 0], -1.0), 1.0))
    return math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0])
