from __future__ import annotations

import io
from functools import cache

import pytest
from PIL import Image

from quadlog.pipelines.tables.following import uwb_table as following_uwb
from quadlog.results.papers.page import section_text


@pytest.fixture(scope="module")
def make():
    """The table from few draws, so that it takes no time."""
    with pytest.MonkeyPatch.context() as patch:
        for name, size in (("FAST_FIXES", 300), ("FAST_RUNS", 2), ("FULL_FIXES", 600), ("FULL_RUNS", 3)):
            patch.setattr(following_uwb, name, size)
        yield cache(following_uwb.make_table)


def test_two_runs_are_the_same_to_the_last_byte(make):
    first, second = make(True, 0), following_uwb.make_table(True, 0)
    assert first == second
    assert section_text(first) == section_text(second)


def test_it_says_what_was_run(make):
    fast, full = make(True, 0), make(False, 4)
    assert fast.sizes == "300 fixes per tag and per number of anchors, 2 walks, seed 0."
    assert full.sizes == "600 fixes per tag and per number of anchors, 3 walks, seed 4."
    assert (fast.fast, full.fast) == (True, False)
    assert full.command == "quadlog tables following-uwb --seed 4"


def test_every_number_that_fails_says_why(make):
    table = make(True, 0)
    failed = [row for row in table.rows if row.reproduces is False]
    assert len(failed) >= 5
    assert all(row.note for row in failed)
    assert all(row.paper is not None for row in table.rows if row.reproduces is not None)


def test_every_group_that_draws_says_how_its_intervals_are_made(make):
    for group in make(True, 0).groups:
        if any(row.low is not None for row in group.rows) and not group.title.startswith("Figs 9"):
            assert "ntervals" in group.text, group.title


def test_pictures_are_pictures_and_say_what_they_show(make):
    pictures = make(True, 0).pictures
    assert [picture.name for picture in pictures] == ["site", "efficiency"]
    for picture in pictures:
        with Image.open(io.BytesIO(picture.png)) as image:
            assert image.width == 1200
            assert len(image.convert("RGB").getcolors(maxcolors=1 << 24)) > 50
        assert picture.alt
        assert picture.caption


def test_the_errata_name_what_is_wrong_in_print(make):
    errata = " ".join(make(True, 0).errata)
    for word in ("(0, 2.4)", "(0, 0.8)", "(0.8, 0)", "(2.4, 0)", "3.55", "3.60"):
        assert word in errata
