"""The smoother against the whole log solved at once, against numerical integrals and derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky, expm
from scipy.optimize import approx_fprime, least_squares

from quadlog.positioning.kalman import (
    HEIGHT_LASTS_S,
    Motion,
    filter_ranges,
    huber_weight,
    predict_state,
    smooth_states,
    update_state,
    update_velocity,
)

ANCHORS_M = np.array([[0.0, 0.0, 0.2], [8.0, 0.0, 2.5], [4.0, 7.0, 0.4], [0.0, 7.0, 2.2]])
STD_M, DENSITY, HEIGHT_M = 0.1, 0.1, 0.9
FLAT, TALL = Motion(DENSITY, HEIGHT_M, 0.0), Motion(DENSITY, HEIGHT_M, 0.4)
START = {4: np.array([2.0, 3.0, 0.0, 0.0]), 5: np.array([2.0, 3.0, 0.0, 0.0, HEIGHT_M])}
START_COVARIANCE = {4: np.diag([0.25, 0.25, 1.0, 1.0]), 5: np.diag([0.25, 0.25, 1.0, 1.0, 0.16])}
BOTH = pytest.mark.parametrize(("n", "motion"), [(4, FLAT), (5, TALL)])


def uneven_log(seed: int, n: int = 40):
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.uniform(0.01, 0.3, n))
    t_s -= t_s[0]
    place_m = np.array([2.0, 3.0, 1.2]) + np.array([0.3, 0.1, 0.0]) * t_s[:, None]
    counts = rng.integers(1, 5, n)
    first_row = np.append(0, np.cumsum(counts))
    anchor = np.concatenate([rng.permutation(4)[:k] for k in counts])
    range_m = np.linalg.norm(np.repeat(place_m, counts, axis=0) - ANCHORS_M[anchor], axis=1)
    return t_s, first_row, anchor, range_m + STD_M * rng.standard_normal(len(anchor)), rng.uniform(0.1, 1, len(anchor))


def rate_matrix(n: int) -> np.ndarray:
    rate = np.zeros((n, n))
    rate[0, 2] = rate[1, 3] = 1.0
    if n == 5:
        rate[4, 4] = -1 / HEIGHT_LASTS_S
    return rate


def process_noise(n: int, dt_s: float) -> np.ndarray:
    """Van Loan's integral of the white acceleration, and of what drives the height, from the matrix exponential."""
    drive = np.diag([0.0, 0.0, DENSITY, DENSITY] + [2 * TALL.height_std_m**2 / HEIGHT_LASTS_S] * (n - 4))
    power = expm(np.block([[-rate_matrix(n), drive], [np.zeros((n, n)), rate_matrix(n).T]]) * dt_s)
    return power[n:, n:].T @ power[:n, n:]


def run(n, motion, t_s, first_row, anchor, range_m, weight, anchors_m=ANCHORS_M, velocity=None):
    velocity_mps, variance = velocity or (np.zeros((len(t_s), 2)), np.full(len(t_s), np.inf))
    forward = filter_ranges(
        t_s, first_row, anchor, range_m, anchors_m, START[n], START_COVARIANCE[n], weight, STD_M, motion, np.inf,
        np.inf, velocity_mps, variance,
    )  # fmt: skip
    return forward, smooth_states(t_s, forward[0], forward[1], motion)


@BOTH
def test_prediction_is_the_exact_integral_of_white_acceleration(n, motion):
    rng = np.random.default_rng(0)
    root = rng.standard_normal((n, n))
    state, covariance = predict_state(np.array([1.0, 2.0, 0.5, -0.25, 1.4])[:n], root @ root.T, 0.7, motion)
    move = expm(rate_matrix(n) * 0.7)
    height_m = HEIGHT_M + 0.5 * np.exp(-0.7 / HEIGHT_LASTS_S)
    np.testing.assert_allclose(state, np.array([1.35, 1.825, 0.5, -0.25, height_m])[:n])
    np.testing.assert_allclose(covariance, move @ root @ root.T @ move.T + process_noise(n, 0.7), atol=1e-12)


def test_a_height_nothing_is_heard_of_keeps_its_std():
    _, covariance = predict_state(START[5], START_COVARIANCE[5], 500.0, TALL)
    assert covariance[4, 4] == pytest.approx(TALL.height_std_m**2)


@BOTH
def test_filter_and_smoother_are_the_batch_solution_of_the_linear_problem(n, motion):
    """Anchors 1e5 m away make ranges linear in the place: then dense normal equations are exact."""
    rng = np.random.default_rng(5)
    t_s, first_row, _, _, weight = uneven_log(5)
    far_m = 1e5 * np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -0.5], [-1.0, 0.2, 0.6], [0.3, -1.0, 0.0]])
    instants, rows = len(t_s), first_row[-1]
    anchor = rng.integers(0, 4, rows)
    unit = -far_m[anchor] / np.linalg.norm(far_m[anchor], axis=1, keepdims=True)
    instant = np.repeat(np.arange(instants), np.diff(first_row))
    along_m = unit @ np.array([2.0, 3.0, HEIGHT_M]) + STD_M * rng.standard_normal(rows)
    range_m = np.linalg.norm(far_m[anchor], axis=1) + along_m
    velocity_mps, variance = rng.normal(0, 0.3, (instants, 2)), rng.uniform(0.05, 0.5, instants)
    variance[::3] = np.inf
    forward, (states, covariances) = run(
        n, motion, t_s, first_row, anchor, range_m, weight, far_m, (velocity_mps, variance)
    )

    # Everything about the mean (0, 0, 0, 0, height), so that motion is linear without a constant.
    mean = np.array([0.0, 0.0, 0.0, 0.0, HEIGHT_M])[:n]
    information = np.zeros((n * instants, n * instants))
    pull = np.zeros(n * instants)
    information[:n, :n] += np.linalg.inv(START_COVARIANCE[n])
    pull[:n] += np.linalg.inv(START_COVARIANCE[n]) @ (START[n] - mean)
    for k in range(instants - 1):
        dt_s = t_s[k + 1] - t_s[k]
        link = np.hstack([-expm(rate_matrix(n) * dt_s), np.eye(n)])
        information[n * k : n * k + 2 * n, n * k : n * k + 2 * n] += (
            link.T @ np.linalg.inv(process_noise(n, dt_s)) @ link
        )
    where = [0, 1, 4][: n - 2]
    for j in range(rows):
        at = [n * instant[j] + i for i in where]
        trust = weight[j] / STD_M**2
        information[np.ix_(at, at)] += trust * np.outer(unit[j, : n - 2], unit[j, : n - 2])
        pull[at] += trust * unit[j, : n - 2] * (along_m[j] - unit[j, 2] * HEIGHT_M)
    for k in np.flatnonzero(np.isfinite(variance)):
        at = [n * k + 2, n * k + 3]
        information[at, at] += 1 / variance[k]
        pull[at] += velocity_mps[k] / variance[k]
    exact = np.linalg.inv(information)
    batch = (exact @ pull).reshape(instants, n) + mean
    np.testing.assert_allclose(states, batch, atol=2e-4)
    for k in range(instants):
        np.testing.assert_allclose(covariances[k], exact[n * k : n * k + n, n * k : n * k + n], rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(forward[0][-1], batch[-1], atol=2e-4)


@BOTH
def test_smoother_is_close_to_the_batch_solution_of_the_true_problem(n, motion):
    """Among the anchors the filter linearises on the way; scipy minimises all at once.

    They agree to 2 mm, 5 with the height.
    """
    t_s, first_row, anchor, range_m, weight = uneven_log(7)
    _, (states, _) = run(n, motion, t_s, first_row, anchor, range_m, weight)
    instants = len(t_s)
    whiten = [np.linalg.inv(cholesky(process_noise(n, dt_s), lower=True)) for dt_s in np.diff(t_s)]
    moves = [expm(rate_matrix(n) * dt_s) for dt_s in np.diff(t_s)]
    instant = np.repeat(np.arange(instants), np.diff(first_row))
    mean = np.array([0.0, 0.0, 0.0, 0.0, HEIGHT_M])[:n]

    def cost_terms(flat):
        x = flat.reshape(instants, n)
        start = (x[0] - START[n]) / np.sqrt(np.diag(START_COVARIANCE[n]))
        steps = [whiten[k] @ (x[k + 1] - mean - moves[k] @ (x[k] - mean)) for k in range(instants - 1)]
        place_m = np.column_stack([x[:, :2], x[:, 4] if n == 5 else np.full(instants, HEIGHT_M)])[instant]
        predicted = np.linalg.norm(place_m - ANCHORS_M[anchor], axis=1)
        return np.concatenate([start, *steps, np.sqrt(weight) * (range_m - predicted) / STD_M])

    batch = least_squares(cost_terms, states.ravel(), method="trf").x.reshape(instants, n)
    np.testing.assert_allclose(states[:, :2], batch[:, :2], atol=2e-3 if n == 4 else 5e-3)


def test_an_update_in_three_dimensions_ends_where_the_cost_is_flat():
    """The gradient of prior plus ranges, by finite differences, vanishes at the posterior; the curvature is P^-1."""
    rng = np.random.default_rng(2)
    root = 0.2 * rng.standard_normal((5, 5))
    prior, covariance = np.array([2.0, 3.0, 0.1, 0.2, 1.0]), root @ root.T + 0.01 * np.eye(5)
    range_m = np.linalg.norm(np.array([2.2, 2.9, 1.3]) - ANCHORS_M, axis=1)
    weight = np.ones(4)
    posterior, shrunk = update_state(
        prior, covariance, ANCHORS_M, range_m, np.ones(4), weight, STD_M, np.nan, np.inf, np.inf
    )

    def cost(x):
        predicted = np.linalg.norm(x[[0, 1, 4]] - ANCHORS_M, axis=1)
        return 0.5 * (
            (x - prior) @ np.linalg.solve(covariance, x - prior) + (((range_m - predicted) / STD_M) ** 2).sum()
        )

    gradient = approx_fprime(posterior, cost, 1e-6)
    assert np.abs(gradient).max() < 0.02 * np.abs(approx_fprime(prior, cost, 1e-6)).max()
    place = posterior[[0, 1, 4]]
    jacobian = np.zeros((4, 5))
    for a in range(4):
        jacobian[a, [0, 1, 4]] = approx_fprime(place, lambda p, a=a: np.linalg.norm(p - ANCHORS_M[a]), 1e-7)
    curvature = np.linalg.inv(covariance) + jacobian.T @ jacobian / STD_M**2
    np.testing.assert_allclose(shrunk, np.linalg.inv(curvature), rtol=1e-3, atol=1e-6)


def test_velocity_update_is_the_information_sum():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((4, 4))
    state, covariance = rng.standard_normal(4), root @ root.T
    posterior, shrunk = update_velocity(state, covariance, np.array([0.4, -0.2]), 0.09)
    information = np.linalg.inv(covariance) + np.diag([0.0, 0.0, 1 / 0.09, 1 / 0.09])
    pull = np.linalg.solve(covariance, state) + np.array([0.0, 0.0, 0.4, -0.2]) / 0.09
    np.testing.assert_allclose(shrunk, np.linalg.inv(information), atol=1e-9)
    np.testing.assert_allclose(posterior, np.linalg.solve(information, pull), atol=1e-9)


@BOTH
def test_covariances_stay_symmetric_and_positive(n, motion):
    forward, smoothed = run(n, motion, *uneven_log(9))
    for covariances in (forward[1], smoothed[1]):
        np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
        assert np.linalg.eigvalsh(covariances).min() > 0
    assert (np.trace(smoothed[1], axis1=1, axis2=2) <= np.trace(forward[1], axis1=1, axis2=2) + 1e-12).all()


def test_huber_weight_bounds_the_pull_on_both_sides():
    assert huber_weight(0.05, 0.1, 0.4) == 1.0
    assert huber_weight(-0.3, 0.1, 0.4) == 1.0
    assert huber_weight(5.0, 0.1, 0.4) * 5.0 == 0.1
    assert huber_weight(-5.0, 0.1, 0.4) * 5.0 == 0.4
