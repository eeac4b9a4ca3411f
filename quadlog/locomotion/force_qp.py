"""The forces of the feet in stance, by a small strictly convex QP that always gives an answer [Tracking, eq. 31]."""

from __future__ import annotations

import math
from enum import StrEnum

import daqp
import numpy as np
import quadprog
from numpy.typing import NDArray

from quadlog.compiled import inlined, inner
from quadlog.locomotion.mpc_build import in_pyramid
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

    |fx|, |fy| <= mu fz and f_min <= fz <= f_max, in map. Who uses it fills hessian (3 S, 3 S), gradient (3 S,) and
    response (6, 3 S + 1), of which the QP itself knows nothing. Where the forces (3 S,) of the free minimum keep to the
    pyramids they are the answer, and no solver is asked.
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
        """Forces (3 S,) and where they come from.

        is_finite: hessian and gradient are numbers, which no solver should be asked otherwise. mpc_forces_n (4, 3), of
        the feet in stance (4,), stand in where no solver gives any.
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
