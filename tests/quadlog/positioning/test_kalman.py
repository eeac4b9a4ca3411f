"""The smoother against the whole log solved at once as sparse least squares, and against numerical derivatives."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, expm
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix, lil_matrix
from scipy.sparse.linalg import spsolve

from quadlog.positioning.kalman import filter_ranges, huber_weight, predict_state, smooth_states

ANCHORS_M = np.array([[0.0, 0.0], [8.0, 0.0], [4.0, 7.0], [0.0, 7.0]])
SLANT_M2 = np.full(4, 0.36)
STD_M, DENSITY = 0.1, 0.1
START = np.array([2.0, 3.0, 0.0, 0.0])
START_COVARIANCE = np.diag([0.25, 0.25, 1.0, 1.0])


def uneven_log(seed: int, n: int = 40):
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.uniform(0.01, 0.3, n))
    t_s -= t_s[0]
    position_m = np.array([2.0, 3.0]) + np.array([0.3, 0.1]) * t_s[:, None]
    counts = rng.integers(1, 5, n)
    first_row = np.append(0, np.cumsum(counts))
    anchor = np.concatenate([rng.permutation(4)[:k] for k in counts])
    row_m = np.repeat(position_m, counts, axis=0)
    range_m = np.sqrt(((row_m - ANCHORS_M[anchor]) ** 2).sum(axis=1) + 0.36)
    return t_s, first_row, anchor, range_m + STD_M * rng.standard_normal(len(anchor)), rng.uniform(0.1, 1, len(anchor))


def process_noise(dt_s: float) -> np.ndarray:
    """Van Loan's integral of the white acceleration, from the matrix exponential."""
    rate = np.zeros((8, 8))
    rate[:4, :4] = -np.eye(4, k=2)
    rate[4:, 4:] = np.eye(4, k=2).T
    rate[2, 6] = rate[3, 7] = DENSITY
    power = expm(rate * dt_s)
    return power[4:, 4:].T @ power[:4, 4:]


def run(t_s, first_row, anchor, range_m, weight):
    forward = filter_ranges(
        t_s,
        first_row,
        anchor,
        range_m,
        ANCHORS_M,
        SLANT_M2,
        START,
        START_COVARIANCE,
        weight,
        STD_M,
        DENSITY,
        np.inf,
        np.inf,
    )
    return forward, smooth_states(t_s, forward[0], forward[1], DENSITY)


def test_prediction_is_the_exact_integral_of_white_acceleration():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 4))
    state, covariance = predict_state(np.array([1.0, 2.0, 0.5, -0.25]), root @ root.T, 0.7, DENSITY)
    move = expm(np.eye(4, k=2) * 0.7)
    np.testing.assert_allclose(state, [1.35, 1.825, 0.5, -0.25])
    np.testing.assert_allclose(covariance, move @ root @ root.T @ move.T + process_noise(0.7), atol=1e-12)


def test_filter_and_smoother_are_the_batch_solution_of_the_linear_problem():
    """Anchors 1e5 m away make ranges linear in the position: then the sparse normal equations are exact."""
    rng = np.random.default_rng(5)
    t_s, first_row, _, _, weight = uneven_log(5)
    far_m = 1e5 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.2], [0.3, -1.0]])
    n, rows = len(t_s), first_row[-1]
    anchor = rng.integers(0, 4, rows)
    unit = -far_m[anchor] / np.linalg.norm(far_m[anchor], axis=1, keepdims=True)
    instant = np.repeat(np.arange(n), np.diff(first_row))
    along_m = (unit * np.array([2.0, 3.0])).sum(axis=1) + STD_M * rng.standard_normal(rows)
    range_m = np.linalg.norm(far_m[anchor], axis=1) + along_m
    forward = filter_ranges(
        t_s,
        first_row,
        anchor,
        range_m,
        far_m,
        np.zeros(4),
        START,
        START_COVARIANCE,
        weight,
        STD_M,
        DENSITY,
        np.inf,
        np.inf,
    )
    states, covariances = smooth_states(t_s, forward[0], forward[1], DENSITY)

    information, pull = lil_matrix((4 * n, 4 * n)), np.zeros(4 * n)
    information[:4, :4] += np.linalg.inv(START_COVARIANCE)
    pull[:4] += np.linalg.inv(START_COVARIANCE) @ START
    for k in range(n - 1):
        dt_s = t_s[k + 1] - t_s[k]
        link = np.hstack([-expm(np.eye(4, k=2) * dt_s), np.eye(4)])
        information[4 * k : 4 * k + 8, 4 * k : 4 * k + 8] += link.T @ np.linalg.inv(process_noise(dt_s)) @ link
    for j in range(rows):
        at = 4 * instant[j]
        information[at : at + 2, at : at + 2] += weight[j] / STD_M**2 * np.outer(unit[j], unit[j])
        pull[at : at + 2] += weight[j] / STD_M**2 * unit[j] * along_m[j]
    batch = spsolve(csr_matrix(information), pull).reshape(n, 4)
    exact = np.linalg.inv(information.toarray())
    np.testing.assert_allclose(states, batch, atol=2e-4)
    for k in range(n):
        np.testing.assert_allclose(covariances[k], exact[4 * k : 4 * k + 4, 4 * k : 4 * k + 4], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(forward[0][-1], batch[-1], atol=2e-4)


def test_smoother_is_close_to_the_batch_solution_of_the_true_problem():
    """Among the anchors the filter linearises on the way; scipy minimises the whole cost. They agree to 2 mm."""
    t_s, first_row, anchor, range_m, weight = uneven_log(7)
    _, (states, _) = run(t_s, first_row, anchor, range_m, weight)
    n = len(t_s)
    whiten = [np.linalg.inv(cholesky(process_noise(dt_s), lower=True)) for dt_s in np.diff(t_s)]
    moves = [expm(np.eye(4, k=2) * dt_s) for dt_s in np.diff(t_s)]
    instant = np.repeat(np.arange(n), np.diff(first_row))

    def cost_terms(flat):
        x = flat.reshape(n, 4)
        start = (x[0] - START) / np.sqrt(np.diag(START_COVARIANCE))
        motion = [whiten[k] @ (x[k + 1] - moves[k] @ x[k]) for k in range(n - 1)]
        predicted = np.sqrt(((x[instant, :2] - ANCHORS_M[anchor]) ** 2).sum(axis=1) + 0.36)
        return np.concatenate([start, *motion, np.sqrt(weight) * (range_m - predicted) / STD_M])

    batch = least_squares(cost_terms, states.ravel(), method="trf").x.reshape(n, 4)
    np.testing.assert_allclose(states[:, :2], batch[:, :2], atol=2e-3)


def test_covariances_stay_symmetric_and_positive():
    forward, smoothed = run(*uneven_log(9))
    for covariances in (forward[1], smoothed[1]):
        np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
        assert np.linalg.eigvalsh(covariances).min() > 0
    assert (np.trace(smoothed[1], axis1=1, axis2=2) <= np.trace(forward[1], axis1=1, axis2=2) + 1e-12).all()


def test_huber_weight_bounds_the_pull_on_both_sides():
    assert huber_weight(0.05, 0.1, 0.4) == 1.0
    assert huber_weight(-0.3, 0.1, 0.4) == 1.0
    assert huber_weight(5.0, 0.1, 0.4) * 5.0 == 0.1
    assert huber_weight(-5.0, 0.1, 0.4) * 5.0 == 0.4
