"""Quadratic programs over the forces of feet, each within its friction pyramid, for MPC and whole-body control.

Forces (3 S,) of S feet, foot by foot, along the ground's axes, z being its normal. A foot can push with
|fx|, |fy| <= mu fz and 0 <= fz <= f_max. Such forces always exist: only numerical trouble can make a solver fail.
"""

from __future__ import annotations

from functools import cache

import daqp
import numpy as np
from scipy.linalg.lapack import dposv

from quadlog.compiled import kernel
from quadlog.control.settings import MpcSettings
from quadlog.messages import GRAVITY_MPS2, Float

_OPTIMAL, _UNBOUNDED = 1, 1e30  # daqp's exit flag and its infinity
MOST_OF_WEIGHT = 1.2
"""Of the robot's weight, what a foot may bear unless f_max_n is given."""


class Pyramid:
    """The forces that a foot can push with, of a robot of a mass.

    limited: how often friction or a limit decided, so that a solver was called; failed: how often it had no answer.
    """

    def __init__(self, settings: MpcSettings, mass_kg: float) -> None:
        f_max_n = MOST_OF_WEIGHT * mass_kg * GRAVITY_MPS2 if settings.f_max_n is None else settings.f_max_n
        self.mu, self.f_max_n = settings.mu, f_max_n
        self.limited = self.failed = 0

    def solve(self, hessian: Float, gradient: Float, instead_n: Float) -> Float:
        """Forces (3 S,) that minimise 1/2 f^T hessian f + gradient f, hessian being positive definite.

        By Cholesky where the free minimum is allowed, as it mostly is; else as `within`.
        """
        # A symmetric matrix is its own transpose, which has LAPACK's order.
        _, forces_n, failed = dposv(hessian.T, -gradient)
        if not failed and is_allowed(forces_n, self.mu, self.f_max_n):
            return np.asarray(forces_n)
        return self.within(hessian, gradient, instead_n)

    def within(self, hessian: Float, gradient: Float, instead_n: Float) -> Float:
        """The same where the free minimum is not allowed; if that fails, instead_n (S, 3) moved into the pyramids."""
        self.limited += 1
        if np.isfinite(hessian).all() and np.isfinite(gradient).all():
            sides, upper, lower, kinds = _constraints(len(instead_n), self.mu, self.f_max_n)
            forces_n, _, flag, _ = daqp.solve(hessian, gradient, sides, upper, lower, kinds.copy())
            if flag == _OPTIMAL:
                return np.asarray(forces_n)
        self.failed += 1
        forces_n = np.nan_to_num(instead_n)
        forces_n[:, 2] = np.clip(forces_n[:, 2], 0.0, self.f_max_n)
        most_n = self.mu * forces_n[:, 2:]
        forces_n[:, :2] = np.clip(forces_n[:, :2], -most_n, most_n)
        return forces_n.ravel()


@cache
def _constraints(feet: int, mu: float, f_max_n: float) -> tuple[Float, Float, Float, Float]:
    """For daqp: rows of the pyramids' sides, bounds of all forces and rows, and their kinds, which it overwrites."""
    sides = np.array([[1.0, 0.0, -mu], [-1.0, 0.0, -mu], [0.0, 1.0, -mu], [0.0, -1.0, -mu]])
    upper = [*feet * [_UNBOUNDED, _UNBOUNDED, f_max_n], *4 * feet * [0.0]]
    lower = [*feet * [-_UNBOUNDED, -_UNBOUNDED, 0.0], *4 * feet * [-_UNBOUNDED]]
    return np.kron(np.eye(feet), sides), np.array(upper), np.array(lower), np.zeros(7 * feet, dtype=np.int32)


@kernel
def is_allowed(forces, mu, f_max):  # type: ignore[no-untyped-def]
    """Whether forces (3 S,) keep to their pyramids; NaN never does."""
    for k in range(0, len(forces), 3):
        up, side = forces[k + 2], mu * forces[k + 2]
        if not (abs(forces[k]) <= side and abs(forces[k + 1]) <= side and 0.0 <= up <= f_max):
            return False
    return True
