from __future__ import annotations

import io

import pytest
from PIL import Image

from quadlog.pipelines.tables.planning import ea_star as planning_ea
from quadlog.results.papers.page import section_text


@pytest.fixture(scope="module")
def table():
    """The table from few crossings, so that it takes no time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning_ea, "FAST_CROSSINGS", 20)
        return planning_ea.make_table(True, 0)


@pytest.fixture(scope="module")
def ours(table):
    return {row.quantity: row.ours for row in table.rows}


def test_two_runs_are_the_same_to_the_last_byte(table, monkeypatch):
    monkeypatch.setattr(planning_ea, "FAST_CROSSINGS", 20)
    again = planning_ea.make_table(True, 0)
    assert again == table
    assert section_text(again) == section_text(table)
    assert planning_ea.make_table(True, 1) != table


def test_charges_that_add_up_keep_off_every_ring_in_every_scene(ours):
    for scene in ("square of 1.6 m", "passage of 1.5 m", "complex scene"):
        for preset in ("paper", "honest"):
            clear = [ours[f"{preset}, {scene}: clearance, clearance_astar, n = {n} (cells)"] for n in (1, 2, 3)]
            assert clear == [2, 3, 4]
            # A way that keeps farther off is never shorter.
            lengths = [ours[f"{preset}, {scene}: length, clearance_astar, n = {n} (m)"] for n in (1, 2, 3)]
            assert lengths == sorted(lengths)


def test_only_the_extension_of_fig_19_is_judged(table):
    judged = [row for row in table.rows if row.reproduces is not None]
    assert [row.paper for row in judged] == [2, 3, 4, 2, 3, 4]
    assert all("ea_star" in row.quantity and "square" in row.quantity for row in judged)
    assert [row.reproduces for row in judged] == [row.ours == row.paper for row in judged]


def test_the_printed_charges_are_worth_nothing(ours):
    for n in (1, 2, 3):
        assert ours[f"cheapest way, n = {n}: length (m)"] == ours["astar: length (m)"]
    assert ours["honest, square of 1.6 m: length, ea_star, n = 1 (m)"] > ours["astar: length (m)"]


def test_the_picture_is_one(table):
    (picture,) = table.pictures
    with Image.open(io.BytesIO(picture.png)) as image:
        assert image.width == 1200
        assert len(image.convert("RGB").getcolors(maxcolors=1 << 24)) > 50
    assert picture.alt
    assert "telescope" in " ".join(table.errata)
