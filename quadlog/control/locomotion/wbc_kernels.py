"""The whole-body controller's compiled part: the forces of the feet in stance by a small strictly convex QP that
always gives an answer, and the joints' torques [Tracking, eqs 24-31].
"""

from __future__ import annotations

import math
from enum import StrEnum

import daqp
import numpy as np
import quadprog
from numpy.typing import NDArray

from quadlog.compiled import inlined, inner, kernel
from quadlog.control.locomotion.mpc_model import in_pyramid
from quadlog.control.locomotion.null_space import invert_weakly, prioritised
from quadlog.messages import Float

OPTIMAL = 1  # daqp's exit flag
FREE = 1e30  # daqp's infinity
FEASIBLE_N = 1e-6
"""A solver's answer that leaves the pyramid by more than this is a failure."""


class QpStatus(StrEnum):
    """Where the forces come from."""

    SOLVED = "solved"
    SECOND_SOLVER = "second solver"  # quadprog, as daqp failed
    PROJECTED = "projected"  # both failed: the MPC's forces, moved into the pyramid
    FLIGHT = "flight"  # no foot stands: nothing to solve


class ForceQp:
    """min 1/2 f^T hessian f + gradient f over the forces f (3 S,) of S feet, each within its friction pyramid.

    |fx|, |fy| <= mu fz and f_min <= fz <= f_max, along the ground's axes: z is its normal, x the heading along it. Who
    uses it fills hessian (3 S, 3 S), gradient (3 S,) and response (6, 3 S + 1), of which the QP itself knows nothing.
    Where the forces (3 S,) of the free minimum keep to the pyramids they are the answer, and no solver is asked.
    """

    def __init__(self, feet: int, mu: float, f_min_n: float, f_max_n: float) -> None:
        self.hessian, self.gradient = np.empty((3 * feet, 3 * feet)), np.empty(3 * feet)
        self.response, self.forces_n = np.empty((6, 3 * feet + 1)), np.empty(3 * feet)
        self._mu, self._f_min_n, self._f_max_n = mu, f_min_n, f_max_n
        sides = np.array([[1.0, 0.0, -mu], [-1.0, 0.0, -mu], [0.0, 1.0, -mu], [0.0, -1.0, -mu]])
        self._sides = np.kron(np.eye(feet), sides)
        self._upper = np.concatenate([np.tile([FREE, FREE, f_max_n], feet), np.zeros(4 * feet)])
        self._lower = np.concatenate([np.tile([-FREE, -FREE, f_min_n], feet), np.full(4 * feet, -FREE)])
        self._sense = np.zeros(7 * feet, dtype=np.int32)
        normal = np.kron(np.eye(feet), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        # fz >= 0 follows from the sides, and its own row would make the tip degenerate.
        normal = normal if f_min_n > 0 else normal[1::2]
        limits = [f_min_n, -f_max_n] if f_min_n > 0 else [-f_max_n]
        self._columns = np.asfortranarray(np.concatenate([-self._sides, normal]).T)
        self._at_least = np.concatenate([np.zeros(4 * feet), np.tile(limits, feet)])

    @property
    def free_answer(self) -> tuple[Float, QpStatus]:
        """Where the free minimum is the answer: its forces (3 S,), and where they come from."""
        return self.forces_n, QpStatus.SOLVED if len(self.forces_n) else QpStatus.FLIGHT

    def solve(self, is_finite: bool, mpc_forces_n: Float, stance: NDArray[np.bool_]) -> tuple[Float, QpStatus]:
        """Forces (3 S,) along the ground's axes, and where they come from.

        is_finite: hessian and gradient are numbers, which no solver should be asked otherwise. mpc_forces_n (4, 3),
        along the ground's axes, of the feet in stance (4,), stand in where no solver gives any.
        """
        if is_finite:
            forces_n = self._daqp()
            if forces_n is not None:
                return forces_n, QpStatus.SOLVED
            forces_n = self._quadprog()
            if forces_n is not None:
                return forces_n, QpStatus.SECOND_SOLVER
        return self._projected(mpc_forces_n[stance]), QpStatus.PROJECTED

    def _daqp(self) -> Float | None:
        problem = (self.hessian, self.gradient, self._sides, self._upper, self._lower, self._sense)
        forces_n, _, flag, _ = daqp.solve(*problem)
        return forces_n if flag == OPTIMAL and self._is_feasible(forces_n) else None

    def _quadprog(self) -> Float | None:
        try:
            forces_n = quadprog.solve_qp(self.hessian, -self.gradient, self._columns, self._at_least)[0]
        except ValueError:  # a Hessian that is not positive definite to quadprog
            return None
        return forces_n if self._is_feasible(forces_n) else None

    def _is_feasible(self, forces_n: Float) -> bool:
        return bool(in_pyramid(forces_n, self._mu, self._f_min_n, self._f_max_n, FEASIBLE_N))

    def _projected(self, forces_n: Float) -> Float:
        """Each normal force (S, 3) into its range, then the others to the sides; what is no number becomes 0."""
        forces = np.nan_to_num(forces_n)
        forces[:, 2] = np.clip(forces[:, 2], self._f_min_n, self._f_max_n)
        side = self._mu * forces[:, 2:]
        forces[:, :2] = np.clip(forces[:, :2], -side, side)
        return forces.ravel()


@inlined
def free_minimum(hessian, gradient, forces):  # type: ignore[no-untyped-def]
    """Writes where 1/2 f^T hessian f + gradient f is least without any limit, forces (n,)."""
    for k in range(len(forces)):
        forces[k] = -gradient[k]
    solve_positive(hessian, forces.reshape(len(forces), 1))


@inner
def solve_positive(matrix, columns):  # type: ignore[no-untyped-def]
    """Overwrites columns (n, C) by matrix^-1 columns, of a symmetric positive definite matrix (n, n), by Cholesky.

    The matrix may be the upper left part of a larger one.
    """
    n, count = columns.shape
    factor = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            left = matrix[i, j]
            for k in range(j):
                left -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(left) if i == j else left / factor[j, j]
    for c in range(count):
        for i in range(n):
            for k in range(i):
                columns[i, c] -= factor[i, k] * columns[k, c]
            columns[i, c] /= factor[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                columns[i, c] -= factor[k, i] * columns[k, c]
            columns[i, c] /= factor[i, i]


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

    f is along the ground's axes, which are those of the rotation wanted of the body: it lies on the slope and along the
    heading, as the MPC's pyramids do. In map axes, on 20 degrees, the cone's side would be a third off.

    The six rows of the base in eq. 43 say what forces do to it: it accelerates by d = response[:, :3 S] f +
    response[:, 3 S] more than commanded, which is written too, (6, 3 S + 1), and leaves no equality to the QP.
    The cost is weights[0] |d|^2 + weights[1] |f - targets' forces|^2. False where it is no number.
    """
    mass, jacobians, stance = state[0].mass_matrix, state[0].foot_jacobians, targets[0].stance
    out, weights, ground_to_map = control[0].out, control[0].weights, targets[0].rotation_body_to_map
    n = len(gradient)
    for i in range(BASE):
        response[i, n] = -state[0].bias[i]
        for j in range(SIZE):
            response[i, n] -= mass[i, j] * out[j, 2]
    column = 0
    for leg in range(4):
        if stance[leg]:
            for along in range(3):
                for i in range(BASE):
                    response[i, column] = 0.0
                gradient[column] = 0.0
                for axis in range(3):
                    share = ground_to_map[axis, along]
                    for i in range(BASE):
                        response[i, column] += jacobians[leg, axis, i] * share
                    gradient[column] -= weights[1] * targets[0].forces_n[leg, axis] * share
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

    stance_forces (3 S,) of the feet in stance, in a row, along the ground's axes. False when a torque is no number,
    from an input that was none: then the joints are only damped.
    """
    mass, bias, qvel, jacobians = state[0].mass_matrix, state[0].bias, state[0].qvel, state[0].foot_jacobians
    stance, gains, out = targets[0].stance, control[0].joint_gains, control[0].out
    forces, torques, ground_to_map = control[0].forces_n, control[0].torques_nm, targets[0].rotation_body_to_map
    k = 0
    for leg in range(4):
        for axis in range(3):
            forces[leg, axis] = 0.0
            if stance[leg]:
                for along in range(3):
                    forces[leg, axis] += ground_to_map[axis, along] * stance_forces[k + along]
        k += 3 * stance[leg]
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
