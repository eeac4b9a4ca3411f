"""Compiled constant-velocity filter on ranges, and its Rauch-Tung-Striebel smoother.

The state is (x, y, vx, vy) in map. Everything here runs once per instant of a
log, which is why it is compiled; `tracker` is what to call.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from quadlog.messages import Float, Int


@njit(cache=True)
def predict_state(state: Float, covariance: Float, dt_s: float, density: float) -> tuple[Float, Float]:
    """State (4,) and covariance (4, 4) after dt_s under white acceleration of spectral density in m^2/s^3."""
    move = np.eye(4)
    move[0, 2] = move[1, 3] = dt_s
    grown = move @ covariance @ move.T
    for i in range(2):
        grown[i, i] += density * dt_s**3 / 3
        grown[i, i + 2] += density * dt_s**2 / 2
        grown[i + 2, i] += density * dt_s**2 / 2
        grown[i + 2, i + 2] += density * dt_s
    return move @ state, grown


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
    anchor_xy_m: Float,
    slant_m2: Float,
    range_m: Float,
    given_weight: Float,
    weight: Float,
    std_m: float,
    long_m: float,
    short_m: float,
) -> tuple[Float, Float]:
    """Posterior of one instant from M ranges (M,) to anchor_xy_m (M, 2); writes the weights used into weight (M,).

    Iterated until the linearisation point rests, so that a poor prediction near
    an anchor does no harm. With L = sum w u u^T/std^2 and the position block C
    of the covariance, the gain is P[:, :2] (I + L C)^-1.
    """
    x, y = state[0], state[1]
    posterior = state
    information, gain = np.zeros((2, 2)), np.zeros((4, 2))
    for _ in range(10):
        information[:, :] = 0.0
        pull = np.zeros(2)
        for j in range(len(range_m)):
            dx, dy = x - anchor_xy_m[j, 0], y - anchor_xy_m[j, 1]
            distance = max(np.sqrt(dx * dx + dy * dy + slant_m2[j]), 1e-9)
            ux, uy, residual = dx / distance, dy / distance, range_m[j] - distance
            weight[j] = given_weight[j] * huber_weight(residual, long_m, short_m)
            trust = weight[j] / std_m**2
            information[0, 0] += trust * ux * ux
            information[0, 1] += trust * ux * uy
            information[1, 1] += trust * uy * uy
            innovation = residual + ux * (x - state[0]) + uy * (y - state[1])
            pull[0] += trust * ux * innovation
            pull[1] += trust * uy * innovation
        information[1, 0] = information[0, 1]
        block = np.ascontiguousarray(covariance[:2, :2])
        gain = np.ascontiguousarray(covariance[:, :2]) @ np.linalg.inv(np.eye(2) + information @ block)
        posterior = state + gain @ pull
        rested = abs(posterior[0] - x) + abs(posterior[1] - y) < 1e-5
        x, y = posterior[0], posterior[1]
        if rested:
            break
    shrunk = covariance - gain @ information @ np.ascontiguousarray(covariance[:2, :])
    return posterior, (shrunk + shrunk.T) / 2


@njit(cache=True)
def filter_ranges(
    t_s: Float,
    first_row: Int,
    anchor: Int,
    range_m: Float,
    anchor_xy_m: Float,
    slant_m2: Float,
    start_state: Float,
    start_covariance: Float,
    given_weight: Float,
    std_m: float,
    density: float,
    long_m: float,
    short_m: float,
) -> tuple[Float, Float, Float]:
    """Filtered states (T, 4), covariances (T, 4, 4) and weights (N,); instant k has rows first_row[k]:first_row[k+1].

    The start holds just before the first update. slant_m2 (A,) are the squared height differences.
    """
    n = len(t_s)
    states, covariances = np.empty((n, 4)), np.empty((n, 4, 4))
    weight = np.ones(len(range_m))
    state, covariance = start_state, start_covariance
    for k in range(n):
        if k > 0:
            state, covariance = predict_state(state, covariance, t_s[k] - t_s[k - 1], density)
        i, j = first_row[k], first_row[k + 1]
        state, covariance = update_state(
            state,
            covariance,
            anchor_xy_m[anchor[i:j]],
            slant_m2[anchor[i:j]],
            range_m[i:j],
            given_weight[i:j],
            weight[i:j],
            std_m,
            long_m,
            short_m,
        )
        states[k], covariances[k] = state, covariance
    return states, covariances, weight


@njit(cache=True)
def smooth_states(t_s: Float, states: Float, covariances: Float, density: float) -> tuple[Float, Float]:
    """Rauch-Tung-Striebel: states (T, 4) and covariances (T, 4, 4) given all ranges, from the filtered ones."""
    states, covariances = states.copy(), covariances.copy()
    for k in range(len(t_s) - 2, -1, -1):
        dt_s = t_s[k + 1] - t_s[k]
        ahead, ahead_covariance = predict_state(states[k], covariances[k], dt_s, density)
        move = np.eye(4)
        move[0, 2] = move[1, 3] = dt_s
        gain = np.linalg.solve(ahead_covariance, move @ covariances[k]).T.copy()
        states[k] += gain @ (states[k + 1] - ahead)
        covariances[k] += gain @ (covariances[k + 1] - ahead_covariance) @ gain.T
        covariances[k] = (covariances[k] + covariances[k].T) / 2
    return states, covariances
