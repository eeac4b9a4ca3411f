"""The constant bias of each anchor, from the ranges of a log alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.epochs import Epochs
from quadlog.positioning.gauss_newton import solve_gauss_newton
from quadlog.positioning.range_log import log_ranges, walker
from quadlog.positioning.shared_errors import (
    bias_covariance_at,
    scatter_covariances,
    solve_shared_errors,
    weigh_by_lateness,
)
from quadlog.positioning.tracker import smooth_places

PRIOR_STD_M = 0.2
"""Biases of real sets lie within 0 and 0.4 m. What the geometry cannot see stays near zero, with this std."""
KNOWN_STD_M = 0.08
"""A bias known no better than this is worth less than none. Chosen on 60 simulated walks of 12 s with NLOS bursts,
seeds 5000 on: up to here every correction was better than none, at 0.1 m one in six was worse."""
RARE_SHARE = 0.05
"""Links with fewer ranges than this share of the busiest one's have no say in whether a correction is applied."""
MAX_EPOCHS = 5000
ROUNDS = 8
LATE_STD_M = 0.01
"""A tenth of ranges late by half a metre shifts a bias by so much (seeds 2000 on), and no scatter shows it."""


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
    epochs: Epochs,
    anchors_m: Float,
    tag_height_m: float,
    range_std_m: float,
    acceleration_std_mps2: float,
    tag_height_std_m: float = 0.0,
) -> AnchorBias:
    """Biases of one tag's links to anchors (A, 3), without any truth.

    In turn: the smoothed track tells which ranges are off their link's usual
    residual (NLOS), and the others tell the biases. One epoch of three ranges
    could not tell the two apart; time can. The std covers white noise, errors
    that persist for as long as a fifth of the log, and late ranges that pass
    for a bias, not errors that last all of it. Nor is it better than what the
    geometry of the uncorrected track allows: a wrong bias bends a track, and
    a bent one seems to tell more. A tag that stands still shows no bias, and
    the std says so. With tag_height_std_m above zero the height is tracked, and
    every fix is free in space: a height that were held would pass its error on
    to the biases.
    """
    chosen = _usable_epochs(epochs, anchors_m, tag_height_m, range_std_m)
    n = np.isfinite(chosen.range_m).sum(axis=0).astype(np.int64)
    none, prior = np.empty(0, dtype=np.int64), np.eye(len(anchors_m)) / PRIOR_STD_M**2
    bias_m: Float = np.zeros(len(anchors_m))
    told_m2: list[Float] = [np.linalg.inv(prior)]
    for count in range(ROUNDS if len(chosen) else 0):
        before_m = bias_m
        unbiased = Epochs(chosen.t_ns, chosen.last_ns, chosen.range_m - bias_m)
        place_m, free_axes = track_epochs(
            unbiased, anchors_m, tag_height_m, range_std_m, acceleration_std_mps2, tag_height_std_m
        )
        residual_m = chosen.range_m - np.linalg.norm(place_m[:, None] - anchors_m, axis=2)
        weight = weigh_by_lateness(residual_m, range_std_m)
        if count == 0:
            told_m2 = [bias_covariance_at(anchors_m, weight, place_m, free_axes, prior)]
        errors = solve_shared_errors(anchors_m, none, chosen.range_m, weight, place_m, free_axes, prior)
        told_m2[1:] = [errors.covariance_m2, *scatter_covariances(errors, weight)]
        bias_m = errors.bias_m
        if np.abs(bias_m - before_m).max() < 0.002:
            break
    std_m = np.sqrt(np.max([np.diag(each_m2) for each_m2 in told_m2], axis=0) + LATE_STD_M**2)
    return AnchorBias(bias_m, std_m, _worth_applying(bias_m, std_m, n), n)


def _worth_applying(bias_m: Float, std_m: Float, n: Int) -> np.ndarray:
    """(A,) bool: the well-known links, if every busy link is one and any bias lies beyond three std; else none."""
    known: np.ndarray = (std_m <= KNOWN_STD_M) & (n > 0)
    busy = n > RARE_SHARE * n.max(initial=0)
    applies = busy.any() and known[busy].all() and bool((np.abs(bias_m) > 3 * std_m)[known].any())
    return known & applies


def _usable_epochs(epochs: Epochs, anchors_m: Float, tag_height_m: float, range_std_m: float) -> Epochs:
    """Epochs that have a fix, thinned evenly: neighbours say the same, and time stays bounded."""
    enough = np.flatnonzero(np.isfinite(epochs.range_m).sum(axis=1) >= 3)
    enough = enough[:: max(1, -(-len(enough) // MAX_EPOCHS))]
    fixes = solve_gauss_newton(anchors_m, epochs.range_m[enough], tag_height_m, range_std_m, np.inf)
    chosen = enough[fixes.solved]
    return Epochs(epochs.t_ns[chosen], epochs.last_ns[chosen], epochs.range_m[chosen])


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
