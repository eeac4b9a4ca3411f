"""Errors that all epochs of a log share, biases of links and displacements of anchors, with every fix being free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.epochs import Epochs
from quadlog.positioning.fix.least_squares import invert_normal
from quadlog.positioning.fix.trilateration import solve_gauss_newton
from quadlog.positioning.track.range_log import log_ranges, walker
from quadlog.positioning.track.tracker import smooth_places

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
    """Normal equations of the shared errors, the fixes eliminated, and what ties the fixes to them; epochs come last.

    reach (K, A, E), pull (K, E): as in SharedErrors; information: (K, K).
    absorb: (D, K, E) how far a fix gives way to each error; fix_step_m: (D, E) where the residuals draw it.
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

    weight: (E, A) in 1/m^2, zero where there is no range. position_m: (E, 3) where the fixes start; free_axes is 2
    where its heights are given, 3 where the ranges had to tell them too. prior: (K, K) information about a zero. Fixing
    and averaging residuals in turn creeps, because a fix absorbs most of a bias; here the fixes are eliminated from the
    normal equations.
    """
    n_links, placed_m, place_m = len(anchors_m), anchors_m.copy(), position_m.T.copy()
    value, range_m, weight = np.zeros(len(prior)), np.ascontiguousarray(range_m.T), np.ascontiguousarray(weight.T)
    equations = _eliminate_fixes(placed_m, moving, range_m, weight, place_m, free_axes)
    for _ in range(ITERATIONS):
        step_m = np.linalg.solve(equations.information + prior, equations.pull.sum(axis=1) - prior @ value)
        value = value + step_m
        placed_m[moving, :2] = anchors_m[moving, :2] + value[n_links:].reshape(-1, 2)
        place_m[:free_axes] += equations.fix_step_m - np.einsum("dke,k->de", equations.absorb, step_m)
        unbiased_m = range_m - value[:n_links, None]
        equations = _eliminate_fixes(placed_m, moving, unbiased_m, weight, place_m, free_axes)
        if np.abs(step_m).max() < 1e-4:
            break
    covariance_m2 = np.linalg.inv(equations.information + prior)
    reach, pull = equations.reach.transpose(2, 0, 1), equations.pull.T
    return SharedErrors(value[:n_links], value[n_links:].reshape(-1, 2), covariance_m2, reach, pull)


def scatter_covariances(errors: SharedErrors, weight: Float) -> Float:
    """(len(BLOCKS), K, K) covariances of shared errors from how the gradient scatters between blocks of the log.

    UWB errors persist in a place, so white noise would promise too much. An error of a whole block moves the estimate
    by the slope of weight times residual, which for `weigh_by_lateness` is 4 w^1.5 - 3 w of w's largest: more than the
    weights alone would say, because trust falls with the error.
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
    off_m = residual_m - column_medians(residual_m)
    weight = redescending_weights(off_m, range_std_m)
    return np.where(np.isfinite(weight), weight, 0.0)


def redescending_weights(off_m: Float, range_std_m: float) -> Float:
    """Weights in 1/m^2 of what ranges are off by, by the std that their median shows, range_std_m at least."""
    std_m = max(range_std_m, 1.4826 * float(column_medians(np.abs(off_m).reshape(-1, 1))[0]))
    weight: Float = 1 / (1 + (off_m / (HALF_TRUST_STD * std_m)) ** 2) ** 2 / std_m**2
    return weight


def column_medians(values: Float) -> Float:
    """(C,) median of each column of (R, C) without its NaN, zero where there is nothing else."""
    if len(values) == 0:
        return np.zeros(values.shape[1])
    ordered = np.sort(values, axis=0)
    n = np.isfinite(values).sum(axis=0)
    column = np.arange(len(n))
    middle = (ordered[(n - 1).clip(0) // 2, column] + ordered[(n // 2).clip(max=len(values) - 1), column]) / 2
    return np.where(n > 0, middle, 0.0)


def _eliminate_fixes(
    anchors_m: Float, moving: Int, range_m: Float, weight: Float, place_m: Float, free_axes: int
) -> _Equations:
    """The normal equations at place_m (3, E) and anchors_m (A, 3), for ranges and weights (A, E).

    With W the weights, U the directions of an epoch and G what the shared errors do to its ranges, the fix moves by F
    (r - G dv), F = (U^T W U)^-1 U^T W. That leaves the gradient R r and the information R G with the reach R = G^T (W -
    W U F). Epochs that their weights leave without a sharp fix do not count.
    """
    offset_m = place_m[:, None, :] - anchors_m.T[:, :, None]
    distance_m = np.maximum(np.sqrt((offset_m**2).sum(axis=0)), 1e-9)
    towards = offset_m / distance_m
    pulled = weight * towards[:free_axes]
    inverse, sharp = _invert_normal(pulled, towards, 0.05 * weight.max(initial=0.0))
    pulled, weight = pulled * sharp, weight * sharp
    follow = np.stack([sum(row[j] * pulled[j] for j in range(free_axes)) for row in inverse])
    residual_m = np.where(weight > 0, range_m - distance_m, 0.0)

    share = -sum(pulled[i][:, None] * follow[i] for i in range(free_axes))
    link = np.arange(len(anchors_m))
    share[link, link] += weight
    # An anchor's displacement makes its range shorter by so much of it as lies along the way to the tag.
    turn = [(anchor, -towards[axis, anchor]) for anchor in moving for axis in range(2)]
    reach = np.concatenate([share, *(each * share[anchor][None] for anchor, each in turn)])
    absorb = np.concatenate([follow, *((each * follow[:, anchor])[:, None] for anchor, each in turn)], axis=1)
    information = [reach.sum(axis=2), *((reach[:, anchor] @ each)[:, None] for anchor, each in turn)]
    return _Equations(
        reach=reach,
        pull=np.einsum("kae,ae->ke", reach, residual_m),
        information=np.concatenate(information, axis=1),
        absorb=absorb,
        fix_step_m=np.einsum("dae,ae->de", follow, residual_m),
    )


def _invert_normal(pulled: Float, towards: Float, least: float) -> tuple[list[list[Float]], np.ndarray]:
    """Rows of (U^T W U)^-1, entries (E,), and where its smallest eigenvalue is above least; elsewhere that of one.

    By Sylvester: it is above where all leading minors of the matrix less that are positive.
    """
    axes = len(pulled)
    xx, xy, yy, xz, yz, zz = (
        (pulled[i] * towards[j]).sum(axis=0) if j < axes else np.zeros(pulled.shape[2]) + (i == j)
        for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    )
    least_z = least if axes == 3 else 0.0
    lower_xx, lower_yy, lower_zz = xx - least, yy - least, zz - least_z
    minor = lower_xx * lower_yy - xy * xy
    det = minor * lower_zz - yz * (lower_xx * yz - xy * xz) + xz * (xy * yz - lower_yy * xz)
    sharp = (lower_xx > 0) & (minor > 0) & (det > 0)
    entries = [np.where(sharp, each, one) for each, one in ((xx, 1), (xy, 0), (yy, 1), (xz, 0), (yz, 0), (zz, 1))]
    with np.errstate(divide="ignore", invalid="ignore"):
        _, ixx, ixy, iyy, ixz, iyz, izz = invert_normal(*entries)
    rows = [[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]
    return [row[:axes] for row in rows[:axes]], sharp


def track_epochs(
    epochs: Epochs,
    anchors_m: Float,
    tag_height_m: float,
    range_std_m: float,
    acceleration_std_mps2: float,
    tag_height_std_m: float = 0.0,
) -> tuple[Float, int]:
    """(E, 3) smoothed places at the epochs, and how many axes are from ranges: 3, or 2 where the height is given."""
    fixes = solve_gauss_newton(anchors_m, epochs.range_m, tag_height_m, range_std_m, np.inf)
    row, column = np.nonzero(np.isfinite(epochs.range_m))
    log = log_ranges(
        epochs.t_ns[row],
        column,
        epochs.range_m[row, column],
        anchors_m,
        epochs.t_ns[fixes.solved],
        fixes.position_m[fixes.solved],
        range_std_m,
        walker(acceleration_std_mps2, tag_height_m, tag_height_std_m),
    )
    t_ns, track_m = smooth_places(log)
    if len(t_ns) == 0:
        return np.tile(np.append(anchors_m[:, :2].mean(axis=0), tag_height_m), (len(epochs), 1)), 2
    wanted_s, known_s = seconds_since(epochs.t_ns, int(t_ns[0])), seconds_since(t_ns, int(t_ns[0]))
    place_m = np.stack([np.interp(wanted_s, known_s, along_m) for along_m in track_m.T], axis=1)
    return place_m, log.axes
