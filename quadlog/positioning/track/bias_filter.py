"""Compiled filter whose state holds a constant bias for each link beside the place and the velocity of a tag."""

from __future__ import annotations

import math

from quadlog.compiled import kernel
from quadlog.messages import Float, Int
from quadlog.positioning.track.kalman import HEIGHT_LASTS_S, MotionModel


@kernel
def filter_biases(
    t_s: Float,
    first_row: Int,
    link: Int,
    unit: Float,
    told_m: Float,
    variance_m2: Float,
    motion: MotionModel,
    state: Float,
    covariance: Float,
    lever: Float,
) -> None:
    """Take T instants into state (5 + A,) and covariance (5 + A, 5 + A), in place: x, y, z, vx, vy, then the biases.

    told_m (N,) is what a range says of u . p + b, with u (N, 3) its direction and b the bias of its link (N,).
    variance_m2 (N,) is infinite for a range that does not count. lever (5 + A,) is work space. The motion is that of
    `predict_state`; ranges are taken one by one.
    """
    size = len(state)
    density, height_m, height_std_m = motion
    for k in range(len(t_s)):
        if k > 0:
            dt_s = t_s[k] - t_s[k - 1]
            keep = math.exp(-dt_s / HEIGHT_LASTS_S)
            for axis in range(2):
                state[axis] += dt_s * state[3 + axis]
                for j in range(size):
                    covariance[axis, j] += dt_s * covariance[3 + axis, j]
                for j in range(size):
                    covariance[j, axis] += dt_s * covariance[j, 3 + axis]
                covariance[axis, axis] += density * dt_s**3 / 3
                covariance[axis, 3 + axis] += density * dt_s**2 / 2
                covariance[3 + axis, axis] += density * dt_s**2 / 2
                covariance[3 + axis, 3 + axis] += density * dt_s
            state[2] = height_m + keep * (state[2] - height_m)
            for j in range(size):
                covariance[2, j] *= keep
            for j in range(size):
                covariance[j, 2] *= keep
            covariance[2, 2] += height_std_m * height_std_m * (1 - keep * keep)
        for row in range(first_row[k], first_row[k + 1]):
            if not variance_m2[row] < math.inf:
                continue
            own = 5 + link[row]
            ux, uy, uz = unit[row, 0], unit[row, 1], unit[row, 2]
            for i in range(size):
                lever[i] = ux * covariance[i, 0] + uy * covariance[i, 1] + uz * covariance[i, 2] + covariance[i, own]
            total = ux * lever[0] + uy * lever[1] + uz * lever[2] + lever[own] + variance_m2[row]
            missed = told_m[row] - ux * state[0] - uy * state[1] - uz * state[2] - state[own]
            for i in range(size):
                state[i] += lever[i] * missed / total
            for i in range(size):
                share = lever[i] / total
                for j in range(size):
                    covariance[i, j] -= share * lever[j]
