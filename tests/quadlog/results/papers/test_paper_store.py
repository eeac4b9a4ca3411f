from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.papers.table import PaperRow, Verdict, json_bytes, load_saved, picture_file


def write(folder, each):
    for picture in each.table.pictures:
        (folder / picture_file(each.table, picture)).write_bytes(picture.png)
    (folder / "one.json").write_bytes(json_bytes(each))


def test_a_table_comes_back_as_it_was(tmp_path, saved):
    write(tmp_path, saved())
    assert load_saved(tmp_path, "one") == saved()


numbers = st.floats(allow_nan=False, allow_infinity=False)
rows = st.builds(
    PaperRow, st.text(), numbers, st.none() | numbers, reproduces=st.none() | st.sampled_from(Verdict), note=st.text()
)


@given(st.lists(rows, max_size=4, unique_by=lambda row: row.quantity))
def test_any_rows_come_back(tmp_path_factory, saved, some):
    folder = tmp_path_factory.mktemp("saved")
    write(folder, saved(rows=some))
    back = load_saved(folder, "one")
    assert back == saved(rows=some)
    assert json_bytes(back) == json_bytes(saved(rows=some))


def test_what_is_not_there_is_no_table(tmp_path):
    assert load_saved(tmp_path, "one") is None
    assert load_saved(tmp_path / "no folder", "one") is None
    (tmp_path / "one.json").mkdir()
    assert load_saved(tmp_path, "one") is None


@given(data=st.data())
def test_no_damaged_file_is_trusted(tmp_path_factory, saved, data):
    folder = tmp_path_factory.mktemp("saved")
    write(folder, saved())
    good = (folder / "one.json").read_bytes()
    at = data.draw(st.integers(0, len(good) - 1))
    bad = data.draw(
        st.sampled_from([good[:at], good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :], good[:at] + b"7" + good[at:]])
    )
    (folder / "one.json").write_bytes(bad)
    back = load_saved(folder, "one")
    # White space about the values may differ, and what it means does not.
    assert back is None or back == saved()


@pytest.mark.parametrize("text", [b"", b"{}", b"[]", b"null", b"[" * 100_000, b"\xff", b'{"sha256": 1}', b"1e999"])
def test_what_is_another_file_is_no_table(tmp_path, text):
    (tmp_path / "one.json").write_bytes(text)
    assert load_saved(tmp_path, "one") is None


def test_a_file_of_another_table_is_not_taken_for_it(tmp_path, saved):
    write(tmp_path, saved())
    (tmp_path / "one.json").rename(tmp_path / "two.json")
    assert load_saved(tmp_path, "two") is None


@pytest.mark.parametrize("damage", ["missing", "other"])
def test_a_table_without_its_pictures_is_not_whole(tmp_path, saved, damage):
    write(tmp_path, saved())
    picture = tmp_path / "one-site.png"
    picture.unlink() if damage == "missing" else picture.write_bytes(b"\x89PNF")
    assert load_saved(tmp_path, "one") is None


def test_a_file_too_large_is_not_read(tmp_path, saved, monkeypatch):
    write(tmp_path, saved())
    monkeypatch.setattr("quadlog.results.papers.table.LARGEST_BYTES", 100)
    assert load_saved(tmp_path, "one") is None


def test_the_difference_is_ours_less_the_papers():
    assert PaperRow("a (m)", 1.5, 2.0).difference == -0.5
    assert PaperRow("a (m)", 1.5).difference is None


@pytest.mark.parametrize(
    "numbers",
    [{"ours": float("nan")}, {"ours": 1.0, "paper": float("inf")}, {"ours": 1.0, "low": 0.5}],
)
def test_what_is_no_number_never_becomes_a_row(numbers):
    with pytest.raises(AssertionError):
        PaperRow("a (m)", **numbers)


def test_a_quantity_is_named_once(saved):
    with pytest.raises(AssertionError, match="quantity"):
        saved(rows=[PaperRow("a", 1.0), PaperRow("a", 2.0)])


def test_what_can_be_compared_is_counted(saved):
    verdicts = [*Verdict, Verdict.YES, None]
    rows = tuple(PaperRow(str(number), 1.0, 2.0, reproduces=verdict) for number, verdict in enumerate(verdicts))
    made = saved(rows=rows).table
    assert [made.count(verdict) for verdict in Verdict] == [2, 1, 1, 1]
    assert made.comparable == 4
    assert made.reproduced == "2 of 4 printed numbers reproduce, 1 undecided, 1 not comparable"
    assert saved(rows=rows[:2]).table.reproduced == "1 of 2 printed numbers reproduce"
    assert saved(rows=rows[5:]).table.reproduced == "the paper prints none"


def test_a_verdict_is_one_of_four():
    with pytest.raises(AssertionError):
        PaperRow("a (m)", 1.0, 1.0, reproduces=True)


def test_the_command_says_what_differs_from_the_defaults(saved):
    assert saved().table.command == "quadlog tables one"
    assert saved(fast=True, seed=7).table.command == "quadlog tables one --fast --seed 7"
