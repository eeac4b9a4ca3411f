from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.text.markup import aligned
from quadlog.results.text.metrics import number
from quadlog.results.text.numbers import count, percent, short, significant

WHOLE = {0.0: "0", 593.0: "593", -3.0: "-3", 1e300: f"{1e300:.0f}", None: ""}
FOUR = {0.0074979: "0.007498", 1.0005: "1.000", 999.96: "1000", 12345.67: "12346", 1e-9: "1.000e-09", -0.25: "-0.2500"}


@pytest.mark.parametrize(
    ("form", "shown"),
    [
        (number, WHOLE | FOUR),
        (significant, FOUR | {math.nan: "", -math.inf: "", None: "", -0.0: "0.000"}),
        (lambda value: significant(value, 3), {198.87: "199", 4.961: "4.96", 0.166: "0.166", 99.96: "100"}),
        (short, {None: "", -0.0: "0", 0.123456: "0.1235", 12345.0: "1.234e+04"}),
        (lambda value: short(value, 6), {5.2: "5.2", 1234567.0: "1.23457e+06"}),
        (count, {0: "0", 1234567: "1\u2009234\u2009567"}),
        (percent, {0.0417: "4.2 %", 0.0: "0.0 %"}),
    ],
)
def test_numbers(form, shown):
    assert {value: form(value) for value in shown} == shown


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(1, 9))
def test_significant_digits_are_as_near_as_can_be(value: float, digits: int) -> None:
    assert float(significant(value, digits)) == pytest.approx(value, rel=0.5000001 * 10 ** (1 - digits), abs=0)


@given(st.lists(st.lists(st.text("ab ", max_size=5), min_size=3, max_size=3), min_size=1, max_size=5))
def test_columns_are_aligned(rows: list[list[str]]) -> None:
    widths = [max(len(row[at]) for row in rows) for at in range(3)]
    wanted = [f"{a:<{widths[0]}}  {b:>{widths[1]}} {c:>{widths[2]}}".rstrip() for a, b, c in rows]
    assert aligned(rows, left=(0,), gaps=[5, 2, 1]) == wanted
