"""Errata of [Planning]."""

from __future__ import annotations

from quadlog.results.paper_errata import Erratum

PLANNING = (
    Erratum(
        "eq. 3",
        "h = |x_t - x| + |y_t - y|, without a unit",
        "10 h for steps of 10 and 14 and x, y in cells",
        "Without the 10 the first waypoint is always the best one and each replan is a whole A*. With it, h may exceed "
        "the way, since diagonals are allowed: routes need not be shortest.",
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
