from __future__ import annotations

import numpy as np

from quadlog.positioning.track.range_log import ERRORS_LAST_S, HOLD_S, VelocitySeries, sample_velocity

SECOND = 1_000_000_000


def series(t_s, velocity, std):
    return VelocitySeries(at(t_s), np.array(velocity, float), np.array(std, float))


def at(seconds):
    return np.rint(np.array(seconds) * SECOND).astype(np.int64)


def test_linear_between_neighbours_or_the_last_one_before():
    known = series([0.0, 0.4, 0.8], [[0, 0], [1, 2], [3, 0]], [0.1, 0.1, 0.2])
    velocity, _ = sample_velocity(known, at([0.1, 0.4, 0.6]), causal=False)
    np.testing.assert_allclose(velocity, [[0.25, 0.5], [1, 2], [2, 1]])
    velocity, _ = sample_velocity(known, at([0.1, 0.4, 0.6]), causal=True)
    np.testing.assert_allclose(velocity, [[0, 0], [1, 2], [1, 2]])


def test_one_second_of_instants_is_worth_one_measurement():
    """Whatever their rate: errors that persist do not average out."""
    known = series(np.arange(0, 5, 0.02), np.zeros((250, 2)), np.full(250, 0.1))
    for rate_hz in (100, 10, 3):
        t_ns = at(np.arange(1, 4, 1 / rate_hz))
        _, variance = sample_velocity(known, t_ns, causal=False)
        information = (1 / variance[1 : 1 + 2 * rate_hz]).sum()
        np.testing.assert_allclose(information, 2 / 0.1**2 / ERRORS_LAST_S, rtol=1e-6)
    _, variance = sample_velocity(known, at([0.0, 1.5, 4.5]), causal=False)
    np.testing.assert_allclose(variance[1:], 0.1**2)


def test_where_there_is_nothing_there_is_no_measurement():
    known = series([1.0, 1.1, 3.0, 3.1, 3.2], np.ones((5, 2)), [0.1, 0.1, 0.1, np.inf, np.nan])
    for causal in (False, True):
        _, variance = sample_velocity(known, at([0.5, 1.05, 1.1 + HOLD_S + 0.1, 3.05, 3.15, 3.3]), causal=causal)
        np.testing.assert_array_equal(np.isfinite(variance), [False, True, False, causal, False, False])


def test_no_series_and_no_instants():
    empty = series([], np.empty((0, 2)), [])
    for known in (None, empty):
        velocity, variance = sample_velocity(known, at([0.0, 1.0]), causal=True)
        np.testing.assert_array_equal(velocity, 0)
        assert np.isinf(variance).all()
    velocity, variance = sample_velocity(series([0.0], [[1, 1]], [0.1]), at([]), causal=False)
    assert velocity.shape == (0, 2)
    assert variance.shape == (0,)
