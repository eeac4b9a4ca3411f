"""Compiled constant-velocity filter on the ranges of one tag; `tracker` is what to call."""

from __future__ import annotations

import math

from quadlog.compiled import inner, kernel
from quadlog.messages import Float, Int
from quadlog.positioning.descent import invert_one
from quadlog.positioning.tag_state import (
    Covariance,
    Motion,
    State,
    absorb,
    exchange,
    gain_of,
    predict_state,
    times,
)

RESTED_M = 1e-5
"""A linearisation point that moves by less rests."""
STATE, COVARIANCE, FILTERED = slice(0, 5), slice(5, 30), 39
"""Where state and covariance are in a row of what the filter writes, and how long that is."""


@inner
def update_velocity(
    state: State, covariance: Covariance, vx_mps: float, vy_mps: float, variance: float
) -> tuple[State, Covariance]:
    """Posterior from a measured velocity in map with the given variance of each axis, in m^2/s^2."""
    _, _, _, u, v = state
    uu, uv, vv = covariance[12] + variance, covariance[13], covariance[14] + variance
    share = 1 / (uu * vv - uv * uv)
    gain = (share * vv, -share * uv, 0.0, share * uu, 0.0, 0.0)
    state, covariance = exchange(state, covariance)
    state, covariance = absorb(state, covariance, gain, times(gain, (vx_mps - u, vy_mps - v, 0.0)))
    return exchange(state, covariance)


@inner
def update_state(
    state: State,
    covariance: Covariance,
    first: int,
    end: int,
    place_m: Float,
    range_m: Float,
    given_weight: Float,
    variance: float,
    free_z: float,
    long_m: float,
    short_m: float,
    weight: Float,
) -> tuple[State, Covariance, tuple[float, ...]]:
    """Posterior of one instant, whose rows are [first, end) of N ranges (N,) to places (N, 3).

    Iterated until the linearisation point rests, so that a poor prediction near
    an anchor does no harm. free_z: one, or zero where the height is given.
    weight (N,) takes given_weight, less 1/residual beyond long_m and -short_m,
    so that the pull of a range is bounded; variance is that of a range of full
    weight. With the covariance C of the place, its information L = sum w u
    u^T/variance over the directions u, and the gradient b of the log-likelihood
    at the prior, the place moves by (C^-1 + L)^-1 b. Returned are L and the
    gradient at the posterior, too.
    """
    sx, sy, sz, _, _ = state
    xx, xy, xz, _, _, yy, yz, _, _, zz, _, _, _, _, _ = covariance
    _, ixx, ixy, iyy, ixz, iyz, izz = invert_one(xx, xy, yy, xz, yz, zz + 1 - free_z)
    full, moved, gradient = 1 / variance, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    x, y, z = sx, sy, sz
    information = shrunk = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for _ in range(10):
        lxx, lxy, lxz, lyy, lyz, lzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        bx, by, bz = 0.0, 0.0, 0.0
        for j in range(first, end):
            dx, dy, dz = x - place_m[j, 0], y - place_m[j, 1], z - place_m[j, 2]
            distance_m = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
            inverse = 1 / distance_m
            ux, uy, uz = dx * inverse, dy * inverse, free_z * dz * inverse
            residual_m = range_m[j] - distance_m
            trust = given_weight[j]
            if residual_m > long_m:
                trust *= long_m / residual_m
            elif residual_m < -short_m:
                trust *= -short_m / residual_m
            weight[j] = trust
            trust *= full
            tx, ty, tz = trust * ux, trust * uy, trust * uz
            told_m = residual_m + ux * (x - sx) + uy * (y - sy) + uz * (z - sz)
            bx, by, bz = bx + told_m * tx, by + told_m * ty, bz + told_m * tz
            lxx, lxy, lxz = lxx + tx * ux, lxy + tx * uy, lxz + tx * uz
            lyy, lyz, lzz = lyy + ty * uy, lyz + ty * uz, lzz + tz * uz
        _, cxx, cxy, cyy, cxz, cyz, czz = invert_one(ixx + lxx, ixy + lxy, iyy + lyy, ixz + lxz, iyz + lyz, izz + lzz)
        information, shrunk, gradient = (lxx, lxy, lxz, lyy, lyz, lzz), (cxx, cxy, cxz, cyy, cyz, czz), (bx, by, bz)
        moved = times(shrunk, gradient)
        off_m = abs(sx + moved[0] - x) + abs(sy + moved[1] - y) + abs(sz + moved[2] - z)
        x, y, z = sx + moved[0], sy + moved[1], sz + moved[2]
        if off_m < RESTED_M:
            break
    gained = times(information, moved)
    gradient = (gradient[0] - gained[0], gradient[1] - gained[1], gradient[2] - gained[2])
    state, covariance = absorb(state, covariance, gain_of(information, shrunk), gradient)
    return state, covariance, information + gradient


@kernel
def filter_ranges(
    t_s: Float,
    first_row: Int,
    place_m: Float,
    range_m: Float,
    given_weight: Float,
    velocity_mps: Float,
    velocity_variance: Float,
    state: State,
    covariance: Covariance,
    motion: Motion,
    range_variance: float,
    long_m: float,
    short_m: float,
    weight: Float,
    filtered: Float,
) -> None:
    """Filters T instants from a state that holds just before the first; instant k has rows first_row[k]:first_row[k+1].

    velocity_mps (T, 2) counts where velocity_variance (T,) is finite. Written:
    weight (N,), and into filtered (T, 39) the STATE, its COVARIANCE row by row,
    and what update_state returns of its ranges: their information, and gradient.
    """
    free_z = 1.0 if motion.height_std_m > 0 else 0.0
    for k in range(len(t_s)):
        if k > 0:
            state, covariance = predict_state(state, covariance, t_s[k] - t_s[k - 1], motion)
        if velocity_variance[k] < math.inf:
            state, covariance = update_velocity(
                state, covariance, velocity_mps[k, 0], velocity_mps[k, 1], velocity_variance[k]
            )
        state, covariance, told = update_state(
            state,
            covariance,
            first_row[k],
            first_row[k + 1],
            place_m,
            range_m,
            given_weight,
            range_variance,
            free_z,
            long_m,
            short_m,
            weight,
        )
        xx, xy, xz, xu, xv, yy, yz, yu, yv, zz, zu, zv, uu, uv, vv = covariance
        whole = (
            xx, xy, xz, xu, xv, xy, yy, yz, yu, yv, xz, yz, zz, zu, zv, xu, yu, zu, uu, uv, xv, yv, zv, uv, vv,
        )  # fmt: skip
        row = state + whole + told
        for i in range(39):
            filtered[k, i] = row[i]
