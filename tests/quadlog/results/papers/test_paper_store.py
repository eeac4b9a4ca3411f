"""A saved table comes back as it was, or not at all; a claim counts once for all settings."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.papers.table import PaperRow, Verdict, json_bytes, load_saved, reproduced


def test_a_table_comes_back_as_it_was_with_its_walks(tmp_path, saved):
    (tmp_path / "one.json").write_bytes(json_bytes(saved()))
    assert load_saved(tmp_path, "one") == saved()
    assert json.loads((tmp_path / "one.json").read_text())["walks"] == [{"seed": 3, "m": 0.1 + 0.2}]


numbers = st.floats(allow_nan=False, allow_infinity=False)
rows = st.builds(
    PaperRow, st.text(), numbers, st.none() | numbers, reproduces=st.none() | st.sampled_from(Verdict), note=st.text()
)


@given(st.lists(rows, max_size=4, unique_by=lambda row: row.quantity))
def test_any_rows_come_back(tmp_path_factory, saved, some):
    folder = tmp_path_factory.mktemp("saved")
    (folder / "one.json").write_bytes(json_bytes(saved(rows=some)))
    back = load_saved(folder, "one")
    assert back == saved(rows=some)
    assert json_bytes(back) == json_bytes(saved(rows=some))


@pytest.mark.parametrize("text", [b"", b"{}", b"[]", b"null", b"[" * 100_000, b"\xff", b'{"table": 1}', b"1e999"])
def test_what_is_another_file_is_no_table(tmp_path, text):
    assert load_saved(tmp_path / "no folder", "one") is None
    (tmp_path / "one.json").write_bytes(text)
    assert load_saved(tmp_path, "one") is None


def test_a_file_too_large_is_not_read(tmp_path, saved, monkeypatch):
    (tmp_path / "one.json").write_bytes(json_bytes(saved()))
    monkeypatch.setattr("quadlog.results.papers.table.LARGEST_BYTES", 100)
    assert load_saved(tmp_path, "one") is None


@pytest.mark.parametrize(
    "numbers", [{"ours": float("nan")}, {"ours": 1.0, "paper": float("inf")}, {"ours": 1.0, "low": 0.5},
                {"ours": 1.0, "reproduces": True}],
)  # fmt: skip
def test_what_is_no_number_or_verdict_never_becomes_a_row(numbers):
    with pytest.raises(AssertionError):
        PaperRow("a (m)", **numbers)


def test_a_quantity_is_named_once(saved):
    with pytest.raises(AssertionError, match="quantity"):
        saved(rows=[PaperRow("a", 1.0), PaperRow("a", 2.0)])


YES, NO, OPEN, OTHER = Verdict.YES, Verdict.NO, Verdict.UNDECIDED, Verdict.NOT_COMPARABLE


@pytest.mark.parametrize(
    ("settings", "claim"),
    [
        ([YES], YES), ([YES, YES, OPEN, OTHER], YES), ([NO, OPEN], NO), ([YES, NO], OPEN), ([OPEN, OTHER], OPEN),
        ([OTHER, OTHER], OTHER),
    ],
)  # fmt: skip
def test_a_claim_counts_once_whatever_the_number_of_settings(saved, settings, claim):
    rows = [PaperRow(f"in setting {k}", 1.0, 2.0, reproduces=each, of="it") for k, each in enumerate(settings)]
    other = PaperRow("another", 1.0, 2.0, reproduces=NO)
    assert saved(rows=[*rows, other, PaperRow("ours", 1.0)]).table.claims == {"it": claim, "another": NO}


def test_claims_are_counted_in_words(saved):
    assert reproduced([YES, NO, YES, OPEN, OTHER]) == "5 claims: 2 reproduce, 1 do not, 1 undecided, 1 not comparable"
    assert saved(rows=[PaperRow("a", 1.0)]).table.reproduced == "the paper prints none"
    assert saved().table.reproduced == "1 claim: 1 do not"
    assert saved().table.command == "quadlog tables one"
    assert saved(fast=True, seed=7).table.command == "quadlog tables one --fast --seed 7"
