"""The quadruped as one rigid body on massless legs, linearised about its yaw [Tracking, eqs 5-14 and 22-23, corrected].

With roll, pitch and omega x (I omega) small: Theta' = T_z^T omega, p' = v, omega' = I^-1 sum(r x f) and
v' = sum(f) / m + g, in Euler steps. Eqs 8 and 14 print T_z for T_z^T, which is right at a yaw of 0 and 180 degrees
only: T_z turns from the heading to map, and omega is in map. Gravity is a term of its own instead of a 13th state.

The state (12,) is Theta = (roll, pitch, yaw), p, omega, v: attitude with R = Rz Ry Rx, then position of the centre of
mass, angular velocity and velocity in map. Forces (4, 3) act on the feet, in map; lever arms (4, 3) lead from the
centre of mass to the feet, in map.
"""

from __future__ import annotations

import math

import numpy as np

from quadlog.compiled import inlined, inner, kernel

GRAVITY_MPS2 = 9.81
LEGS = 4
STATES = 12


@kernel
def build_cost(state, reference, lever_arms_m, contacts, mass_kg, inverse_in_body, weights, alpha, dt_s):  # type: ignore[no-untyped-def]
    """H (n, n), g (n,) and whether they are finite, n being 3 for each stance foot of each step, in that order.

    State (12,), reference (N, 12) for the ends of the steps, lever arms (N, 4, 3),
    contacts (N, 4), the inverse inertia (3, 3) in the body, weights (12,) of the state.
    """
    errors, yaw_rad = free_errors(state, reference, dt_s)
    to_map = np.zeros((3, 3))
    to_map[0, 0] = to_map[1, 1] = math.cos(yaw_rad)
    to_map[1, 0], to_map[0, 1] = math.sin(yaw_rad), -math.sin(yaw_rad)
    to_map[2, 2] = 1.0
    to_body = to_map.T.copy()
    inverse_in_map = _product(_product(to_map, inverse_in_body), to_body)
    arms, steps = stance_feet(lever_arms_m, contacts)
    g = _gradient(errors, weights, to_map, inverse_in_map, arms, steps, mass_kg, dt_s)
    H = _hessian(contacts.shape[0], weights, to_body, inverse_in_map, arms, steps, mass_kg, alpha, dt_s)
    # In a sum of magnitudes no inf or nan can cancel.
    total = np.abs(errors).sum()
    for row in range(g.shape[0]):
        total += abs(g[row])
        for column in range(g.shape[0]):
            total += abs(H[row, column])
    return H, g, math.isfinite(total)


@inner
def free_errors(state, reference, dt_s):  # type: ignore[no-untyped-def]
    """What the states (N, 12) would be without forces, less the reference; and the yaw the model is linearised at.

    That yaw is the mean over the states from which the N steps start: the
    measured one, then the reference's. Yaws are unwrapped along this way, so
    the reference may jump by whole turns.
    """
    horizon = reference.shape[0]
    errors = np.empty((horizon, 12))
    turned, yaw_sum = 0.0, 0.0
    for step in range(horizon):
        yaw_sum += turned
        turn = reference[step, 2] - state[2] - turned
        turned += turn - 2 * math.pi * np.rint(turn / (2 * math.pi))
        errors[step, 2] = -turned
    yaw_rad = state[2] + yaw_sum / horizon
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    for step in range(horizon):
        t = (step + 1) * dt_s
        errors[step, 0] = state[0] - reference[step, 0] + t * (cos * state[6] + sin * state[7])
        errors[step, 1] = state[1] - reference[step, 1] + t * (cos * state[7] - sin * state[6])
        errors[step, 2] += t * state[8]
        for axis in range(3):
            errors[step, 3 + axis] = state[3 + axis] - reference[step, 3 + axis] + t * state[9 + axis]
        for k in range(6, 12):
            errors[step, k] = state[k] - reference[step, k]
        # Euler's fall: g dt^2 times 0 + 1 + ... + step.
        errors[step, 5] -= GRAVITY_MPS2 * dt_s * dt_s * step * (step + 1) / 2
        errors[step, 11] -= GRAVITY_MPS2 * t
    return errors, yaw_rad


@inner
def stance_feet(lever_arms_m, contacts):  # type: ignore[no-untyped-def]
    """The feet that carry: lever arms (m, 3) and steps (m,), step by step and leg by leg."""
    count = 0
    arms, steps = np.empty((contacts.size, 3)), np.empty(contacts.size, np.int64)
    for step in range(contacts.shape[0]):
        for leg in range(contacts.shape[1]):
            if contacts[step, leg]:
                for axis in range(3):
                    arms[count, axis] = lever_arms_m[step, leg, axis]
                steps[count] = step
                count += 1
    return arms[:count], steps[:count]


@kernel
def in_pyramid(forces, mu, f_min, f_max, tolerance):  # type: ignore[no-untyped-def]
    """Whether forces (n,) keep |fx|, |fy| <= mu fz and f_min <= fz <= f_max; no nan does."""
    for foot in range(forces.shape[0] // 3):
        x, y, z = forces[3 * foot], forces[3 * foot + 1], forces[3 * foot + 2]
        side = mu * z + tolerance
        if not (abs(x) <= side and abs(y) <= side and f_min - tolerance <= z <= f_max + tolerance):
            return False
    return True


@inner
def _gradient(errors, weights, to_map, inverse_in_map, arms, steps, mass_kg, dt_s):  # type: ignore[no-untyped-def]
    """B^T Q errors, by the adjoint: what a change of the state after a step costs, from the last step to the first."""
    g = np.empty(3 * arms.shape[0])
    adjoint, torque = np.zeros(12), np.empty(3)
    foot = arms.shape[0] - 1
    for step in range(errors.shape[0] - 1, -1, -1):
        # A^T: omega turns attitude by T_z^T, whose transpose is T_z.
        for axis in range(3):
            for k in range(3):
                adjoint[6 + axis] += dt_s * to_map[axis, k] * adjoint[k]
            adjoint[9 + axis] += dt_s * adjoint[3 + axis]
        for k in range(12):
            adjoint[k] += weights[k] * errors[step, k]
        # B^T: inverse_in_map is symmetric.
        for axis in range(3):
            torque[axis] = 0.0
            for k in range(3):
                torque[axis] += dt_s * inverse_in_map[axis, k] * adjoint[6 + k]
        while foot >= 0 and steps[foot] == step:
            x, y, z = arms[foot]
            g[3 * foot] = dt_s / mass_kg * adjoint[9] + torque[1] * z - torque[2] * y
            g[3 * foot + 1] = dt_s / mass_kg * adjoint[10] + torque[2] * x - torque[0] * z
            g[3 * foot + 2] = dt_s / mass_kg * adjoint[11] + torque[0] * y - torque[1] * x
            foot -= 1
    return g


@inner
def _hessian(horizon, weights, to_body, inverse_in_map, arms, steps, mass_kg, alpha, dt_s):  # type: ignore[no-untyped-def]
    """B^T Q B + alpha, in 3x3 blocks [r_u]^T M [r_v] + diagonal for each pair of feet u, v and their steps."""
    to_theta = _product(to_body, inverse_in_map)
    theta_cost, omega_cost = np.zeros((3, 3)), np.zeros((3, 3))
    for row in range(3):
        for column in range(3):
            for k in range(3):
                theta_cost[row, column] += to_theta[k, row] * weights[k] * to_theta[k, column]
                omega_cost[row, column] += inverse_in_map[k, row] * weights[6 + k] * inverse_in_map[k, column]

    count = arms.shape[0]
    H = np.empty((3 * count, 3 * count))
    cost, turned = np.empty((3, 3)), np.empty((3, 3))
    for v in range(count):
        last = -1
        for u in range(v + 1):
            if steps[u] != last:
                last = steps[u]
                at_once, later = _step_pair(horizon, steps[u], steps[v], dt_s)
                for row in range(3):
                    for column in range(3):
                        cost[row, column] = at_once * omega_cost[row, column] + later * theta_cost[row, column]
                _times_skew(cost, arms[v], turned)
            # [r]^T = -[r]: each column of `turned` crossed with the arm.
            x, y, z = arms[u]
            for column in range(3):
                H[3 * u, 3 * v + column] = turned[1, column] * z - turned[2, column] * y
                H[3 * u + 1, 3 * v + column] = turned[2, column] * x - turned[0, column] * z
                H[3 * u + 2, 3 * v + column] = turned[0, column] * y - turned[1, column] * x
            for axis in range(3):
                H[3 * u + axis, 3 * v + axis] += (at_once * weights[9 + axis] + later * weights[3 + axis]) / mass_kg**2
        for axis in range(3):
            H[3 * v + axis, 3 * v + axis] += alpha
    for row in range(3 * count):
        for column in range(row):
            H[row, column] = H[column, row]
    return H


@inlined
def _step_pair(horizon, early, late, dt_s):  # type: ignore[no-untyped-def]
    """Over the states after both steps, the sums of 1 (omega, v) and (i - early - 1)(i - late - 1) dt^2, times dt^2."""
    states, apart = horizon - late, late - early
    # k (k + apart) for k = i - late - 1 from 0 to states - 1.
    products = (states - 1) * states * (2 * states - 1) / 6 + apart * (states - 1) * states / 2
    return dt_s**2 * states, dt_s**4 * products


@inlined
def _times_skew(matrix, arm, out):  # type: ignore[no-untyped-def]
    """To `out` matrix @ skew(arm): each row crossed with the arm."""
    x, y, z = arm
    for row in range(3):
        a, b, c = matrix[row]
        out[row, 0] = b * z - c * y
        out[row, 1] = c * x - a * z
        out[row, 2] = a * y - b * x


@inner
def _product(a, b):  # type: ignore[no-untyped-def]
    out = np.zeros((3, 3))
    for row in range(3):
        for column in range(3):
            for k in range(3):
                out[row, column] += a[row, k] * b[k, column]
    return out
