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


def test_relative_is_to_the_larger_of_both() -> None:
    one, other = np.array([1.0, 1.05]), np.array([1.05, 1.0])  # 0.05 is 4.76 % of 1.05, 5 % of 1
    assert not unequal(one, other, Tolerance(relative=0.049))[0].any()
    assert unequal(one, other, Tolerance(relative=0.047))[0].all()


@settings(max_examples=100, deadline=None)
@given(st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1))
def test_integers_are_apart_what_python_says(a: int, b: int) -> None:
    differ, apart = unequal(np.array([a]), np.array([b]), Tolerance())
    assert bool(differ[0]) is (a != b)
    assert apart is not None
    assert apart[0] == float(abs(a - b))


def test_angles_are_apart_by_the_shorter_way() -> None:
    a, b = np.array([math.pi - 1e-9, 0.1, 3.0]), np.array([-math.pi + 1e-9, 0.3, 3.0 + 2 * math.pi])
    differ, apart = unequal(a, b, Tolerance(absolute=1e-6), angle=True)
    assert differ.tolist() == [False, True, False]
    assert apart == pytest.approx([2e-9, 0.2, 0.0], abs=1e-12)
    assert unequal(a, b, Tolerance(absolute=1e-6))[0].tolist() == [True, True, True]


@pytest.mark.parametrize("kind", [object, np.bool_])
def test_texts_and_truth_values_know_no_tolerance(kind: type) -> None:
    a, b = np.array([True, False], kind), np.array([True, True], kind)
    differ, apart = unequal(a, b, Tolerance(absolute=10, relative=10))
    assert differ.tolist() == [False, True]
    assert apart is None
