"""When two saved values are the same, and how far they are apart where they are not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Numbers no further apart than `absolute`, or `relative` times the larger magnitude, are the same."""

    absolute: float = 0.0
    relative: float = 0.0

    def allows(self, apart: Float, a: Float, b: Float) -> NDArray[np.bool_]:
        """Whether numbers (N,) a and b that are `apart` (N,) are the same; never where one of them does not exist."""
        with np.errstate(invalid="ignore"):
            allowed = np.maximum(self.absolute, self.relative * np.maximum(np.abs(a), np.abs(b)))
            return np.isfinite(apart) & (apart <= allowed)


def unequal(
    a: NDArray[Any], b: NDArray[Any], tolerance: Tolerance, angle: bool = False
) -> tuple[NDArray[np.bool_], Float | None]:
    """Where a (N,) and b (N,) differ, and how far they are apart (N,), None for text and truth values.

    NaN equals NaN. Angles [rad] are apart by the shorter way around, so that pi and -pi are neighbours.
    """
    if a.dtype.kind not in "iuf":
        return np.asarray(a != b, np.bool_), None
    differ = a != b
    if a.dtype.kind == "f":
        differ &= ~(np.isnan(a) & np.isnan(b))
    apart = _apart(a, b)
    if angle:
        with np.errstate(invalid="ignore"):
            apart = np.abs(apart - math.tau * np.round(apart / math.tau))
    return differ & ~tolerance.allows(apart, a.astype(np.float64), b.astype(np.float64)), apart


def _apart(a: NDArray[Any], b: NDArray[Any]) -> Float:
    if a.dtype.kind == "f":
        with np.errstate(invalid="ignore", over="ignore"):
            return np.abs(a - b, dtype=np.float64)
    # Larger less smaller, read as unsigned: right also where the difference does not fit the type.
    larger, smaller = np.maximum(a, b), np.minimum(a, b)
    return (larger.astype(np.int64) - smaller.astype(np.int64)).view(np.uint64).astype(np.float64)
