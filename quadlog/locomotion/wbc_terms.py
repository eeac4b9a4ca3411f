"""The compiled halves of whole-body control, before its QP and after it [Tracking, eqs 39-44]."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from quadlog.locomotion.null_space import invert_weakly, prioritised

BASE, JOINTS = 6, 12
SIZE = BASE + JOINTS


@njit(cache=True, error_model="numpy")
def commands(  # type: ignore[no-untyped-def]
    rotation,
    position,
    qvel,
    feet,
    jacobians,
    jacobian_rates,
    stance,
    body_rotation,
    body,
    swing,
    gains,
    weakest,
    out,
    room,
):
    """Writes out (18, 3), the columns being the change of q, the velocity and the acceleration commanded.

    Tasks by Table 3: feet in stance do not move; the body turns; the body moves; feet in swing follow their curves.
    jacobians (4, 3, 18) of the feet in map, jacobian_rates (4, 3) their change times qvel; stance (4,) bool.
    body_rotation (3, 3) wanted; body (5, 3): position, velocity, angular velocity, acceleration, angular acceleration
    wanted, all in map; swing (3, 4, 3): positions, velocities and accelerations wanted of the feet. gains (3, 2):
    k_p, k_d of rotation, translation and swing. room (5, 18, 18) to work in. Returns how many tasks are met weakly.

    qvel's angular part is in the body: omega = R qvel[3:6], whose rate is R qacc[3:6], for R' qvel[3:6] = 0.
    Erratum: the first task's acceleration is J^+ (-J' q'), where eq. 40 prints J.
    """
    rows, wanted = room[0], np.zeros((SIZE, 3))
    rows[:] = 0.0
    r = 0
    for leg in range(4):
        if stance[leg]:
            for axis in range(3):
                rows[r] = jacobians[leg, axis]
                wanted[r, 2] = -jacobian_rates[leg, axis]
                r += 1
    contacts = r
    error = rotation_error(body_rotation, rotation)
    for axis in range(3):
        omega = 0.0
        for j in range(3):
            rows[r, 3 + j] = rotation[axis, j]
            omega += rotation[axis, j] * qvel[3 + j]
        wanted[r, 0], wanted[r, 1] = error[axis], body[2, axis]
        wanted[r, 2] = body[4, axis] + gains[0, 0] * error[axis] + gains[0, 1] * (body[2, axis] - omega)
        rows[r + 3, axis] = 1.0
        away = body[0, axis] - position[axis]
        wanted[r + 3, 0], wanted[r + 3, 1] = away, body[1, axis]
        wanted[r + 3, 2] = body[3, axis] + gains[1, 0] * away + gains[1, 1] * (body[1, axis] - qvel[axis])
        r += 1
    r += 3
    for leg in range(4):
        if not stance[leg]:
            for axis in range(3):
                rows[r] = jacobians[leg, axis]
                speed = 0.0
                for j in range(SIZE):
                    speed += rows[r, j] * qvel[j]
                away = swing[0, leg, axis] - feet[leg, axis]
                wanted[r, 0], wanted[r, 1] = away, swing[1, leg, axis]
                feedback = gains[2, 0] * away + gains[2, 1] * (swing[1, leg, axis] - speed)
                wanted[r, 2] = swing[2, leg, axis] + feedback - jacobian_rates[leg, axis]
                r += 1
    ends = np.array([contacts, contacts + 3, contacts + 6, SIZE])
    return prioritised(rows, ends, wanted, weakest, out, room[1], room[2], room[3], room[4])


@njit(cache=True, error_model="numpy")
def rotation_error(wanted, actual):  # type: ignore[no-untyped-def]
    """(3,) rotation vector in map that turns the actual rotation into the wanted one: log(wanted actual^T)."""
    turn = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                turn[i, j] += wanted[i, k] * actual[j, k]
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
    sine = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    angle = math.atan2(sine, (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0) / 2.0)
    return vector * (angle / sine if sine > 1e-12 else 1.0)


@njit(cache=True, error_model="numpy")
def force_cost(  # type: ignore[no-untyped-def]
    mass, bias, jacobians, stance, out, mpc_forces, weights, hessian, gradient, response
):
    """Writes the QP's cost 1/2 f^T hessian f + gradient f over the forces f (3 S,) of the S feet in stance.

    The six rows of the base in eq. 43 say what forces do to it: it accelerates by d = response[:, :3 S] f +
    response[:, 3 S] more than commanded, which is written too, (6, 3 S + 1), and leaves no equality to the QP.
    The cost is weights[0] |d|^2 + weights[1] |f - mpc_forces|^2. False where it is no number.
    """
    n = len(gradient)
    factor = np.zeros((BASE, BASE))
    for i in range(BASE):
        for j in range(i + 1):
            left = mass[i, j]
            for k in range(j):
                left -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(left) if i == j else left / factor[j, j]
    for i in range(BASE):
        response[i, n] = -bias[i]
        for j in range(SIZE):
            response[i, n] -= mass[i, j] * out[j, 2]
    column = 0
    for leg in range(4):
        if stance[leg]:
            for axis in range(3):
                for i in range(BASE):
                    response[i, column] = jacobians[leg, axis, i]
                gradient[column] = -weights[1] * mpc_forces[leg, axis]
                column += 1
    for column in range(n + 1):
        for i in range(BASE):
            for k in range(i):
                response[i, column] -= factor[i, k] * response[k, column]
            response[i, column] /= factor[i, i]
        for i in range(BASE - 1, -1, -1):
            for k in range(i + 1, BASE):
                response[i, column] -= factor[k, i] * response[k, column]
            response[i, column] /= factor[i, i]
    total = 0.0
    for p in range(n):
        for i in range(BASE):
            gradient[p] += weights[0] * response[i, p] * response[i, n]
        for q in range(p + 1):
            dot = 0.0
            for i in range(BASE):
                dot += response[i, p] * response[i, q]
            hessian[p, q] = weights[0] * dot
            hessian[q, p] = hessian[p, q]
        hessian[p, p] += weights[1]
        total += gradient[p] + hessian[p, p]
    return math.isfinite(total)


@njit(cache=True, error_model="numpy")
def joint_torques(  # type: ignore[no-untyped-def]
    mass, bias, jacobians, stance, qvel, out, response, stance_forces, gains, limits, forces, torques, saturated
):
    """Writes torques (12,) by eqs 43 and 44 and which of them the limits (12,) cut; moves out's base acceleration.

    stance_forces (3 S,) of the feet in stance, in a row, become forces (4, 3). gains: k_p, k_d of the joints.
    False when a torque is no number, from an input that was none: then the joints are only damped.
    """
    k = 0
    for leg in range(4):
        for axis in range(3):
            forces[leg, axis] = stance_forces[k] if stance[leg] else 0.0
            k += stance[leg]
    for i in range(BASE):
        more = response[i, len(stance_forces)]
        for k in range(len(stance_forces)):
            more += response[i, k] * stance_forces[k]
        out[i, 2] += more
    is_finite = True
    for joint in range(JOINTS):
        row = BASE + joint
        torque = bias[row]
        for j in range(SIZE):
            torque += mass[row, j] * out[j, 2]
        leg = joint // 3
        for axis in range(3):
            torque -= jacobians[leg, axis, row] * forces[leg, axis]
        torques[joint] = torque + gains[0] * out[row, 0] + gains[1] * (out[row, 1] - qvel[row])
        is_finite = is_finite and math.isfinite(torques[joint])
    if not is_finite:
        for joint in range(JOINTS):
            speed = qvel[BASE + joint]
            torques[joint] = -gains[1] * speed if math.isfinite(speed) else 0.0
    limit(torques, limits, saturated)
    return is_finite


@njit(cache=True, error_model="numpy")
def limit(torques, limits, saturated):  # type: ignore[no-untyped-def]
    """Cuts torques (12,) to +- limits (12,) and writes which of them were cut."""
    for joint in range(JOINTS):
        saturated[joint] = abs(torques[joint]) > limits[joint]
        torques[joint] = min(max(torques[joint], -limits[joint]), limits[joint])


@njit(cache=True, error_model="numpy")
def leg_torques(  # type: ignore[no-untyped-def]
    mass, bias, jacobians, jacobian_rates, qvel, feet, stance, forces, swing, gains, weakest, limits, torques, saturated
):
    """Writes torques (12,) without whole-body control: -J^T f in stance, a spring and its own inertia in swing.

    forces (4, 3) are the ground's on the robot, in map like the Jacobians, so no hip's frame comes in. A leg in swing
    gets J^T (k_p e + k_d e') + M J^-1 (x'' - J' q'), each leg for itself as if the body were held: gains in N/m and
    N s/m, swing (3, 4, 3) and weakest as in commands. Every leg carries its own weight besides (bias).
    """
    inverse = np.empty((3, 3))
    for leg in range(4):
        first = BASE + 3 * leg
        force, acceleration = np.zeros(3), np.zeros(3)
        if not stance[leg]:
            invert_weakly(jacobians[leg, :, first : first + 3], weakest, inverse)
        for axis in range(3):
            if stance[leg]:
                force[axis] = -forces[leg, axis]
                continue
            speed = 0.0
            for j in range(SIZE):
                speed += jacobians[leg, axis, j] * qvel[j]
            force[axis] = gains[0] * (swing[0, leg, axis] - feet[leg, axis]) + gains[1] * (swing[1, leg, axis] - speed)
            for i in range(3):
                acceleration[i] += inverse[i, axis] * (swing[2, leg, axis] - jacobian_rates[leg, axis])
        for joint in range(3 * leg, 3 * leg + 3):
            row = BASE + joint
            torques[joint] = bias[row]
            for axis in range(3):
                torques[joint] += jacobians[leg, axis, row] * force[axis] + mass[row, first + axis] * acceleration[axis]
            if not math.isfinite(torques[joint]):
                torques[joint] = 0.0
    limit(torques, limits, saturated)
