"""The experiment of [Foot, section 4]: 2 s of rest, then 30 s of a trot whose joints are driven along a foot curve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from quadlog.locomotion.foot_trajectory import PARABOLA, FootCycle
from quadlog.locomotion.kinematics import joints_for
from quadlog.locomotion.robot import Robot
from quadlog.messages import Float, Int
from quadlog.simulation.model_files import without_log
from quadlog.simulation.quadruped_model import QuadrupedModel
from quadlog.simulation.trot_robot import TIMESTEP_S, start_qpos
from quadlog.simulation.walking_robot import FALLEN_HEIGHT_SHARE, FALLEN_TILT_RAD

REST_S, TROT_S = 2.0, 30.0
PERIOD_S, STEP_M, LIFT_M = 1.0, 0.04, 0.02
"""T, S and H [Foot, section 4]; half of the period is swing."""
PAIRS: Int = np.array([0, 1, 1, 0])
"""Of each leg: 0 with the left fore one, 1 with the right fore one."""
SAMPLES_HZ = 50
"""How often a second what the robot does is kept."""
SAMPLE_TICKS = round(1 / (SAMPLES_HZ * TIMESTEP_S))
NS = 1_000_000_000


class OutOfReach(ValueError):
    """The feet are sent to where the legs do not reach."""


@dataclass(frozen=True, slots=True, eq=False)
class TrotWalk:
    """What the robot did, T samples: what columns of control.parquet there are, and MuJoCo's coordinates (T, nq)."""

    t_ns: Int
    position_m: Float
    rpy_rad: Float
    velocity_mps: Float
    yaw_rate_radps: Float
    torques_nm: Float
    loads_n: Float
    fallen: NDArray[np.bool_]
    qpos: Float

    def columns(self) -> dict[str, NDArray[Any]]:
        """By the names of control.parquet. There is no course, hence no reference, no error and no command."""
        three = {
            **dict(zip(("x_m", "y_m", "z_m"), self.position_m.T, strict=True)),
            **dict(zip(("roll_rad", "pitch_rad", "yaw_rad"), self.rpy_rad.T, strict=True)),
            **dict(zip(("vx_mps", "vy_mps"), self.velocity_mps.T, strict=True)),
        }
        return {
            "t_ns": self.t_ns,
            **three,
            "yaw_rate_radps": self.yaw_rate_radps,
            **{f"tau_{joint:02d}_nm": self.torques_nm[:, joint] for joint in range(12)},
            **{f"fz_{leg}_n": self.loads_n[:, leg] for leg in range(4)},
            "fallen": self.fallen,
        }


def joint_targets(plan: Robot, asides_m: Float, power: int = PARABOLA, first_pair: int = 0) -> Float:
    """(N, 12) what every joint is sent to at each tick; raises OutOfReach.

    asides_m: (4,) the peak of each leg's y(t), left positive, and power of its shape; first_pair: of PAIRS, which
    swings first. While it rests the robot already stands as the first step begins, the first pair's feet half a step
    behind.
    """
    ticks = round(PERIOD_S / TIMESTEP_S)
    t_s = np.arange(ticks) * TIMESTEP_S
    feet = np.repeat(plan.standing_feet_m[None], ticks, axis=0)
    for leg in range(4):
        cycle = FootCycle(PERIOD_S, STEP_M, LIFT_M, aside_m=float(asides_m[leg]), power=power)
        later_s = 0.0 if PAIRS[leg] == first_pair else PERIOD_S / 2
        feet[:, leg] += cycle.at(t_s + later_s)[0]
    joints = np.empty((ticks, 12))
    for tick in range(ticks):
        if not joints_for(feet[tick], plan.hips_m, plan.lengths, joints[tick]):
            raise OutOfReach(f"a foot {1e3 * float(np.abs(asides_m).max()):.0f} mm aside is out of the legs' reach")
    resting = np.zeros(round(REST_S / TIMESTEP_S), np.int64)
    trotting = np.arange(round(TROT_S / TIMESTEP_S)) % ticks
    return joints[np.concatenate([resting, trotting])]


def walk_trot(model: QuadrupedModel, targets: Float, posture_rad: Float) -> TrotWalk:
    """The whole experiment, joints sent to targets (N, 12), from joints that are posture_rad (12,) beside the first.

    A fall is a result.
    """
    data, world = mujoco.MjData(model.model), model.model
    data.qpos[:] = start_qpos(model, targets[0] + posture_rad)
    controls = np.zeros_like(targets)
    controls[:, model.actuators] = targets
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(world, full))
    mujoco.mj_getState(world, data, start, full)
    with without_log():
        states, sensors = rollout.rollout(world, data, start, controls)
    return sampled(model, start, states[0], sensors[0])


def sampled(model: QuadrupedModel, start: Float, states: Float, sensors: Float) -> TrotWalk:
    """Samples of states (N, ...) after each tick, beginning before the first; loads and torques of the tick before."""
    nq, nv = model.model.nq, model.model.nv
    kept = np.vstack([start, states[SAMPLE_TICKS - 1 :: SAMPLE_TICKS]])
    felt = np.vstack([np.zeros(sensors.shape[1]), sensors[SAMPLE_TICKS - 1 :: SAMPLE_TICKS]])
    qpos, qvel = kept[:, 1 : 1 + nq], kept[:, 1 + nq : 1 + nq + nv]
    w, x, y, z = qpos[:, 3:7].T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    cos, sin, (vx, vy) = np.cos(yaw), np.sin(yaw), qvel[:, :2].T
    # The third row of the body's rotation: how fast it turns about map's z.
    upward = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    tilt = np.maximum(np.abs(roll), np.abs(pitch))
    down = (qpos[:, 2] < FALLEN_HEIGHT_SHARE * model.robot.standing_height_m) | (tilt > FALLEN_TILT_RAD)
    return TrotWalk(
        t_ns=np.arange(len(kept), dtype=np.int64) * (NS // SAMPLES_HZ),
        position_m=qpos[:, :3],
        rpy_rad=np.column_stack([roll, pitch, yaw]),
        velocity_mps=np.column_stack([cos * vx + sin * vy, cos * vy - sin * vx]),
        yaw_rate_radps=(upward * qvel[:, 3:6]).sum(axis=1),
        torques_nm=felt[:, model.actuators],
        loads_n=felt[:, 12:16],
        fallen=np.logical_or.accumulate(down),
        qpos=qpos,
    )
