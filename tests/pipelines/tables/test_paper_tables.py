from __future__ import annotations

import importlib
import sys
from types import ModuleType

import pytest

from quadlog.errors import AlreadyExists, UnknownName
from quadlog.pipelines.tables import make_tables as measuring
from quadlog.pipelines.tables import make_tables as paper_tables
from quadlog.pipelines.tables.make_tables import make_tables
from quadlog.pipelines.tables.registry import TABLES
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup

CONTRACT = (
    *("following-uwb", "following-lidar", "following-2", "planning-1", "planning-2", "planning-ea"),
    *("tracking-courses", "tracking-5", "foot-torque", "foot-drift", "uwb-real"),
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
    monkeypatch.setattr(paper_tables, "code_digest", lambda: "this code")
    monkeypatch.setattr(measuring, "cores", lambda: 1)
    return made


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_without_a_name_all_are_made(made, tmp_path):
    tables = make_tables([], tmp_path / "out", fast=True, seed=3)
    assert made == [("a", True, 3), ("b", True, 3), ("c", True, 3)]
    assert [table.name for table in tables] == ["a", "b", "c"]
    assert set(contents(tmp_path / "out")) == {
        "report.html", *(f"{name}.{suffix}" for name in "abc" for suffix in ("csv", "tex", "json")),
    }  # fmt: skip


def test_named_tables_are_made_once_in_the_order_of_the_papers(made, tmp_path):
    make_tables(["c", "a", "c"], tmp_path)
    assert made == [("a", False, 0), ("c", False, 0)]


def test_what_is_there_is_not_made_again_and_nothing_changes(made, tmp_path):
    first = make_tables([], tmp_path)
    before = contents(tmp_path)
    assert make_tables([], tmp_path) == make_tables([], tmp_path, force=True) == first
    assert len(made) == 3
    assert contents(tmp_path) == before


@pytest.mark.parametrize("change", ["seed", "fast", "code"])
def test_with_another_seed_size_or_code_it_is_made_again(made, tmp_path, monkeypatch, change):
    make_tables(["a"], tmp_path)
    if change == "code":
        monkeypatch.setattr(paper_tables, "code_digest", lambda: "other code")
    options = {"seed": {"seed": 1}, "fast": {"fast": True}, "code": {}}[change]
    with pytest.raises(AlreadyExists, match=r"report\.html"):
        make_tables(["a"], tmp_path, **options)
    make_tables(["a"], tmp_path, force=True, **options)
    assert len(made) == 2


@pytest.mark.parametrize("name", ["b.json", "b.csv"])
def test_a_damaged_file_is_made_good_and_only_its_table_measured_if_need_be(made, tmp_path, name):
    make_tables([], tmp_path)
    before = contents(tmp_path)
    (tmp_path / name).write_bytes(before[name][:-3])
    with pytest.raises(AlreadyExists):
        make_tables([], tmp_path)
    make_tables([], tmp_path, force=True)
    assert [each[0] for each in made] == ["a", "b", "c"] + ["b"] * (name == "b.json")
    assert contents(tmp_path) == before


def test_an_interrupted_command_goes_on_where_it_stopped(made, tmp_path, monkeypatch):
    module = sys.modules["quadlog_test_table_b"]
    whole = module.make_table

    def fail(fast: bool, seed: int) -> PaperTable:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "make_table", fail)
    with pytest.raises(KeyboardInterrupt):
        make_tables([], tmp_path)
    assert set(contents(tmp_path)) == {"a.csv", "a.tex", "a.json"}
    monkeypatch.setattr(module, "make_table", whole)
    make_tables([], tmp_path)
    assert [name for name, _, _ in made] == ["a", "b", "c"]
    assert "report.html" in contents(tmp_path)


def test_the_page_keeps_the_tables_of_earlier_commands(made, tmp_path):
    make_tables(["b"], tmp_path)
    with pytest.raises(AlreadyExists, match=r"report\.html"):
        make_tables(["a"], tmp_path)
    make_tables(["a"], tmp_path, force=True)
    text = (tmp_path / "report.html").read_text()
    assert text.index("Title of a") < text.index("Title of b")


def test_the_page_ends_with_the_figures_and_the_errata(made, tmp_path):
    make_tables(["b"], tmp_path)
    text = (tmp_path / "report.html").read_text()
    assert text.rindex("Title of b") < text.rindex("Where the papers") < text.rindex("Errata of the four papers")


def test_what_cannot_be_made_is_refused_before_anything_is_computed(made, tmp_path):
    (tmp_path / "b.csv").write_text("mine")
    with pytest.raises(AlreadyExists, match=r"b\.csv"):
        make_tables([], tmp_path)
    with pytest.raises(UnknownName, match="a, b, c"):
        make_tables(["a", "d"], tmp_path / "new")
    assert made == []
    assert [path.name for path in tmp_path.iterdir()] == ["b.csv"]


def test_every_table_on_the_list_is_one_of_the_contract_and_there():
    assert tuple(TABLES) == CONTRACT
    for module in TABLES.values():
        assert callable(importlib.import_module(module).make_table)
