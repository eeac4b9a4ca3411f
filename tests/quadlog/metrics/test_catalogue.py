from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import UnknownMetric
from quadlog.metrics.catalogue import CATALOGUE, OPERATORS, Condition, parse_condition

REFERENCES = (Path(__file__).parents[3] / "docs" / "references.md").read_text()
UNITS = {"_n": "N", "_mps": "m/s", "_m": "m", "_s": "s", "_rad": "rad", "_nm": "N·m", "_degps": "deg/s", "_hz": "Hz"}


def test_every_entry_says_all_there_is():
    for name, entry in CATALOGUE.items():
        assert entry.name == name
        assert all([entry.meaning, entry.formula, entry.source, entry.counted]), name
        suffix = next((each for each in UNITS if name.endswith(each)), "")
        assert entry.unit == ("µs" if name.startswith("us_") else UNITS.get(suffix, "")), name
        assert all(f"| {key} |" in REFERENCES for key in re.findall(r"\[[^]]+\]", entry.source)), name


numbers = st.floats(allow_nan=False, allow_infinity=False)
spaces = st.text(" \t", max_size=3)


@given(st.sampled_from(sorted(CATALOGUE)), st.sampled_from(sorted(OPERATORS)), numbers, st.tuples(*[spaces] * 4))
def test_every_condition_is_read_as_it_is_written(name, sign, limit, gaps):
    before, after_name, after_sign, after = gaps
    found = parse_condition(f"{before}{name}{after_name}{sign}{after_sign}{limit!r}{after}")
    assert found == Condition(name, sign, limit)


@pytest.mark.parametrize(
    "text",
    [
        *("", "eta_m", "eta_m > ", "> 0.3", "0.3 < eta_m", "eta_m > sigma_m", "eta_m = 1", "eta_m > nan", "eta_m > ١"),
        *("eta_m > 0.3 or fallen == 1", "eta_m > 1e999", "eta_m > 0x10", "eta_m > " + "9" * 300),
    ],
)
def test_what_is_no_condition(text):
    with pytest.raises(UnknownMetric, match=r"write NAME OPERATOR NUMBER, as in 'eta_m>0\.3'; operators: >= <="):
        parse_condition(text)
