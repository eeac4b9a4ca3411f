from __future__ import annotations

import io

import pytest
from PIL import Image

from quadlog.pipelines.tables.following import lidar_table as following_lidar
from quadlog.pipelines.tables.following.lidar_scores import METHODS, PLACES, UNCROPPED
from quadlog.results.papers.page import section_text


@pytest.fixture(scope="module")
def table():
    """The table from few scans, so that it takes no time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(following_lidar, "FAST_SCANS", 2)
        return following_lidar.make_table(True, 0)


def test_two_runs_are_the_same_to_the_last_byte(table, monkeypatch):
    monkeypatch.setattr(following_lidar, "FAST_SCANS", 2)
    again = following_lidar.make_table(True, 0)
    assert again == table
    assert section_text(again) == section_text(table)


def test_it_says_what_was_run(table):
    assert table.sizes == (
        "2 scans of each of 9 places, every one with a layout and a pose of its own, seed 0: scans drawn from seed "
        "1000, constants chosen on seed 100."
    )
    assert table.fast
    assert table.command == "quadlog tables following-lidar --fast"
    assert "front half is judged, for both" in table.caption


def test_a_full_run_takes_more_scans_and_its_own_seed(monkeypatch):
    asked = []

    def stop(n_scans, seed):
        asked.append((n_scans, seed))
        raise InterruptedError

    monkeypatch.setattr(following_lidar, "score_all", stop)
    for fast in (True, False):
        with pytest.raises(InterruptedError):
            following_lidar.make_table(fast, 4)
    assert asked == [(following_lidar.FAST_SCANS, 4), (following_lidar.FULL_SCANS, 4)]
    # Four scans see every way in which the robot stands.
    assert following_lidar.FAST_SCANS % 4 == following_lidar.FULL_SCANS % 4 == 0
    assert following_lidar.FAST_SCANS < following_lidar.FULL_SCANS


def test_the_paper_prints_nothing_and_every_row_has_its_interval(table):
    assert len(table.rows) == len(PLACES) * len(METHODS) * 6 + 10
    for row in table.rows:
        assert row.paper is None
        assert row.reproduces is None
        assert row.low is not None
    for group in table.groups:
        assert "ntervals" in group.text, group.title


def test_the_walls_are_lost_by_the_paper_and_kept_by_the_default(table):
    ours = {row.quantity: row.ours for row in table.rows}
    for place in ("2 m corridor", "wall ahead"):
        assert ours[f"{place}: obstacle cells found (1), range_image"] > 0.98
        assert ours[f"{place}: obstacle cells found (1), paper"] < 0.8
        assert ours[f"{place}: ground recall (1), range_image"] > 0.98
        assert ours[f"{place}: ground precision (1), paper"] < 0.6


def test_pictures_are_pictures_and_say_what_they_show(table):
    assert [picture.name for picture in table.pictures] == ["measures", "scans"]
    for picture in table.pictures:
        with Image.open(io.BytesIO(picture.png)) as image:
            assert image.width == 1200
            assert len(image.convert("RGB").getcolors(maxcolors=1 << 24)) > 50
        assert picture.alt
        assert picture.caption


def test_the_erratum_is_what_was_measured(table):
    (erratum,) = table.errata
    ours = {row.quantity: row.ours for row in table.rows}
    ahead, beside = (
        [f"{100 * ours[f'{place}: ground precision (1), {method}']:.0f} %" for method in ("paper", UNCROPPED)]
        for place in ("wall ahead", "2 m corridor")
    )
    assert f"{ahead[0]} are ground with a wall ahead and {beside[0]} in a 2 m corridor" in erratum
    assert f"({ahead[1]} without it), not in the corridor ({beside[1]})" in erratum
