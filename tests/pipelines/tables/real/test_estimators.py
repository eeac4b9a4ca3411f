"""The estimators that quadlog is held against: their linear limit in closed form, and scipy's own least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import least_squares

from quadlog.pipelines.tables.real.estimators import (
    ACCELERATION_STD_MPS2,
    BIAS_STD_M,
    FIRST_STD_MPS,
    HUBER,
    KNOT_S,
    RANGE_STD_M,
    batch_smoother,
    plain_ekf,
)

ANCHORS_M = np.array([(0.0, 0, 1.2), (8, 0.5, 1.2), (7.5, 7, 1.2), (0.5, 6, 1.2)])


def log(seconds: float, hz: float, anchors_m: np.ndarray, nlos: float = 0.0, seed: int = 0):
    """Single ranges in turns to a tag that drives an ellipse: times, anchors' indices, ranges, and true positions."""
    rng, at_s = np.random.default_rng(seed), np.arange(0, seconds, 1 / hz)
    true_m = np.column_stack([4 + 2 * np.sin(0.4 * at_s), 3 + 1.5 * np.cos(0.4 * at_s)])
    anchor = np.arange(len(at_s)) % len(anchors_m)
    apart_m = np.column_stack([true_m, np.full(len(at_s), 0.6)]) - anchors_m[anchor]
    range_m = np.linalg.norm(apart_m, axis=1) + rng.normal(0, 0.05, len(at_s))
    range_m[rng.random(len(at_s)) < nlos] += 0.8
    return np.round(at_s * 1e9).astype(np.int64), anchor, range_m, true_m


def test_the_ekf_is_the_best_linear_estimate_where_ranges_are_linear():
    """Anchors 500 km away: its last position is that of all states and ranges solved at once."""
    far_m = np.array([(-5e5, 0, 0.6), (0, -5e5, 0.6), (5e5, 20, 0.6), (30, 5e5, 0.6)])
    t_ns, anchor, range_m, _ = log(10.0, 4, far_m)
    got_m = plain_ekf(t_ns, far_m[anchor], range_m, 0.6)[-1]
    n, step_s = len(t_ns), 0.25
    early = (t_ns * 1e-9) <= 0.6
    start = least_squares(
        lambda p: np.linalg.norm(p - far_m[anchor[early], :2], axis=1) - range_m[early], far_m[:, :2].mean(axis=0)
    ).x
    noise = ACCELERATION_STD_MPS2**2 * step_s * np.array([[step_s**2 / 3, step_s / 2], [step_s / 2, 1]])
    whiten = np.linalg.inv(np.linalg.cholesky(np.kron(noise, np.eye(2))))
    move = np.kron(np.array([[1, step_s], [0, 1]]), np.eye(2))
    rows, wanted = [], []
    first = np.diag(1 / np.array([RANGE_STD_M, RANGE_STD_M, FIRST_STD_MPS, FIRST_STD_MPS]))
    rows.append(np.hstack([first, np.zeros((4, 4 * (n - 1)))]))
    wanted.append(first @ [*start, 0, 0])
    for k in range(n - 1):
        row = np.zeros((4, 4 * n))
        row[:, 4 * k : 4 * k + 4], row[:, 4 * k + 4 : 4 * k + 8] = -whiten @ move, whiten
        rows.append(row)
        wanted.append(np.zeros(4))
    for k in range(n):
        apart_m = start - far_m[anchor[k], :2]
        slope = apart_m / np.linalg.norm(apart_m)
        row = np.zeros((1, 4 * n))
        row[0, 4 * k : 4 * k + 2] = slope / RANGE_STD_M
        rows.append(row)
        wanted.append([(range_m[k] - np.linalg.norm(apart_m) + slope @ start) / RANGE_STD_M])
    solved, *_ = np.linalg.lstsq(np.vstack(rows), np.concatenate(wanted), rcond=None)
    np.testing.assert_allclose(got_m, solved[-4:-2], atol=5e-5)


@pytest.mark.parametrize("robust", [True, False])
def test_the_batch_smoother_is_scipys_minimum(robust):
    """The same spline, priors and loss, written down as residuals for `scipy.optimize.least_squares`."""
    t_ns, anchor, range_m, true_m = log(3.0, 40, ANCHORS_M, nlos=0.1)
    start_m = plain_ekf(t_ns, ANCHORS_M[anchor], range_m, 0.6)
    got_m = batch_smoother(t_ns, anchor, ANCHORS_M, range_m, 0.6, start_m, robust=robust)
    at_s = t_ns * 1e-9
    inner = np.arange(0.0, at_s[-1] + KNOT_S, KNOT_S)
    knots = np.arange(-3, len(inner) + 3) * KNOT_S
    n = len(knots) - 4

    def track(state):
        return BSpline(knots, state[: 2 * n].reshape(2, n).T, 3)

    def residuals(state):
        apart_m = np.column_stack([track(state)(at_s), np.full(len(at_s), 0.6)]) - ANCHORS_M[anchor]
        miss = (np.linalg.norm(apart_m, axis=1) + state[2 * n :][anchor] - range_m) / RANGE_STD_M
        if robust:  # so that half its square is Huber's loss
            size = np.abs(miss)
            miss = np.where(size > HUBER, np.sqrt(np.maximum(2 * HUBER * size - HUBER**2, 0)), size) * np.sign(miss)
        bends = track(state).derivative(2)(inner[:-1]) * np.sqrt(KNOT_S) / ACCELERATION_STD_MPS2
        return np.concatenate([miss, bends.ravel(), state[2 * n :] / BIAS_STD_M])

    middle_m = np.repeat(true_m.mean(axis=0), n)
    solved = least_squares(residuals, np.concatenate([middle_m, np.zeros(4)]), xtol=1e-12, ftol=1e-12, max_nfev=300)
    np.testing.assert_allclose(got_m, track(solved.x)(at_s), atol=2e-3)


def test_late_ranges_cost_the_robust_smoother_less():
    t_ns, anchor, range_m, true_m = log(20.0, 40, ANCHORS_M, nlos=0.1)
    start_m = plain_ekf(t_ns, ANCHORS_M[anchor], range_m, 0.6)
    rmse_m = {
        robust: np.sqrt(
            np.mean((batch_smoother(t_ns, anchor, ANCHORS_M, range_m, 0.6, start_m, robust=robust) - true_m) ** 2)
        )
        for robust in (True, False)
    }
    assert rmse_m[True] < 0.8 * rmse_m[False]
    assert rmse_m[False] < np.sqrt(np.mean((start_m - true_m) ** 2))
