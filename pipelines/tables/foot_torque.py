"""foot-torque: what legs and gravity do to a trotting body, by corrected formulas [Foot, Fig. 3, eqs 7-12]."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from quadlog.control.locomotion.kinematics import leg_inverse, leg_jacobian
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.messages import GRAVITY_MPS2, Float
from quadlog.pipelines.simulation.trot import FootCycle
from quadlog.pipelines.tables.claims import Claim, Figures, Group, Study, StudyTable
from quadlog.pipelines.tables.judge import EXACT, always, beyond, number, rests
from quadlog.simulation.robot.height_field import flat
from quadlog.simulation.robot.model import quadruped_model

ROBOT = ROBOTS["foot"]
LEG_KG, HEIGHT_M, STRIDE_M, PERIOD_S, ACCELERATION_MPS2 = 0.5, 0.2, 0.05, 0.5, 0.08
"""Table 2; the links' lengths are the robot's."""
WALK_STRIDE_M, LIFT_M = 0.04, 0.02
"""Section 4; its robot weighs 10 kg, which Table 2 does not say."""
RIGHT, LEFT = -1.0, 1.0
SWING_POINTS = 401
LENGTH_M, WIDTH_M = 2 * ROBOT.hip_x_m, 2 * (ROBOT.hip_y_m + ROBOT.lengths_m[0])
"""Between the feet: L_x and L_y + 2 L1."""


def ground_force(carried_kg: float) -> Float:
    """(3,) what the ground pushes a support foot with: it carries that mass and speeds it up."""
    return carried_kg * np.array([ACCELERATION_MPS2, 0.0, GRAVITY_MPS2])


def stance_feet(side: float, count: int) -> Float:
    """(count, 3) a foot from its hip, half a stride ahead to half a stride behind, under its leg's plane [eq. 5]."""
    ahead_m = np.linspace(STRIDE_M / 2, -STRIDE_M / 2, count)
    return np.column_stack([ahead_m, np.full(count, side * ROBOT.lengths_m[0]), np.full(count, -HEIGHT_M)])


def joints_of(feet_m: Float, side: float) -> Float:
    """(N, 3) joints for feet (N, 3) from the hip, the knee behind as an elbow [eq. 3, corrected]."""
    joints = np.empty((len(feet_m), 3))
    for row, foot in zip(joints, feet_m, strict=True):
        leg_inverse(foot, side, ROBOT.lengths, row)
    return joints


def stance_torques(joints_rad: Float, force_n: Float, side: float) -> Float:
    """(N, 3) motor torques in N m of joints (N, 3) that hold a force (3,) of the ground on the foot [eq. 6].

    torque = -J' force: motors and ground do no work together on links without mass.
    """
    torques, jacobian = np.empty((len(joints_rad), 3)), np.empty((3, 3))
    for row, joints in zip(torques, joints_rad, strict=True):
        leg_jacobian(joints, side, ROBOT.lengths, jacobian)
        row[:] = -jacobian.T @ force_n
    return torques


def torques_of(side: float, carried_kg: float) -> Float:
    """(N, 3) joint torques over a stance, from touch-down to lift-off [eqs 5 and 6]."""
    return stance_torques(joints_of(stance_feet(side, 101), side), ground_force(carried_kg), side)


def touch_down_about_diagonal() -> float:
    """N m about the diagonal, backwards positive, as left fore and right hind foot touch down under half the body each.

    The couples with which the legs turn the body at its hips, and the forces there about the middle between the feet.
    """
    force, ahead = ground_force(ROBOT.mass_kg / 2), np.array([STRIDE_M / 2, 0.0, -HEIGHT_M])
    moment = np.zeros(3)
    for leg, side in ((0, LEFT), (3, RIGHT)):
        moment += np.cross(stance_feet(side, 2)[0] + ROBOT.hips_m[leg] - ahead, force)
    # From right to left: turning about it is tipping backwards for the body's own -y.
    axis = -np.array([LENGTH_M, WIDTH_M, 0.0]) / np.hypot(LENGTH_M, WIDTH_M)
    return float(moment @ axis)


def swing_hip_reaction(gravity_mps2: float, period_s: float = PERIOD_S) -> Float:
    """(N,) N m on the body about the hip's own axis while the right fore leg swings as in eq. 9, without its y.

    What MuJoCo's inverse dynamics ask of the hip's motor, taken backwards. Stride, period and height are Table 2's, the
    lift is section 4's.
    """
    cycle, own = FootCycle(period_s, STRIDE_M, LIFT_M), slice(3, 6)
    t_s = np.linspace(0.0, cycle.swing_share * period_s, SWING_POINTS)
    feet = cycle.at(t_s) + np.array([0.0, RIGHT * ROBOT.lengths_m[0], -HEIGHT_M])
    spline = CubicSpline(t_s, joints_of(feet, RIGHT))
    quadruped = quadruped_model(ROBOT, flat())
    model, data = quadruped.model, mujoco.MjData(quadruped.model)
    model.opt.gravity[2], model.dof_armature[:] = -gravity_mps2, 0.0
    data.qpos[2] = 1.0  # no foot touches the ground
    qpos, qvel = quadruped.joint_qpos[own], quadruped.joint_qvel[own]
    asked = np.empty(SWING_POINTS)
    for k, at_s in enumerate(t_s):
        data.qpos[qpos], data.qvel[qvel], data.qacc[qvel] = (spline(at_s, order) for order in range(3))
        mujoco.mj_inverse(model, data)
        asked[k] = data.qfrc_inverse[qvel[1]]
    return -asked


def mass_behind() -> tuple[float, float]:
    """Mass m in kg and d in metres [eq. 7]: thigh and shank of a standing leg, and how far behind its hip."""
    quadruped = quadruped_model(ROBOT, flat())
    model, data = quadruped.model, mujoco.MjData(quadruped.model)
    data.qpos[quadruped.joint_qpos] = ROBOT.standing_joints_rad
    mujoco.mj_forward(model, data)
    thigh = model.body("right_fore_thigh").id
    return float(model.body_subtreemass[thigh]), float(data.xpos[thigh, 0] - data.subtree_com[thigh, 0])


def measure() -> Figures:
    """Everything; torques in N m."""
    leg = torques_of(RIGHT, LEG_KG)
    swing = float(swing_hip_reaction(GRAVITY_MPS2)[: SWING_POINTS // 2 + 1].mean())
    mass_kg, behind_m = mass_behind()
    ahead_m = -4 * mass_kg * behind_m / ROBOT.mass_kg
    return {
        "tau 1, abduction (N m)": float(leg[0, 0]),
        "hip's torque, tau 2: sign at touch-down (1)": float(np.sign(leg[0, 1])),
        "hip's torque, tau 2: sign at lift-off (1)": float(np.sign(leg[-1, 1])),
        "support hip's reaction: sign at touch-down (1)": float(np.sign(-leg[0, 1])),
        "support hip's reaction: sign at lift-off (1)": float(np.sign(-leg[-1, 1])),
        "touch-down, about the diagonal: sign of both (1)": float(np.sign(round(touch_down_about_diagonal(), 9))),
        "swing hip's reaction, first half: sign (1)": float(np.sign(swing)),
        "way of a stance with the centre of mass behind the diagonal (1)": float(
            np.clip((WALK_STRIDE_M / 2 - ahead_m) / WALK_STRIDE_M, 0.0, 1.0)
        ),
    }


FORMULAS = "By construction: a sign of the paper's own formulas with its own numbers."
POSITIVE, NEGATIVE = rests(beyond(0.0), FORMULAS), rests(beyond(0.0, above=False), FORMULAS)
ABDUCTION = "By eqs 5 and 6 it is -P_y f_z = L1 m g: the foot stands L1 beside the abduction axis."
BACKWARDS = (
    "Claimed: the hips tip it backwards. The ground pushes at the feet, on the diagonal itself, without a lever."
)
AGAINST = "Claimed: against the support hip's. What speeds the leg up is; its weight, behind the hip, does more."
BEHIND = "Claimed: to the back. The body moves 40 mm over its feet, past the diagonal; eq. 7 takes it as standing."
JUDGED = {
    "tau 1, abduction (N m)": (number(0.0, 0.01), ABDUCTION),
    "hip's torque, tau 2: sign at touch-down (1)": (NEGATIVE, ""),
    "hip's torque, tau 2: sign at lift-off (1)": (POSITIVE, ""),
    "support hip's reaction: sign at touch-down (1)": (POSITIVE, ""),
    "support hip's reaction: sign at lift-off (1)": (NEGATIVE, ""),
    "touch-down, about the diagonal: sign of both (1)": (beyond(0.0), BACKWARDS),
    "swing hip's reaction, first half: sign (1)": (beyond(0.0, above=False), AGAINST),
    "way of a stance with the centre of mass behind the diagonal (1)": (always(), BEHIND),
}


def table(fast: bool, seed: int) -> StudyTable:
    """The same for every seed, and with fast."""
    del fast, seed
    return StudyTable(
        title="Torques of a trotting robot [Foot, Fig. 3, eqs 7 to 12]",
        caption="From the joint torques of a support leg, their reaction on the body, and gravity about the support "
        "diagonal the paper derives a foot that swings sideways. Here its formulas are worked out, corrected, with its "
        "numbers. It prints Fig. 3 as curves, and otherwise words: a sign of +1 or -1 stands for what it says.",
        sizes="Nothing is drawn at random: one value each, the same for every seed, and with --fast.",
        study=Study(measure, [{}]),
        groups=[
            Group(
                "Printed numbers and claims",
                "The right fore leg of Table 2, knee behind, from 25 mm ahead of its hip to 25 mm behind; "
                "f = (m a, 0, m g), m = 0.5 kg, links without mass. A sign of +1 tips the body backwards. Touch-down: "
                "left fore and right hind foot with 5 kg each. Swing: eq. 9 without y(t), lifted 20 mm. Last "
                "row: section 4's robot of 10 kg over a stance of 40 mm.",
                [Claim(name, name, {}, judge, EXACT, why_not=why) for name, (judge, why) in JUDGED.items()],
            ),
        ],
    )
