from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import InvalidConfigValue, QuadlogError, TooLarge, UnknownConfigKey, UnreadableConfig
from quadlog.results.compare.expectations import MAX_FILE_BYTES, Bound, parse_expectations, read_expectations
from quadlog.results.run.tables import METRIC_NAMES

NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(10**9), 10**9)
SIDES = st.lists(NUMBERS, min_size=2, max_size=2).map(sorted)
NAMES = st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]), min_size=1, max_size=12)
BOUND = st.builds(
    lambda sides, kept: {key: side for key, side in zip(("min", "max"), sides, strict=True) if key in kept},
    SIDES,
    st.sampled_from([("min",), ("max",), ("min", "max")]),
)
BOUNDS = st.dictionaries(st.sampled_from(METRIC_NAMES), BOUND, max_size=4)


def parse(text: str) -> Any:
    return parse_expectations(text, "bounds.toml", METRIC_NAMES)


@given(BOUNDS, st.dictionaries(NAMES, BOUNDS, max_size=3), NUMBERS)
def test_what_is_written_is_what_is_expected(default: Any, recordings: Any, value: float) -> None:
    expectations = parse(tomli_w.dumps({"default": default, "recordings": recordings}))
    for name in [*recordings, "of no section"]:
        wanted = default | recordings.get(name, {})
        found = {bound.metric: bound for bound in expectations.bounds_for((name,))}
        assert {metric: bound.sides() for metric, bound in found.items()} == wanted
        for metric, sides in wanted.items():
            within = sides.get("min", -math.inf) <= value <= sides.get("max", math.inf)
            assert found[metric].holds(value) is within


PIECES = [
    *("[default]", "[recordings.x]", '[recordings."', "[[recordings]]", "recordings", "eta_m", "min", "max", "true"),
    *(" = ", *"={}[].,#\n\x00", "1.0", "1e999", "nan", "-inf", "2020-13-01", '"text"'),
]


@given(st.lists(st.sampled_from(PIECES) | st.text(max_size=3), max_size=25).map("".join))
def test_any_text_gives_bounds_or_one_of_our_errors(text: str) -> None:
    try:
        expectations = parse(text)
    except QuadlogError:
        return
    for bound in expectations.bounds_for(("x",)):
        assert bound.metric in METRIC_NAMES
        assert all(math.isfinite(side) for side in bound.sides().values())


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("default = 3", "default: is a table"),
        ("[recordings]\nfollow = 3", "recordings.follow: is a table"),
        ("[[recordings]]", "recordings: is a table"),
        ("[default]\neta_m = 0.1", "default.eta_m: is a table, as in { min = 0.0, max = 1.0 }"),
        ("[default]\neta_m = {}", "default.eta_m: needs min, max or both"),
        ("[default]\neta_m = { max = true }", "default.eta_m.max: is a number"),
        ('[default]\neta_m = { max = "0.1" }', "default.eta_m.max: is a number"),
        ("[default]\neta_m = { max = 2020-01-01 }", "default.eta_m.max: is a number"),
        ("[default]\neta_m = { max = nan }", "default.eta_m.max: is a finite number"),
        ("[default]\neta_m = { min = -inf }", "default.eta_m.min: is a finite number"),
        (f"[default]\neta_m = {{ max = 1{'0' * 400} }}", "default.eta_m.max: is a finite number"),
        ("[recordings.follow]\neta_m = { min = 2, max = 1 }", "recordings.follow.eta_m: min 2 lies above max 1"),
    ],
)
def test_a_wrong_value_is_named_by_its_key(text: str, key: str) -> None:
    with pytest.raises(InvalidConfigValue) as raised:
        parse(text)
    assert str(raised.value) == f"bounds.toml: {key}"


@pytest.mark.parametrize(
    ("text", "key", "nearest"),
    [
        ("[recording.follow]", "recording", "recordings"),
        ("[default]\neta = { max = 1 }", "default.eta", "eta_m"),
        ("[recordings.a]\nsucces_rate = { min = 1 }", "recordings.a.succes_rate", "success_rate"),
        ("[default]\neta_m = { maximum = 1 }", "default.eta_m.maximum", "max"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest(text: str, key: str, nearest: str) -> None:
    with pytest.raises(UnknownConfigKey) as raised:
        parse(text)
    assert str(raised.value) == f"bounds.toml: unknown key {key}; did you mean {nearest}?"


def test_a_later_name_goes_before_an_earlier_one_and_an_empty_table_before_the_default() -> None:
    text = """
        [default]
        eta_m = { max = 1 }
        sigma_m = { max = 1 }
        [recordings.line-fpmw]
        eta_m = { min = 2 }
        sigma_m = {}
        [recordings."line-fpmw/seed-000"]
        eta_m = { max = 3 }
    """
    expectations = parse(text)
    assert expectations.bounds_for(("line-fpmw", "line-fpmw/seed-000")) == (Bound("eta_m", most=3),)
    assert expectations.bounds_for(("line-fpmw", "line-fpmw/seed-001")) == (Bound("eta_m", least=2),)
    assert expectations.bounds_for(("follow",)) == (Bound("eta_m", most=1), Bound("sigma_m", most=1))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "bounds.toml"
    for content, match in (
        (None, "No such file"),
        (b"# \xff", "not TOML"),
        (b"x = " + b"[" * 5000, "not TOML"),
        (b"x = " + b"1" * 5000, "not TOML"),
    ):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(UnreadableConfig, match=match):
            read_expectations(path, METRIC_NAMES)
    with pytest.raises(UnreadableConfig, match="Is a directory"):
        read_expectations(tmp_path, METRIC_NAMES)
    os.truncate(path, MAX_FILE_BYTES + 1)
    with pytest.raises(TooLarge):
        read_expectations(path, METRIC_NAMES)
