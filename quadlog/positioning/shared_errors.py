"""What all epochs of a log share, link biases and misplaced anchors, fitted with every epoch's fix being free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int

HALF_TRUST_STD = 2.0
"""A range so many std off its link's median is well on its way to not counting."""
BLOCKS = (40, 20, 10, 5)
"""Into how many pieces a log is cut to see how its errors persist."""
ITERATIONS = 20


@dataclass(frozen=True, slots=True)
class SharedErrors:
    """Biases of A links, and displacements of the M anchors that were allowed to move, K = A + 2M numbers.

    bias_m: (A,); shift_m: (M, 2) in map, to be added to the configured places.
    covariance_m2: (K, K) of the biases, then of each displacement's x and y, as weights and prior have it.
    reach: (E, K, A) in 1/m^2, what a metre on a link adds to the gradient, the epoch's fix having given way.
    pull: (E, K) in 1/m, what each epoch did add to it.
    """

    bias_m: Float
    shift_m: Float
    covariance_m2: Float
    reach: Float
    pull: Float


@dataclass(frozen=True, slots=True)
class _Equations:
    """Normal equations of the shared errors, the fixes eliminated, and what ties the fixes to them.

    reach, pull: as in SharedErrors; information: (K, K).
    absorb: (E, D, K) how far a fix gives way to each error; fix_step_m: (E, D) where the residuals draw it.
    """

    reach: Float
    pull: Float
    information: Float
    absorb: Float
    fix_step_m: Float


def solve_shared_errors(
    anchors_m: Float, moving: Int, range_m: Float, weight: Float, position_m: Float, free_axes: int, prior: Float
) -> SharedErrors:
    """The biases, and the places of the anchors in moving (M,), that fit ranges (E, A) to anchors (A, 3) best.

    weight: (E, A) in 1/m^2, zero where there is no range. position_m: (E, 3)
    where the fixes start; free_axes is 2 where its heights are given, 3 where
    the ranges had to tell them too. prior: (K, K) information about a zero.
    Fixing and averaging residuals in turn creeps, because a fix absorbs most of
    a bias; here the fixes are eliminated from the normal equations.
    """
    n_links, placed_m, position_m = len(anchors_m), anchors_m.copy(), position_m.copy()
    value = np.zeros(len(prior))
    equations = _eliminate_fixes(placed_m, moving, range_m, weight, position_m, free_axes)
    for _ in range(ITERATIONS):
        step_m = np.linalg.solve(equations.information + prior, equations.pull.sum(axis=0) - prior @ value)
        value = value + step_m
        placed_m[moving, :2] = anchors_m[moving, :2] + value[n_links:].reshape(-1, 2)
        position_m[:, :free_axes] += equations.fix_step_m - equations.absorb @ step_m
        equations = _eliminate_fixes(placed_m, moving, range_m - value[:n_links], weight, position_m, free_axes)
        if np.abs(step_m).max() < 1e-4:
            break
    covariance_m2 = np.linalg.inv(equations.information + prior)
    return SharedErrors(value[:n_links], value[n_links:].reshape(-1, 2), covariance_m2, equations.reach, equations.pull)


def bias_covariance_at(anchors_m: Float, weight: Float, position_m: Float, free_axes: int, prior: Float) -> Float:
    """(A, A) in m^2, how well biases could be told if the fixes were at position_m (E, 3)."""
    none = np.empty(0, dtype=np.int64)
    equations = _eliminate_fixes(anchors_m, none, np.zeros_like(weight), weight, position_m, free_axes)
    return np.asarray(np.linalg.inv(equations.information + prior))


def scatter_covariances(errors: SharedErrors, weight: Float) -> Float:
    """(len(BLOCKS), K, K) covariances of shared errors from how the gradient scatters between blocks of the log.

    UWB errors persist in a place, so white noise would promise too much. An
    error of a whole block moves the estimate by the slope of weight times
    residual, which for `weigh_by_lateness` is 4 w^1.5 - 3 w of w's largest:
    more than the weights alone would say, because trust falls with the error.
    """
    share = weight / max(weight.max(initial=0.0), 1e-300)
    slope = np.sum(4 * share**1.5 - 3 * share) / max(share.sum(), 1e-300)
    reply = errors.covariance_m2 / max(slope, 0.3)
    found = []
    for n in BLOCKS:
        blocks = np.array([block.sum(axis=0) for block in np.array_split(errors.pull, n)])
        found.append(reply @ (blocks.T @ blocks) @ reply * n / (n - 1))
    return np.array(found)


def wander_covariance(errors: SharedErrors, t_s: Float, wander_std_m: float, wander_s: float) -> Float:
    """(K, K) in m^2, what comes of every link being off by wander_std_m for wander_s at a time; t_s: (E,)."""
    piece = np.floor((t_s - t_s[0]) / wander_s).astype(np.int64)
    starts = np.flatnonzero(np.diff(piece, prepend=-1))
    reach = np.add.reduceat(errors.reach, starts, axis=0)
    moved = errors.covariance_m2 @ reach
    return np.asarray(wander_std_m**2 * np.einsum("bka,bla->kl", moved, moved))


def weigh_by_lateness(residual_m: Float, range_std_m: float) -> Float:
    """(E, A) weights in 1/m^2, zero where there is no range.

    About each link's median, for a bias is no reason for distrust; and alike on
    both sides, since trimming one side only would shift what is estimated.
    """
    heard = np.isfinite(residual_m).any(axis=0)
    median_m = np.zeros(residual_m.shape[1])
    median_m[heard] = np.nanmedian(residual_m[:, heard], axis=0)
    off_m = residual_m - median_m
    std_m = max(range_std_m, 1.4826 * float(np.nanmedian(np.abs(off_m))))
    return np.nan_to_num(1 / (1 + (off_m / (HALF_TRUST_STD * std_m)) ** 2) ** 2) / std_m**2


def _eliminate_fixes(
    anchors_m: Float, moving: Int, range_m: Float, weight: Float, position_m: Float, free_axes: int
) -> _Equations:
    """The normal equations at position_m (E, 3) and anchors_m (A, 3).

    With W the weights, U the directions of an epoch and G what the shared
    errors do to its ranges, the fix moves by F (r - G dv), F = (U^T W U)^-1 U^T W.
    That leaves the gradient R r and the information R G with the reach
    R = G^T W - G^T W U F. Epochs that their weights leave without a sharp fix
    do not count.
    """
    n_links = len(anchors_m)
    offset_m = position_m[:, None, :] - anchors_m[None, :, :]
    distance_m = np.maximum(np.linalg.norm(offset_m, axis=2), 1e-9)
    towards = offset_m / distance_m[:, :, None]
    direction = towards[:, :, :free_axes]
    normal = np.einsum("ea,eai,eaj->eij", weight, direction, direction)
    sharp = np.linalg.eigvalsh(normal)[:, 0] > 0.05 * weight.max(initial=0.0)
    weight = weight * sharp[:, None]
    normal[~sharp] = np.eye(free_axes)

    effect = np.zeros((*weight.shape, n_links + 2 * len(moving)))
    effect[:, np.arange(n_links), np.arange(n_links)] = 1.0
    for i, anchor in enumerate(moving):
        effect[:, anchor, n_links + 2 * i : n_links + 2 * i + 2] = -towards[:, anchor, :2]

    residual_m = np.where(weight > 0, range_m - distance_m, 0.0)
    follow = np.linalg.inv(normal) @ (weight[:, :, None] * direction).transpose(0, 2, 1)
    weighted = effect.transpose(0, 2, 1) * weight[:, None, :]
    reach = weighted - (weighted @ direction) @ follow
    return _Equations(
        reach=reach,
        pull=np.einsum("eka,ea->ek", reach, residual_m),
        information=np.tensordot(reach, effect, axes=((0, 2), (0, 1))),
        absorb=follow @ effect,
        fix_step_m=np.einsum("eia,ea->ei", follow, residual_m),
    )
