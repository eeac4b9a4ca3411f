"""The quadruped as one rigid body on massless legs, linearised about its yaw [Tracking, eqs 5-14 and 22-23, corrected].

The state (12,) is Theta = (roll, pitch, yaw), p, omega, v: attitude with R = Rz Ry Rx, then position of the centre of
mass, angular velocity and velocity in map. Forces (4, 3) act on the feet, in map; lever arms (4, 3) lead from the
centre of mass to the feet, in map.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadlog.messages import Float

GRAVITY_MPS2 = 9.81
LEGS = 4
STATES = 12
THETA, POSITION, OMEGA, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


class LinearModel(NamedTuple):
    """A (12, 12), B (12, 12) and gravity (12,) of x' = A x + B u + gravity, u being the forces (4, 3) in a row.

    x' is the derivative of the state in a continuous model, the next state in a discrete one.
    """

    A: Float
    B: Float
    gravity: Float


def continuous_model(mass_kg: float, inertia_in_body: Float, yaw_rad: float, lever_arms_m: Float) -> LinearModel:
    """The body's motion with roll, pitch and omega x (I omega) small, so that Theta' = T_z^T omega.

    [Tracking] eqs 8 and 14 print T_z here, which is right at no yaw but 0 and
    180 degrees: T_z turns from the heading to map, and omega is in map.
    Gravity is its own term (12,), -9.81 on v_z, in place of a 13th state.
    """
    to_map = yaw_rotation(yaw_rad)
    inertia_inverse = np.linalg.inv(to_map @ inertia_in_body @ to_map.T)
    A, B, gravity = np.zeros((STATES, STATES)), np.zeros((STATES, 3 * LEGS)), np.zeros(STATES)
    A[THETA, OMEGA] = to_map.T
    A[POSITION, VELOCITY] = np.eye(3)
    for leg, arm_m in enumerate(lever_arms_m):
        force = slice(3 * leg, 3 * leg + 3)
        B[OMEGA, force] = inertia_inverse @ skew(arm_m)
        B[VELOCITY, force] = np.eye(3) / mass_kg
    gravity[-1] = -GRAVITY_MPS2
    return LinearModel(A, B, gravity)


def discrete_model(continuous: LinearModel, dt_s: float) -> LinearModel:
    """One Euler step [Tracking, eqs 22-23 with gravity's dt]: I + A dt, B dt, gravity dt.

    A is nilpotent, A A = 0, hence I + A dt is the exact transition. For forces
    held over the step the exact response has A B dt^2/2 and A gravity dt^2/2
    besides: half a step's worth of attitude and position, 4.4 mm of free fall
    at 0.03 s, which appear one step later in Euler's prediction.
    """
    return LinearModel(np.eye(STATES) + continuous.A * dt_s, continuous.B * dt_s, continuous.gravity * dt_s)


def yaw_rotation(yaw_rad: float) -> Float:
    """T_z (3, 3), from the heading's frame to map."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def skew(vector: Float) -> Float:
    """The cross product as a matrix (3, 3): skew of a, times b, is a x b."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
