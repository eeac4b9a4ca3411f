"""The condensed cost against plain stacking of A and B, eq 25 as it should read."""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.control.locomotion.mpc_model import build_cost, continuous_model, discrete_model, in_pyramid

MASS_KG, ALPHA, DT_S = 12.786, 2e-5, 0.03
INERTIA = np.array([[0.07, 0.005, -0.01], [0.005, 0.25, 0.0], [-0.01, 0.0, 0.28]])
WEIGHTS = np.array([25, 20, 12, 21, 19, 80, 0.15, 0.2, 0.4, 2, 1.5, 0.8])


def _stacked(state, reference, arms_m, contacts, yaw_rad):
    """H and g of J = sum (x - x_ref)^T Q (x - x_ref) + alpha f^T f, halved, by rolling the model out."""
    steps = len(reference)
    free, response = state, np.zeros((12, 12 * steps))
    H, g = ALPHA * np.eye(12 * steps), np.zeros(12 * steps)
    for step in range(steps):
        model = discrete_model(continuous_model(MASS_KG, INERTIA, yaw_rad, arms_m[step]), DT_S)
        free, response = model.A @ free + model.gravity, model.A @ response
        response[:, 12 * step : 12 * step + 12] = model.B
        H += response.T @ np.diag(WEIGHTS) @ response
        g += response.T @ (WEIGHTS * (free - reference[step]))
    stands = np.repeat(contacts.ravel(), 3)
    return H[np.ix_(stands, stands)], g[stands]


def _built(state, reference, arms_m, contacts):
    return build_cost(state, reference, arms_m, contacts, MASS_KG, np.linalg.inv(INERTIA), WEIGHTS, ALPHA, DT_S)


@pytest.mark.parametrize("seed", range(6))
def test_cost_is_that_of_the_rolled_out_model(seed):
    random = np.random.default_rng(seed)
    steps = [1, 2, 5, 10, 10, 17][seed]
    state = random.normal(size=12)
    reference = state + random.normal(scale=0.3, size=(steps, 12))
    arms_m = random.normal(scale=0.3, size=(steps, 4, 3))
    contacts = random.random((steps, 4)) < 0.6
    contacts[0, 0] = True
    H, g, is_finite = _built(state, reference, arms_m, contacts)
    yaw_rad = np.mean([state[2], *reference[:-1, 2]])
    expected_H, expected_g = _stacked(state, reference, arms_m, contacts, yaw_rad)
    assert is_finite
    np.testing.assert_allclose(H, expected_H, rtol=1e-10, atol=1e-13 * abs(expected_H).max())
    np.testing.assert_allclose(g, expected_g, rtol=1e-10, atol=1e-13 * abs(expected_g).max())
    np.testing.assert_array_equal(H, H.T)


def test_whole_turns_of_the_reference_change_nothing():
    random = np.random.default_rng(0)
    state = random.normal(scale=0.1, size=12)
    state[2] = 3.1
    reference = state + random.normal(scale=0.05, size=(10, 12))
    reference[:, 2] = 3.1 + 0.02 * np.arange(1, 11)
    wrapped = reference.copy()
    wrapped[:, 2] = (reference[:, 2] + np.pi) % (2 * np.pi) - np.pi
    wrapped[4:, 2] -= 4 * np.pi
    arms_m, contacts = random.normal(scale=0.3, size=(10, 4, 3)), np.ones((10, 4), dtype=bool)
    plain, turned = (_built(state, each, arms_m, contacts) for each in (reference, wrapped))
    np.testing.assert_allclose(turned[0], plain[0], rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(turned[1], plain[1], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_told_even_in_flight(value):
    state = np.zeros(12)
    state[4] = value
    for contacts in (np.ones((10, 4), dtype=bool), np.zeros((10, 4), dtype=bool)):
        assert not _built(state, np.zeros((10, 12)), np.ones((10, 4, 3)), contacts)[2]


@pytest.mark.parametrize(
    ("force", "allowed"),
    [
        ([0, 0, 0], True),
        ([6, -6, 10], True),
        ([6.1, 0, 10], False),
        ([0, -6.1, 10], False),
        ([0, 0, 151], False),
        ([0, 0, -1], False),
        ([np.nan, 0, 10], False),
        ([0, np.nan, 10], False),
        ([0, 0, np.nan], False),
    ],
)
def test_pyramid(force, allowed):
    assert in_pyramid(np.array([0, 0, 10, *force], dtype=float), 0.6, 0.0, 150.0, 1e-9) == allowed
