"""Compiled constant-velocity filter on the ranges of one tag: its state, its updates and its loop."""

from __future__ import annotations

import math
from typing import NamedTuple

from quadlog.compiled import inner, kernel
from quadlog.messages import Float, Int
from quadlog.positioning.fix.least_squares import invert_one

HEIGHT_LASTS_S = 20.0
"""Correlation time of a tag's height about its known mean: sitting down, a step, a slope."""
Vector = tuple[float, float, float]
Symmetric = tuple[float, float, float, float, float, float]
"""xx, xy, xz, yy, yz, zz."""
State = tuple[float, float, float, float, float]
"""x, y, z, vx, vy."""
Covariance = tuple[
    float, float, float, float, float,
    float, float, float, float,
    float, float, float,
    float, float,
    float,
]  # fmt: skip
"""The upper triangle row by row; below, vx and vy are u and v."""


class MotionModel(NamedTuple):
    """How a tag moves: spectral density of its white horizontal acceleration, mean and std of its height."""

    density_m2ps3: float
    height_m: float
    height_std_m: float


@inner
def predict_state(state: State, covariance: Covariance, dt_s: float, motion: MotionModel) -> tuple[State, Covariance]:
    """State and covariance after dt_s.

    The height is a first-order Gauss-Markov process: what is known of it holds at every instant, so where the anchors'
    geometry says nothing it keeps that std. A free random walk would grow until its mirror image came in reach.
    """
    x, y, z, u, v = state
    xx, xy, xz, xu, xv, yy, yz, yu, yv, zz, zu, zv, uu, uv, vv = covariance
    density, height_m, height_std_m = motion
    keep = math.exp(-dt_s / HEIGHT_LASTS_S)
    shaken, driven = density * dt_s * dt_s / 2, height_std_m * height_std_m * (1 - keep * keep)
    cubed = shaken * dt_s * 2 / 3
    ahead = (x + dt_s * u, y + dt_s * v, height_m + keep * (z - height_m), u, v)
    grown = (
        xx + dt_s * (xu + xu + dt_s * uu) + cubed, xy + dt_s * (yu + xv + dt_s * uv), keep * (xz + dt_s * zu),
        xu + dt_s * uu + shaken, xv + dt_s * uv,
        yy + dt_s * (yv + yv + dt_s * vv) + cubed, keep * (yz + dt_s * zv), yu + dt_s * uv, yv + dt_s * vv + shaken,
        keep * keep * zz + driven, keep * zu, keep * zv,
        uu + density * dt_s, uv, vv + density * dt_s,
    )  # fmt: skip
    return ahead, grown


@inner
def times(symmetric: Symmetric, vector: Vector) -> Vector:
    """Their product."""
    xx, xy, xz, yy, yz, zz = symmetric
    x, y, z = vector
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


@inner
def absorb(state: State, covariance: Covariance, gain: Symmetric, pull: Vector) -> tuple[State, Covariance]:
    """Posterior from gain_of measurements of the first three components, and from their gradient there."""
    x, y, z, u, v = state
    xx, xy, xz, xu, xv, yy, yz, yu, yv, zz, zu, zv, uu, uv, vv = covariance
    ax, bx, cx = times(gain, (xx, xy, xz))
    ay, by, cy = times(gain, (xy, yy, yz))
    az, bz, cz = times(gain, (xz, yz, zz))
    au, bu, cu = times(gain, (xu, yu, zu))
    av, bv, cv = times(gain, (xv, yv, zv))
    px, py, pz = pull
    moved = (
        x + xx * px + xy * py + xz * pz,
        y + xy * px + yy * py + yz * pz,
        z + xz * px + yz * py + zz * pz,
        u + xu * px + yu * py + zu * pz,
        v + xv * px + yv * py + zv * pz,
    )
    shrunk = (
        xx - ax * xx - bx * xy - cx * xz,
        xy - ax * xy - bx * yy - cx * yz,
        xz - ax * xz - bx * yz - cx * zz,
        xu - ax * xu - bx * yu - cx * zu,
        xv - ax * xv - bx * yv - cx * zv,
        yy - ay * xy - by * yy - cy * yz,
        yz - ay * xz - by * yz - cy * zz,
        yu - ay * xu - by * yu - cy * zu,
        yv - ay * xv - by * yv - cy * zv,
        zz - az * xz - bz * yz - cz * zz,
        zu - az * xu - bz * yu - cz * zu,
        zv - az * xv - bz * yv - cz * zv,
        uu - au * xu - bu * yu - cu * zu,
        uv - au * xv - bu * yv - cu * zv,
        vv - av * xv - bv * yv - cv * zv,
    )
    return moved, shrunk


@inner
def exchange(state: State, covariance: Covariance) -> tuple[State, Covariance]:
    """With the velocity where the horizontal place was, and the place where the velocity was."""
    x, y, z, u, v = state
    xx, xy, xz, xu, xv, yy, yz, yu, yv, zz, zu, zv, uu, uv, vv = covariance
    return (u, v, z, x, y), (uu, uv, zu, xu, yu, vv, zv, xv, yv, zz, xz, yz, xx, xy, yy)


@inner
def gain_of(information: Symmetric, shrunk: Symmetric) -> Symmetric:
    """L - L C L of the information L in measurements and the covariance C after them: what lowers P by P M P."""
    xx, xy, xz, yy, yz, zz = information
    ax, bx, cx = times(shrunk, (xx, xy, xz))
    ay, by, cy = times(shrunk, (xy, yy, yz))
    az, bz, cz = times(shrunk, (xz, yz, zz))
    return (
        xx - ax * xx - bx * xy - cx * xz,
        xy - ay * xx - by * xy - cy * xz,
        xz - az * xx - bz * xy - cz * xz,
        yy - ay * xy - by * yy - cy * yz,
        yz - az * xy - bz * yy - cz * yz,
        zz - az * xz - bz * yz - cz * zz,
    )


RESTED_M = 1e-5
"""A linearisation point that moves by less rests."""
STATE, COVARIANCE, INNOVATION, FILTERED = slice(0, 5), slice(5, 30), 39, 40
"""Where state, covariance and squared innovation are in a row of what the filter writes, and how long that is."""


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

    Iterated until the linearisation point rests, so that a poor prediction near an anchor does no harm. free_z: one, or
    zero where the height is given. weight (N,) takes given_weight, less 1/residual beyond long_m and -short_m, so that
    the pull of a range is bounded; variance is that of a range of full weight. With the covariance C of the place, its
    information L = sum w u u^T/variance over the directions u, and the gradient b of the log-likelihood at the prior,
    the place moves by (C^-1 + L)^-1 b. Returned are L and the gradient at the posterior, too; and v^T S^-1 v, with v
    what the ranges miss the prediction by, and S its covariance (of n ranges of full weight, n on average).
    """
    sx, sy, sz, _, _ = state
    xx, xy, xz, _, _, yy, yz, _, _, zz, _, _, _, _, _ = covariance
    _, ixx, ixy, iyy, ixz, iyz, izz = invert_one(xx, xy, yy, xz, yz, zz + 1 - free_z)
    full, moved, gradient, innovation = 1 / variance, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0
    x, y, z = sx, sy, sz
    information = shrunk = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for step in range(10):
        lxx, lxy, lxz, lyy, lyz, lzz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        bx, by, bz, missed = 0.0, 0.0, 0.0, 0.0
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
            missed += trust * residual_m * residual_m
            tx, ty, tz = trust * ux, trust * uy, trust * uz
            told_m = residual_m + ux * (x - sx) + uy * (y - sy) + uz * (z - sz)
            bx, by, bz = bx + told_m * tx, by + told_m * ty, bz + told_m * tz
            lxx, lxy, lxz = lxx + tx * ux, lxy + tx * uy, lxz + tx * uz
            lyy, lyz, lzz = lyy + ty * uy, lyz + ty * uz, lzz + tz * uz
        _, cxx, cxy, cyy, cxz, cyz, czz = invert_one(ixx + lxx, ixy + lxy, iyy + lyy, ixz + lxz, iyz + lyz, izz + lzz)
        information, shrunk, gradient = (lxx, lxy, lxz, lyy, lyz, lzz), (cxx, cxy, cxz, cyy, cyz, czz), (bx, by, bz)
        moved = times(shrunk, gradient)
        if step == 0:
            innovation = missed - gradient[0] * moved[0] - gradient[1] * moved[1] - gradient[2] * moved[2]
        off_m = abs(sx + moved[0] - x) + abs(sy + moved[1] - y) + abs(sz + moved[2] - z)
        x, y, z = sx + moved[0], sy + moved[1], sz + moved[2]
        if off_m < RESTED_M:
            break
    gained = times(information, moved)
    gradient = (gradient[0] - gained[0], gradient[1] - gained[1], gradient[2] - gained[2])
    state, covariance = absorb(state, covariance, gain_of(information, shrunk), gradient)
    return state, covariance, (*information, *gradient, innovation)


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
    motion: MotionModel,
    range_variance: float,
    long_m: float,
    short_m: float,
    weight: Float,
    filtered: Float,
) -> None:
    """Filters T instants from a state that holds just before the first; instant k has rows first_row[k]:first_row[k+1].

    velocity_mps (T, 2) counts where velocity_variance (T,) is finite. Written: weight (N,), and into filtered (T, 40)
    the STATE, its COVARIANCE row by row, and what update_state returns of its ranges: their information, their gradient
    and the squared INNOVATION.
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
        for i in range(40):
            filtered[k, i] = row[i]
