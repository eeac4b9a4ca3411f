"""The tables of the papers: a claim counts once for all settings; their page and files say what is measured."""

from __future__ import annotations

import html
import io
import json
import re
from pathlib import Path

import pytest
from PIL import Image

from quadlog.results.page.blocks import render
from quadlog.results.studies.papers import (
    PaperRow,
    PaperTable,
    RowGroup,
    Verdict,
    papers_page,
    prepare_folder,
    write_table,
)

YES, NO, OPEN, OTHER = Verdict.YES, Verdict.NO, Verdict.UNDECIDED, Verdict.NOT_COMPARABLE
HOSTILE = "</td><script>alert(1)</script>"
ROWS = (
    PaperRow("e", 7.0),
    PaperRow("a (m)", 1.23456789, 1.2, 1.0, 1.5, YES),
    PaperRow(f"b {HOSTILE}", -0.25, 0.75, -0.5, 0.0, NO, HOSTILE),
    PaperRow("c", 3.0, 3.0, 2.0, 4.0, OPEN),
    PaperRow("d", 3.0, 3.0, reproduces=OTHER),
    PaperRow("f (1)", 14.49, 5.0, 12.0, 16.0, YES, claim="> 5", of="a (m)"),
)


def table(name: str = "one", rows: tuple[PaperRow, ...] = ROWS, fast: bool = False, seed: int = 0) -> PaperTable:
    groups = (RowGroup("Judged", "Text.", rows), RowGroup("Unprinted", "", (PaperRow("g", 1.0),)))
    return PaperTable(name, f"Title of {name}", "The `cap`.", "Sizes.", seed, fast, groups)


@pytest.fixture(scope="module")
def page() -> str:
    return render(papers_page([table(), table("two", ROWS[1:2], fast=True)])).decode()


def rows_of(page: str, name: str) -> list[list[str]]:
    found = re.search(rf'<table id="{name}">.*?<tbody>(.*?)</tbody>', page, re.DOTALL)
    assert found is not None
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", found[1], re.DOTALL)
    return [[html.unescape(cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)] for row in rows]


def test_verdicts_are_counted_worst_first_and_what_the_paper_prints_comes_before_the_rest(page: str) -> None:
    rows = rows_of(page, "one-0")
    assert rows[0] == ["a (m)", "1.2", "1.235", "1 to 1.5", "yes", ""]
    assert rows[1] == [f"b {HOSTILE}", "0.75", "−0.25", "−0.5 to 0", "no", HOSTILE]
    assert [row[4] for row in rows] == ["yes", "no", "undecided", "not comparable", "yes", ""]
    assert [row[:3] for row in rows[4:]] == [["f (1)", "> 5", "14.49"], ["e", "", "7"]]
    assert page.count('<tr class="folded">') == 3  # of what the paper does not print, one in each table
    top = page[: page.index('id="one"')]
    found = re.findall(r'<div class="(\w*)"><dt>([\w ]+)</dt><dd>(\d+) of 5 claims', top)
    looks = [("bad", "Do not"), ("warn", "Undecided"), ("good", "Reproduce"), ("", "Not comparable")]
    assert found == [(*look, number) for look, number in zip(looks, "1121", strict=True)]
    assert page.count("with wider intervals") == 1
    assert "<script>alert" not in page


@pytest.mark.parametrize(
    ("settings", "claim"),
    [([YES], YES), ([YES, YES, OPEN, OTHER], YES), ([NO, OPEN], NO), ([YES, NO], OPEN), ([OPEN, OTHER], OPEN),
     ([OTHER, OTHER], OTHER)],
)  # fmt: skip
def test_a_claim_counts_once_whatever_the_number_of_settings(settings: list[Verdict], claim: Verdict) -> None:
    rows = [PaperRow(f"in setting {k}", 1.0, 2.0, reproduces=each, of="it") for k, each in enumerate(settings)]
    assert table(rows=(*rows, PaperRow("another", 1.0, 2.0, reproduces=NO))).claims == {"it": claim, "another": NO}


def test_a_table_is_its_files_the_same_each_time_and_a_picture_has_what_can_be_compared(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    both = []
    for _ in range(2):
        prepare_folder(folder, ["one"], force=True)
        write_table(folder, table(seed=7), [{"seed": 3, "m": 0.1 + 0.2}])
        both.append({path.name: path.read_bytes() for path in folder.iterdir()})
    written = both[0]
    assert both == [written, written]
    assert sorted(written) == ["one.csv", "one.json", "one.png", "one.tex"]
    saved = json.loads(written["one.json"])
    assert (saved["table"]["seed"], saved["walks"]) == (7, [{"seed": 3, "m": 0.1 + 0.2}])
    write_table(folder, table("few", ROWS[:2]), [])
    heights = [Image.open(io.BytesIO((folder / f"{name}.png").read_bytes())).height for name in ("few", "one")]
    assert heights[0] < heights[1]
    write_table(folder, table("none", (ROWS[0], ROWS[4])), [])
    assert not (folder / "none.png").exists()
