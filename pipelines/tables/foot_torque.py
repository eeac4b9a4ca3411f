"""foot-torque: what legs and gravity do to a trotting body, by corrected formulas [Foot, Fig. 3, eqs 7-12]."""

from __future__ import annotations

import numpy as np

from quadlog.control.locomotion import leg_dynamics as legs
from quadlog.control.locomotion.foot_trajectory import FootCycle
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.messages import GRAVITY_MPS2, Float
from quadlog.pipelines.tables.claims import Claim, Figures, Group, Study, StudyTable
from quadlog.pipelines.tables.judge import EXACT, always, beyond, number, rests

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


def torques_of(side: float, carried_kg: float) -> Float:
    """(N, 3) joint torques over a stance, from touch-down to lift-off."""
    feet = legs.stance_feet(side, ROBOT.lengths, HEIGHT_M, STRIDE_M, 101)
    joints = legs.stance_joints(feet, side, ROBOT.lengths, legs.KNEE_BEHIND)
    return legs.stance_torques(joints, ground_force(carried_kg), side, ROBOT.lengths)


def touch_down_about_diagonal() -> float:
    """N m about the diagonal, backwards positive, as left fore and right hind foot touch down under half the body each.

    The couples at both hips, and the forces there about the middle between the feet.
    """
    force, ahead = ground_force(ROBOT.mass_kg / 2), np.array([STRIDE_M / 2, 0.0, -HEIGHT_M])
    moment = np.zeros(3)
    for leg, side in ((0, LEFT), (3, RIGHT)):
        moment += legs.hip_reaction(legs.stance_feet(side, ROBOT.lengths, HEIGHT_M, STRIDE_M, 2)[:1], force)[0]
        moment += np.cross(ROBOT.hips_m[leg] - ahead, force)
    # From right to left: turning about it is tipping backwards for the body's own -y.
    axis = -np.array([LENGTH_M, WIDTH_M, 0.0]) / np.hypot(LENGTH_M, WIDTH_M)
    return float(moment @ axis)


def swing_hip_reaction(gravity_mps2: float, period_s: float = PERIOD_S) -> Float:
    """(N,) N m on the body about the hip's own axis while a leg swings as in eq. 9, without its y.

    Stride, period and height are Table 2's, the lift is section 4's.
    """
    cycle = FootCycle(period_s, STRIDE_M, LIFT_M)
    t_s = np.linspace(0.0, cycle.swing_share * period_s, SWING_POINTS)
    feet = cycle.at(t_s) + np.array([0.0, RIGHT * ROBOT.lengths_m[0], -HEIGHT_M])
    joints = legs.stance_joints(feet, RIGHT, ROBOT.lengths, legs.KNEE_BEHIND)
    # Straight under the leg's plane, the hip's axis is the body's -y.
    return -legs.swing_reaction(ROBOT, RIGHT, t_s, joints, gravity_mps2)[:, 1]


def measure() -> Figures:
    """Everything; torques in N m."""
    leg = torques_of(RIGHT, LEG_KG)
    swing = float(swing_hip_reaction(GRAVITY_MPS2)[: SWING_POINTS // 2 + 1].mean())
    standing = ROBOT.standing_joints_rad[3:6]
    mass_kg, behind_m = legs.mass_behind(ROBOT, RIGHT, standing)
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
