from __future__ import annotations

import importlib
import sys
from types import ModuleType

import pytest

from quadlog.errors import AlreadyExists, UnknownName
from quadlog.pipelines import paper_tables
from quadlog.pipelines.paper_tables import make_tables
from quadlog.pipelines.tables.registry import TABLES
from quadlog.results.paper_rows import PaperRow, PaperTable, RowGroup

CONTRACT = (
    *("following-uwb", "following-lidar", "following-2", "planning-1", "planning-2", "planning-ea"),
    *("tracking-courses", "tracking-5", "foot-torque", "foot-drift"),
)


@pytest.fixture
def made(monkeypatch):
    """Three tables of one row each; the list holds what was made, in order."""
    made: list[tuple[str, bool, int]] = []

    def register(name: str) -> None:
        def make_table(fast: bool, seed: int) -> PaperTable:
            made.append((name, fast, seed))
            group = RowGroup("Group", "Text.", (PaperRow("a (m)", float(seed)),))
            return PaperTable(name, f"Title of {name}", "Caption.", "Sizes.", seed, fast, (group,))

        module = ModuleType(f"quadlog_test_table_{name}")
        module.make_table = make_table  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, module.__name__, module)

    for name in "abc":
        register(name)
    monkeypatch.setattr(paper_tables, "TABLES", {name: f"quadlog_test_table_{name}" for name in "abc"})
    return made


def test_without_a_name_all_are_made(made, tmp_path):
    tables = make_tables([], tmp_path / "out", fast=True, seed=3)
    assert made == [("a", True, 3), ("b", True, 3), ("c", True, 3)]
    assert [table.name for table in tables] == ["a", "b", "c"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "README.md", *(f"{name}.{suffix}" for name in "abc" for suffix in ("csv", "tex", "md")),
    }  # fmt: skip


def test_named_tables_are_made_once_in_the_order_of_the_papers(made, tmp_path):
    make_tables(["c", "a", "c"], tmp_path)
    assert made == [("a", False, 0), ("c", False, 0)]


def test_the_page_keeps_the_tables_of_earlier_commands(made, tmp_path):
    make_tables(["b"], tmp_path)
    with pytest.raises(AlreadyExists, match=r"README\.md"):
        make_tables(["a"], tmp_path)
    make_tables(["a"], tmp_path, force=True)
    text = (tmp_path / "README.md").read_text()
    assert text.index("Title of a") < text.index("Title of b")


def test_what_cannot_be_made_is_refused_before_anything_is_computed(made, tmp_path):
    (tmp_path / "b.csv").write_text("mine")
    with pytest.raises(AlreadyExists, match=r"b\.csv"):
        make_tables([], tmp_path)
    with pytest.raises(UnknownName, match="a, b, c"):
        make_tables(["a", "d"], tmp_path / "new")
    assert made == []
    assert [path.name for path in tmp_path.iterdir()] == ["b.csv"]


def test_a_table_that_fails_leaves_the_finished_ones_and_no_page(made, tmp_path, monkeypatch):
    def fail(fast: bool, seed: int) -> PaperTable:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["quadlog_test_table_b"], "make_table", fail)
    with pytest.raises(KeyboardInterrupt):
        make_tables([], tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"a.csv", "a.tex", "a.md"}


def test_every_table_on_the_list_is_one_of_the_contract_and_there():
    assert set(TABLES) <= set(CONTRACT)
    assert list(TABLES) == [name for name in CONTRACT if name in TABLES]
    for module in TABLES.values():
        assert callable(importlib.import_module(module).make_table)
