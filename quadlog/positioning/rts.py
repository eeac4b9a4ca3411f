"""The Rauch-Tung-Striebel smoother [RTS] of what `kalman` has filtered: states many times, covariances once."""

from __future__ import annotations

import math

import numpy as np

from quadlog.compiled import kernel
from quadlog.messages import Float
from quadlog.positioning.kalman import COVARIANCE
from quadlog.positioning.tag_state import HEIGHT_LASTS_S, Motion


@kernel
def smooth_states(t_s: Float, velocity_mps: Float, velocity_variance: Float, filtered: Float, smoothed: Float) -> None:
    """Writes into smoothed (T, 5) the states given all ranges, from what filter_ranges wrote.

    They are those of [RTS], without an inverse [Bryson]: the state plus its
    covariance times the pull, the gradient of the log-likelihood of all that comes later.
    Backwards in time, each instant's measurements join in with what they miss
    the smoothed state by.
    """
    px, py, pz, pu, pv = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(t_s) - 1, -1, -1):
        for i in range(5):
            smoothed[k, i] = (
                filtered[k, 5 * i + 5] * px
                + filtered[k, 5 * i + 6] * py
                + filtered[k, 5 * i + 7] * pz
                + filtered[k, 5 * i + 8] * pu
                + filtered[k, 5 * i + 9] * pv
            )
        x, y, z = smoothed[k, 0], smoothed[k, 1], smoothed[k, 2]
        lxx, lxy, lxz, lyy, lyz, lzz = (
            filtered[k, 30], filtered[k, 31], filtered[k, 32], filtered[k, 33], filtered[k, 34], filtered[k, 35]
        )  # fmt: skip
        px += filtered[k, 36] - lxx * x - lxy * y - lxz * z
        py += filtered[k, 37] - lxy * x - lyy * y - lyz * z
        pz += filtered[k, 38] - lxz * x - lyz * y - lzz * z
        for i in range(5):
            smoothed[k, i] += filtered[k, i]
        pu += (velocity_mps[k, 0] - smoothed[k, 3]) / velocity_variance[k]
        pv += (velocity_mps[k, 1] - smoothed[k, 4]) / velocity_variance[k]
        if k > 0:
            dt_s = t_s[k] - t_s[k - 1]
            pu, pv, pz = pu + dt_s * px, pv + dt_s * py, pz * math.exp(-dt_s / HEIGHT_LASTS_S)


def smooth_covariances(t_s: Float, filtered: Float, motion: Motion) -> Float:
    """(T, 5, 5) covariances given all ranges, from what filter_ranges wrote: C + G (C' - F C F^T - Q) G^T."""
    covariances = filtered[:, COVARIANCE].reshape(-1, 5, 5)
    moved, ahead = _predict_covariances(covariances[:-1], np.diff(t_s), motion)
    gain = np.linalg.solve(ahead, moved).transpose(0, 2, 1)
    rest = covariances[:-1] - gain @ ahead @ gain.transpose(0, 2, 1)
    rest = (rest + rest.transpose(0, 2, 1)) / 2
    smoothed = covariances.copy()
    for k in range(len(t_s) - 2, -1, -1):
        smoothed[k] = rest[k] + gain[k] @ smoothed[k + 1] @ gain[k].T
    return (smoothed + smoothed.transpose(0, 2, 1)) / 2


def _predict_covariances(covariances: Float, dt_s: Float, motion: Motion) -> tuple[Float, Float]:
    """F C and F C F^T + Q (K, 5, 5), dt_s (K,) after C, as predict_state has them.

    A height that is given gets a variance there, of which the gain takes nothing: so it has an inverse.
    """
    moved = _move(covariances, dt_s)
    ahead = _move(moved.transpose(0, 2, 1), dt_s)
    for place, speed in ((0, 3), (1, 4)):
        ahead[:, place, place] += motion.density_m2ps3 * dt_s**3 / 3
        ahead[:, place, speed] += motion.density_m2ps3 * dt_s**2 / 2
        ahead[:, speed, place] += motion.density_m2ps3 * dt_s**2 / 2
        ahead[:, speed, speed] += motion.density_m2ps3 * dt_s
    if motion.height_std_m > 0:
        ahead[:, 2, 2] -= motion.height_std_m**2 * np.expm1(-2 * dt_s / HEIGHT_LASTS_S)
    else:
        ahead[:, 2, 2] = 1.0
    return moved, ahead


def _move(rows: Float, dt_s: Float) -> Float:
    """F @ rows for rows (K, 5, 5): position moves with velocity, a height falls back to its mean."""
    moved = rows.copy()
    moved[:, :2] += dt_s[:, None, None] * rows[:, 3:]
    moved[:, 2] *= np.exp(-dt_s / HEIGHT_LASTS_S)[:, None]
    return moved
