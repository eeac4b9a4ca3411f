"""How gravity tips a trotting body about the line between its two support feet [Foot, eqs 7-8, corrected]."""

from __future__ import annotations

import math

import numpy as np

from quadlog.messages import Float

LEFT_FORE_RIGHT_HIND, RIGHT_FORE_LEFT_HIND = 1.0, -1.0
"""The two pairs of support legs: the sign of the diagonal's slope, seen from above."""


def diagonal_m(length_m: float, width_m: float) -> float:
    """D: how far the two support feet are from one another."""
    return math.hypot(length_m, width_m)


def diagonal_moment(weight_n: float, ahead_m: float, length_m: float, width_m: float, pair: float) -> Float:
    """(3,) gravity's moment in N m about the support diagonal, in the body; positive y tips it onto its nose.

    ahead_m: the centre of mass ahead of the middle between the support feet, neither left nor right of it. length_m,
    width_m: between the feet, L_x and L_y + 2 L1. pair: LEFT_FORE_RIGHT_HIND or RIGHT_FORE_LEFT_HIND.
    Eq. 8 is ahead_m = -4 m d / (all mass): the total is M g d (L_y + 2 L1) / D with M = 4 m. The part about x
    alternates with the pair.
    """
    lever = weight_n * ahead_m * width_m / diagonal_m(length_m, width_m) ** 2
    return lever * np.array([pair * length_m, width_m, 0.0])
