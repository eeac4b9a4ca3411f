"""Errata of [Tracking]."""

from __future__ import annotations

from quadlog.results.paper_errata import Erratum

TRACKING = (
    Erratum(
        "eq. 1",
        "L1 lies along the leg: P_y = s1 (L1 + r), P_z = -c1 (L1 + r)",
        "it lies aside: P_y = ±L1 c1 + s1 r, P_z = ±L1 s1 - c1 r, with r = L2 c2 + L3 c23",
        "+ on the left.",
    ),
    Erratum(
        "eqs 3, 4",
        "T with B above and B_i below",
        "B_i above and B below: it takes B into B_i",
        "The body's turning within a cycle is left out.",
    ),
    Erratum("eq. 5, text", "the last state is an acceleration", "V is the velocity of the centre of mass"),
    Erratum("eqs 7, 10", "T, [ω]×, I in R^3", "3 × 3 matrices"),
    Erratum("eqs 8, 14, 23", "T_z(φ)", "its transpose", "The matrix that eq. 8 writes out is the transposed one."),
    Erratum("eq. 9", "entry (3, 1) is 0", "-sin θ"),
    Erratum("eq. 14", "+1 for the state g", "+1 with g = -9.81, or -1 with 9.81 as in eq. 6"),
    Erratum("eq. 22", "+ g", "+ g Δt, in the rows of V"),
    Erratum(
        "eq. 24",
        "u(k + 1) in every term",
        "u(k), u(k + 1), ..., u(k + t_n - 1)",
        "Eqs 24 to 26 leave out gravity; here it is kept.",
    ),
    Erratum("eq. 28", "x(k + N)", "x(k + t_n)"),
    Erratum("eq. 30", "Q^T (x - x_ref) Q + W^T u W", "(x - x_ref)^T Q (x - x_ref) + u^T W u"),
    Erratum("eq. 31", "f_z > 0", "f_min <= f_z <= f_max, as its text says"),
    Erratum(
        "eq. 36",
        "q'_i = J_i^+ x'_i + N_i q'_δ",
        "q'_i = q'_(i-1) + N^A_(i-1) q'_δ",
        "As printed a later task disturbs the first. Primes are time derivatives.",
    ),
    Erratum("eq. 37", "q'_i - J_i q'_(i-1)", "x'_i - J_i q'_(i-1)", "q'_δ serves the i-th task, not the one before."),
    Erratum("eq. 40", "first line: J_1^+ (-J_1 q')", "J_1^+ (-J'_1 q')"),
    Erratum("Table 3", "1 and 2 for rotation and translation; the text has 2 and 3", "the table's"),
    Erratum(
        "eq. 21",
        "the centroid over seven points",
        "the centroid over the continuous universe is another one",
        "They differ by up to 0.80 in Δk_v and 1.11 in Δk_w, 0.57 m in l; both can be chosen.",
    ),
    Erratum("Table 1", "(NS, PM) is PS", "NS, or ZO", "Its only break of monotony."),
    Erratum(
        "Table 2",
        "(ZO, ZO) is NS",
        "ZO",
        "As printed no error at all shortens l by λ_w v. The table resembles the usual one for a derivative gain.",
    ),
    Erratum(
        "eq. 45",
        "the predicted position, not said of what",
        "the nearest point of the path, or the place in time",
        "Both are given, under names of their own.",
    ),
    Erratum("eqs 46, 47", "sums to N, divided by N_e and N_e - 1", "one number of ticks in all places"),
    Erratum(
        "section 5.1.3",
        "62 s round a circle of 5 m radius at 0.6 m/s",
        "52.4 s; 62 s are 0.507 m/s",
        "Table tracking-courses.",
    ),
)
