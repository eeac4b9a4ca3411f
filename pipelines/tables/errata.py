"""All errata of the four papers: for the tables' page and, by `python -m`, for docs/errata.md."""

from __future__ import annotations

from typing import NamedTuple

from quadlog.results.page.blocks import Cell, Column, Section, Table
from quadlog.results.text import escape_markdown, print_table

HEADER = ("where", "printed", "right", "remark")


class Erratum(NamedTuple):
    """place: as the paper numbers it; printed and right: formulas or words; remark: what follows, may be empty."""

    place: str
    printed: str
    right: str
    remark: str = ""


FOLLOWING = (
    Erratum(
        "ranging",
        "two-way ranging of both sides, its formula lost",
        "T_f = (R_a R_b - D_a D_b) / (R_a + R_b + D_a + D_b), of the rounds R and the replies D",
        "A mean of four, as is common, errs with unequal replies: 2.1 m for 300 and 1000 µs at 40 ppm between clocks.",
    ),
    Erratum(
        "weighted trilateration",
        "weights improve the fix of three stations",
        "no weight changes it: one equation taken from the others leaves two in two unknowns",
        "What helps is a direct fit of the ranges (table following-uwb).",
    ),
    Erratum(
        "trilateration",
        "circles of the measured distances",
        "spheres: a tag at 0.6 or 1.3 m measures slant ranges to stations at 1.2 m",
        "Differences of squares cancel one common height, a direct fit must be told (table following-uwb).",
    ),
    Erratum(
        "tags, Figs 9 to 12",
        "robot at (0, 2.4), person at (0, 0.8)",
        "robot at (0.8, 0), person at (2.4, 0)",
        "x and y are interchanged, and so are the tags. The distances cannot tell it from interchanged stations.",
    ),
    Erratum("person to station 3", "3.55 m", "3.60 m", "The tag's two other distances fit its corrected place."),
    Erratum(
        "ground",
        "the largest plane of the front half is the ground",
        "it is the wall where a wall is near",
        "Measured in table following-lidar.",
    ),
)

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

PLANNING = (
    Erratum(
        "eq. 3",
        "h = |x_t - x| + |y_t - y|, without a unit",
        "10 h for steps of 10 and 14 and x, y in cells",
        "Without the 10 the first waypoint is always the best one and each replan is a whole A*. With it, h may exceed "
        "the way, since diagonals are allowed: routes need not be shortest.",
    ),
    Erratum(
        "below eq. 4",
        'the waypoint of minimal f is "searched out from the end vertex"',
        "left open: the least f of the whole route (ia_star), or walking back from the end while f falls (ia_star_end)",
        "The second searches less and leads longer ways. By it alone all ratios are above 5, as printed (table "
        "planning-2).",
    ),
    Erratum("eq. 5", "g(r'') = g(r') + g(r_e')", "g(r'') = g(r'') + g(r_e')", "The new part goes on where r' ends."),
    Erratum(
        "eq. 10",
        "dis = min(|dx|, |dy|) off the axes",
        "dis = max(|dx|, |dy|): rings",
        "By the smaller one a cell at (3, 1) has distance 1, the highest danger.",
    ),
    Erratum(
        "eqs 12, 13",
        "a cell's danger is added on entering and taken off on leaving",
        "added and kept, if danger is to cost anything",
        "As printed the charges cancel along any way. The detours come of a heuristic that knows nothing of it, and of "
        "cells that stay closed (table planning-ea).",
    ),
    Erratum(
        "eq. 13",
        "- 0.02 for a step within one level",
        "it decides between ways of one length only",
        "Lengths differ by 2 or more, so that it takes 100 such steps to change one.",
    ),
    Erratum(
        "text about eq. 13",
        'eqs "(11)" and "(12)" by dflag; growth "using (12)"',
        "eqs (12) and (13); growth by (11)",
    ),
    Erratum(
        "Table 1",
        "IA* leads the shorter way",
        "no plan is shorter than that of A* with a heuristic that never exceeds the way",
        "It can hold for the smoothed way that a robot walks (table planning-1).",
    ),
    Erratum(
        "Table 2",
        "ratios 5.86, 7.35, 11.57 and 5.5 in runs 4 to 7",
        "5.87, 7.36, 11.58 and 5.55",
        "Cut off, not rounded.",
    ),
    Erratum(
        "Table 2",
        '"searched" cells; ties not mentioned',
        "left open: opened, closed or touched cells, and which of equal f is taken first",
        "With the printed heuristic ties change next to nothing, what counts as searched much (table planning-2).",
    ),
)

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

ERRATA = {"[Following]": FOLLOWING, "[Planning]": PLANNING, "[Tracking]": TRACKING, "[Foot]": FOOT}
"""By paper, keyed as in docs/references.md, in the order of the papers' own numbers."""
TITLE = "Errata of the four papers"
INTRODUCTION = (
    "What is wrong, or left open, in print, and the right form. quadlog takes the right one; where comparing is\n"
    "instructive, `--preset paper` runs the printed one. What an erratum does to a number stands with the table that\n"
    "measures it.\n"
)


def errata_section() -> Section:
    """The list as it stands on the tables' page."""
    rows = [[*map(Cell, (paper, *erratum))] for paper, mine in ERRATA.items() for erratum in mine]
    columns = [*map(Column, ("paper", *HEADER))]
    text = INTRODUCTION.replace("`", "").replace("\n", " ").strip()
    return Section(TITLE, [Table(columns, rows, "errata", search="Search, as in eq. 8")], text)


def errata_document() -> str:
    """docs/errata.md."""
    lists = (
        f"## {escape_markdown(paper)}\n\n{print_table(HEADER, mine, 'markdown')}" for paper, mine in ERRATA.items()
    )
    return f"# {TITLE}\n\n{INTRODUCTION}\n" + "\n".join(lists)
