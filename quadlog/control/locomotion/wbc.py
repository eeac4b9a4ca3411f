"""Whole-body control: joint torques from tasks in a strict order and the MPC's forces [Tracking, eqs 33-44].

The tasks by Table 3 are: feet in stance do not move, the body turns, the body moves, feet in swing follow their curves.
A free body and four feet have 18 independent rows for 18 coordinates, so that the recursion over null spaces (eqs
33-40; errata: 36 as printed disturbs the first task, 37 has q_i for x_i, 40 has J for J') has a closed form: the body
moves as its tasks want, and each leg's own three joints give its foot what the body's motion leaves to do.

Tasks and the MPC's forces seldom agree on what the base does. A QP over the stance forces shares the difference out
between both (eqs 41-43), and the joints' rows of the equations of motion give torques (eq. 44). Coordinates are
MuJoCo's: qvel (18,) = velocity in map (3), angular velocity IN THE BODY (3), joint speeds (12); mass matrix, bias and
Jacobians go with them. Forces (4, 3) are the ground's on the feet, in map.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from quadlog.compiled import inner, kernel
from quadlog.control.locomotion.force_qp import Pyramid, is_allowed
from quadlog.control.locomotion.numba_record import Bool, Record
from quadlog.messages import Float

BASE, JOINTS, SIZE = 6, 12, 18

# Feedback of error and rate, all ours, which walks hardly depend on: of the tasks in 1/s^2 and 1/s; of joints [eq. 44]
# in N m/rad and N m s/rad; of feet in swing without whole-body control in N/m and N s/m.
ROTATION, TRANSLATION, SWING = (80.0, 8.0), (60.0, 8.0), (350.0, 30.0)
JOINT, SWING_FORCE = (20.0, 0.8), (700.0, 25.0)
# Of the QP's cost [eq. 41]: of what the base does beside the tasks, and of forces beside those of the MPC.
WEIGHT_ACCELERATION, WEIGHT_FORCE = 0.1, 1.0
WEAKEST = 0.02
"""A leg whose Jacobian may have a singular value below this, bent by less than 15 degrees, is damped."""


class WholeBodyState(Record):
    """Where the robot is, and its dynamics there, as its controller knows them.

    rotation_body_to_map (3, 3), its angles rpy (3,), position_m (3,) of the base, qvel (18,); velocity_mps (3,) is the
    base's true one, where that in qvel is biased. joints_rad (12,). feet_m (4, 3) in map, foot_jacobians (4, 3, 18) and
    foot_jacobian_rates (4, 3), their change times qvel; mass_matrix (18, 18), bias (18,) of Coriolis forces and
    gravity; touches (4,): which feet are in contact with anything.
    """

    rotation_body_to_map: Annotated[Float, 3, 3]
    rpy: Annotated[Float, 3]
    position_m: Annotated[Float, 3]
    velocity_mps: Annotated[Float, 3]
    qvel: Annotated[Float, SIZE]
    joints_rad: Annotated[Float, JOINTS]
    feet_m: Annotated[Float, 4, 3]
    foot_jacobians: Annotated[Float, 4, 3, SIZE]
    foot_jacobian_rates: Annotated[Float, 4, 3]
    mass_matrix: Annotated[Float, SIZE, SIZE]
    bias: Annotated[Float, SIZE]
    touches: Annotated[Bool, 4]


class WholeBodyTargets(Record):
    """What is wanted, in map.

    rotation_body_to_map (3, 3): the body then lies on the ground and along the heading, and so do the sides and normals
    of the friction pyramids; body (3, 3): position, velocity, angular velocity; stance (4,): which feet stand; feet
    (3, 4, 3): positions, velocities and accelerations of the others; forces_n (4, 3): the MPC's.
    """

    rotation_body_to_map: Annotated[Float, 3, 3]
    body: Annotated[Float, 3, 3]
    feet: Annotated[Float, 3, 4, 3]
    forces_n: Annotated[Float, 4, 3]
    stance: Annotated[Bool, 4]


class WholeBodyControl(Record):
    """Whole-body control, tick after tick.

    Of the last tick: torques_nm (12,), and with whole-body control forces_n (4, 3) and, in out's last column,
    accelerations (18,) that go with them; saturated (12,): which torques their limits cut.
    """

    cone: Annotated[Float, 2]
    limits_nm: Annotated[Float, JOINTS]
    out: Annotated[Float, SIZE, 3]
    hessian: Annotated[Float, JOINTS, JOINTS]
    gradient: Annotated[Float, JOINTS]
    response: Annotated[Float, JOINTS + 1, BASE]
    stance_n: Annotated[Float, 1, JOINTS]
    room: Annotated[Float, 2, JOINTS, JOINTS]
    small: Annotated[Float, 4, 3, 3]
    forces_n: Annotated[Float, 4, 3]
    torques_nm: Annotated[Float, JOINTS]
    saturated: Annotated[Bool, JOINTS]

    def __init__(self, pyramid: Pyramid, limits_nm: float | Float) -> None:
        super().__init__()
        self.pyramid = pyramid
        self.cone[:], self.limits_nm[:] = (pyramid.mu, pyramid.f_max_n), limits_nm

    def step(self, state: WholeBodyState, targets: WholeBodyTargets) -> Float:
        """Torques (12,) within their limits; overwritten by the next step."""
        records = state.record, targets.record, self.record
        if not free_torques(*records):
            n = 3 * int(np.count_nonzero(targets.stance))
            instead_n = (targets.forces_n @ targets.rotation_body_to_map)[targets.stance]
            hessian, gradient = self.hessian[:n, :n].copy(), self.gradient[:n].copy()
            self.stance_n[0, :n] = self.pyramid.within(hessian, gradient, instead_n)
            forced_torques(*records)
        return self.torques_nm

    def mpc_only_step(self, state: WholeBodyState, targets: WholeBodyTargets) -> Float:
        """The same without whole-body control.

        Feet in stance push by the MPC's forces and nothing else, so an error of the MPC shows that whole-body control
        would hide. Feet in swing are drawn to their curves by a spring, with their own leg's inertia fed forward, each
        leg for itself as if the body were held. Legs carry their own weight.
        """
        leg_torques(state.record, targets.record, self.record)
        return self.torques_nm


@kernel
def free_torques(state, targets, control):  # type: ignore[no-untyped-def]
    """Writes the torques by the free minimum of the QP over forces; False, and none, where friction forbids these."""
    now, to, own = state[0], targets[0], control[0]
    commands(state, targets, control)
    n = _free_forces(now, to, own)
    mu, f_max = own.cone
    if not is_allowed(own.stance_n[0, :n], mu, f_max):
        return False
    forced_torques(state, targets, control)
    return True


@kernel
def commands(state, targets, control):  # type: ignore[no-untyped-def]
    """Writes out (18, 3): the change of q, the velocity and the acceleration that meet the tasks.

    qvel's angular part is in the body: omega = R qvel[3:6], whose rate is R qacc[3:6], for R' qvel[3:6] = 0.
    """
    now, to, own = state[0], targets[0], control[0]
    out, rotation, qvel, body = own.out, now.rotation_body_to_map, now.qvel, to.body
    turn, wanted = own.small[0], own.small[1]
    for i in range(3):
        for j in range(3):
            turn[i, j] = 0.0
            for k in range(3):
                turn[i, j] += to.rotation_body_to_map[i, k] * rotation[j, k]
    # The rotation vector of the turn that is left, in map.
    x, y, z = (turn[2, 1] - turn[1, 2]) / 2.0, (turn[0, 2] - turn[2, 0]) / 2.0, (turn[1, 0] - turn[0, 1]) / 2.0
    sine = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0) / 2.0)
    longer = angle / sine if sine > 1e-12 else 1.0
    wanted[0, 0], wanted[1, 0], wanted[2, 0] = longer * x, longer * y, longer * z
    for i in range(3):
        omega = rotation[i, 0] * qvel[3] + rotation[i, 1] * qvel[4] + rotation[i, 2] * qvel[5]
        wanted[i, 1] = body[2, i]
        wanted[i, 2] = ROTATION[0] * wanted[i, 0] + ROTATION[1] * (body[2, i] - omega)
        away = body[0, i] - now.position_m[i]
        out[i, 0], out[i, 1] = away, body[1, i]
        out[i, 2] = TRANSLATION[0] * away + TRANSLATION[1] * (body[1, i] - qvel[i])
    for c in range(3):
        x, y, z = wanted[0, c], wanted[1, c], wanted[2, c]
        for i in range(3):
            out[3 + i, c] = rotation[0, i] * x + rotation[1, i] * y + rotation[2, i] * z

    for leg in range(4):
        jacobian, first = now.foot_jacobians[leg], BASE + 3 * leg
        _invert_leg(jacobian, first, own.small)
        for i in range(3):
            wanted[i, 0], wanted[i, 1], wanted[i, 2] = 0.0, 0.0, -now.foot_jacobian_rates[leg, i]
            if not to.stance[leg]:
                speed = 0.0
                for j in range(SIZE):
                    speed += jacobian[i, j] * qvel[j]
                wanted[i, 0], wanted[i, 1] = to.feet[0, leg, i] - now.feet_m[leg, i], to.feet[1, leg, i]
                wanted[i, 2] += to.feet[2, leg, i] + SWING[0] * wanted[i, 0] + SWING[1] * (wanted[i, 1] - speed)
            for c in range(3):
                for j in range(BASE):
                    wanted[i, c] -= jacobian[i, j] * out[j, c]
        inverse = own.small[2]
        for c in range(3):
            x, y, z = wanted[0, c], wanted[1, c], wanted[2, c]
            for i in range(3):
                out[first + i, c] = inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] * z


@inner
def _invert_leg(jacobian, first, small):  # type: ignore[no-untyped-def]
    """Writes to small[2] the inverse (3, 3) of a leg's own columns D of a foot's Jacobian (3, 18): D^T (D D^T + d)^-1.

    d is 0 as a rule, and up to WEAKEST^2 where the least singular value is small [Nakamura]: a straight leg then gives
    way, in stance too, where the plain inverse would ask for endless joint speeds. The gain never exceeds 1 / WEAKEST,
    and is continuous. For the singular value stands its lower bound 2 |det D| / |D|^2.
    """
    inverse, gram, adjugate = small[2], small[3], small[0]
    for i in range(3):
        for j in range(3):
            gram[i, j] = 0.0
            for k in range(3):
                gram[i, j] += jacobian[i, first + k] * jacobian[j, first + k]
    trace = gram[0, 0] + gram[1, 1] + gram[2, 2]
    determinant = _adjugate(gram, adjugate)
    damping = WEAKEST * WEAKEST - 4.0 * determinant / (trace * trace)
    if damping > 0.0:
        for i in range(3):
            gram[i, i] += damping
        determinant = _adjugate(gram, adjugate)
    for i in range(3):
        for j in range(3):
            inverse[i, j] = 0.0
            for k in range(3):
                inverse[i, j] += jacobian[k, first + i] * adjugate[k, j] / determinant


@inner
def _adjugate(matrix, out):  # type: ignore[no-untyped-def]
    """Writes the adjugate of a symmetric matrix (3, 3), which its determinant divides to the inverse; returns that."""
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            out[i, j] = matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]
    return matrix[0, 0] * out[0, 0] + matrix[0, 1] * out[0, 1] + matrix[0, 2] * out[0, 2]


@inner
def _free_forces(now, to, own):  # type: ignore[no-untyped-def]
    """Writes the QP over the forces f (n,) of the feet in stance, and f at its free minimum: n, 3 for each such foot.

    f is along the ground's axes, which are those of the rotation wanted of the body: it lies on the slope and along the
    heading, as the MPC's pyramids do. In map axes, on 20 degrees, the cone's side would be a third off.

    The six rows of the base in eq. 43 say what forces do to it: it accelerates by d = f response[:n] + response[n]
    more than commanded, which leaves no equality to the QP. The cost is WEIGHT_ACCELERATION |d|^2 +
    WEIGHT_FORCE |f - the MPC's|^2.
    """
    mass, axes, hessian, gradient = now.mass_matrix, to.rotation_body_to_map, own.hessian, own.gradient
    response, forces, base = own.response, own.stance_n, own.room[1]
    n = 0
    for leg in range(4):
        if not to.stance[leg]:
            continue
        for along in range(3):
            gradient[n] = 0.0
            for i in range(BASE):
                response[n, i] = 0.0
            for axis in range(3):
                gradient[n] -= WEIGHT_FORCE * axes[axis, along] * to.forces_n[leg, axis]
                for i in range(BASE):
                    response[n, i] += axes[axis, along] * now.foot_jacobians[leg, axis, i]
            n += 1
    for i in range(BASE):
        response[n, i] = -now.bias[i]
        for j in range(SIZE):
            response[n, i] -= mass[i, j] * own.out[j, 2]
        for j in range(BASE):
            base[i, j] = mass[i, j]
    _solve(base, BASE, response, n + 1, own.room[0])
    for p in range(n):
        for i in range(BASE):
            gradient[p] += WEIGHT_ACCELERATION * response[p, i] * response[n, i]
        for q in range(n):
            hessian[p, q] = WEIGHT_FORCE if p == q else 0.0
            for i in range(BASE):
                hessian[p, q] += WEIGHT_ACCELERATION * response[p, i] * response[q, i]
        forces[0, p] = -gradient[p]
    _solve(hessian, n, forces, 1, own.room[0])
    return n


@inner
def _solve(matrix, n, rows, count, factor):  # type: ignore[no-untyped-def]
    """Overwrites rows[:count, :n] by matrix[:n, :n]^-1 times each, the matrix being positive definite, by Cholesky."""
    for i in range(n):
        for j in range(i + 1):
            left = matrix[i, j]
            for k in range(j):
                left -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(left) if i == j else left / factor[j, j]
    for c in range(count):
        for i in range(n):
            for k in range(i):
                rows[c, i] -= factor[i, k] * rows[c, k]
            rows[c, i] /= factor[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                rows[c, i] -= factor[k, i] * rows[c, k]
            rows[c, i] /= factor[i, i]


@kernel
def forced_torques(state, targets, control):  # type: ignore[no-untyped-def]
    """Writes torques by eqs 43 and 44 for the stance forces that were found, these as forces (4, 3), and adds to out's
    accelerations what the base does beside.
    """
    now, to, own = state[0], targets[0], control[0]
    out, forces, axes, response = own.out, own.forces_n, to.rotation_body_to_map, own.response
    n = 0
    for leg in range(4):
        for axis in range(3):
            forces[leg, axis] = 0.0
            if to.stance[leg]:
                for along in range(3):
                    forces[leg, axis] += axes[axis, along] * own.stance_n[0, n + along]
        n += 3 * to.stance[leg]
    for i in range(BASE):
        out[i, 2] += response[n, i]
        for k in range(n):
            out[i, 2] += response[k, i] * own.stance_n[0, k]
    for joint in range(JOINTS):
        row = BASE + joint
        torque = now.bias[row] + JOINT[0] * out[row, 0] + JOINT[1] * (out[row, 1] - now.qvel[row])
        for j in range(SIZE):
            torque += now.mass_matrix[row, j] * out[j, 2]
        for axis in range(3):
            torque -= now.foot_jacobians[joint // 3, axis, row] * forces[joint // 3, axis]
        _limit(own, joint, torque)


@inner
def _limit(own, joint, torque):  # type: ignore[no-untyped-def]
    """Writes a torque within its limit, and whether that cut it; what is no number, of a robot flung away, as 0."""
    limit = own.limits_nm[joint]
    own.saturated[joint] = abs(torque) > limit
    own.torques_nm[joint] = min(max(torque, -limit), limit) if math.isfinite(torque) else 0.0


@kernel
def leg_torques(state, targets, control):  # type: ignore[no-untyped-def]
    """Writes torques by the MPC alone: -J^T f in stance, J^T (k_p e + k_d e') + M J^-1 (x'' - J' q') in swing."""
    now, to, own = state[0], targets[0], control[0]
    force, acceleration, inverse = own.small[1, 0], own.small[1, 1], own.small[2]
    for leg in range(4):
        jacobian, first = now.foot_jacobians[leg], BASE + 3 * leg
        _invert_leg(jacobian, first, own.small)
        for axis in range(3):
            force[axis], acceleration[axis] = -to.forces_n[leg, axis], 0.0
            if to.stance[leg]:
                continue
            speed = 0.0
            for j in range(SIZE):
                speed += jacobian[axis, j] * now.qvel[j]
            away = to.feet[0, leg, axis] - now.feet_m[leg, axis]
            force[axis] = SWING_FORCE[0] * away + SWING_FORCE[1] * (to.feet[1, leg, axis] - speed)
            for k in range(3):
                acceleration[axis] += inverse[axis, k] * (to.feet[2, leg, k] - now.foot_jacobian_rates[leg, k])
        for joint in range(3 * leg, 3 * leg + 3):
            row = BASE + joint
            torque = now.bias[row]
            for axis in range(3):
                torque += jacobian[axis, row] * force[axis] + now.mass_matrix[row, first + axis] * acceleration[axis]
            _limit(own, joint, torque)
