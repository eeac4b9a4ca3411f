"""Compiled constant-velocity filter on ranges, and its Rauch-Tung-Striebel smoother.

The state is (x, y, vx, vy) in map, or (x, y, vx, vy, z) where the height is
tracked too. Everything here runs once per instant of a log, which is why it is
compiled; `tracker` is what to call.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from quadlog.messages import Float, Int

HEIGHT_LASTS_S = 20.0
"""Correlation time of a tag's height about its known mean: sitting down, a step, a slope."""


class Motion(NamedTuple):
    """How a tag moves: spectral density of its white horizontal acceleration, mean and std of its height."""

    density_m2ps3: float
    height_m: float
    height_std_m: float


@njit(cache=True)
def move_rows(rows: Float, dt_s: float) -> Float:
    """F @ rows for rows (n, m), n 4 or 5: position moves with velocity, a tracked height falls back to its mean."""
    moved = rows.copy()
    for i in range(2):
        for j in range(rows.shape[1]):
            moved[i, j] += dt_s * rows[i + 2, j]
    if len(rows) == 5:
        moved[4] *= np.exp(-dt_s / HEIGHT_LASTS_S)
    return moved


@njit(cache=True)
def predict_state(state: Float, covariance: Float, dt_s: float, motion: Motion) -> tuple[Float, Float]:
    """State (4,) or (5,) and its covariance after dt_s.

    The height is a first-order Gauss-Markov process: what is known of it holds
    at every instant, so where the anchors' geometry says nothing it keeps that
    std. A free random walk would grow until its mirror image came in reach.
    """
    ahead = move_rows(np.expand_dims(state, 1), dt_s)[:, 0].copy()
    grown = move_rows(move_rows(covariance, dt_s).T, dt_s)
    for i in range(2):
        grown[i, i] += motion.density_m2ps3 * dt_s**3 / 3
        grown[i, i + 2] += motion.density_m2ps3 * dt_s**2 / 2
        grown[i + 2, i] += motion.density_m2ps3 * dt_s**2 / 2
        grown[i + 2, i + 2] += motion.density_m2ps3 * dt_s
    if len(state) == 5:
        keep = np.exp(-dt_s / HEIGHT_LASTS_S)
        ahead[4] += (1 - keep) * motion.height_m
        grown[4, 4] += motion.height_std_m**2 * (1 - keep**2)
    return ahead, grown


@njit(cache=True)
def huber_weight(residual_m: float, long_m: float, short_m: float) -> float:
    """One where -short <= residual <= long, falling as 1/residual beyond: the pull of a range is bounded."""
    if residual_m > long_m:
        return long_m / residual_m
    if residual_m < -short_m:
        return -short_m / residual_m
    return 1.0


@njit(cache=True)
def update_state(
    state: Float,
    covariance: Float,
    anchor_m: Float,
    range_m: Float,
    given_weight: Float,
    weight: Float,
    std_m: float,
    height_m: float,
    long_m: float,
    short_m: float,
) -> tuple[Float, Float]:
    """Posterior of one instant from M ranges (M,) to anchor_m (M, 3); writes the weights used into weight (M,).

    Iterated until the linearisation point rests, so that a poor prediction near
    an anchor does no harm. With L = sum w u u^T/std^2 over the coordinates that
    are tracked and their block C of the covariance, the gain is P[:, C] (I + L C)^-1.
    height_m counts where the state has no height.
    """
    n, d = len(state), len(state) - 2
    where = (0, 1, 4)
    at = np.array([state[0], state[1], state[4] if n == 5 else height_m])
    unit, pull = np.zeros(3), np.zeros(d)
    posterior = state
    information, gain, columns, block = np.zeros((d, d)), np.zeros((n, d)), np.empty((n, d)), np.empty((d, d))
    for a in range(d):
        columns[:, a] = covariance[:, where[a]]
        for b in range(d):
            block[a, b] = covariance[where[a], where[b]]
    for _ in range(10):
        information[:, :] = 0.0
        pull[:] = 0.0
        for j in range(len(range_m)):
            dx, dy, dz = at[0] - anchor_m[j, 0], at[1] - anchor_m[j, 1], at[2] - anchor_m[j, 2]
            distance = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
            unit[0], unit[1], unit[2] = dx / distance, dy / distance, dz / distance
            residual = range_m[j] - distance
            weight[j] = given_weight[j] * huber_weight(residual, long_m, short_m)
            trust = weight[j] / std_m**2
            innovation = residual
            for a in range(d):
                innovation += unit[a] * (at[a] - state[where[a]])
            for a in range(d):
                pull[a] += trust * unit[a] * innovation
                for b in range(a, d):
                    information[a, b] += trust * unit[a] * unit[b]
        for a in range(d):
            for b in range(a):
                information[a, b] = information[b, a]
        gain = columns @ np.linalg.inv(np.eye(d) + information @ block)
        posterior = state + gain @ pull
        moved = 0.0
        for a in range(d):
            moved += abs(posterior[where[a]] - at[a])
            at[a] = posterior[where[a]]
        if moved < 1e-5:
            break
    shrunk = covariance - gain @ information @ columns.T
    return posterior, (shrunk + shrunk.T) / 2


@njit(cache=True)
def update_velocity(state: Float, covariance: Float, velocity_mps: Float, variance: float) -> tuple[Float, Float]:
    """Posterior from a measured velocity (2,) in map with the given variance of each axis, in m^2/s^2."""
    columns = np.ascontiguousarray(covariance[:, 2:4])
    gain = columns @ np.linalg.inv(np.ascontiguousarray(columns[2:4]) + variance * np.eye(2))
    shrunk = covariance - gain @ columns.T
    return state + gain @ (velocity_mps - state[2:4]), (shrunk + shrunk.T) / 2


@njit(cache=True)
def filter_ranges(
    t_s: Float,
    first_row: Int,
    anchor: Int,
    range_m: Float,
    anchors_m: Float,
    start_state: Float,
    start_covariance: Float,
    given_weight: Float,
    std_m: float,
    motion: Motion,
    long_m: float,
    short_m: float,
    velocity_mps: Float,
    velocity_variance: Float,
) -> tuple[Float, Float, Float]:
    """Filtered states (T, n), covariances (T, n, n) and weights (N,); instant k has rows first_row[k]:first_row[k+1].

    The start holds just before the first update. velocity_mps (T, 2) counts where velocity_variance (T,) is finite.
    """
    instants, n = len(t_s), len(start_state)
    states, covariances = np.empty((instants, n)), np.empty((instants, n, n))
    weight = np.ones(len(range_m))
    state, covariance = start_state, start_covariance
    for k in range(instants):
        if k > 0:
            state, covariance = predict_state(state, covariance, t_s[k] - t_s[k - 1], motion)
        if np.isfinite(velocity_variance[k]):
            state, covariance = update_velocity(state, covariance, velocity_mps[k], velocity_variance[k])
        i, j = first_row[k], first_row[k + 1]
        state, covariance = update_state(
            state,
            covariance,
            anchors_m[anchor[i:j]],
            range_m[i:j],
            given_weight[i:j],
            weight[i:j],
            std_m,
            motion.height_m,
            long_m,
            short_m,
        )
        states[k], covariances[k] = state, covariance
    return states, covariances, weight


@njit(cache=True)
def smooth_states(t_s: Float, states: Float, covariances: Float, motion: Motion) -> tuple[Float, Float]:
    """Rauch-Tung-Striebel [RTS]: states (T, n) and covariances (T, n, n) given all ranges, from the filtered ones."""
    states, covariances = states.copy(), covariances.copy()
    for k in range(len(t_s) - 2, -1, -1):
        dt_s = t_s[k + 1] - t_s[k]
        ahead, ahead_covariance = predict_state(states[k], covariances[k], dt_s, motion)
        gain = np.linalg.solve(ahead_covariance, move_rows(covariances[k], dt_s)).T.copy()
        states[k] += gain @ (states[k + 1] - ahead)
        covariances[k] += gain @ (covariances[k + 1] - ahead_covariance) @ gain.T
        covariances[k] = (covariances[k] + covariances[k].T) / 2
    return states, covariances
