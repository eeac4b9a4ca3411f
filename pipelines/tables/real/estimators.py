"""What quadlog's tracks are held against: a plain causal EKF over single ranges, and a batch smoother of a whole log.

Both are the field's usual kind and share no code with `quadlog.positioning`.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import least_squares
from scipy.sparse import block_diag, csr_matrix, diags, hstack
from scipy.sparse.linalg import spsolve

from quadlog.messages import Float, Int

RANGE_STD_M = 0.1
ACCELERATION_STD_MPS2 = 1.0
FIRST_STD_MPS = 1.0
START_S = 0.6
"""Ranges of so long give the first position."""


def plain_ekf(t_ns: Int, anchors_m: Float, range_m: Float, height_m: float) -> Float:
    """Causal positions (N, 2) after each of N ranges, by an extended Kalman filter with constant velocity.

    t_ns (N,) rising; anchors_m (N, 3) of the anchor of each range_m (N,). No gate, no bias, no robust weight.
    """
    at_s = (t_ns - t_ns[0]) * 1e-9
    early = at_s <= START_S
    height_squared_m2 = (anchors_m[:, 2] - height_m) ** 2
    start = least_squares(_misses_m, anchors_m[:, :2].mean(axis=0), args=(anchors_m[early], range_m[early], height_m))
    state = np.concatenate([start.x, [0.0, 0.0]])
    covariance = np.diag([RANGE_STD_M**2, RANGE_STD_M**2, FIRST_STD_MPS**2, FIRST_STD_MPS**2])
    positions_m = np.empty((len(t_ns), 2))
    before_s = 0.0
    for i, now_s in enumerate(at_s.tolist()):
        step_s, before_s = now_s - before_s, now_s
        if step_s > 0:
            state, covariance = _predicted(state, covariance, step_s)
        apart_m = state[:2] - anchors_m[i, :2]
        predicted_m = float(np.sqrt(apart_m @ apart_m + height_squared_m2[i])) or 1e-9
        slope = apart_m / predicted_m
        cross = covariance[:, :2] @ slope
        gain = cross / (float(slope @ cross[:2]) + RANGE_STD_M**2)
        state = state + gain * (range_m[i] - predicted_m)
        covariance = covariance - np.outer(gain, cross)
        positions_m[i] = state[:2]
    return positions_m


def _misses_m(position_m: Float, anchors_m: Float, range_m: Float, height_m: float) -> Float:
    apart_m = np.column_stack([position_m - anchors_m[:, :2], height_m - anchors_m[:, 2]])
    misses_m: Float = np.linalg.norm(apart_m, axis=1) - range_m
    return misses_m


def _predicted(state: Float, covariance: Float, step_s: float) -> tuple[Float, Float]:
    """State and covariance step_s later, driven by white acceleration held over the step."""
    move = np.eye(4)
    move[0, 2] = move[1, 3] = step_s
    noise = ACCELERATION_STD_MPS2**2 * step_s * np.array([[step_s**2 / 3, step_s / 2], [step_s / 2, 1.0]])
    return move @ state, move @ covariance @ move.T + np.kron(noise, np.eye(2))


KNOT_S = 0.25
BIAS_STD_M = 0.5
HUBER = 1.345
_MOST_ROUNDS = 100
_SETTLED = 1e-8


def batch_smoother(
    t_ns: Int, anchor: Int, anchors_m: Float, range_m: Float, height_m: float, start_m: Float, *, robust: bool = True
) -> Float:
    """Positions (N, 2) at each of N ranges, by least squares over the whole log: a track and a bias of each anchor.

    anchor (N,) indices into anchors_m (A, 3); start_m (N, 2) a first track. The track is a cubic B-spline with a knot
    every 0.25 s [Furgale], its acceleration white with the filter's std; robust: Huber's weights for ranges. Solved by
    Levenberg-Marquardt on sparse normal equations; `test_estimators` holds it against scipy's least_squares.
    """
    at_s = (t_ns - t_ns[0]) * 1e-9
    basis, prior = _spline(at_s)
    n, n_anchors = basis.shape[1], len(anchors_m)
    heard = csr_matrix((np.ones(len(anchor)), (np.arange(len(anchor)), anchor)), (len(anchor), n_anchors))
    penalty = block_diag([prior, prior, diags(np.full(n_anchors, 1 / BIAS_STD_M))]).tocsr()
    stiffness = penalty.T @ penalty
    state = np.concatenate([_fitted(basis, prior, start_m).T.ravel(), np.zeros(n_anchors)])
    problem = basis, heard, anchors_m[anchor], range_m, height_m
    miss, jacobian = _linearised(state, *problem)
    cost, damping = _cost(miss, penalty @ state, robust), 1e-3
    for _ in range(_MOST_ROUNDS):
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(miss), 1e-12)) if robust else np.ones(len(miss))
        normal = (jacobian.T @ diags(weight) @ jacobian + stiffness).tocsc()
        damped = normal + damping * diags(normal.diagonal())
        step = spsolve(damped, -(jacobian.T @ (weight * miss) + stiffness @ state))
        tried_miss, tried_jacobian = _linearised(state + step, *problem)
        tried = _cost(tried_miss, penalty @ (state + step), robust)
        if tried > cost:
            damping *= 10
            continue
        settled = cost - tried < _SETTLED * cost
        state, cost, miss, jacobian, damping = state + step, tried, tried_miss, tried_jacobian, damping / 10
        if settled:
            break
    positions_m: Float = basis @ state[: 2 * n].reshape(2, n).T
    return positions_m


def _cost(miss: Float, rest: Float, robust: bool) -> float:
    """Half the sum of squares, with Huber's loss of the ranges' residuals where robust."""
    size = np.abs(miss)
    loss = np.where((size > HUBER) & robust, HUBER * (size - HUBER / 2), size**2 / 2)
    return float(loss.sum() + (rest**2).sum() / 2)


def _spline(at_s: Float) -> tuple[csr_matrix, csr_matrix]:
    """Cubic B-splines at the instants (N, K), and their second derivatives at the knots (K', K) as a prior of std 1."""
    inner = np.arange(0.0, at_s[-1] + KNOT_S, KNOT_S)
    knots = np.concatenate([inner[0] - KNOT_S * np.arange(3, 0, -1), inner, inner[-1] + KNOT_S * np.arange(1, 4)])
    n = len(knots) - 4
    basis = csr_matrix(BSpline.design_matrix(at_s, knots, 3))
    bends = BSpline(knots, np.eye(n), 3).derivative(2)(inner[:-1])
    return basis, csr_matrix(bends * np.sqrt(KNOT_S) / ACCELERATION_STD_MPS2)


def _fitted(basis: csr_matrix, prior: csr_matrix, start_m: Float) -> Float:
    """Control points (K, 2) of the spline nearest to a track."""
    normal = (basis.T @ basis + 1e-6 * prior.T @ prior).tocsc()
    return np.column_stack([spsolve(normal, basis.T @ start_m[:, axis]) for axis in range(2)])


def _linearised(
    state: Float, basis: csr_matrix, heard: csr_matrix, anchors_m: Float, range_m: Float, height_m: float
) -> tuple[Float, csr_matrix]:
    """Residuals (N,) of the ranges in stds, and their derivative by the state: control points' x, y, and biases."""
    n = basis.shape[1]
    apart_m = basis @ state[: 2 * n].reshape(2, n).T - anchors_m[:, :2]
    distance_m = np.sqrt((apart_m**2).sum(axis=1) + (anchors_m[:, 2] - height_m) ** 2)
    slope = apart_m / np.maximum(distance_m, 1e-9)[:, None]
    miss = (distance_m + heard @ state[2 * n :] - range_m) / RANGE_STD_M
    parts = [diags(slope[:, axis]) @ basis for axis in range(2)]
    return miss, hstack([*parts, heard]).tocsr() / RANGE_STD_M
