"""Four-legged robots in numbers: masses, lengths and limits, each with the place it comes from.

Legs in the order of LEGS, each with joints in the order of JOINTS; joint 3 * leg + k. The body's frame lies at the
trunk's centre, level with the four hips: x forward, y left, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from quadlog.control.locomotion.kinematics import joints_for
from quadlog.messages import Float

LEGS = ("left_fore", "right_fore", "left_hind", "right_hind")
JOINTS = ("abduction", "hip", "knee")
SIDES: Float = np.array([1.0, -1.0, 1.0, -1.0])
"""+1 for a left leg, -1 for a right one."""


@dataclass(frozen=True)
class Robot:
    """What a robot is; see ROBOTS for where the numbers come from.

    trunk_m: length, width and height of the trunk, a box about the body's origin.
    hip_x_m, hip_y_m: where the abduction axes are, forward and aside of the origin.
    lengths_m: L1 aside to the leg's plane, L2 thigh, L3 shank to the foot's centre.
    link_masses_kg: abduction link, thigh, shank, foot, of one leg; in a robot of a file all its mass is the trunk's.
    standing_height_m: the body's origin above level ground.
    trunk_centre_m, trunk_inertia_kgm2: the trunk's centre of mass, and xx, yy, zz, xy, xz, yz about it, where a maker
    prints them; else it is an even box.
    hip_centre_m: the middle of the abduction axes in the body, where that is not its origin.
    centre_of_mass_m, inertia_kgm2: (3,) in the body and (3, 3) about it, along the body's axes, of the whole robot that
    stands: the single rigid body of the MPC. Known of the robot of a QuadrupedModel, by MuJoCo; else NaN.
    """

    name: str
    trunk_mass_kg: float
    trunk_m: tuple[float, float, float]
    hip_x_m: float
    hip_y_m: float
    lengths_m: tuple[float, float, float]
    link_masses_kg: tuple[float, float, float, float]
    torque_limit_nm: float
    standing_height_m: float
    foot_radius_m: float = 0.02
    trunk_centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    trunk_inertia_kgm2: tuple[float, ...] | None = None
    hip_centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    centre_of_mass_m: Float = field(default_factory=lambda: np.full(3, np.nan), compare=False, repr=False)
    inertia_kgm2: Float = field(default_factory=lambda: np.full((3, 3), np.nan), compare=False, repr=False)

    @property
    def mass_kg(self) -> float:
        """All of it."""
        return self.trunk_mass_kg + 4 * sum(self.link_masses_kg)

    @cached_property
    def lengths(self) -> Float:
        """(3,) L1, L2, L3 in metres."""
        return np.array(self.lengths_m)

    @cached_property
    def hips_m(self) -> Float:
        """(4, 3) where the abduction axes are in the body."""
        forward = np.array([1.0, 1.0, -1.0, -1.0])
        return np.column_stack([self.hip_x_m * forward, self.hip_y_m * SIDES, np.zeros(4)]) + self.hip_centre_m

    @cached_property
    def standing_feet_m(self) -> Float:
        """(4, 3) the feet's centres in the body when it stands: each straight under its leg's plane at the hip."""
        feet = self.hips_m.copy()
        feet[:, 1] += SIDES * self.lengths_m[0]
        feet[:, 2] = self.foot_radius_m - self.standing_height_m
        return feet

    @cached_property
    def standing_joints_rad(self) -> Float:
        """(12,) joint angles of standing_feet_m."""
        joints = np.empty(12)
        reached = joints_for(self.standing_feet_m, self.hips_m, self.lengths, joints)
        if not reached:
            raise ValueError(f"{self.name}: legs of {self.lengths_m} m cannot stand {self.standing_height_m} m high")
        return joints


# [Tracking, Table 4]: mass, trunk box and link lengths. Ours: Table 4 gives neither hips, nor how the mass is shared
# out, nor limits. Its box is the Unitree A1's trunk, so hips, link masses and torque limit follow that robot's
# description, with the trunk's mass made up to the table's total.
_TRACKING = Robot(
    name="tracking",
    trunk_mass_kg=6.01,
    trunk_m=(0.267, 0.194, 0.114),
    hip_x_m=0.1805,
    hip_y_m=0.047,
    lengths_m=(0.075, 0.22, 0.22),
    link_masses_kg=(0.595, 0.888, 0.151, 0.060),
    torque_limit_nm=33.5,
    standing_height_m=0.29,
)

# [Following]: 62 x 26 x 37 cm, 15 kg with its sensors, 48 N m per joint. Ours: the rest, made to fit: the legs' planes
# are 26 cm apart, the trunk's top is 37 cm above ground, links are as heavy as those of robots of that size.
_FOLLOWING = Robot(
    name="following",
    trunk_mass_kg=8.12,
    trunk_m=(0.62, 0.16, 0.12),
    hip_x_m=0.22,
    hip_y_m=0.05,
    lengths_m=(0.08, 0.22, 0.22),
    link_masses_kg=(0.6, 0.9, 0.16, 0.06),
    torque_limit_nm=48.0,
    standing_height_m=0.31,
)

# [Foot, Table 2]: link lengths and body height; its simulation: 10 kg in all, legs of 0.4 kg. Ours: hips, trunk box,
# how a leg's mass is shared out, and a limit far above what standing takes.
_FOOT = Robot(
    name="foot",
    trunk_mass_kg=8.4,
    trunk_m=(0.40, 0.16, 0.10),
    hip_x_m=0.18,
    hip_y_m=0.06,
    lengths_m=(0.07, 0.21, 0.21),
    link_masses_kg=(0.12, 0.18, 0.07, 0.03),
    torque_limit_nm=40.0,
    standing_height_m=0.20,
)

# [unitree_ros, const.xacro]: masses, lengths, hips, the trunk's box, centre and inertia, and of the torque limits
# the least. Ours: standing heights, about 0.7 of the leg's length, as these robots stand.
_GO1 = Robot(
    name="go1",
    trunk_mass_kg=4.8,
    trunk_m=(0.3762, 0.0935, 0.114),
    hip_x_m=0.1881,
    hip_y_m=0.04675,
    lengths_m=(0.08, 0.213, 0.213),
    link_masses_kg=(0.510299, 0.898919, 0.158015, 0.06),
    torque_limit_nm=33.5,
    standing_height_m=0.29,
    trunk_centre_m=(0.011611, 0.004437, 0.000108),
    trunk_inertia_kgm2=(0.016130741919, 0.036507810812, 0.044693872053, 0.000593180607, 7.324662e-06, 2.0969537e-05),
)
_GO2 = Robot(
    name="go2",
    trunk_mass_kg=6.921,
    trunk_m=(0.3762, 0.0935, 0.114),
    hip_x_m=0.1934,
    hip_y_m=0.0465,
    lengths_m=(0.0955, 0.213, 0.213),
    link_masses_kg=(0.678, 1.152, 0.154, 0.06),
    torque_limit_nm=23.7,
    standing_height_m=0.29,
    trunk_centre_m=(0.021112, 0.0, -0.005366),
    trunk_inertia_kgm2=(0.02448, 0.098077, 0.107, 0.00012166, 0.0014849, -3.12e-05),
)
_A1 = Robot(
    name="a1",
    trunk_mass_kg=6.0,
    trunk_m=(0.267, 0.194, 0.114),
    hip_x_m=0.1805,
    hip_y_m=0.047,
    lengths_m=(0.0838, 0.2, 0.2),
    link_masses_kg=(0.595, 0.888, 0.151, 0.06),
    torque_limit_nm=33.5,
    standing_height_m=0.27,
    trunk_centre_m=(0.0, 0.0041, -0.0005),
    trunk_inertia_kgm2=(0.0158533, 0.0377999, 0.0456542, -3.66e-05, -6.11e-05, -2.75e-05),
)
_B1 = Robot(
    name="b1",
    trunk_mass_kg=18.276,
    trunk_m=(0.647, 0.3, 0.15),
    hip_x_m=0.3455,
    hip_y_m=0.072,
    lengths_m=(0.12675, 0.35, 0.35),
    link_masses_kg=(1.998, 3.444, 0.803, 0.05),
    torque_limit_nm=100.0,
    standing_height_m=0.48,
    foot_radius_m=0.04,
    trunk_centre_m=(-0.01, 0.0, 0.0),
    trunk_inertia_kgm2=(0.174426, 0.7001, 0.785955, 0.005544, 0.003278, 7e-06),
)

ROBOTS = {robot.name: robot for robot in (_TRACKING, _FOLLOWING, _FOOT, _GO1, _GO2, _A1, _B1)}
