"""Errata of [Following]."""

from __future__ import annotations

from quadlog.results.paper_errata import Erratum

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
