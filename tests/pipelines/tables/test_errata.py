from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadlog.pipelines.tables.errata import ERRATA, errata_document
from quadlog.pipelines.tables.planning.planner_walks import CELL_RATIO, PRINTED_RATIO
from quadlog.pipelines.tables.registry import TABLES

DOCUMENT = Path(__file__).parents[3] / "docs" / "errata.md"


def test_the_document_is_what_the_code_says():
    made = errata_document()
    assert DOCUMENT.read_text(encoding="utf-8") == made, "python -m quadlog.pipelines.tables.errata > docs/errata.md"


def test_tables_that_are_pointed_to_are_there():
    for erratum in (each for mine in ERRATA.values() for each in mine):
        for word in erratum.remark.replace(")", " ").replace(".", " ").split():
            if word.split("-")[0] in {"following", "planning", "tracking", "foot"} and "-" in word:
                assert word in TABLES, erratum


def erratum(paper: str, place: str, words: str):
    """The one erratum at a place that says something."""
    (found,) = (each for each in ERRATA[paper] if each.place == place and words in " ".join(each))
    return found


def test_the_ratios_of_planning_are_cut_off_where_it_is_said():
    cut = [run for run in range(9) if round(CELL_RATIO[run], 2) != PRINTED_RATIO[run]]
    found = erratum("[Planning]", "Table 2", "Cut off")
    assert found.printed.split(" in ")[0] == "ratios {:g}, {:g}, {:g} and {:g}".format(*PRINTED_RATIO[cut])
    assert found.right == "{:.2f}, {:.2f}, {:.2f} and {:.2f}".format(*CELL_RATIO[cut])
    assert [run + 1 for run in cut] == [4, 5, 6, 7]


def test_the_right_solution_of_foot_eq_11_solves_it_and_the_printed_one_does_not():
    """2 J1 k y'' = M with y(0) = y(T/2) = 0, by differences of the quadratic, which are exact but for rounding."""
    moment, k, inertia, period, step = 1.3, 175.0, 0.02, 0.8, 0.01

    def right(t):
        return moment / (4 * k * inertia) * t * (t - period / 2)

    def printed(t):
        return 4 * moment / (k * inertia) * t**2 - 8 * moment / (k * inertia) * t

    def left_side(y, t=0.1):
        return 2 * inertia * k * (y(t + step) - 2 * y(t) + y(t - step)) / step**2

    assert right(0) == right(period / 2) == 0
    assert left_side(right) == pytest.approx(moment)
    assert left_side(printed) == pytest.approx(16 * moment)
    assert abs(printed(period / 2)) > 1e-3
    assert abs(right(period / 4)) == pytest.approx(moment * period**2 / (64 * k * inertia))
    assert abs(right(1e-9) / 1e-9) == pytest.approx(moment * period / (8 * k * inertia))
    assert "M T² / (64 k J1)" in erratum("[Foot]", "eq. 12", "peak").right


def test_the_circle_of_tracking_takes_as_long_as_it_is_said():
    found = erratum("[Tracking]", "section 5.1.3", "circle")
    assert found.right == f"{10 * np.pi / 0.6:.1f} s; 62 s are {10 * np.pi / 62:.3f} m/s"


def test_unequal_replies_err_as_much_as_it_is_said():
    """The mean of four intervals against the general form, for clocks that are 20 ppm fast and slow."""
    flight_s, reply_a_s, reply_b_s = 1e-7, 1e-3, 3e-4
    fast, slow = 1 + 20e-6, 1 - 20e-6
    round_a, round_b = (2 * flight_s + reply_b_s) * fast, (2 * flight_s + reply_a_s) * slow
    delay_a, delay_b = reply_a_s * fast, reply_b_s * slow
    mean_of_four = (round_a - delay_a + round_b - delay_b) / 4
    general = (round_a * round_b - delay_a * delay_b) / (round_a + round_b + delay_a + delay_b)
    off_m = 299792458 * np.abs(np.array([mean_of_four, general]) - flight_s)
    assert off_m[0] == pytest.approx(2.1, abs=0.05)
    assert off_m[1] < 1e-3
    assert "2.1 m for 300 and 1000 µs" in erratum("[Following]", "ranging", "mean of four").remark
