"""State and covariance of a tag in components, and what is done with them: moved on, and told by measurements.

The state is (x, y, z, vx, vy) in map; a height that is given is one of no variance. All of it runs at every instant of
a log, which is why it is compiled, and written out: arrays of five cost more than what is done with them, when it runs
and when it compiles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadlog.compiled import inner

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


class Motion(NamedTuple):
    """How a tag moves: spectral density of its white horizontal acceleration, mean and std of its height."""

    density_m2ps3: float
    height_m: float
    height_std_m: float


@inner
def predict_state(state: State, covariance: Covariance, dt_s: float, motion: Motion) -> tuple[State, Covariance]:
    """State and covariance after dt_s.

    The height is a first-order Gauss-Markov process: what is known of it holds
    at every instant, so where the anchors' geometry says nothing it keeps that
    std. A free random walk would grow until its mirror image came in reach.
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
