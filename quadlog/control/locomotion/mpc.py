"""Convex MPC: ground forces that bring the body back to a reference within a horizon [Tracking, section 4.1].

The quadruped is one rigid body on massless legs, linearised about its yaw [eqs 5-14, 22-28, corrected]. With roll,
pitch and omega x (I omega) small: Theta' = T_z^T omega, p' = v, omega' = I^-1 sum(r x f) and v' = sum(f) / m + g, in
Euler steps. Eqs 8 and 14 print T_z for T_z^T, which is right at a yaw of 0 and 180 degrees only: T_z turns from the
heading to map, and omega is in map. Gravity is a term of its own instead of a 13th state.

The state (12,) is Theta = (roll, pitch, yaw), p, omega, v: attitude with R = Rz Ry Rx, then position of the centre of
mass, angular velocity and velocity in map. Lever arms (N, 4, 3) lead from the centre of mass to the feet, in map.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import kernel
from quadlog.control.locomotion.force_qp import Pyramid
from quadlog.messages import GRAVITY_MPS2, Float

STATES = 12
LEVEL: Float = np.eye(3)
"""Level ground, seen along map's axes."""
# All ours, for the paper prints none: steps that are planned ahead, and the length of each, after which forces are
# planned again; and the weights of squared errors, by state in rad, m, rad/s and m/s, and of squared forces in N.
HORIZON, DT_S = 10, 0.03
_ATTITUDE, _POSITION, _ANGULAR, _VELOCITY = (25.0, 25.0, 12.0), (20.0, 20.0, 80.0), (0.15, 0.15, 0.4), (2.0, 2.0, 0.8)
WEIGHTS: Float = np.array([*_ATTITUDE, *_POSITION, *_ANGULAR, *_VELOCITY])
ALPHA = 2e-5


class Mpc:
    """MPC for a body of a mass and an inertia (3, 3) about its centre of mass, in the body's frame.

    solves: how often forces were planned.
    """

    def __init__(self, mass_kg: float, inertia_in_body: Float, pyramid: Pyramid) -> None:
        self.mass_kg, self.pyramid, self.solves = float(mass_kg), pyramid, 0
        self._inverse_in_body = np.linalg.inv(inertia_in_body)
        most = 12 * HORIZON
        shapes = (3, 3), (HORIZON, STATES), (STATES,), (most, STATES)
        self._room = *(np.empty(shape) for shape in shapes), np.empty(most, np.int64)
        self._hessian, self._gradient = np.empty(most * most), np.empty(most)

    def condense(
        self, state: Float, reference: Float, lever_arms_m: Float, contacts: NDArray[np.bool_], ground_to_map: Float
    ) -> tuple[Float, Float]:
        """H (n, n) and g (n,) over the forces of all stance feet, step by step, along the ground's axes; see solve."""
        problem = state, reference, lever_arms_m, contacts, ground_to_map
        body = self._inverse_in_body, self.mass_kg, WEIGHTS, ALPHA, DT_S
        n = _condense(*problem, *body, *self._room, self._hessian, self._gradient)
        return self._hessian[: n * n].reshape(n, n), self._gradient[:n]

    def solve(
        self,
        state: Float,
        reference: Float,
        lever_arms_m: Float,
        contacts: NDArray[np.bool_],
        ground_to_map: Float = LEVEL,
    ) -> Float:
        """Forces (N, 4, 3) in N on the feet, in map, for a state (12,), over N steps of dt from now.

        reference (N, 12): the states wanted at the steps' ends. lever_arms_m (N, 4, 3): in the middle of each step:
        taken at its start, a body at 0.3 m/s is planned 0.6 N m wrong in pitch. contacts (N, 4): which feet stand;
        lever arms of the others are not read. ground_to_map (3, 3): a rotation; its columns are where the friction
        pyramids' sides face and their normal. The yaw of the linear model is the mean over the steps' starts: the
        measured one, then the reference's. Where no solver has an answer, the feet of each step share the weight.
        """
        self.solves += 1
        forces_n: Float = np.zeros((*contacts.shape, 3))
        hessian, gradient = self.condense(state, reference, lever_arms_m, contacts, ground_to_map)
        if len(gradient):
            shared_n = np.zeros_like(forces_n)
            shared_n[..., 2] = self.mass_kg * GRAVITY_MPS2 / np.maximum(contacts.sum(axis=1, keepdims=True), 1)
            found_n = self.pyramid.solve(hessian, gradient, shared_n[contacts] @ ground_to_map)
            forces_n[contacts] = found_n.reshape(-1, 3) @ ground_to_map.T
        return forces_n


@kernel
def _free_errors(state, reference, dt, errors):  # type: ignore[no-untyped-def]
    """Writes what the states would be without forces, less the reference: cosine and sine of the model's yaw."""
    horizon = len(reference)
    # Yaws are unwrapped along the way, so that the reference may jump by whole turns.
    turned, yaw_sum = 0.0, 0.0
    for i in range(horizon):
        yaw_sum += turned
        turn = reference[i, 2] - state[2] - turned
        turned += turn - 2 * math.pi * np.rint(turn / (2 * math.pi))
        errors[i, 2] = -turned
    cos, sin = math.cos(state[2] + yaw_sum / horizon), math.sin(state[2] + yaw_sum / horizon)

    for i in range(horizon):
        t = (i + 1) * dt
        for k in range(12):
            if k != 2:
                errors[i, k] = state[k] - reference[i, k]
        errors[i, 0] += t * (cos * state[6] + sin * state[7])
        errors[i, 1] += t * (cos * state[7] - sin * state[6])
        errors[i, 2] += t * state[8]
        for axis in range(3):
            errors[i, 3 + axis] += t * state[9 + axis]
        errors[i, 5] -= GRAVITY_MPS2 * dt * dt * i * (i + 1) / 2  # Euler's fall
        errors[i, 11] -= GRAVITY_MPS2 * t
    return cos, sin


@kernel
def _condense(  # type: ignore[no-untyped-def]
    state, reference, arms, contacts, axes, inverse_in_body, mass, weights, alpha, dt, inverse, errors, pull, effects,
    steps, hessian, gradient,
):  # fmt: skip
    """Writes H, row by row, and g: how many forces there are.

    The model is nilpotent: of a force's components each has six numbers, the angular acceleration, in the heading's
    frame for Theta, and the acceleration that it gives. At the end of step i a force of step s <= i has made dt times
    these of omega and v, and (i - s) dt^2 times these of Theta and p. So no powers of A are needed.
    """
    horizon = len(reference)
    cos, sin = _free_errors(state, reference, dt, errors)

    # The inverse inertia in map, T_z I^-1 T_z^T.
    for i in range(3):
        a, b, c = inverse_in_body[i, 0], inverse_in_body[i, 1], inverse_in_body[i, 2]
        inverse[i, 0], inverse[i, 1], inverse[i, 2] = cos * a - sin * b, sin * a + cos * b, c
    for j in range(3):
        a, b = inverse[0, j], inverse[1, j]
        inverse[0, j], inverse[1, j] = cos * a - sin * b, sin * a + cos * b

    n = 0
    for step in range(horizon):
        for k in range(12):
            pull[k] = 0.0
            for i in range(step, horizon):
                pull[k] += weights[k] * errors[i, k] * ((i - step) * dt * dt if k < 6 else dt)
        for leg in range(4):
            if not contacts[step, leg]:
                continue
            x, y, z = arms[step, leg, 0], arms[step, leg, 1], arms[step, leg, 2]
            for along in range(3):
                a, b, c = axes[0, along], axes[1, along], axes[2, along]
                moment_x, moment_y, moment_z = y * c - z * b, z * a - x * c, x * b - y * a
                effect = effects[n]
                for k in range(3):
                    effect[6 + k] = inverse[k, 0] * moment_x + inverse[k, 1] * moment_y + inverse[k, 2] * moment_z
                    effect[9 + k] = effect[3 + k] = axes[k, along] / mass
                effect[0] = cos * effect[6] + sin * effect[7]
                effect[1] = cos * effect[7] - sin * effect[6]
                effect[2] = effect[8]
                gradient[n] = 0.0
                for k in range(12):
                    gradient[n] += effect[k] * pull[k]
                    effect[k] *= math.sqrt(weights[k])
                steps[n] = step
                n += 1

    for v in range(n):
        for u in range(v + 1):
            of_place, of_rate = 0.0, 0.0
            for k in range(6):
                of_place += effects[u, k] * effects[v, k]
                of_rate += effects[u, 6 + k] * effects[v, 6 + k]
            # Sums over the states after both steps, `ends` in number: of 1 and of (i - s) (i - s').
            ends, apart = horizon - steps[v], steps[v] - steps[u]
            products = (ends - 1) * ends * (2 * ends - 1) / 6 + apart * (ends - 1) * ends / 2
            both = dt * dt * (ends * of_rate + products * dt * dt * of_place)
            hessian[u * n + v] = hessian[v * n + u] = both
        hessian[v * n + v] += alpha
    return n
