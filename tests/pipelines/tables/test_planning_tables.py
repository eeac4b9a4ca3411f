"""The three tables that walk: planning-1, planning-2 and following-2, each made once from very few walks."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from quadlog.pipelines.tables.following import table_2 as following_2
from quadlog.pipelines.tables.planning import table_1 as planning_1
from quadlog.pipelines.tables.planning import table_2 as planning_2
from quadlog.pipelines.tables.planning.planner_walks import CELL_RATIO, LENGTH_M, TIME_S
from quadlog.results.papers.page import section_text

FEW = {planning_1: ("FAST_WALKS", 2), planning_2: ("FAST_EPISODES", 2), following_2: ("FAST_WALKS", 1)}


@pytest.fixture(scope="session")
def tables():
    with pytest.MonkeyPatch.context() as patch:
        for module, (name, count) in FEW.items():
            patch.setattr(module, name, count)
        return {module: module.make_table(True, 0) for module in FEW}


@pytest.fixture(params=list(FEW), ids=lambda module: module.__name__.rsplit(".", 1)[-1])
def table(request, tables):
    return tables[request.param]


def test_it_says_what_was_run(table):
    assert table.fast
    assert table.command == f"quadlog tables {table.name} --fast"
    assert "seed 0" in table.sizes
    for group in table.groups:
        assert "ntervals" in group.text or "nterval is" in group.text, group.title


def test_what_fails_says_why_or_by_how_much(table):
    failed = [row for row in table.rows if row.reproduces is False]
    assert all(row.note or row.low is not None for row in failed)
    assert all(row.paper is not None for row in table.rows if row.reproduces is not None)
    assert "nan" not in section_text(table)


def test_pictures_are_pictures_and_say_what_they_show(table):
    assert table.pictures
    for picture in table.pictures:
        with Image.open(io.BytesIO(picture.png)) as image:
            assert image.width == 1200
            assert len(image.convert("RGB").getcolors(maxcolors=1 << 24)) > 50
        assert picture.alt
        assert picture.caption


def test_two_runs_are_the_same_to_the_last_byte(tables, monkeypatch):
    monkeypatch.setattr(planning_2, "FAST_EPISODES", 2)
    assert planning_2.make_table(True, 0) == tables[planning_2]


def test_table_2_stands_beside_ours(tables):
    printed = {row.quantity: row.paper for row in tables[planning_2].rows}
    for preset in ("paper", "honest"):
        for name, expected in (("smallest", 5.5494), ("median", 7.1428), ("largest", 11.5768)):
            quantity = f"{preset}, 0.1 trees/m²: {name} ratio A*/IA* of nine runs (1)"
            assert printed[quantity] == pytest.approx(expected, abs=1e-4)
        assert printed[f"{preset}, 0.2 trees/m²: share of nine runs with a ratio above 5 (1)"] == 1
    assert printed["paper, 0.1 trees/m²: cells of A* a run, mean of nine (1)"] == pytest.approx(337176 / 9)
    assert printed["honest, 0.1 trees/m²: cells of A* a run, mean of nine (1)"] is None
    assert np.median(CELL_RATIO) == pytest.approx(41864 / 5861)


def test_optimal_planners_have_no_excess_cost(tables):
    ours = {row.quantity: row.ours for row in tables[planning_2].rows}
    for planner in ("astar", "mt_d_star_lite"):
        assert ours[f"honest, 0.2 trees/m²: mean excess cost of a plan, {planner} (1)"] == 0
    assert ours["honest, 0.2 trees/m²: mean excess cost of a plan, ia_star (1)"] > 0


def test_the_erratum_on_rounding_is_arithmetic(tables):
    erratum = tables[planning_2].errata[-1]
    for words in (
        "5.87, not 5.86, in run 4",
        "7.36, not 7.35, in run 5",
        "11.58, not 11.57, in run 6",
        "5.55, not 5.5,",
    ):
        assert words in erratum


def test_table_1_stands_beside_ours(tables):
    rows = {row.quantity: row for row in tables[planning_1].rows}
    for preset in ("paper", "honest"):
        where = f"{preset}, 0.1 trees/m²"
        assert rows[f"{where}: length, mean of ten, A* (m)"].paper == pytest.approx(20.386)
        assert rows[f"{where}: length, mean of ten, A* (m)"].reproduces is None
        ratio = rows[f"{where}: length of IA* over that of A*, mean of ten (1)"]
        assert ratio.paper == pytest.approx(float(np.mean(LENGTH_M[1] / LENGTH_M[0])))
        assert rows[f"{where}: length: share of ten walks in which IA* is shorter (1)"].paper == 0.8
        slower = rows[f"{where}: time of IA* over that of A*, mean of ten (1)"]
        assert slower.paper == pytest.approx(float(np.mean(TIME_S[1] / TIME_S[0])))
        # At an even speed a way takes its length, so that both ratios are nearly one.
        assert slower.ours == pytest.approx(ratio.ours, abs=0.01)
        assert rows[f"{where}, cell by cell without smoothing: length of IA* over that of A*, mean (1)"].ours >= 0.99


def test_the_claim_of_following_is_judged_on_a_star_over_ia_star_alone(tables):
    judged = [row for row in tables[following_2].rows if row.paper is not None]
    assert len(judged) == 8
    for row in judged:
        assert row.paper == 5
        assert row.quantity.endswith("/ia_star (1)")
        assert row.reproduces is (max(row.ours, row.high or 0) > 5)
        assert row.note.startswith("Claimed: more than 5.")
