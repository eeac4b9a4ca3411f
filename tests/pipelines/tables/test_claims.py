"""Rows as data on walks that are made up: which walks count, how they are paired, and what a note says."""

from __future__ import annotations

from concurrent.futures import Executor, Future, ThreadPoolExecutor

import pandas as pd
import pytest

from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.tables.claims import (
    SEEDS_PER_TABLE,
    Change,
    Claim,
    Group,
    Ratio,
    Study,
    StudyTable,
    grid,
    held_out_seeds,
    order,
)
from quadlog.pipelines.tables.judge import MEAN, SHARE, beyond, number
from quadlog.pipelines.tables.make_tables import measure_tables
from quadlog.results.studies.papers import Verdict

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
    assert row is not None
    assert row.ours == pytest.approx(4.1)
    assert (row.paper, row.reproduces, row.note) == (4.0, Verdict.YES, "")
    assert row.low is not None
    assert row.high is not None
    assert row.low < 4.1 < row.high
    refused = Claim("m", "m", {"who": "b", "k": 0.5}, number(4.0, 0.1), note="Note.", why_not="Why.").row(WALKS)
    assert refused is not None
    assert (refused.reproduces, refused.note) == (Verdict.NO, "Note. Why.")
    assert Claim("m", "m", {"who": "c"}).row(WALKS) is None
    assert Claim("m", "not measured").row(WALKS) is None


def test_a_share_says_of_how_many():
    row = Claim("falls (1)", "fallen", {"who": "a"}, statistic=SHARE, note="Note.").row(WALKS)
    assert row is not None
    assert row.note == "1 of 4. Note."


def test_ratios_and_changes_are_paired_and_walks_without_a_partner_are_left_out():
    sides = {"part": {"who": "b"}, "whole": {"who": "a"}}
    ratios = Ratio("b / a (1)", "m", {"k": None}, **sides)
    assert ratios.values(WALKS) == pytest.approx([2.0, 4.1 / 2.1, 4.2 / 2.2])
    changes = Change("b less a (m)", "m", {"k": None}, beyond(0.0, why="Claimed."), **sides)
    assert changes.values(WALKS) == pytest.approx([2.0, 2.0, 2.0])
    row = changes.row(WALKS)
    assert row is not None
    assert (row.low, row.reproduces, row.claim, row.note) == (None, Verdict.UNDECIDED, "> 0", "Claimed.")


def test_an_order_is_no_number():
    row = order("order (1)", "m", {"k": None}, {"who": "b"}, {"who": "a"}, 5.0, "order").row(WALKS)
    assert row is not None
    assert (row.paper, row.claim, row.reproduces, row.of) == (None, "> 1", Verdict.YES, "order")
    assert "5.000" in row.note
    # Above 1, but by less than a tenth of what is printed.
    weak = order("order (1)", "m", {"k": None}, {"who": "b"}, {"who": "a"}, 20.0, "order").row(WALKS)
    assert weak is not None
    assert weak.reproduces is Verdict.NO


def walk(who: str, seed: int) -> dict[str, float]:
    return {"m": seed + len(who), "nothing": float("nan")}


class AtOnce(Executor):
    """Runs a task when it is handed in."""

    def submit(self, fn, /, *args, **kwargs):
        future: Future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@pytest.mark.parametrize("executor", [AtOnce(), ThreadPoolExecutor(2)])
def test_a_study_is_the_same_on_any_executor_and_keeps_its_walks(executor):
    study = Study(walk, grid(who=["a", "bb"], seed=range(3)))
    table = StudyTable("Title", "Caption.", "Sizes.", study, [Group("G", "T", [Claim("m (m)", "m", {"who": "bb"})])])
    ((made, walks),) = measure_tables({"one": table}, True, 5, executor, Silent())
    assert walks[4] == {"who": "bb", "seed": 1, "m": 3.0}
    (row,) = made.rows
    assert (row.ours, made.command) == (3.0, "quadlog tables one --fast --seed 5")
    assert MEAN.interval(pd.DataFrame(walks)["m"][3:].to_numpy()) == (row.low, row.high)


def test_what_is_reported_was_never_chosen_on():
    drawn = [each for seed in range(4) for each in held_out_seeds(SEEDS_PER_TABLE, seed)]
    assert len(set(drawn)) == len(drawn)
    assert min(drawn) >= 2000
