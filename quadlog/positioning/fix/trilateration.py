"""Ranges of one epoch become a fix: every method by its name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from quadlog.errors import UnknownName
from quadlog.messages import Float
from quadlog.positioning.fix.ambiguity import THIN_STD, descend_both_sides
from quadlog.positioning.fix.least_squares import Fixes, complete_fixes, descend_all
from quadlog.positioning.fix.linear import solve_linear, solve_paper, solve_weighted, start_linear

LONG_STD, SHORT_STD = 1.25, 4.0
"""Residuals, in std, where Huber's weights begin to fall: late paths exist, early ones hardly do. Chosen on simulated
seed 1 between 0.5 and 1.5: without late ranges they cost 1-2 %, with them they halve the error of eight anchors."""


def solve_gauss_newton(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float, outlier_m: float
) -> Fixes:
    """Maximum-likelihood fixes from ranges (E, A), NaN where absent, to anchors (A, 3) in map.

    Starts at the linear solution and iterates u = (p - a)/|p - a|, dp = (sum u u^T)^-1 sum u (d - |p - a|) [Following,
    right form] with the full 3-D distance, whose known height difference is the slant. The covariance is (sum u u^T /
    std^2)^-1, the Cramér-Rao bound. Not solved: fewer than three ranges, anchors on a line, or so near to one that the
    fix's mirror image fits as well. With tag_height_m None the height is solved for: that takes four ranges, and for a
    line read a plane.
    """
    return _solve(anchors_m, range_m, tag_height_m, range_std_m, outlier_m, np.inf, np.inf)


def solve_huber(
    anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float, outlier_m: float
) -> Fixes:
    """As solve_gauss_newton, but residuals beyond LONG_STD (late) or -SHORT_STD std weigh as Huber has it.

    Iteratively reweighted; the weight falls as 1/residual, so a late range pulls with bounded force. The loss being
    convex, the start decides little. One epoch of three ranges cannot show which is late: there it is no help. Nor is
    it with ranges that are all too long by a constant: calibrate them. The covariance is (sum w u u^T / std^2)^-1,
    honest without late ranges, and too small with them, as no single epoch can show them all.
    """
    return _solve(
        anchors_m, range_m, tag_height_m, range_std_m, outlier_m, LONG_STD * range_std_m, SHORT_STD * range_std_m
    )


def _solve(
    anchors_m: Float,
    range_m: Float,
    tag_height_m: float | None,
    range_std_m: float,
    outlier_m: float,
    long_m: float,
    short_m: float,
) -> Fixes:
    start_m, spread_m2 = start_linear(anchors_m, range_m, tag_height_m, range_std_m)
    solve_z = tag_height_m is None
    position_m, inverse, _ = descend_all(anchors_m, range_m, start_m, solve_z, long_m, short_m)
    thin = np.flatnonzero(spread_m2 < (THIN_STD * range_std_m) ** 2)
    if len(thin):
        position_m[thin], inverse[thin] = descend_both_sides(
            anchors_m, range_m[thin], start_m[thin], solve_z, range_std_m, long_m, short_m
        )
    return complete_fixes(anchors_m, range_m, position_m, range_std_m**2 * inverse, outlier_m)


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

    tag_height_m: the tag's height in map; None solves for it, from four ranges to anchors that differ in height. A
    residual rms above outlier_m marks an outlier. Whatever cannot be solved is marked in the result: too few ranges by
    n_ranges, anchors on a line (on a plane, where the height is solved for) or a mirror image that fits as well by
    degenerate.

    Raises UnknownName for a method that is none.
    """
    if method not in METHODS:
        raise UnknownName("UWB method", method, METHODS)
    return METHODS[method](anchors_m, range_m, tag_height_m, range_std_m, outlier_m)
