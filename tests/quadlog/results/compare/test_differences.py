from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.compare.differences import Tolerance, ValueDifference, compare_values, flatten, unequal

NUMBERS = st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([0.0, -0.0, 1.0, 1.0 + 1e-9, math.nan])
AMOUNTS = st.just(0.0) | st.floats(0, 10)


@given(NUMBERS, NUMBERS, AMOUNTS, st.just(0.0) | st.floats(0, 0.5))
def test_numbers_are_the_same_where_math_isclose_says_so(a: float, b: float, absolute: float, relative: float) -> None:
    differ, apart = unequal(np.array([a]), np.array([b]), Tolerance(absolute, relative))
    both_missing = math.isnan(a) and math.isnan(b)
    assert bool(differ[0]) is not (both_missing or math.isclose(a, b, rel_tol=relative, abs_tol=absolute))
    if math.isfinite(a - b):
        assert apart[0] == abs(a - b)


@given(st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1))
def test_integers_are_apart_what_python_says(a: int, b: int) -> None:
    differ, apart = unequal(np.array([a]), np.array([b]), Tolerance())
    assert bool(differ[0]) is (a != b)
    assert apart[0] == float(abs(a - b))


@pytest.mark.parametrize("kind", [object, np.bool_])
def test_texts_and_truth_values_know_no_tolerance(kind: type) -> None:
    a, b = np.array([True, False], kind), np.array([True, True], kind)
    differ, apart = unequal(a, b, Tolerance(absolute=10, relative=10))
    assert differ.tolist() == [False, True]
    assert apart is None


LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
JSON = st.recursive(LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)


def test_leaves_have_dotted_names() -> None:
    content = {"uwb": {"anchors": [{"id": 0}, {"id": 1}], "tags": []}, "seed": 3}
    assert flatten(content) == {"uwb.anchors.0.id": 0, "uwb.anchors.1.id": 1, "uwb.tags": [], "seed": 3}


@given(JSON)
def test_anything_is_the_same_as_itself(content: Any) -> None:
    assert compare_values(flatten({"x": content}), flatten({"x": content})) == ()


def test_depth_is_no_matter() -> None:
    content: dict[str, Any] = {}
    for _ in range(5000):
        content = {"a": content}
    assert len(flatten(content)) == 1


def test_each_kind_of_difference() -> None:
    a = {"same": 1, "number": 1.0, "text": "x", "kind": True, "gone": 0, "huge": 10**400, "close": 2.0}
    b = {"same": 1.0, "number": 3.0, "text": "y", "kind": 1, "new": None, "huge": 10**400 + 1, "close": 2.05}
    assert compare_values(a, b, Tolerance(absolute=0.1)) == (
        ValueDifference("gone", 0, None),
        ValueDifference("huge", 10**400, 10**400 + 1),
        ValueDifference("kind", True, 1),
        ValueDifference("new", None, None),
        ValueDifference("number", 1.0, 3.0, 2.0),
        ValueDifference("text", "x", "y"),
    )
