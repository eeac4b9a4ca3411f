"""The pages that docs/make.py writes: up to date, and true to the models they are read from."""

from __future__ import annotations

import importlib.util
import math
import re
import tomllib
from functools import reduce
from pathlib import Path
from types import ModuleType

import pytest

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.config.section import Section
from quadlog.errors import InvalidConfigValue
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.tables import METRIC_NAMES

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "configuration.md").read_text()
CELL = " | "


def rows(section: str) -> list[list[str]]:
    """The cells of a section's table, without its header."""
    lines = [line for line in section.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in line[1:-1].split(CELL)] for line in lines]


SECTIONS = {
    re.sub(r"[\[\]]", "", title): rows(text)
    for title, text in re.findall(r"^## `(\[+[\w.]+\]+)`\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)
}
KEYS = [(section, *row) for section, found in SECTIONS.items() for row in found]
BOUNDED = [(each[0], each[1], each[4]) for each in KEYS if re.search(r"[\[(].*, .*[\])]$", each[4])]


@pytest.fixture(scope="module")
def make() -> ModuleType:
    spec = importlib.util.spec_from_file_location("docs_make", DOCS / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["configuration.md", "metrics.md"])
def test_the_committed_page_is_what_make_docs_writes(make, name):
    assert (DOCS / name).read_text() == make.PAGES[name](), "run  make docs"


def test_every_key_has_a_row_and_no_other():
    def dotted(model, prefix):
        for name in type(model).model_fields:
            value = getattr(model, name)
            yield from dotted(value, f"{prefix}{name}.") if isinstance(value, Section) else [f"{prefix}{name}"]

    inside = ("uwb.anchors.", "uwb.tags.", "uwb.range_topics.")
    told = {f"{section}.{key.strip('`')}" for section, key, *_ in KEYS}
    assert {each for each in told if not each.startswith(inside)} == set(dotted(Config(), ""))
    assert {each for each in told if each.startswith(inside)} >= {"uwb.anchors.bias_m", "uwb.tags.role"}


@pytest.mark.parametrize(("section", "key", "default"), [each[:3] for each in KEYS if each[2].startswith("`")])
def test_a_default_is_what_is_used(section, key, default):
    if section in ("uwb.anchors", "uwb.tags", "uwb.range_topics"):
        return
    used = reduce(getattr, [*section.split("."), key.strip("`")], Config())
    said = tomllib.loads(f"x = {default.strip('`')}")["x"]
    assert (tuple(said) if isinstance(used, tuple) else said) == used


TABLES_OF = {"uwb.anchors": "id=0 x_m=0 y_m=0", "uwb.tags": "id=0", "uwb.range_topics": "topic='/r' tag=0 anchor=0"}


def override(section: str, name: str, value: float, times: str | None) -> str:
    """The key with a value, as --set takes it; in a table of a list beside what the table must have."""
    number = f"{value:.10g}"
    text = f"[{', '.join([number] * int(times))}]" if times else number
    if section not in TABLES_OF:
        return f"{section}.{name}={text}"
    others = [each for each in TABLES_OF[section].split() if not each.startswith(f"{name}=")]
    return f"{section}=[{{{', '.join([*others, f'{name}={text}'])}}}]"


def why_refused(override: str) -> str:
    """What loading says of it, empty when it is taken."""
    try:
        load_config(None, [override], {})
    except InvalidConfigValue as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("section", "key", "allowed"), BOUNDED)
def test_its_bounds_hold_and_so_do_their_ends(section, key, allowed):
    times, interval = re.fullmatch(r"(?:whole )?(?:(\d) × )?([\[(].*)", allowed).groups()
    low, high = (float(each.replace("−", "-").replace("∞", "inf")) for each in interval[1:-1].split(", "))
    for end, away, taken_in in ((low, low - 1, interval[0] == "["), (high, high + 1, interval[-1] == "]")):
        if math.isfinite(end):
            beyond, at = (override(section, key.strip("`"), value, times) for value in (away, end))
            # At its end another key may still refuse it, for a reason that is no bound.
            assert "input should be" in why_refused(beyond)
            assert ("input should be" in why_refused(at)) is not taken_in


def test_there_are_bounds_to_try():
    assert len(BOUNDED) > 100


@pytest.mark.parametrize(("key", "unit"), [
    ("uwb.range_std_m", "m"), ("uwb.acceleration_std_mps2", "m/s²"), ("lidar.field_of_view_deg", "°"),
    ("pursuit.max_yaw_rate_radps", "rad/s"), ("pursuit.fuzzy.lambda_v_s2_per_m", "s²/m"), ("mpc.f_max_n", "N"),
    ("pursuit.rate_hz", "Hz"), ("simulation.trot.payload_kg", "kg"), ("grid.size_cells", "cells"), ("mpc.mu", ""),
])  # fmt: skip
def test_a_unit_is_what_the_name_ends_in(key, unit):
    section, _, name = key.rpartition(".")
    assert [each[3] for each in KEYS if each[:2] == (section, f"`{name}`")] == [unit]


def test_every_metric_has_a_row_with_its_unit_and_meaning():
    found = {row[0].strip("`"): row for row in rows((DOCS / "metrics.md").read_text())}
    assert list(found) == list(METRIC_NAMES)
    for name, row in found.items():
        assert row[1:3] == [CATALOGUE[name].unit, CATALOGUE[name].meaning]
        assert row[5] == CATALOGUE[name].counted
