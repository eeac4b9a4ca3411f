"""Convex MPC: the ground forces that bring the body back to a reference within a horizon [Tracking, section 4.1].

A strictly convex QP over the stance feet's forces, solved exactly by an active-set method (quadprog; daqp where that
fails). It always has a solution, so only numerical trouble can fail it; then older or shared forces carry on.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

import daqp
import numpy as np
import quadprog
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv, dtrtri

from quadlog.control.locomotion.mpc_model import GRAVITY_MPS2, LEGS, STATES, build_cost, in_pyramid
from quadlog.messages import Float

FEASIBLE_N = 1e-6
"""A solver's answer that leaves the pyramid by more than this is a failure."""
LEVEL: Float = np.eye(3)
"""Level ground, seen along map's axes."""


class MpcStatus(StrEnum):
    """Where the forces come from."""

    SOLVED = "solved"
    SECOND_SOLVER = "second solver"  # daqp, as quadprog failed
    SHIFTED = "shifted"  # both failed: the last forces, one step on
    SHARED = "shared"  # both failed, with other feet down: the weight in equal parts on the feet that stand now
    FLIGHT = "flight"  # no foot stands within the horizon: nothing to solve


@dataclass(frozen=True)
class MpcSettings:
    """Horizon, weights of the squared state errors and of squared forces (alpha, per N^2), and the friction pyramid."""

    horizon: int = 10
    dt_s: float = 0.03
    weight_rpy: tuple[float, float, float] = (25.0, 25.0, 12.0)
    weight_position: tuple[float, float, float] = (20.0, 20.0, 80.0)
    weight_omega: tuple[float, float, float] = (0.15, 0.15, 0.4)
    weight_velocity: tuple[float, float, float] = (2.0, 2.0, 0.8)
    alpha: float = 2e-5
    mu: float = 0.6
    f_min_n: float = 0.0
    f_max_n: float = 150.0

    def __post_init__(self) -> None:
        """Refuses what would make the QP empty or not strictly convex."""
        if not 1 <= self.horizon <= 100:
            raise ValueError(f"horizon {self.horizon} is not within 1..100")
        weights = self.weights()
        if weights.shape != (STATES,) or not (np.isfinite(weights).all() and (weights >= 0).all()):
            raise ValueError(f"weights {weights.tolist()} are not {STATES} finite numbers >= 0")
        for name in ("dt_s", "alpha", "mu", "f_max_n"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} {getattr(self, name)} is not finite and > 0")
        if not 0 <= self.f_min_n <= self.f_max_n:
            raise ValueError(f"f_min_n {self.f_min_n} is not within 0..f_max_n")

    def weights(self) -> Float:
        """The diagonal (12,) of Q."""
        return np.array([*self.weight_rpy, *self.weight_position, *self.weight_omega, *self.weight_velocity])


@dataclass(frozen=True)
class MpcSolution:
    """Forces in N on the feet, in map: of the first step (4, 3) and of all (N, 4, 3); iterations of the solver."""

    forces_n: Float
    all_forces_n: Float
    status: MpcStatus
    iterations: int


class Mpc:
    """MPC for a body of a mass and an inertia (3, 3) about its centre of mass, in the body's frame.

    `counts` says how often each status came up.
    """

    def __init__(self, mass_kg: float, inertia_in_body: Float, settings: MpcSettings | None = None) -> None:
        """ValueError for a mass that is not positive, or an inertia that is not symmetric and positive definite."""
        self.settings = settings or MpcSettings()
        inertia = np.ascontiguousarray(inertia_in_body, dtype=np.float64)
        if not 0 < mass_kg < np.inf:
            raise ValueError(f"mass {mass_kg} kg is not finite and > 0")
        if inertia.shape != (3, 3) or not np.isfinite(inertia).all() or not np.allclose(inertia, inertia.T, rtol=1e-9):
            raise ValueError("the inertia is not a finite symmetric (3, 3)")
        if np.linalg.eigvalsh(inertia)[0] <= 0:
            raise ValueError("the inertia is not positive definite")
        self.mass_kg = float(mass_kg)
        self.counts: Counter[MpcStatus] = Counter()
        self._inverse_in_body = np.linalg.inv(inertia)
        self._weights = self.settings.weights()
        self._pyramids: dict[int, tuple[Float, Float]] = {}
        self._last: tuple[Float, NDArray[np.bool_]] | None = None

    def solve(
        self,
        state: Float,
        reference: Float,
        lever_arms_m: Float,
        contacts: NDArray[np.bool_],
        ground_to_map: Float = LEVEL,
    ) -> MpcSolution:
        """Forces for a state (12,) as in `mpc_model`, over N steps of dt from now.

        reference (N, 12): the states wanted at the steps' ends. lever_arms_m
        (N, 4, 3): from the centre of mass to the feet in the middle of each step, in map: taken
        at its start, a body at 0.3 m/s is planned 0.6 N m wrong in pitch.
        contacts (N, 4): which feet stand; the others get no force, and their
        lever arms are not read. ground_to_map (3, 3): a rotation; its columns are
        where the friction pyramids' sides face and their normal. The yaw of the
        linear model is the mean over the steps' starts: the measured one, then
        the reference's. ValueError for other shapes and for what is not finite;
        never an error for numerical trouble, which `status` reports.
        """
        steps = self.settings.horizon
        state, reference, lever_arms_m, ground_to_map = (
            np.ascontiguousarray(each, dtype=np.float64) for each in (state, reference, lever_arms_m, ground_to_map)
        )
        # A copy, as it is kept beside the forces.
        contacts = np.array(contacts, dtype=np.bool_, order="C")
        shapes = state.shape, reference.shape, lever_arms_m.shape, contacts.shape, ground_to_map.shape
        wanted = (STATES,), (steps, STATES), (steps, LEGS, 3), (steps, LEGS), (3, 3)
        if shapes != wanted:
            raise ValueError(f"state, reference, lever arms, contacts and ground have shapes {shapes}, not {wanted}")
        forces, status, iterations = self._forces(state, reference, lever_arms_m, contacts, ground_to_map)
        self._last = forces, contacts
        self.counts[status] += 1
        return MpcSolution(forces[0].copy(), forces.copy(), status, iterations)

    def _forces(
        self,
        state: Float,
        reference: Float,
        lever_arms_m: Float,
        contacts: NDArray[np.bool_],
        ground_to_map: Float,
    ) -> tuple[Float, MpcStatus, int]:
        H, g, is_finite = build_cost(
            state,
            reference,
            lever_arms_m,
            contacts,
            self.mass_kg,
            self._inverse_in_body,
            self._weights,
            self.settings.alpha,
            self.settings.dt_s,
        )
        if not (is_finite and np.isfinite(ground_to_map).all()):
            # From the input, or from an overflow: only the former is the caller's fault.
            for name, array in (
                ("state", state),
                ("reference", reference),
                ("lever arms", lever_arms_m[contacts]),
                ("ground's axes", ground_to_map),
            ):
                if not np.isfinite(array).all():
                    raise ValueError(f"the {name} are not all finite")
        if len(g) == 0:
            return np.zeros((*contacts.shape, 3)), MpcStatus.FLIGHT, 0
        if is_finite:
            for status, solver in ((MpcStatus.SOLVED, self._quadprog), (MpcStatus.SECOND_SOLVER, self._daqp)):
                answer, iterations = solver(H, g, ground_to_map)
                if answer is not None and self._is_allowed(answer, ground_to_map, FEASIBLE_N):
                    forces = np.zeros((*contacts.shape, 3))
                    forces[contacts] = answer.reshape(-1, 3)
                    return forces, status, iterations
        forces, status = self._without_solver(contacts, ground_to_map)
        return forces, status, 0

    def _quadprog(self, H: Float, g: Float, ground_to_map: Float) -> tuple[Float | None, int]:
        """Forces (n,), None if it failed, and iterations: none where no constraint is active, as mostly in a walk."""
        # H is symmetric: its transpose is H in the order of LAPACK.
        factor, forces, failed = dposv(H.T, -g)
        if failed:
            return None, 0
        if self._is_allowed(forces, ground_to_map, 0.0):
            return forces, 0
        inverse, _ = dtrtri(factor)
        rows, lower = self._pyramid(len(g) // 3, ground_to_map)
        try:
            forces, _, _, iterations, _, _ = quadprog.solve_qp(inverse, -g, rows.T, lower, 0, True)
        except ValueError:
            # "Inconsistent", which these constraints never are but for rounding.
            return None, 0
        return forces, int(iterations[0])

    def _daqp(self, H: Float, g: Float, ground_to_map: Float) -> tuple[Float | None, int]:
        """Forces (n,), None if it failed, and iterations."""
        rows, lower = self._pyramid(len(g) // 3, ground_to_map)
        forces, _, exit_flag, info = daqp.solve(H, g, rows, np.full(len(lower), np.inf), lower)
        return (forces if exit_flag == 1 else None), int(info["iterations"])

    def _is_allowed(self, forces: Float, ground_to_map: Float, tolerance_n: float) -> bool:
        settings = self.settings
        forces = (forces.reshape(-1, 3) @ ground_to_map).ravel()
        return bool(in_pyramid(forces, settings.mu, settings.f_min_n, settings.f_max_n, tolerance_n))

    def _pyramid(self, feet: int, ground_to_map: Float) -> tuple[Float, Float]:
        """|fx|, |fy| <= mu fz and f_min <= fz <= f_max along the ground's axes, as rows @ forces >= lower.

        forces (n,) are those of all feet, in map.
        """
        if feet not in self._pyramids:
            mu, f_min, f_max = self.settings.mu, self.settings.f_min_n, self.settings.f_max_n
            rows = [[-1.0, 0.0, mu], [1.0, 0.0, mu], [0.0, -1.0, mu], [0.0, 1.0, mu], [0.0, 0.0, -1.0]]
            lower = [0.0, 0.0, 0.0, 0.0, -f_max]
            if f_min > 0:
                # fz >= 0 needs no row: it follows from the sides, and would make the tip degenerate.
                rows.append([0.0, 0.0, 1.0])
                lower.append(f_min)
            self._pyramids[feet] = np.kron(np.eye(feet), np.array(rows)), np.tile(lower, feet)
        along_ground, at_least = self._pyramids[feet]
        # Each row is a foot's force after the other: all of them are turned by the same rotation.
        return (along_ground.reshape(-1, 3) @ ground_to_map.T).reshape(along_ground.shape), at_least

    def _without_solver(self, contacts: NDArray[np.bool_], ground_to_map: Float) -> tuple[Float, MpcStatus]:
        """The last one step on, where the same feet stand; else the weight in equal parts. Clipped to the pyramid."""
        stance = contacts.sum(axis=1, keepdims=True)
        forces = np.zeros((*contacts.shape, 3))
        forces[..., 2] = self.mass_kg * GRAVITY_MPS2 / np.maximum(stance, 1)
        status = MpcStatus.SHARED
        if self._last is not None:
            later = np.minimum(np.arange(1, len(contacts) + 1), len(contacts) - 1)
            last_forces, last_contacts = self._last[0][later], self._last[1][later]
            same = (last_contacts == contacts).all(axis=1)
            forces[same] = last_forces[same]
            if same[0]:
                status = MpcStatus.SHIFTED
        forces = forces @ ground_to_map
        forces[..., 2] = np.clip(forces[..., 2], self.settings.f_min_n, self.settings.f_max_n)
        side = self.settings.mu * forces[..., 2:]
        forces[..., :2] = np.clip(forces[..., :2], -side, side)
        forces = forces @ ground_to_map.T
        forces[~contacts] = 0.0
        return forces, status
