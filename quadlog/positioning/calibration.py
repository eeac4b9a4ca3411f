"""The constant bias of each anchor, from the ranges of a log alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.epochs import Epochs
from quadlog.positioning.fixes import predict_ranges
from quadlog.positioning.gauss_newton import solve_gauss_newton
from quadlog.positioning.tracker import track_ranges

PRIOR_STD_M = 0.2
"""Biases of real sets lie within 0 and 0.4 m. What the geometry cannot see stays near zero, with this std."""
KNOWN_STD_M = 0.06
"""A bias known no better than this is worth less than none. Chosen on synthesized seeds 1 to 3: at 12 s of walking
the std is 0.063 or more and correcting makes tracks worse; from 30 s on it is 0.050 or less and errors fall to a
third."""
RARE_SHARE = 0.05
"""Links with fewer ranges than this share of the busiest one's have no say in whether a correction is applied."""
MAX_EPOCHS = 5000
ROUNDS = 8
HALF_TRUST_STD = 2.0
"""A range so many std off its link's median is well on its way to not counting."""
BLOCKS = (40, 20, 10, 5)
"""Into how many pieces a log is cut to see how its errors persist."""


@dataclass(frozen=True, slots=True)
class AnchorBias:
    """Measured minus true range of one tag's links to A anchors.

    bias_m, std_m: (A,); n: (A,) ranges it rests on.
    significant: (A,) bool, the links that are corrected. All that are well known, or none: errors of links
    that were estimated together cancel only together.
    """

    bias_m: Float
    std_m: Float
    significant: np.ndarray
    n: Int

    @property
    def applied_m(self) -> Float:
        """(A,) what to subtract from the ranges: the biases of the links that are corrected, zero elsewhere."""
        return np.where(self.significant, self.bias_m, 0.0)


def estimate_anchor_bias(
    epochs: Epochs, anchors_m: Float, tag_height_m: float, range_std_m: float, acceleration_std_mps2: float
) -> AnchorBias:
    """Biases of one tag's links to anchors (A, 3), without any truth.

    In turn: the smoothed track tells which ranges are off their link's usual
    residual (NLOS), and the others tell the biases. One epoch of three ranges
    could not tell the two apart; time can. The std covers white noise, and
    errors that persist for as long as a fifth of the log, not ones that last
    all of it. A tag that stands still shows no bias, and the std says so.
    """
    chosen = _usable_epochs(epochs, anchors_m, tag_height_m, range_std_m)
    n = np.isfinite(chosen.range_m).sum(axis=0).astype(np.int64)
    bias_m: Float = np.zeros(len(anchors_m))
    std_m: Float = np.full(len(anchors_m), PRIOR_STD_M)
    for _ in range(ROUNDS if len(chosen) else 0):
        before_m = bias_m
        unbiased = Epochs(chosen.t_ns, chosen.last_ns, chosen.range_m - bias_m)
        position_m = _track_epochs(unbiased, anchors_m, tag_height_m, range_std_m, acceleration_std_mps2)
        residual_m = chosen.range_m - predict_ranges(position_m, anchors_m, tag_height_m)
        weight = _weigh_by_lateness(residual_m, range_std_m)
        bias_m, std_m = solve_biases(anchors_m, chosen.range_m, weight, position_m, tag_height_m)
        if np.abs(bias_m - before_m).max() < 0.002:
            break
    return AnchorBias(bias_m, std_m, _worth_applying(bias_m, std_m, n), n)


def _worth_applying(bias_m: Float, std_m: Float, n: Int) -> np.ndarray:
    """(A,) bool: the well-known links, if every busy link is one and any bias lies beyond three std; else none."""
    known: np.ndarray = (std_m <= KNOWN_STD_M) & (n > 0)
    busy = n > RARE_SHARE * n.max(initial=0)
    applies = busy.any() and known[busy].all() and bool((np.abs(bias_m) > 3 * std_m)[known].any())
    return known & applies


def solve_biases(
    anchors_m: Float, range_m: Float, weight: Float, position_m: Float, tag_height_m: float
) -> tuple[Float, Float]:
    """Bias and std (A,) that fit ranges (E, A) with weights (E, A) in 1/m^2 best, every epoch's fix being free.

    Fixing and averaging residuals in turn creeps, because a fix absorbs most of
    a bias; here the fixes, started at position_m (E, 2), are eliminated from
    the normal equations. The std is the largest of those from the weights and
    from the scatter between blocks of the log: UWB errors persist in a place.
    """
    bias_m = np.zeros(len(anchors_m))
    prior = np.eye(len(anchors_m)) / PRIOR_STD_M**2
    information, gradient, absorb, fix_m = _eliminate_fixes(anchors_m, range_m, weight, position_m, tag_height_m)
    for _ in range(20):
        step_m = np.linalg.solve(information + prior, gradient.sum(axis=0) - bias_m / PRIOR_STD_M**2)
        bias_m = bias_m + step_m
        position_m = position_m + fix_m - absorb @ step_m
        information, gradient, absorb, fix_m = _eliminate_fixes(
            anchors_m, range_m - bias_m, weight, position_m, tag_height_m
        )
        if np.abs(step_m).max() < 1e-4:
            break
    covariance = np.linalg.inv(information + prior)
    variances = [np.diag(covariance)]
    for n in BLOCKS:
        blocks = np.array([block.sum(axis=0) for block in np.array_split(gradient, n)])
        variances.append(np.diag(covariance @ (blocks.T @ blocks) @ covariance) * n / (n - 1))
    return bias_m, np.sqrt(np.max(variances, axis=0))


def _usable_epochs(epochs: Epochs, anchors_m: Float, tag_height_m: float, range_std_m: float) -> Epochs:
    """Epochs that have a fix, thinned evenly: neighbours say the same, and time stays bounded."""
    enough = np.flatnonzero(np.isfinite(epochs.range_m).sum(axis=1) >= 3)
    enough = enough[:: max(1, -(-len(enough) // MAX_EPOCHS))]
    fixes = solve_gauss_newton(anchors_m, epochs.range_m[enough], tag_height_m, range_std_m, np.inf)
    chosen = enough[fixes.solved]
    return Epochs(epochs.t_ns[chosen], epochs.last_ns[chosen], epochs.range_m[chosen])


def _track_epochs(
    epochs: Epochs, anchors_m: Float, tag_height_m: float, range_std_m: float, acceleration_std_mps2: float
) -> Float:
    """(E, 2) smoothed positions at the epochs."""
    fixes = solve_gauss_newton(anchors_m, epochs.range_m, tag_height_m, range_std_m, np.inf)
    row, column = np.nonzero(np.isfinite(epochs.range_m))
    track = track_ranges(
        epochs.t_ns[row],
        column,
        epochs.range_m[row, column],
        anchors_m,
        tag_height_m,
        epochs.t_ns[fixes.solved],
        fixes.position_m[fixes.solved],
        range_std_m=range_std_m,
        acceleration_std_mps2=acceleration_std_mps2,
        smooth=True,
    ).track
    if len(track) == 0:
        return np.tile(anchors_m[:, :2].mean(axis=0), (len(epochs), 1))
    start_ns = int(track.t_ns[0])
    wanted_s, known_s = seconds_since(epochs.t_ns, start_ns), seconds_since(track.t_ns, start_ns)
    return np.stack([np.interp(wanted_s, known_s, track.position_m[:, axis]) for axis in range(2)], axis=1)


def _weigh_by_lateness(residual_m: Float, range_std_m: float) -> Float:
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
    anchors_m: Float, range_m: Float, weight: Float, position_m: Float, tag_height_m: float
) -> tuple[Float, Float, Float, Float]:
    """Normal equations of the biases alone, and what ties the fixes to them.

    With W the weights and U the directions of an epoch, the fix moves by
    A (r - db), A = (U^T W U)^-1 U^T W. So the biases' information (A, A) is the
    sum of W - W U A, and an epoch's gradient (E, A) is W (r - U A r). Returns
    these, A as (E, 2, A), and A r as (E, 2). Epochs that their weights leave
    without a sharp fix do not count.
    """
    distance_m = np.maximum(predict_ranges(position_m, anchors_m, tag_height_m), 1e-9)
    direction = (position_m[:, None, :] - anchors_m[None, :, :2]) / distance_m[:, :, None]
    normal = np.einsum("ea,eai,eaj->eij", weight, direction, direction)
    sharp = np.linalg.eigvalsh(normal)[:, 0] > 0.05 * weight.max()
    weight = weight * sharp[:, None]
    normal[~sharp] = np.eye(2)

    residual_m = np.where(weight > 0, range_m - distance_m, 0.0)
    weighted = weight[:, :, None] * direction
    absorb = np.linalg.inv(normal) @ weighted.transpose(0, 2, 1)
    fix_m = np.einsum("eia,ea->ei", absorb, residual_m)
    information = np.diag(weight.sum(axis=0)) - np.einsum("eai,eib->ab", weighted, absorb)
    return information, weight * residual_m - np.einsum("eai,ei->ea", weighted, fix_m), absorb, fix_m
