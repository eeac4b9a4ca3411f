from __future__ import annotations

import csv

import pytest

from quadlog.cli.main import run
from quadlog.cli.tables import print_table
from quadlog.pipelines.tables import make_tables as paper_tables
from quadlog.pipelines.tables.following import uwb_table as following_uwb
from quadlog.pipelines.tables.registry import TABLES
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup


@pytest.fixture(scope="module", autouse=True)
def _few_draws():
    """The command as it is, only with fewer draws, and whoever edits quadlog meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper_tables, "code_digest", lambda: "this code")
        patch.setattr(following_uwb, "FAST_FIXES", 1000)
        patch.setattr(following_uwb, "FAST_RUNS", 3)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables") / "out"
    assert run(["tables", "following-uwb", "-o", str(folder), "--fast"]) == 0
    return folder


def test_everything_the_contract_names_is_written(made):
    names = {path.name for path in made.iterdir()}
    assert {"README.md", "following-uwb.csv", "following-uwb.json", "following-uwb.tex"} <= names
    assert {name for name in names if name.endswith(".png")} == {
        "following-uwb-site.png",
        "following-uwb-efficiency.png",
    }
    assert not any(name.startswith(".") for name in names)


def test_the_csv_file_holds_what_the_contract_says(made):
    with (made / "following-uwb.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["quantity", "paper", "ours", "low", "high", "difference", "reproduces", "note"]
    for row in rows:
        ours = float(row["ours"])
        assert row["reproduces"] in {"yes", "no", "undecided", "not comparable", ""}
        assert (row["low"] == "") == (row["high"] == "")
        if row["low"]:
            assert float(row["low"]) <= ours <= float(row["high"])
        if row["paper"]:
            assert float(row["difference"]) == pytest.approx(ours - float(row["paper"]), abs=2e-5)
        else:
            assert row["difference"] == row["reproduces"] == ""
    assert sum(row["reproduces"] == "no" for row in rows) >= 5


def test_the_page_shows_the_pictures_that_are_there_and_says_that_it_is_fast(made):
    page = (made / "README.md").read_text(encoding="utf-8")
    assert "`quadlog tables following-uwb --fast`" in page
    assert "**A fast run" in page
    for picture in made.glob("*.png"):
        assert f"]({picture.name})" in page
    assert "### Errata" in page


def test_a_second_run_writes_the_same_bytes(made, tmp_path):
    assert run(["tables", "following-uwb", "-o", str(tmp_path / "again"), "--fast"]) == 0
    for path in made.iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes(), path.name


def test_stdout_has_the_printed_numbers_and_stderr_the_progress(tmp_path, capsys):
    assert run(["tables", "following-uwb", "-o", str(tmp_path), "--fast", "--seed", "2"]) == 0
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert lines[0].startswith("following-uwb: ")
    assert "(fast run)" in lines[0]
    assert any("station 3" in line and line.endswith("no") for line in lines)
    assert "printed numbers reproduce" in lines[-2]
    assert lines[-1].startswith(str(tmp_path / "README.md"))
    assert captured.err == "following-uwb: fast run, seed 2\n"


def test_where_the_paper_prints_nothing_all_of_ours_is_printed(capsys):
    rows = (PaperRow("cells (1)", 0.25, None, 0.125, 0.5), PaperRow("scans (1)", 3.0))
    print_table(PaperTable("t", "Title", "Caption.", "Sizes.", 0, False, (RowGroup("Group", "Text.", rows),)))
    head, columns, first, second, last = capsys.readouterr().out.splitlines()
    assert head == "t: Title"
    assert columns.split()[0] == "quantity"
    assert first.split("  ")[1] == "cells (1)"
    assert "0.125 to 0.5" in first
    assert second.split()[-1] == "3"
    assert last == "the paper prints none; 2 quantities in all"


def test_what_was_measured_before_is_printed_again_and_not_measured(made, capsys, monkeypatch):
    assert run(["tables", "following-uwb", "-o", str(made), "--fast", "--force"]) == 0
    first = capsys.readouterr()
    before = {path.name: path.read_bytes() for path in made.iterdir()}
    monkeypatch.setattr(following_uwb, "make_table", None)
    assert run(["tables", "following-uwb", "-o", str(made), "--fast"]) == 0
    second = capsys.readouterr()
    assert second.out == first.out
    assert second.err == "measured before, and nothing has changed since: following-uwb\n"
    assert {path.name: path.read_bytes() for path in made.iterdir()} == before


def test_nothing_is_overwritten_without_force(made, capsys):
    before = {path.name: path.read_bytes() for path in made.iterdir()}
    assert run(["tables", "following-uwb", "-o", str(made), "--fast", "--seed", "5"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "--force" in error
    assert {path.name: path.read_bytes() for path in made.iterdir()} == before


def test_an_unknown_table_is_wrong_usage_and_the_known_ones_are_listed(tmp_path, capsys):
    assert run(["tables", "following-uvb", "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "following-uvb" in error
    assert all(name in error for name in TABLES)
    assert not (tmp_path / "out").exists()


def test_help_names_every_table(capsys):
    assert run(["tables", "--help"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in TABLES)
