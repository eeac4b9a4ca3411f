"""Ranges of one epoch become a fix: every method by its name."""

from __future__ import annotations

from collections.abc import Callable

from quadlog.errors import UnknownName
from quadlog.messages import Float
from quadlog.positioning.fixes import Fixes
from quadlog.positioning.gauss_newton import solve_gauss_newton, solve_huber
from quadlog.positioning.linear import solve_linear, solve_paper, solve_weighted

METHODS: dict[str, Callable[[Float, Float, float | None, float, float], Fixes]] = {
    "gauss_newton": solve_gauss_newton,
    "linear": solve_linear,
    "weighted": solve_weighted,
    "paper": solve_paper,
    "huber": solve_huber,
}


def solve_fixes(
    method: str,
    anchors_m: Float,
    range_m: Float,
    tag_height_m: float | None,
    range_std_m: float,
    outlier_m: float,
) -> Fixes:
    """Fixes of E epochs from ranges (E, A), NaN where absent, to anchors (A, 3) in map, by one of METHODS.

    tag_height_m: the tag's height in map; None solves for it, from four ranges
    to anchors that differ in height. A residual rms above outlier_m marks an
    outlier. Whatever cannot be solved is marked in the result: too few ranges
    by n_ranges, anchors on a line (on a plane, where the height is solved for)
    or a mirror image that fits as well by degenerate.

    Raises UnknownName for a method that is none.
    """
    if method not in METHODS:
        raise UnknownName("UWB method", method, METHODS)
    return METHODS[method](anchors_m, range_m, tag_height_m, range_std_m, outlier_m)
