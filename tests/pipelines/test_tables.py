"""The papers' tables: what their walks measure, what their rows claim, and the contract of every table."""

from __future__ import annotations

import importlib
import zlib
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.tables import TABLES
from quadlog.pipelines.tables.claims import Change, Claim, Group, Ratio, Study, StudyTable, grid, order
from quadlog.pipelines.tables.judge import MEAN, beyond, number
from quadlog.pipelines.tables.make_tables import measure_tables
from quadlog.pipelines.tables.planning_1 import path_change_m
from quadlog.results.studies.papers import PaperTable, Verdict, csv_text

ROOT = Path(__file__).parents[2]
SHARES = ("arrived", "touched", "clean", "fallen", "above")
REAL = ("following-uwb", "planning-ea", "foot-torque")
"""Whose walks take no time: the tables as they are."""


def made_up(columns: list[str], point: dict[str, object]) -> dict[str, float]:
    """A figure of each name, with noise of the walk."""
    rng = np.random.default_rng(zlib.crc32(repr(sorted(point.items())).encode()))
    figures = dict(zip(columns, rng.uniform(1.0, 2.0, len(columns)).tolist(), strict=True))
    return {name: float(rng.random() < 0.8) if name in SHARES else figure for name, figure in figures.items()}


@cache
def table(name: str) -> PaperTable:
    fast = name in REAL
    made = importlib.import_module(TABLES[name]).table(fast, 0)
    columns = sorted({row.column for group in made.groups for row in group.rows})
    figures = [made.study.measure(**point) if name in REAL else made_up(columns, point) for point in made.study.points]
    return made.on(pd.DataFrame(made.study.records(figures)), name, fast, 0)


@pytest.mark.parametrize("name", TABLES)
def test_it_keeps_the_contract_of_a_table(name: str):
    made = table(name)
    assert "seed" in made.sizes
    assert made.rows
    assert made.claims
    assert "nan" not in csv_text(made)
    for row in made.rows:
        assert row.reproduces is not None or (row.paper is None and row.claim == ""), row
        assert row.reproduces is None or row.paper is not None or row.claim, row
        assert row.note or row.reproduces is not Verdict.NOT_COMPARABLE, row
        assert row.note or row.low is not None or row.reproduces is not Verdict.NO, row
    for group in made.groups:
        if any(row.low is not None for row in group.rows):
            assert "nterval" in group.text, group.title


def test_claims_are_fewer_than_the_rows_in_which_they_are_measured():
    counts = {name: (sum(row.reproduces is not None for row in table(name).rows), len(table(name).claims))
              for name in TABLES}  # fmt: skip
    assert counts["following-2"] == (12, 1)
    assert counts["planning-2"] == (36, 6)
    assert counts["planning-1"][1] == 13
    assert counts["foot-drift"][1] == 11
    page = (ROOT / "docs" / "references.md").read_text(encoding="utf-8")
    assert f"{sum(claims for _, claims in counts.values())} printed numbers and claims" in page


def verdicts(name: str) -> dict[str, Verdict]:
    return {row.quantity: row.reproduces for row in table(name).rows if row.reproduces is not None}


def test_what_holds_by_construction_is_no_yes():
    assert set(verdicts("planning-ea").values()) == {Verdict.NOT_COMPARABLE}
    torque = verdicts("foot-torque")
    assert {name for name, verdict in torque.items() if verdict is not Verdict.NOT_COMPARABLE} == {
        "tau 1, abduction (N m)",
        "touch-down, about the diagonal: sign of both (1)",
        "swing hip's reaction, first half: sign (1)",
        "way of a stance with the centre of mass behind the diagonal (1)",
    }
    assert Verdict.YES not in torque.values()
    on_sites = {of for name, of in verdicts("following-2").items() if "obstacle" in name}
    assert on_sites == {Verdict.NOT_COMPARABLE}


def test_nothing_is_confirmed_by_noise_of_the_printed_size_and_errata_are_found():
    found = verdicts("following-uwb")
    assert Verdict.YES not in found.values()
    assert {name for name, verdict in found.items() if verdict is Verdict.NO} == {
        *(f"{tag} tag, {axis} (m)" for tag in ("robot", "person") for axis in "xy"),
        "distance of the person tag from station 3 (m)",
    }


WALKS = pd.DataFrame(
    [
        {"who": who, "k": k, "seed": seed, "m": base + 0.1 * seed, "fallen": float(seed == 2)}
        for who, k, base in (("a", None, 2.0), ("b", None, 4.0), ("b", 0.5, 9.0))
        for seed in range(3)
    ]
    + [{"who": "a", "k": None, "seed": 7, "m": 100.0, "fallen": 0.0}, {"who": "b", "k": None, "seed": 8}]
)


def test_a_claim_is_of_the_walks_that_have_the_factors_and_the_figure():
    row = Claim("m of b (m)", "m", {"who": "b", "k": None}, number(4.0, 0.1), why_not="Why.").row(WALKS)
    assert row.ours == pytest.approx(4.1)
    assert (row.paper, row.reproduces, row.note) == (4.0, Verdict.YES, "")
    assert row.low < 4.1 < row.high
    refused = Claim("m", "m", {"who": "b", "k": 0.5}, number(4.0, 0.1), note="Note.", why_not="Why.").row(WALKS)
    assert (refused.reproduces, refused.note) == (Verdict.NO, "Note. Why.")
    two = Claim("m", "m", {"who": "b", "k": None, "fallen": 0.0}, number(4.0, 0.1)).row(WALKS)
    assert (two.paper, two.reproduces, two.note) == (4.0, Verdict.NOT_COMPARABLE, "2 walks decide nothing.")
    assert Claim("m", "m", {"who": "c"}).row(WALKS) is None
    assert Claim("m", "not measured").row(WALKS) is None


def test_ratios_and_changes_are_paired_and_walks_without_a_partner_are_left_out():
    sides = {"part": {"who": "b"}, "whole": {"who": "a"}}
    ratios = Ratio("b / a (1)", "m", {"k": None}, **sides)
    assert ratios.values(WALKS) == pytest.approx([2.0, 4.1 / 2.1, 4.2 / 2.2])
    changes = Change("b less a (m)", "m", {"k": None}, beyond(0.0, why="Claimed."), **sides)
    assert changes.values(WALKS) == pytest.approx([2.0, 2.0, 2.0])
    row = changes.row(WALKS)
    assert (row.low, row.reproduces, row.claim, row.note) == (None, Verdict.UNDECIDED, "> 0", "Claimed.")


def test_an_order_is_no_number():
    row = order("order (1)", "m", {"k": None}, {"who": "b"}, {"who": "a"}, 5.0, "order").row(WALKS)
    assert (row.paper, row.claim, row.reproduces, row.of) == (None, "> 1", Verdict.YES, "order")
    assert "5.000" in row.note
    # Above 1, but by less than a tenth of what is printed.
    weak = order("order (1)", "m", {"k": None}, {"who": "b"}, {"who": "a"}, 20.0, "order").row(WALKS)
    assert weak.reproduces is Verdict.NO


def measure(who: str, seed: int) -> dict[str, float]:
    return {"m": seed + len(who), "nothing": float("nan")}


@pytest.mark.parametrize("executor", [ThreadPoolExecutor(1), ThreadPoolExecutor(2)])
def test_a_study_is_the_same_on_any_executor_and_keeps_its_walks(executor):
    study = Study(measure, grid(who=["a", "bb"], seed=range(3)))
    made = StudyTable("Title", "Caption.", "Sizes.", study, [Group("G", "T", [Claim("m (m)", "m", {"who": "bb"})])])
    ((made, walks),) = measure_tables({"one": made}, True, 5, executor, Silent())
    assert walks[4] == {"who": "bb", "seed": 1, "m": 3.0}
    (row,) = made.rows
    assert (row.ours, made.command) == (3.0, "quadlog tables one --fast --seed 5")
    assert MEAN.interval(pd.DataFrame(walks)["m"][3:].to_numpy()) == (row.low, row.high)


def test_a_path_changes_by_its_distance_from_what_was_left_of_the_one_before():
    before_m = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]])
    assert path_change_m(before_m, np.array([[2.0, 0.0], [4.0, 0.0], [4.0, 9.0]])) == 0
    assert path_change_m(before_m, np.array([[2.0, 0.5], [3.0, 1.0], [4.0, 1.5]])) == 0.75  # the last is beyond 2 m
