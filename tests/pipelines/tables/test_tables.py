"""Every table on walks that are made up: the contract of its rows, and what is claimed once for all settings."""

from __future__ import annotations

import importlib
import zlib
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from quadlog.pipelines.tables import TABLES
from quadlog.results.studies.papers import PaperTable, Verdict, csv_text

ROOT = Path(__file__).parents[3]
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


def test_nothing_is_confirmed_by_noise_of_the_printed_size_and_errata_are_found():
    found = verdicts("following-uwb")
    assert Verdict.YES not in found.values()
    assert {name for name, verdict in found.items() if verdict is Verdict.NO} == {
        *(f"{tag} tag, {axis} (m)" for tag in ("robot", "person") for axis in "xy"),
        "distance of the person tag from station 3 (m)",
    }


def test_fig_3_by_hand():
    rows = {row.quantity: row.ours for row in table("foot-torque").rows}
    assert rows["tau 1, abduction (N m)"] == pytest.approx(0.07 * 0.5 * 9.81)


def test_tables_that_the_errata_point_to_are_there():
    text = (ROOT / "docs" / "errata.md").read_text(encoding="utf-8")
    words = {word.strip("(),.|") for word in text.split("table ")[1:] for word in word.split()[:1]}
    assert {word for word in words if "-" in word} <= set(TABLES)
