"""A simulated quadruped, one tick after the other: what controllers read of it, and what they do to it."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.locomotion.wbc import WholeBodyState
from quadlog.messages import Float
from quadlog.simulation.quadruped_model import QuadrupedModel

JOINTS, DOF = 12, 18


class Quadruped:
    """The robot of a model, put on its feet at a place in map.

    read and act take turns. The arrays that read returns are overwritten by the next one.
    """

    def __init__(self, model: QuadrupedModel, x_m: float, y_m: float, yaw_rad: float) -> None:
        self.model = model
        self.data = mujoco.MjData(model.model)
        self.data.qpos[:] = model.standing_at(x_m, y_m, yaw_rad)
        # The leg of each geom, 4 for those of none.
        self._leg_of_geom = np.full(model.model.ngeom, 4)
        self._leg_of_geom[model.foot_geoms] = range(4)
        self._sites = [int(site) for site in model.foot_sites]
        self._bodies = [int(body) for body in model.foot_bodies]
        self._mass = np.zeros((DOF, DOF))
        self._jacobians, self._jacobian_rates, self._rates = (
            np.zeros((4, 3, DOF)),
            np.zeros((4, 3, DOF)),
            np.zeros((4, 3)),
        )
        self._feet, self._force = np.zeros((4, 3)), np.zeros(6)
        # Views into MuJoCo's memory, which stays where it is: each costs more to make than to read.
        data = self.data
        self._qpos, self._qvel, self._bias, self._site_xpos = data.qpos, data.qvel, data.qfrc_bias, data.site_xpos
        self._trunk_xmat = data.xmat[model.trunk_body].reshape(3, 3)
        self._push_n, self._ctrl = data.xfrc_applied[model.trunk_body, :3], data.ctrl

    def read(self) -> WholeBodyState:
        """Where the robot is now, and its dynamics there."""
        m, d = self.model.model, self.data
        mujoco.mj_step1(m, d)
        mujoco.mj_fullM(m, d, self._mass)
        self._site_xpos.take(self._sites, axis=0, out=self._feet, mode="clip")
        for leg in range(4):
            mujoco.mj_jacSite(m, d, self._jacobians[leg], None, self._sites[leg])
            mujoco.mj_jacDot(m, d, self._jacobian_rates[leg], None, self._feet[leg], self._bodies[leg])
        _times(self._jacobian_rates, self._qvel, self._rates)
        return WholeBodyState(
            self._trunk_xmat,
            self._qpos[:3].copy(),
            self._qvel.copy(),
            self._feet,
            self._jacobians,
            self._rates,
            self._mass,
            self._bias,
        )

    def touches(self) -> NDArray[np.bool_]:
        """(4,) which feet are in contact with anything."""
        touching = np.zeros(5, dtype=np.bool_)
        touching[self._leg_of_geom[self.data.contact.geom]] = True
        return touching[:4]

    def act(self, torques_nm: Float, push_n: Float | None = None) -> None:
        """Hold the joint torques (12,) for one tick, and push the trunk by a force (3,) in map."""
        self._ctrl[self.model.actuators] = torques_nm
        self._push_n[:] = 0.0 if push_n is None else push_n
        mujoco.mj_step2(self.model.model, self.data)

    def foot_loads_n(self) -> Float:
        """(4,) normal force on each foot in the tick before; between act and read only, for read forgets forces."""
        loads = np.zeros(5)
        for i, pair in enumerate(self.data.contact.geom):
            mujoco.mj_contactForce(self.model.model, self.data, i, self._force)
            loads[self._leg_of_geom[pair].min()] += self._force[0]
        return loads[:4]


@njit(cache=True, error_model="numpy")
def _times(jacobian_rates, qvel, rates):  # type: ignore[no-untyped-def]
    """Writes rates (4, 3), the change of each foot's Jacobian times qvel."""
    for leg in range(4):
        for axis in range(3):
            rates[leg, axis] = 0.0
            for j in range(len(qvel)):
                rates[leg, axis] += jacobian_rates[leg, axis, j] * qvel[j]


def roll_pitch_yaw(rotation: Float) -> tuple[float, float, float]:
    """Of a rotation body to map (3, 3) = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = math.asin(min(max(-float(rotation[2, 0]), -1.0), 1.0))
    return math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0])
