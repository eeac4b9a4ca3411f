from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import BadCondition, ExitCode, UnknownMetric, UsageError
from quadlog.metrics.catalogue import CATALOGUE, OPERATORS, Condition, parse_condition

numbers = st.floats(allow_nan=False, allow_infinity=False)
spaces = st.text(" \t", max_size=3)
names = st.sampled_from(sorted(CATALOGUE))


@given(names, st.sampled_from(sorted(OPERATORS)), numbers, st.tuples(spaces, spaces, spaces, spaces))
def test_every_condition_is_read_as_it_is_written(name, sign, limit, gaps):
    before, after_name, after_sign, after = gaps
    found = parse_condition(f"{before}{name}{after_name}{sign}{after_sign}{limit!r}{after}")
    assert found == Condition(name, sign, limit)


@given(st.text(st.sampled_from("eta_m<>=!0123456789.eE+- ()x\n\x00"), max_size=30) | st.text(max_size=300))
def test_any_other_text_is_one_line_of_usage(text):
    try:
        found = parse_condition(text)
    except UsageError as error:
        refused = error
    else:
        name, limit = text.split(found.operator, 1)
        assert (name.strip(), float(limit)) == (found.name, found.limit)
        return
    assert refused.exit_code is ExitCode.USAGE
    assert len(str(refused)) < 1500


@pytest.mark.parametrize(
    "text",
    [
        *("", "eta_m", "eta_m > ", "> 0.3", "0.3 < eta_m", "eta_m > sigma_m", "eta_m = 1", "eta_m > nan", "eta_m > ١"),
        *("eta_m > 0.3 or fallen == 1", "eta_m > 1e999", "eta_m > 0x10", "eta_m > " + "9" * 300),
    ],
)
def test_what_is_no_condition(text):
    with pytest.raises(BadCondition, match=r"write NAME OPERATOR NUMBER, as in 'eta_m>0\.3'; operators: >= <="):
        parse_condition(text)


@pytest.mark.parametrize(
    ("typo", "meant"), [("eta", "eta_m"), ("ETA_M", "eta_m"), ("collision", "collisions"), ("ate_rmse", "ate_rmse_m")]
)
def test_the_nearest_name_is_suggested(typo, meant):
    with pytest.raises(UnknownMetric, match=f"unknown metric '{typo}'; did you mean {meant}\\?"):
        parse_condition(f"{typo}>1")
