from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.results.compare.differences import Tolerance, unequal

NUMBERS = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([0.0, -0.0, 1.0, 1.0 + 1e-9, math.nan])
AMOUNTS = st.just(0.0) | st.floats(0, 10)


@settings(max_examples=300, deadline=None)
@given(NUMBERS, NUMBERS, AMOUNTS, st.just(0.0) | st.floats(0, 0.5))
def test_numbers_are_the_same_where_math_isclose_says_so(a: float, b: float, absolute: float, relative: float) -> None:
    differ, apart = unequal(np.array([a]), np.array([b]), Tolerance(absolute, relative))
    both_missing = math.isnan(a) and math.isnan(b)
    assert bool(differ[0]) is not (both_missing or math.isclose(a, b, rel_tol=relative, abs_tol=absolute))
    if math.isfinite(a - b):
        assert apart is not None
        assert apart[0] == abs(a - b)


@settings(max_examples=100, deadline=None)
@given(st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1))
def test_integers_are_apart_what_python_says(a: int, b: int) -> None:
    differ, apart = unequal(np.array([a]), np.array([b]), Tolerance())
    assert bool(differ[0]) is (a != b)
    assert apart is not None
    assert apart[0] == float(abs(a - b))


@pytest.mark.parametrize("kind", [object, np.bool_])
def test_texts_and_truth_values_know_no_tolerance(kind: type) -> None:
    a, b = np.array([True, False], kind), np.array([True, True], kind)
    differ, apart = unequal(a, b, Tolerance(absolute=10, relative=10))
    assert differ.tolist() == [False, True]
    assert apart is None
