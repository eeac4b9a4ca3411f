"""Errata of [Foot]."""

from __future__ import annotations

from quadlog.results.paper_errata import Erratum

FOOT = (
    Erratum(
        "eq. 2",
        "P_z ends in L2 c2 s2",
        "L3 c3 s2",
        "So mended it still has L1 in row 0 of Table 1, which has it in row 1: P_x = c1 (L2 c2 + L3 c23) + L1 s1, "
        "P_y = s1 (L2 c2 + L3 c23) - L1 c1, P_z = L2 s2 + L3 s23 on the right.",
    ),
    Erratum(
        "eq. 3",
        "θ1 = -arctan(P_y / P_z) - arctan(L1 / root)",
        "θ1 = atan2(P_y, -P_z) - σ arctan(L1 / root), σ = +1 on the left, -1 on the right",
        "As printed a foot straight below has -38.6° of abduction.",
    ),
    Erratum("eq. 4", "entry (2, 3) is L3 s1 s23", "-L3 s1 s23", "It is the left leg's, in another frame than eq. 2."),
    Erratum(
        "Fig. 3",
        "τ1 = 0",
        "τ1 = -P_y f_z, 0.343 N m with its numbers",
        "By its own eqs 4 to 6, with a foot at P_y = -L1 (table foot-torque).",
    ),
    Erratum("Fig. 3", "f_z = m g, one leg's mass", "half of the body's weight, for two legs support it in a trot"),
    Erratum(
        "eq. 8",
        "M_x = M g d, M_y = M g d L_y / (2 L1 + L_x)",
        "M_x = M g d L_x (L_y + 2 L1) / D², M_y = M g d (L_y + 2 L1)² / D², D² = L_x² + (L_y + 2 L1)²",
        "With eq. 7's d, M = 4 m. About the support diagonal it is M g d (L_y + 2 L1) / D. M_x changes its sign with "
        "the pair of support feet, not M_y.",
    ),
    Erratum(
        "eq. 9",
        "x and y for 0 <= t < T; z without the body's height",
        "for 0 <= t < λT; -h + z",
        "What comes later is the stance of eq. 10.",
    ),
    Erratum("eq. 10", "y = 0 for 0 <= t < T", "for λT <= t < T"),
    Erratum("eq. 11", "2 J1 k y'' = M_y", "2 J1 k y'' = M_x", "Abduction turns about x. k has the unit 1/m."),
    Erratum(
        "eq. 12",
        "y = 4 M t² / (k J1) - 8 M t / (k J1)",
        "y = M t (t - T/2) / (4 k J1), with its peak of M T² / (64 k J1)",
        "The square term is 16 times too large, and y(T/2) = 0 only for T = 4 s. T/2 presumes λ = 1/2.",
    ),
    Erratum(
        "eq. 12",
        "a foot that starts and lands at rest",
        "y' is M T / (8 k J1) at both ends",
        "An eased form is at rest there (table foot-drift).",
    ),
)
