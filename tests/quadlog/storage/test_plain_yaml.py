from __future__ import annotations

import contextlib
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from quadlog.storage.plain_yaml import NotPlainYaml, parse_yaml

texts = st.text(st.characters(exclude_categories=["Cs", "Cc", "Zl", "Zp"]), max_size=8)
values = st.recursive(st.none() | texts, lambda each: st.lists(each) | st.dictionaries(texts, each), max_leaves=12)


@given(values, st.booleans())
def test_round_trip_of_plain_values(value: Any, flow: bool) -> None:
    assert parse_yaml(yaml.safe_dump(value, default_flow_style=flow, allow_unicode=True).encode()) == value


@given(st.binary(max_size=60) | texts.map(str.encode) | st.text("-:,[]{}&*!<a#?|>'\"% \n").map(str.encode))
def test_any_bytes_parse_or_raise_not_plain_yaml(content: bytes) -> None:
    with contextlib.suppress(NotPlainYaml):
        parse_yaml(content)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("a: &b c", "line 1: has an alias or anchor"),
        ("a: 1\nb: *a", "line 2: has an alias or anchor"),
        ("!!set {}", "line 1: has the tag"),
        ("[a]: 1", "line 1: is no YAML: found unhashable key"),
        ("a\n--- b", "line 2: is no YAML: but found another document"),
        ("[" * 30, "line 1: is nested deeper than 20"),
        ("- a\n" * 250_000, "has more than 200000 parts"),
    ],
)
def test_refused_yaml_names_line_and_reason(content: str, reason: str) -> None:
    with pytest.raises(NotPlainYaml, match=reason):
        parse_yaml(content.encode())
