from __future__ import annotations

import os
import signal

import pytest

from quadlog.errors import QuadlogError
from quadlog.pipelines.tables import make_tables as measuring
from quadlog.pipelines.tables.make_tables import LONGEST_FIRST, SHARED_OUT, measure_tables
from quadlog.pipelines.tables.registry import TABLES

MODULE = """
import os, signal
from quadlog.errors import QuadlogError
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup

def make_table(fast, seed):
    {first}
    rows = (PaperRow("process", float(os.getpid())), PaperRow("seed", float(seed)))
    return PaperTable("x", "Title", "", "", seed, fast, (RowGroup("Group", "", rows),))
"""


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Writes modules that a fresh process can import, too."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(measuring, "cores", lambda: 2)

    def write(**first: str) -> dict[str, str]:
        for name, statement in first.items():
            (tmp_path / f"quadlog_measured_{name}.py").write_text(MODULE.format(first=statement))
        return {name: f"quadlog_measured_{name}" for name in first}

    return write


def process(table):
    return int(table.rows[0].ours)


def test_tables_are_measured_side_by_side_and_those_that_share_themselves_out_here(modules, monkeypatch):
    monkeypatch.setattr(measuring, "SHARED_OUT", ("b",))
    said = []
    tables = dict(measure_tables(modules(a="pass", b="pass", c="pass"), True, 7, said.append))
    assert set(tables) == {"a", "b", "c"}
    assert all(table.rows[1].ours == table.seed == 7 and table.fast for table in tables.values())
    assert process(tables["b"]) == os.getpid()
    assert os.getpid() not in {process(tables["a"]), process(tables["c"])}
    assert said == ["a, c: fast run, seed 7", "b: fast run, seed 7"]


@pytest.mark.parametrize("names", ["a", "ab"])
def test_one_core_or_one_table_needs_no_other_process(modules, monkeypatch, names):
    monkeypatch.setattr(measuring, "cores", lambda: 1 if len(names) > 1 else 2)
    tables = dict(measure_tables(modules(**dict.fromkeys(names, "pass")), False, 0, lambda _: None))
    assert {process(table) for table in tables.values()} == {os.getpid()}


def test_the_failure_of_one_is_the_failure_of_all(modules):
    given = modules(a='raise QuadlogError("no such ground")', b="pass")
    with pytest.raises(QuadlogError, match="no such ground"):
        list(measure_tables(given, False, 0, lambda _: None))


def test_a_worker_that_is_killed_is_told_in_one_line(modules):
    given = modules(a=f"os.kill(os.getpid(), {int(signal.SIGKILL)})", b="pass")
    with pytest.raises(QuadlogError, match="killed"):
        list(measure_tables(given, False, 0, lambda _: None))


def test_the_lists_name_tables_that_there_are():
    assert set(SHARED_OUT) | set(LONGEST_FIRST) <= set(TABLES)
    assert not set(SHARED_OUT) & set(LONGEST_FIRST)
