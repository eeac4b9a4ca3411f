"""Which rows of two tables are about the same thing: those with equal key columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Int


@dataclass(frozen=True, slots=True)
class RowMatch:
    """Row a[k] of the one is row b[k] of the other, in the one's order; the rest is in one of them only."""

    a: Int
    b: Int
    only_a: Int
    only_b: Int


def match_rows(a: Sequence[NDArray[Any]], b: Sequence[NDArray[Any]]) -> RowMatch:
    """Match rows by key columns, (N,) each of a and (M,) each of b, in whatever order the rows are.

    Of rows with the same key the first of the one belongs to the first of the other, and so on.
    """
    n = len(a[0])
    code = np.zeros(n + len(b[0]), np.int64)
    for one, other in zip(a, b, strict=True):
        code = _joint(code, np.unique(np.concatenate([one, other]), return_inverse=True)[1])
    code = _joint(code, np.concatenate([_occurrence(code[:n]), _occurrence(code[n:])]))
    _, in_a, in_b = np.intersect1d(code[:n], code[n:], assume_unique=True, return_indices=True)
    order = np.argsort(in_a, kind="stable")
    return RowMatch(
        in_a[order], in_b[order], np.setdiff1d(np.arange(n), in_a), np.setdiff1d(np.arange(len(code) - n), in_b)
    )


def _joint(code: Int, further: Int) -> Int:
    """One number for each pair of numbers, none above how many there are, so that no product overflows."""
    if not len(code):
        return code
    return np.unique(code * (int(further.max()) + 1) + further, return_inverse=True)[1]


def _occurrence(code: Int) -> Int:
    """How many equal codes stand before each."""
    order = np.argsort(code, kind="stable")
    ordered = code[order]
    starts = np.flatnonzero(np.diff(ordered, prepend=-1))
    place = np.arange(len(code)) - np.repeat(starts, np.diff(np.append(starts, len(code))))
    occurrence = np.empty_like(code)
    occurrence[order] = place
    return occurrence
