"""The compiled halves of whole-body control, before its QP and after it [Tracking, eqs 39-44].

state, targets and control are the records of WholeBodyState, WholeBodyTargets and WholeBodyControl (`wbc`).
What a single compiled function calls is put into it ("inline"), so that it is not optimised twice.
"""

from __future__ import annotations

import math

import numpy as np

from quadlog.compiled import inlined, inner, kernel
from quadlog.locomotion.force_qp import free_minimum, solve_positive
from quadlog.locomotion.mpc_build import in_pyramid
from quadlog.locomotion.null_space import invert_weakly, prioritised

BASE, JOINTS = 6, 12
SIZE = BASE + JOINTS


@kernel
def before_qp(state, targets, control, hessian, gradient, response, forces):  # type: ignore[no-untyped-def]
    """Commands, the QP's cost (see force_cost), and the forces (3 S,) at its free minimum.

    Returns how many tasks are met weakly, whether the cost is a number, and whether those forces are the answer: they
    are, mostly, within the friction pyramid.
    """
    mu, f_min, f_max = control[0].pyramid
    weak = commands(state, targets, control)
    is_finite = force_cost(state, targets, control, hessian, gradient, response)
    free_minimum(hessian, gradient, forces)
    return weak, is_finite, is_finite and in_pyramid(forces, mu, f_min, f_max, 0.0)


@inlined
def commands(state, targets, control):  # type: ignore[no-untyped-def]
    """Writes the control's out (18, 3): the change of q, the velocity and the acceleration commanded.

    Tasks by Table 3: feet in stance do not move; the body turns; the body moves; feet in swing follow their curves.
    Returns how many tasks are met weakly.

    qvel's angular part is in the body: omega = R qvel[3:6], whose rate is R qacc[3:6], for R' qvel[3:6] = 0.
    Erratum: the first task's acceleration is J^+ (-J' q'), where eq. 40 prints J.
    """
    now, to, room, gains = state[0], targets[0], control[0].room, control[0].task_gains
    rotation, qvel = now.rotation_body_to_map, now.qvel
    jacobians, jacobian_rates = now.foot_jacobians, now.foot_jacobian_rates
    stance, body, swing = to.stance, to.body, to.feet
    rows, wanted = room[0], np.zeros((SIZE, 3))
    rows[:] = 0.0
    r = 0
    for leg in range(4):
        if stance[leg]:
            for axis in range(3):
                for j in range(SIZE):
                    rows[r, j] = jacobians[leg, axis, j]
                wanted[r, 2] = -jacobian_rates[leg, axis]
                r += 1
    contacts = r
    error = rotation_error(to.rotation_body_to_map, rotation)
    for axis in range(3):
        omega = 0.0
        for j in range(3):
            rows[r, 3 + j] = rotation[axis, j]
            omega += rotation[axis, j] * qvel[3 + j]
        wanted[r, 0], wanted[r, 1] = error[axis], body[2, axis]
        wanted[r, 2] = body[4, axis] + gains[0, 0] * error[axis] + gains[0, 1] * (body[2, axis] - omega)
        rows[r + 3, axis] = 1.0
        away = body[0, axis] - now.position_m[axis]
        wanted[r + 3, 0], wanted[r + 3, 1] = away, body[1, axis]
        wanted[r + 3, 2] = body[3, axis] + gains[1, 0] * away + gains[1, 1] * (body[1, axis] - qvel[axis])
        r += 1
    r += 3
    for leg in range(4):
        if not stance[leg]:
            for axis in range(3):
                speed = 0.0
                for j in range(SIZE):
                    rows[r, j] = jacobians[leg, axis, j]
                    speed += rows[r, j] * qvel[j]
                away = swing[0, leg, axis] - now.feet_m[leg, axis]
                wanted[r, 0], wanted[r, 1] = away, swing[1, leg, axis]
                feedback = gains[2, 0] * away + gains[2, 1] * (swing[1, leg, axis] - speed)
                wanted[r, 2] = swing[2, leg, axis] + feedback - jacobian_rates[leg, axis]
                r += 1
    ends = np.array([contacts, contacts + 3, contacts + 6, SIZE])
    weakest, out = control[0].weakest, control[0].out
    return prioritised(rows, ends, wanted, weakest, out, room[1], room[2], room[3], room[4])


@inner
def rotation_error(wanted, actual):  # type: ignore[no-untyped-def]
    """x, y, z in map of the rotation vector from the actual rotation to the wanted one: log(wanted actual^T)."""
    turn = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                turn[i, j] += wanted[i, k] * actual[j, k]
    x, y, z = (turn[2, 1] - turn[1, 2]) / 2.0, (turn[0, 2] - turn[2, 0]) / 2.0, (turn[1, 0] - turn[0, 1]) / 2.0
    sine = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0) / 2.0)
    longer = angle / sine if sine > 1e-12 else 1.0
    return longer * x, longer * y, longer * z


@inlined
def force_cost(state, targets, control, hessian, gradient, response):  # type: ignore[no-untyped-def]
    """Writes the QP's cost 1/2 f^T hessian f + gradient f over the forces f (3 S,) of the S feet in stance.

    The six rows of the base in eq. 43 say what forces do to it: it accelerates by d = response[:, :3 S] f +
    response[:, 3 S] more than commanded, which is written too, (6, 3 S + 1), and leaves no equality to the QP.
    The cost is weights[0] |d|^2 + weights[1] |f - targets' forces|^2. False where it is no number.
    """
    mass, jacobians, stance = state[0].mass_matrix, state[0].foot_jacobians, targets[0].stance
    out, weights = control[0].out, control[0].weights
    n = len(gradient)
    for i in range(BASE):
        response[i, n] = -state[0].bias[i]
        for j in range(SIZE):
            response[i, n] -= mass[i, j] * out[j, 2]
    column = 0
    for leg in range(4):
        if stance[leg]:
            for axis in range(3):
                for i in range(BASE):
                    response[i, column] = jacobians[leg, axis, i]
                gradient[column] = -weights[1] * targets[0].forces_n[leg, axis]
                column += 1
    # A view has the type of any other array: the field itself would have another, and be compiled for by itself.
    solve_positive(mass[:], response)
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


@kernel
def joint_torques(state, targets, control, response, stance_forces):  # type: ignore[no-untyped-def]
    """Writes the control's torques (12,) by eqs 43 and 44, forces (4, 3), and out's acceleration with what they add.

    stance_forces (3 S,) of the feet in stance, in a row. False when a torque is no number, from an input that was
    none: then the joints are only damped.
    """
    mass, bias, qvel, jacobians = state[0].mass_matrix, state[0].bias, state[0].qvel, state[0].foot_jacobians
    stance, gains, out = targets[0].stance, control[0].joint_gains, control[0].out
    forces, torques = control[0].forces_n, control[0].torques_nm
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
    _limit(control)
    return is_finite


@inner
def _limit(control):  # type: ignore[no-untyped-def]
    """Cuts the torques to their limits and writes which of them were cut."""
    torques, limits = control[0].torques_nm, control[0].limits_nm
    for joint in range(JOINTS):
        control[0].saturated[joint] = abs(torques[joint]) > limits[joint]
        torques[joint] = min(max(torques[joint], -limits[joint]), limits[joint])


@kernel
def leg_torques(state, targets, control):  # type: ignore[no-untyped-def]
    """Writes the control's torques (12,) without its tasks: -J^T f in stance, a spring and its own inertia in swing.

    The targets' forces are the ground's on the robot, in map like the Jacobians, so no hip's frame comes in. A leg in
    swing gets J^T (k_p e + k_d e') + M J^-1 (x'' - J' q'), each leg for itself as if the body were held: gains in N/m
    and N s/m, weakest as in commands. Every leg carries its own weight besides (bias).
    """
    now, stance, swing = state[0], targets[0].stance, targets[0].feet
    mass, jacobians = now.mass_matrix, now.foot_jacobians
    gains, torques = control[0].swing_force_gains, control[0].torques_nm
    inverse = np.empty((3, 3))
    for leg in range(4):
        first = BASE + 3 * leg
        force, acceleration = np.zeros(3), np.zeros(3)
        if not stance[leg]:
            invert_weakly(jacobians[leg, :, first : first + 3], control[0].weakest, inverse)
        for axis in range(3):
            if stance[leg]:
                force[axis] = -targets[0].forces_n[leg, axis]
                continue
            speed = 0.0
            for j in range(SIZE):
                speed += jacobians[leg, axis, j] * now.qvel[j]
            away = swing[0, leg, axis] - now.feet_m[leg, axis]
            force[axis] = gains[0] * away + gains[1] * (swing[1, leg, axis] - speed)
            for i in range(3):
                acceleration[i] += inverse[i, axis] * (swing[2, leg, axis] - now.foot_jacobian_rates[leg, axis])
        for joint in range(3 * leg, 3 * leg + 3):
            row = BASE + joint
            torques[joint] = now.bias[row]
            for axis in range(3):
                torques[joint] += jacobians[leg, axis, row] * force[axis] + mass[row, first + axis] * acceleration[axis]
            if not math.isfinite(torques[joint]):
                torques[joint] = 0.0
    _limit(control)
