from __future__ import annotations

import math

import numpy as np
import pytest

from quadlog.geometry import arc_lengths
from quadlog.planning.path import is_free, resample, turning


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
