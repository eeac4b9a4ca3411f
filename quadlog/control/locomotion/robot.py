"""Four-legged robots in numbers: masses, lengths and limits, each with the place it comes from.

Legs in the order of LEGS, each with joints in the order of JOINTS; joint 3 * leg + k. The body's frame lies at the
trunk's centre, level with the four hips: x forward, y left, z up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from quadlog.control.locomotion.kinematics import joints_for
from quadlog.messages import Float

LEGS = ("left_fore", "right_fore", "left_hind", "right_hind")
JOINTS = ("abduction", "hip", "knee")
SIDES: Float = np.array([1.0, -1.0, 1.0, -1.0])
"""+1 for a left leg, -1 for a right one."""

# How the links' mass is spread, ours, after common robots: the motors of hip and knee sit about the hip.
_ABDUCTION_BALL_M, _THIGH_RADIUS_M, _SHANK_RADIUS_M = 0.045, 0.045, 0.012
_THIGH_CENTRE = 0.15  # of the thigh's length, below the hip
_SHANK_CENTRE = 0.5


class Link(NamedTuple):
    """A rigid piece: the trunk, or one of a left leg, of which the right leg's is the mirror image.

    centre_m: (3,) its centre of mass from its joint, with all joints at 0; inertia_kgm2: (3,) about that centre, along
    the body's axes.
    """

    mass_kg: float
    centre_m: Float
    inertia_kgm2: Float


@dataclass(frozen=True)
class Robot:
    """What a robot is; see ROBOTS for where the numbers come from.

    trunk_m: length, width and height of the trunk, a box of even density about the body's origin.
    hip_x_m, hip_y_m: where the abduction axes are, forward and aside of the origin.
    lengths_m: L1 aside to the leg's plane, L2 thigh, L3 shank to the foot's centre.
    link_masses_kg: abduction link, thigh, shank, foot, of one leg.
    standing_height_m: the body's origin above level ground.
    hip_centre_m: the middle of the abduction axes in the body, where that is not its origin.
    measured: (3,) centre of mass and (3, 3) inertia about it, standing, used where links have none.
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
    armature_kgm2: float = 0.01
    hip_centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    measured: tuple[Float, Float] | None = field(default=None, compare=False, repr=False)

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

    @cached_property
    def trunk(self) -> Link:
        """The trunk: an even box about the body's origin."""
        return Link(self.trunk_mass_kg, np.zeros(3), _box(self.trunk_mass_kg, *self.trunk_m))

    @cached_property
    def links(self) -> tuple[Link, Link, Link]:
        """A left leg's abduction link (a ball), thigh (a cylinder), and shank (a cylinder) with its foot (a ball)."""
        abduction_kg, thigh_kg, shank_kg, foot_kg = self.link_masses_kg
        aside_m, thigh_m, shank_m = self.lengths_m
        abduction = Link(abduction_kg, np.array([0.0, aside_m / 2, 0.0]), _ball(abduction_kg, _ABDUCTION_BALL_M))
        thigh = Link(thigh_kg, np.array([0.0, 0.0, -_THIGH_CENTRE * thigh_m]), _rod(thigh_kg, _THIGH_RADIUS_M, thigh_m))
        below_m = np.array([-_SHANK_CENTRE * shank_m, -shank_m])
        masses = np.array([shank_kg, foot_kg])
        centre_m = float(masses @ below_m) / (shank_kg + foot_kg)
        apart = float(masses @ (below_m - centre_m) ** 2) * np.array([1.0, 1.0, 0.0])
        inertia = _rod(shank_kg, _SHANK_RADIUS_M, shank_m) + _ball(foot_kg, self.foot_radius_m) + apart
        return abduction, thigh, Link(shank_kg + foot_kg, np.array([0.0, 0.0, centre_m]), inertia)

    @cached_property
    def centre_of_mass_m(self) -> Float:
        """(3,) in the body, standing."""
        return self._standing_masses[0]

    @cached_property
    def inertia_kgm2(self) -> Float:
        """(3, 3) of the whole robot about its centre of mass, along the body's axes, standing.

        The single rigid body of the MPC: it takes the legs as fixed where they stand. What walking moves of it, and
        the rotors, which turn about their own joints only, are left out.
        """
        return self._standing_masses[1]

    @cached_property
    def _standing_masses(self) -> tuple[Float, Float]:
        if self.measured is not None:
            return self.measured
        from quadlog.control.locomotion.leg_dynamics import leg_masses  # it takes a Robot

        legs = [
            leg_masses(self, side, joints[None])
            for side, joints in zip(SIDES, self.standing_joints_rad.reshape(4, 3), strict=True)
        ]
        weights = np.concatenate([[self.trunk.mass_kg], *(leg.masses_kg for leg in legs)])
        hips = zip(self.hips_m, legs, strict=True)
        offsets = np.concatenate([[self.trunk.centre_m], *(hip + leg.centres_m[0] for hip, leg in hips)])
        centre = weights @ offsets / weights.sum()
        offsets -= centre
        own = np.diag(self.trunk.inertia_kgm2) + np.sum([leg.inertias_kgm2[0] for leg in legs], axis=(0, 1))
        apart = np.sum(weights * (offsets**2).sum(axis=1)) * np.eye(3) - (offsets.T * weights) @ offsets
        return centre, own + apart


def _box(mass_kg: float, x_m: float, y_m: float, z_m: float) -> Float:
    return mass_kg / 12 * np.array([y_m**2 + z_m**2, x_m**2 + z_m**2, x_m**2 + y_m**2])


def _ball(mass_kg: float, radius_m: float) -> Float:
    return np.full(3, 0.4 * mass_kg * radius_m**2)


def _rod(mass_kg: float, radius_m: float, length_m: float) -> Float:
    """A cylinder along z."""
    across = mass_kg * (3 * radius_m**2 + length_m**2) / 12
    return np.array([across, across, mass_kg * radius_m**2 / 2])


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

# [unitree_ros, const.xacro]: masses, lengths, hips, the trunk's box, and of the joints' torque limits the least. Ours:
# standing heights, about 0.7 of the leg's length, as these robots stand.
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
)

ROBOTS = {robot.name: robot for robot in (_TRACKING, _FOLLOWING, _FOOT, _GO1, _GO2, _A1, _B1)}
