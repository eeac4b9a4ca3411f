"""docs/files.md against what the code writes: tables, columns, types, units, and the keys of run.json."""

from __future__ import annotations

import re
from pathlib import Path

import pyarrow as pa
import pytest

from quadlog.recordings.containers.container import Loss
from quadlog.results.find_runs import OWN_FILES
from quadlog.results.record import RunRecord, StageRecord, TopicRecord
from quadlog.results.studies.papers import COLUMNS
from quadlog.results.studies.planners import PLANNERS, REPLANS, SCENARIOS
from quadlog.results.tables import METRIC_NAMES, TABLES

PAGE = (Path(__file__).parents[2] / "docs" / "files.md").read_text()
SECTIONS = {
    title.strip(): text for title, text in re.findall(r"^##+ (.*?)\n(.*?)(?=^##|\Z)", PAGE, re.DOTALL | re.MULTILINE)
}
KINDS = {pa.int64(): "int", pa.float64(): "float", pa.bool_(): "bool", pa.string(): "text"}
ALIKE = {"resim_plans": "plans", "resim_paths": "paths"}


def columns_told(section: str) -> list[tuple[str, str]]:
    """(name, type) in the order of the page; `a_0` … `a_3` are four."""
    told = []
    for names, kind, _ in re.findall(r"^\| (`.*?) \| (\w+) \| (.+) \|$", section, re.MULTILINE):
        found = re.findall(r"`(\w+)`", names)
        if "…" in names:
            pattern = re.fullmatch(r"(\D+)(\d+)(\w*)", found[0])
            digits, last = len(pattern[2]), int(re.search(r"\d+", found[1])[0])
            found = [f"{pattern[1]}{number:0{digits}d}{pattern[3]}" for number in range(last + 1)]
        told += [(name, kind) for name in found]
    return told


def of_schema(schema: pa.Schema) -> list[tuple[str, str]]:
    return [(field.name, KINDS[field.type]) for field in schema]


@pytest.mark.parametrize("name", TABLES)
def test_the_columns_of_a_run_are_those_told(name):
    # The summary has the metrics beside its own columns; they have a page of their own.
    metrics = [(metric, "float") for metric in METRIC_NAMES] if name == "summary" else []
    told = columns_told(SECTIONS[ALIKE.get(name, name)])
    assert told[:3] + metrics + told[3:] == of_schema(TABLES[name])


@pytest.mark.parametrize(("name", "schema"), {"replans": REPLANS, "planners": PLANNERS, "scenarios": SCENARIOS}.items())
def test_the_columns_of_a_comparison_are_those_told(name, schema):
    assert columns_told(SECTIONS[name]) == of_schema(schema)


@pytest.mark.parametrize("name", ALIKE)
def test_a_table_like_another_says_so(name):
    assert TABLES[name] == TABLES[ALIKE[name]]
    assert SECTIONS[name].strip().startswith(f"As `{ALIKE[name]}`")


def test_every_file_of_a_run_is_listed_and_no_other():
    listed = re.findall(r"^\| (`.*?) \| ", SECTIONS["A run folder"], re.MULTILINE)
    names = {name for cell in listed for name in re.findall(r"`([^`]+)`", cell)}
    assert names - {"plots/*.png"} == OWN_FILES


def test_the_keys_of_run_json_are_those_told():
    listed = re.findall(r"^\| (`.*?) \| (.*) \|$", SECTIONS["run.json"], re.MULTILINE)
    meaning = {name: text for cell, text in listed for name in re.findall(r"`(\w+)`", cell)}
    assert set(meaning) == RunRecord.model_fields.keys()
    for key, kind in (("topics", TopicRecord), ("losses", Loss), ("stages", StageRecord)):
        assert re.findall(r"`(\w+)`", meaning[key]) == list(kind.__annotations__)


def test_the_columns_of_a_papers_table_are_those_told():
    assert f"(`{', '.join(COLUMNS)}`)" in SECTIONS["What the other commands write"]
