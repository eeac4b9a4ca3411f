"""Named values compared: configs, versions, metrics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from quadlog.results.differences import ValueDifference
from quadlog.results.equality import Tolerance, unequal

EXACT = Tolerance()


def flatten(content: Any) -> dict[str, Any]:
    """The leaves of a JSON object by dotted name, as in `uwb.anchors.0.x_m`; an empty table or list is a leaf itself.

    What is no object or list has no leaves.
    """
    leaves: dict[str, Any] = {}
    pending: list[tuple[str, Any]] = [("", content)]
    while pending:
        name, value = pending.pop()
        inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        if name and not (inner and value):
            leaves[name] = value
            continue
        pending += [(f"{name}.{key}" if name else str(key), each) for key, each in inner]
    return leaves


def compare_values(
    a: Mapping[str, Any], b: Mapping[str, Any], tolerance: Tolerance = EXACT
) -> tuple[ValueDifference, ...]:
    """The names whose values differ, in alphabetical order, those that only one of both has included."""
    compared = (_compare(key, a, b, tolerance) for key in sorted({*a, *b}))
    return tuple(each for each in compared if each is not None)


def _compare(key: str, a: Mapping[str, Any], b: Mapping[str, Any], tolerance: Tolerance) -> ValueDifference | None:
    one, other = a.get(key), b.get(key)
    if not (_is_number(one) and _is_number(other)):
        same = key in a and key in b and type(one) is type(other) and one == other
        return None if same else ValueDifference(key, one, other)
    differ, apart = unequal(np.array([one], np.float64), np.array([other], np.float64), tolerance)
    if not differ[0] or apart is None:
        return None
    return ValueDifference(key, one, other, float(apart[0]) if np.isfinite(apart[0]) else None)


def _is_number(value: Any) -> bool:
    """Whether arithmetic can be done with it; JSON has integers of any length."""
    return isinstance(value, float) or (isinstance(value, int) and type(value) is not bool and abs(value) < 1 << 63)
