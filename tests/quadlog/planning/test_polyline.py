from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.geometry import arc_lengths
from quadlog.planning.path import is_free, resample, turning


@given(seed=st.integers(0, 2**32 - 1))
def test_is_free_against_dense_samples(seed):
    """Free means that no sample is blocked; blocked, that cutting the cells finely finds one (or a sliver of one)."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((9, 7)) < 0.15
    points = rng.uniform([0, 0], [7, 9], (3, 2))
    t = np.linspace(0, 1, 4001)[:, None]
    samples = np.concatenate([points[i] + t * (points[i + 1] - points[i]) for i in range(2)])
    cells = np.floor(samples).astype(int)
    hit = blocked[cells[:, 1], cells[:, 0]].any()
    free = is_free(blocked, points)
    if free:
        assert not hit
    elif not hit:
        # Missed by the samples: some blocked cell must lie within a sample's distance.
        rows, cols = np.nonzero(blocked)
        away_x = np.maximum(np.abs(samples[:, 0, None] - cols - 0.5) - 0.5, 0)
        away_y = np.maximum(np.abs(samples[:, 1, None] - rows - 0.5) - 0.5, 0)
        assert np.hypot(away_x, away_y).min() < 5e-3


def test_diagonal_through_a_corner_and_outside():
    blocked = np.array([[False, True], [True, False]])
    centres = np.array([[0.5, 0.5], [1.5, 1.5]])
    assert is_free(blocked, centres)
    assert is_free(blocked, centres[::-1].copy())
    assert not is_free(blocked, np.array([[0.5, 0.5], [1.5, 0.6]]))
    assert not is_free(np.zeros((2, 2), dtype=bool), np.array([[0.5, 0.5], [2.5, 0.5]]))
    assert not is_free(np.zeros((2, 2), dtype=bool), np.array([[-0.5, 0.5]]))
    assert is_free(blocked, np.array([[0.5, 0.5]]))


def test_resample_keeps_ends_and_equal_steps():
    points = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])
    np.testing.assert_allclose(arc_lengths(points), [0, 3, 7])
    np.testing.assert_allclose(resample(points, 8)[[0, 3, 5, 7]], [[0, 0], [3, 0], [3, 2], [3, 4]])


def test_turning_of_a_staircase():
    points = np.array([[0, 0], [2, 0], [2, 1], [3, 1], [3, 2]])
    assert turning(points) == (5.0, pytest.approx(3 * math.pi / 2))
    assert turning(points * 0.1) == (pytest.approx(0.5), pytest.approx(3 * math.pi / 2))
    assert turning(np.array([[0, 0], [1, 0], [0, 0]])) == (2.0, pytest.approx(math.pi))
