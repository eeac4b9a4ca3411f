"""Compiled filter and smoother of a rigid body with several tags: place, yaw, velocity and yaw rate from ranges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadlog.compiled import inner, kernel
from quadlog.messages import Float, Int
from quadlog.positioning.fix.least_squares import invert_one
from quadlog.positioning.track.kalman import RESTED_M, Symmetric, Vector, gain_of, times
from quadlog.positioning.track.rts_smoother import smooth_backwards

SIZE = 6
"""State: x, y, yaw, then their rates vx, vy, yaw rate. Ranges measure the first three."""
ITERATIONS = 10


class BodyDynamics(NamedTuple):
    """White acceleration of spectral density density_m2ps3; a yaw rate that is a first-order Gauss-Markov process."""

    density_m2ps3: float
    yaw_rate_std_radps: float
    yaw_rate_lasts_s: float


@inner
def predict_body(state: Float, covariance: Float, dt_s: float, motion: BodyDynamics) -> None:
    """State (6,) and covariance (6, 6) after dt_s, in place.

    The yaw rate decays with the time constant T: yaw += T (1 - e^(-dt/T)) rate. Its noise is integrated exactly.
    """
    density, rate_std, lasts_s = motion
    keep = math.exp(-dt_s / lasts_s)
    turned_s = lasts_s * (1 - keep)
    for axis in range(3):
        reach_s = turned_s if axis == 2 else dt_s
        state[axis] += reach_s * state[axis + 3]
        for j in range(SIZE):
            covariance[axis, j] += reach_s * covariance[axis + 3, j]
        for j in range(SIZE):
            covariance[j, axis] += reach_s * covariance[j, axis + 3]
    state[5] *= keep
    for j in range(SIZE):
        covariance[5, j] *= keep
    for j in range(SIZE):
        covariance[j, 5] *= keep
    for axis in range(2):
        covariance[axis, axis] += density * dt_s**3 / 3
        covariance[axis, axis + 3] += density * dt_s**2 / 2
        covariance[axis + 3, axis] += density * dt_s**2 / 2
        covariance[axis + 3, axis + 3] += density * dt_s
    variance, lost = rate_std * rate_std, 1 - keep
    covariance[2, 2] += variance * lasts_s * (2 * dt_s - lasts_s * lost * (3 - keep))
    covariance[2, 5] += variance * lasts_s * lost * lost
    covariance[5, 2] += variance * lasts_s * lost * lost
    covariance[5, 5] += variance * (1 - keep * keep)


@inner
def update_body(
    state: Float,
    covariance: Float,
    first: int,
    end: int,
    anchor_m: Float,
    lever_m: Float,
    range_m: Float,
    given_weight: Float,
    variance: float,
    long_m: float,
    short_m: float,
    weight: Float,
    head: Float,
) -> tuple[Symmetric, Vector, float]:
    """Posterior of one instant with rows [first, end), in place; `update_state` with the yaw in place of the height.

    anchor_m (N, 3): each range's anchor, its height less the tag's; lever_m (N, 2): where the tag sits in the body. A
    range measures x, y, yaw along (u, u . dR/dyaw l). Returned: their information and gradient at the posterior, and
    the squared innovation.
    """
    sx, sy, syaw = state[0], state[1], state[2]
    _, ixx, ixy, iyy, ixw, iyw, iww = invert_one(
        covariance[0, 0], covariance[0, 1], covariance[1, 1], covariance[0, 2], covariance[1, 2], covariance[2, 2]
    )
    x, y, yaw = sx, sy, syaw
    full, innovation = 1 / variance, 0.0
    moved, gradient = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    information = shrunk = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for step in range(ITERATIONS):
        lxx, lxy, lxw, lyy, lyw, lww = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        bx, by, bw, missed = 0.0, 0.0, 0.0, 0.0
        cos, sin = math.cos(yaw), math.sin(yaw)
        for j in range(first, end):
            ahead_m, left_m = lever_m[j, 0], lever_m[j, 1]
            arm_x, arm_y = cos * ahead_m - sin * left_m, sin * ahead_m + cos * left_m
            dx, dy, dz = x + arm_x - anchor_m[j, 0], y + arm_y - anchor_m[j, 1], anchor_m[j, 2]
            distance_m = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
            ux, uy = dx / distance_m, dy / distance_m
            uw = uy * arm_x - ux * arm_y
            residual_m = range_m[j] - distance_m
            trust = given_weight[j]
            if residual_m > long_m:
                trust *= long_m / residual_m
            elif residual_m < -short_m:
                trust *= -short_m / residual_m
            weight[j] = trust
            trust *= full
            missed += trust * residual_m * residual_m
            told_m = residual_m + ux * (x - sx) + uy * (y - sy) + uw * (yaw - syaw)
            tx, ty, tw = trust * ux, trust * uy, trust * uw
            bx, by, bw = bx + told_m * tx, by + told_m * ty, bw + told_m * tw
            lxx, lxy, lxw = lxx + tx * ux, lxy + tx * uy, lxw + tx * uw
            lyy, lyw, lww = lyy + ty * uy, lyw + ty * uw, lww + tw * uw
        _, cxx, cxy, cyy, cxw, cyw, cww = invert_one(ixx + lxx, ixy + lxy, iyy + lyy, ixw + lxw, iyw + lyw, iww + lww)
        information, shrunk, gradient = (lxx, lxy, lxw, lyy, lyw, lww), (cxx, cxy, cxw, cyy, cyw, cww), (bx, by, bw)
        moved = times(shrunk, gradient)
        if step == 0:
            innovation = missed - gradient[0] * moved[0] - gradient[1] * moved[1] - gradient[2] * moved[2]
        off = abs(sx + moved[0] - x) + abs(sy + moved[1] - y) + abs(syaw + moved[2] - yaw)
        x, y, yaw = sx + moved[0], sy + moved[1], syaw + moved[2]
        if off < RESTED_M:
            break
    gained = times(information, moved)
    pull = (gradient[0] - gained[0], gradient[1] - gained[1], gradient[2] - gained[2])
    absorb_body(state, covariance, gain_of(information, shrunk), pull, head)
    return information, pull, innovation


@inner
def absorb_body(state: Float, covariance: Float, gain: Symmetric, pull: Vector, head: Float) -> None:
    """Posterior from gain_of measurements of the first three components and their gradient there, in place.

    head (3, 6): work space.
    """
    px, py, pw = pull
    for i in range(3):
        for j in range(SIZE):
            head[i, j] = covariance[i, j]
    for i in range(SIZE):
        hx, hy, hw = head[0, i], head[1, i], head[2, i]
        state[i] += hx * px + hy * py + hw * pw
        ax, ay, aw = times(gain, (hx, hy, hw))
        for j in range(SIZE):
            covariance[i, j] -= ax * head[0, j] + ay * head[1, j] + aw * head[2, j]


@inner
def absorb_rate(state: Float, covariance: Float, row: int, measured: float, variance: float, head: Float) -> None:
    """Posterior from a measurement of one component of the state, in place; head (3, 6): work space."""
    total = covariance[row, row] + variance
    missed = measured - state[row]
    for i in range(SIZE):
        head[0, i] = covariance[row, i]
    for i in range(SIZE):
        share = head[0, i] / total
        state[i] += share * missed
        for j in range(SIZE):
            covariance[i, j] -= share * head[0, j]


STATE, COVARIANCE, INNOVATION, FILTERED = slice(0, 6), slice(6, 42), 51, 52
"""Where state, covariance and squared innovation are in a row of what the filter writes, and how long that is."""


@kernel
def filter_body(
    t_s: Float,
    first_row: Int,
    anchor_m: Float,
    lever_m: Float,
    range_m: Float,
    given_weight: Float,
    velocity_mps: Float,
    velocity_variance: Float,
    start: Float,
    start_variance: Float,
    motion: BodyDynamics,
    range_variance: float,
    long_m: float,
    short_m: float,
    weight: Float,
    filtered: Float,
) -> None:
    """Filter T instants from a start (6,) with variances (6,); instant k has the rows first_row[k]:first_row[k+1].

    Rows as in `update_body`. velocity_mps (T, 2) counts where velocity_variance (T,) is finite. Written: weight (N,),
    and into filtered (T, 52) the STATE, its COVARIANCE row by row, and of the instant's ranges their information (6),
    gradient (3) and squared INNOVATION.
    """
    state, covariance, head = start.copy(), np.zeros((SIZE, SIZE)), np.empty((3, SIZE))
    for i in range(SIZE):
        covariance[i, i] = start_variance[i]
    for k in range(len(t_s)):
        if k > 0:
            predict_body(state, covariance, t_s[k] - t_s[k - 1], motion)
        for axis in range(2):
            if velocity_variance[k] < math.inf:
                absorb_rate(state, covariance, 3 + axis, velocity_mps[k, axis], velocity_variance[k], head)
        information, pull, innovation = update_body(
            state,
            covariance,
            first_row[k],
            first_row[k + 1],
            anchor_m,
            lever_m,
            range_m,
            given_weight,
            range_variance,
            long_m,
            short_m,
            weight,
            head,
        )
        for i in range(SIZE):
            filtered[k, i] = state[i]
            for j in range(SIZE):
                filtered[k, 6 + SIZE * i + j] = covariance[i, j]
        for i in range(6):
            filtered[k, 42 + i] = information[i]
        for i in range(3):
            filtered[k, 48 + i] = pull[i]
        filtered[k, 51] = innovation


@kernel
def smooth_body(
    t_s: Float,
    velocity_mps: Float,
    velocity_variance: Float,
    filtered: Float,
    motion: BodyDynamics,
    smoothed: Float,
) -> None:
    """Write the states (T, 6) given all ranges, from what filter_body wrote: `smooth_states` of a body."""
    pull = np.zeros(SIZE)
    for k in range(len(t_s) - 1, -1, -1):
        for i in range(SIZE):
            smoothed[k, i] = filtered[k, i]
            for j in range(SIZE):
                smoothed[k, i] += filtered[k, 6 + SIZE * i + j] * pull[j]
        x, y, yaw = smoothed[k, 0] - filtered[k, 0], smoothed[k, 1] - filtered[k, 1], smoothed[k, 2] - filtered[k, 2]
        lxx, lxy, lxw, lyy, lyw, lww = (
            filtered[k, 42], filtered[k, 43], filtered[k, 44], filtered[k, 45], filtered[k, 46], filtered[k, 47]
        )  # fmt: skip
        pull[0] += filtered[k, 48] - lxx * x - lxy * y - lxw * yaw
        pull[1] += filtered[k, 49] - lxy * x - lyy * y - lyw * yaw
        pull[2] += filtered[k, 50] - lxw * x - lyw * y - lww * yaw
        for axis in range(2):
            pull[3 + axis] += (velocity_mps[k, axis] - smoothed[k, 3 + axis]) / velocity_variance[k]
        if k > 0:
            dt_s = t_s[k] - t_s[k - 1]
            keep = math.exp(-dt_s / motion.yaw_rate_lasts_s)
            pull[3] += dt_s * pull[0]
            pull[4] += dt_s * pull[1]
            pull[5] = keep * pull[5] + motion.yaw_rate_lasts_s * (1 - keep) * pull[2]


def smooth_body_covariances(t_s: Float, filtered: Float, motion: BodyDynamics) -> Float:
    """(T, 6, 6) covariances given all ranges, from what filter_body wrote; the prediction is that of predict_body."""
    covariances, dt_s = filtered[:, COVARIANCE].reshape(-1, SIZE, SIZE), np.diff(t_s)
    density, rate_std, lasts_s = motion
    keep = np.exp(-dt_s / lasts_s)
    step, noise = np.zeros((len(dt_s), SIZE, SIZE)), np.zeros((len(dt_s), SIZE, SIZE))
    step[:] = np.eye(SIZE)
    for axis in range(2):
        rate = axis + 3
        step[:, axis, rate] = dt_s
        noise[:, axis, axis], noise[:, rate, rate] = density * dt_s**3 / 3, density * dt_s
        noise[:, axis, rate] = noise[:, rate, axis] = density * dt_s**2 / 2
    step[:, 2, 5], step[:, 5, 5] = lasts_s * (1 - keep), keep
    noise[:, 2, 2] = rate_std**2 * lasts_s * (2 * dt_s - lasts_s * (1 - keep) * (3 - keep))
    noise[:, 2, 5] = noise[:, 5, 2] = rate_std**2 * lasts_s * (1 - keep) ** 2
    noise[:, 5, 5] = rate_std**2 * (1 - keep**2)
    moved = step @ covariances[:-1]
    return smooth_backwards(covariances, moved, moved @ step.transpose(0, 2, 1) + noise)
