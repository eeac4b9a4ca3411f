from __future__ import annotations

import csv
import io
import re
import shlex

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.config.file import load_config
from quadlog.errors import csv_table, printable, set_flag

NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=20)


@given(st.text())
def test_printable_text_has_no_control_characters(text: str) -> None:
    shown = printable(text)
    assert shown.isprintable()
    assert len(shown) == len(text)


@given(st.lists(st.tuples(NAMES, NAMES), min_size=1), st.sampled_from("=+-@\t\r"))
def test_no_cell_of_a_csv_is_a_formula_and_numbers_stay(names: list[tuple[str, str]], first: str) -> None:
    rows = [(first + name, other, -1.5, "-2e-05", None) for name, other in names]
    found = list(csv.reader(io.StringIO(csv_table(rows), newline="")))
    for row, cells in zip(rows, found, strict=True):
        assert all(cell == str(text) or cell == f"'{text}" for text, cell in zip(row[:2], cells, strict=False))
        assert cells[2:] == ["-1.5", "-2e-05", ""]
        assert not any(re.match(r"[=@\t\r]|[+-](?![0-9.e+-]+$)", cell) for cell in cells[:2])


def test_printable_text_stays_and_the_rest_is_seen_to_be_missing() -> None:
    assert printable("/Büro 7") == "/Büro 7"
    assert printable("a\nb\x1b[31m\u202e\ud800") == "a b\ufffd[31m\ufffd\ufffd"
    assert printable(ValueError(3)) == "3"


@pytest.mark.parametrize(
    ("names", "flag"),
    [
        (["/points"], "--set topics.uwb=/points"),
        (["/a", "/b"], '--set \'topics.uwb=["/a", "/b"]\''),
        (["/a b"], "--set 'topics.uwb=/a b'"),
        (["/it's"], "--set 'topics.uwb=/it'\"'\"'s'"),
        (["true"], "--set 'topics.uwb=\"true\"'"),
    ],
)
def test_flags(names: list[str], flag: str) -> None:
    assert set_flag("topics.uwb", names) == flag


@given(st.lists(NAMES, min_size=1, max_size=3))
def test_a_flag_pasted_into_a_shell_names_the_very_same_topics(names: list[str]) -> None:
    flag = set_flag("topics.uwb", names)
    assert flag.isprintable()
    option, override = shlex.split(flag)
    assert option == "--set"
    assert load_config(None, [override]).topics.uwb == names
