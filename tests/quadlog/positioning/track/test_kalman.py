"""The smoother against the whole log solved at once, against numerical integrals and derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import approx_fprime

from quadlog.positioning.track.kalman import (
    COVARIANCE,
    FILTERED,
    HEIGHT_LASTS_S,
    STATE,
    MotionModel,
    filter_ranges,
    predict_state,
    update_state,
)
from quadlog.positioning.track.rts_smoother import smooth_covariances, smooth_states

ANCHORS_M = np.array([[0.0, 0.0, 0.2], [8.0, 0.0, 2.5], [4.0, 7.0, 0.4], [0.0, 7.0, 2.2]])
STD_M, DENSITY, HEIGHT_M = 0.1, 0.1, 0.9
FLAT, TALL = MotionModel(DENSITY, HEIGHT_M, 0.0), MotionModel(DENSITY, HEIGHT_M, 0.4)
START = np.array([2.0, 3.0, HEIGHT_M, 0.0, 0.0])
START_STD = {FLAT: np.array([0.5, 0.5, 0.0, 1.0, 1.0]), TALL: np.array([0.5, 0.5, 0.4, 1.0, 1.0])}
TRACKED = {FLAT: [0, 1, 3, 4], TALL: [0, 1, 2, 3, 4]}
"""The components that are not given."""
BOTH = pytest.mark.parametrize("motion", [FLAT, TALL])
UPPER = np.triu_indices(5)


def packed(covariance: np.ndarray) -> tuple[float, ...]:
    return tuple(covariance[UPPER].tolist())


def unpacked(covariance: tuple[float, ...]) -> np.ndarray:
    whole = np.zeros((5, 5))
    whole[UPPER] = covariance
    return whole + np.triu(whole, 1).T


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


def rate_matrix() -> np.ndarray:
    rate = np.zeros((5, 5))
    rate[0, 3] = rate[1, 4] = 1.0
    rate[2, 2] = -1 / HEIGHT_LASTS_S
    return rate


def process_noise(motion: MotionModel, dt_s: float) -> np.ndarray:
    """Van Loan's integral of the white acceleration, and of what drives the height, from the matrix exponential."""
    drive = np.diag([0.0, 0.0, 2 * motion.height_std_m**2 / HEIGHT_LASTS_S, DENSITY, DENSITY])
    power = expm(np.block([[-rate_matrix(), drive], [np.zeros((5, 5)), rate_matrix().T]]) * dt_s)
    return power[5:, 5:].T @ power[:5, 5:]


def run(motion, t_s, first_row, anchor, range_m, weight, anchors_m=ANCHORS_M, velocity=None, limits=(np.inf, np.inf)):
    """Filtered states, covariances and weights; smoothed states and covariances."""
    velocity_mps, variance = velocity or (np.zeros((len(t_s), 2)), np.full(len(t_s), np.inf))
    used, filtered, smoothed = np.empty(len(range_m)), np.empty((len(t_s), FILTERED)), np.empty((len(t_s), 5))
    filter_ranges(
        t_s, first_row, anchors_m[anchor], range_m, weight, velocity_mps, variance, tuple(START.tolist()),
        packed(np.diag(START_STD[motion] ** 2)), motion, STD_M**2, *limits, used, filtered,
    )  # fmt: skip
    smooth_states(t_s, velocity_mps, variance, filtered, smoothed)
    forward = filtered[:, STATE], filtered[:, COVARIANCE].reshape(-1, 5, 5), used
    return forward, (smoothed, smooth_covariances(t_s, filtered, motion))


def test_a_height_nothing_is_heard_of_keeps_its_std():
    _, covariance = predict_state(tuple(START.tolist()), packed(np.diag(START_STD[TALL] ** 2)), 500.0, TALL)
    assert unpacked(covariance)[2, 2] == pytest.approx(TALL.height_std_m**2)


@BOTH
def test_filter_and_smoother_are_the_batch_solution_of_the_linear_problem(motion):
    """Anchors 1e5 m away make ranges linear in the place: then dense normal equations are exact."""
    rng = np.random.default_rng(5)
    t_s, first_row, _, _, weight = uneven_log(5)
    far_m = 1e5 * np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -0.5], [-1.0, 0.2, 0.6], [0.3, -1.0, 0.0]])
    instants, rows, known = len(t_s), first_row[-1], TRACKED[motion]
    n = len(known)
    anchor = rng.integers(0, 4, rows)
    unit = -far_m[anchor] / np.linalg.norm(far_m[anchor], axis=1, keepdims=True)
    instant = np.repeat(np.arange(instants), np.diff(first_row))
    along_m = unit @ np.array([2.0, 3.0, HEIGHT_M]) + STD_M * rng.standard_normal(rows)
    range_m = np.linalg.norm(far_m[anchor], axis=1) + along_m
    velocity_mps, variance = rng.normal(0, 0.3, (instants, 2)), rng.uniform(0.05, 0.5, instants)
    variance[::3] = np.inf
    forward, (states, covariances) = run(
        motion, t_s, first_row, anchor, range_m, weight, far_m, (velocity_mps, variance)
    )

    # Everything about the mean (0, 0, height, 0, 0), so that motion is linear without a constant.
    own, mean = np.ix_(known, known), np.array([0.0, 0.0, HEIGHT_M, 0.0, 0.0])
    information = np.zeros((n * instants, n * instants))
    pull = np.zeros(n * instants)
    before = np.diag(START_STD[motion][known] ** -2.0)
    information[:n, :n] += before
    pull[:n] += before @ (START - mean)[known]
    for k in range(instants - 1):
        dt_s = t_s[k + 1] - t_s[k]
        link = np.hstack([-expm(rate_matrix() * dt_s)[own], np.eye(n)])
        information[n * k : n * k + 2 * n, n * k : n * k + 2 * n] += (
            link.T @ np.linalg.inv(process_noise(motion, dt_s)[own]) @ link
        )
    place = [i for i, component in enumerate(known) if component < 3]
    for j in range(rows):
        at = [n * instant[j] + i for i in place]
        trust = weight[j] / STD_M**2
        axes = unit[j, : len(place)]
        information[np.ix_(at, at)] += trust * np.outer(axes, axes)
        pull[at] += trust * axes * (along_m[j] - unit[j, 2] * HEIGHT_M)
    for k in np.flatnonzero(np.isfinite(variance)):
        at = [n * k + n - 2, n * k + n - 1]
        information[at, at] += 1 / variance[k]
        pull[at] += velocity_mps[k] / variance[k]
    exact = np.linalg.inv(information)
    batch = (exact @ pull).reshape(instants, n) + mean[known]
    np.testing.assert_allclose(states[:, known], batch, atol=2e-4)
    for k in range(instants):
        np.testing.assert_allclose(
            covariances[k][own], exact[n * k : n * k + n, n * k : n * k + n], rtol=1e-3, atol=1e-6
        )
    np.testing.assert_allclose(forward[0][-1, known], batch[-1], atol=2e-4)
    if motion is FLAT:
        np.testing.assert_array_equal(states[:, 2], HEIGHT_M)
        assert not covariances[:, 2].any()


def test_an_update_in_three_dimensions_ends_where_the_cost_is_flat():
    """The gradient of prior plus ranges, by finite differences, vanishes at the posterior; the curvature is P^-1."""
    rng = np.random.default_rng(2)
    root = 0.2 * rng.standard_normal((5, 5))
    prior, covariance = np.array([2.0, 3.0, 1.0, 0.1, 0.2]), root @ root.T + 0.01 * np.eye(5)
    range_m = np.linalg.norm(np.array([2.2, 2.9, 1.3]) - ANCHORS_M, axis=1)
    posterior, shrunk, told = update_state(
        tuple(prior.tolist()), packed(covariance), 0, 4, ANCHORS_M, range_m, np.ones(4), STD_M**2, 1.0, np.inf, np.inf,
        np.empty(4),
    )  # fmt: skip

    def likelihood(place):
        predicted = np.linalg.norm(place - ANCHORS_M, axis=1)
        return -0.5 * (((range_m - predicted) / STD_M) ** 2).sum()

    def cost(x):
        return 0.5 * (x - prior) @ np.linalg.solve(covariance, x - prior) - likelihood(x[:3])

    gradient = approx_fprime(posterior, cost, 1e-6)
    assert np.abs(gradient).max() < 0.02 * np.abs(approx_fprime(prior, cost, 1e-6)).max()
    place = np.array(posterior[:3])
    jacobian = np.zeros((4, 5))
    for a in range(4):
        jacobian[a, :3] = approx_fprime(place, lambda p, a=a: np.linalg.norm(p - ANCHORS_M[a]), 1e-7)
    information = jacobian.T @ jacobian / STD_M**2
    np.testing.assert_allclose(
        unpacked(shrunk), np.linalg.inv(np.linalg.inv(covariance) + information), rtol=1e-3, atol=1e-6
    )
    np.testing.assert_allclose(told[:6], information[:3, :3][np.triu_indices(3)], rtol=1e-4)
    np.testing.assert_allclose(told[6:9], approx_fprime(place, likelihood, 1e-7), atol=0.02)
    offset_m = prior[:3] - ANCHORS_M
    innovation_m = range_m - np.linalg.norm(offset_m, axis=1)
    unit = offset_m / np.linalg.norm(offset_m, axis=1)[:, None]
    spread_m2 = unit @ covariance[:3, :3] @ unit.T + STD_M**2 * np.eye(4)
    assert told[9] == pytest.approx(innovation_m @ np.linalg.solve(spread_m2, innovation_m))


def test_a_given_height_counts_and_stays():
    """The ranges' slant is that of the height, and no range moves it."""
    low, high = (
        update_state(
            (2.0, 3.0, height_m, 0.0, 0.0), packed(np.diag([1.0, 1.0, 0.0, 1.0, 1.0])), 0, 4, ANCHORS_M,
            np.linalg.norm(np.array([2.2, 2.9, HEIGHT_M]) - ANCHORS_M, axis=1), np.ones(4), STD_M**2, 0.0, np.inf,
            np.inf, np.empty(4),
        )
        for height_m in (HEIGHT_M, HEIGHT_M + 2)
    )  # fmt: skip
    np.testing.assert_allclose(low[0][:2], [2.2, 2.9], atol=5e-3)
    assert np.hypot(high[0][0] - 2.2, high[0][1] - 2.9) > 0.05
    assert (low[0][2], high[0][2]) == (HEIGHT_M, HEIGHT_M + 2)
    assert not unpacked(low[1])[2].any()


@BOTH
def test_covariances_stay_symmetric_and_positive(motion):
    forward, smoothed = run(motion, *uneven_log(9))
    own = TRACKED[motion]
    for covariances in (forward[1], smoothed[1]):
        np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
        assert np.linalg.eigvalsh(covariances[:, own][:, :, own]).min() > 0
    assert (np.trace(smoothed[1], axis1=1, axis2=2) <= np.trace(forward[1], axis1=1, axis2=2) + 1e-12).all()


@pytest.mark.parametrize(("late_m", "limits", "weight"), [
    (0.05, (0.1, 0.4), 1.0), (-0.3, (0.1, 0.4), 1.0), (5.0, (0.1, 0.4), 0.02), (-5.0, (0.1, 0.4), 0.08),
    (5.0, (np.inf, 0.4), 1.0),
])  # fmt: skip
def test_the_pull_of_a_range_is_bounded_on_both_sides(late_m, limits, weight):
    """One range to a place that is known firmly, so that all of it stays as residual."""
    weights = np.empty(1)
    firm = packed(1e-12 * np.eye(5))
    range_m = np.linalg.norm(START[:3] - ANCHORS_M[:1], axis=1) + late_m
    update_state(tuple(START.tolist()), firm, 0, 1, ANCHORS_M[:1], range_m, np.ones(1), STD_M**2, 1.0, *limits, weights)
    assert weights[0] == pytest.approx(weight, rel=1e-6)
