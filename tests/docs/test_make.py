"""The pages that docs/make.py writes: up to date, and true to the models they are read from; and the site."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tomllib
from functools import reduce
from pathlib import Path

import pytest

from quadlog.config.file import SCHEMA
from quadlog.config.schema import Config
from quadlog.config.section import Section

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def make():
    sys.path.insert(0, str(DOCS))
    yield importlib.import_module("make")
    sys.path.remove(str(DOCS))


@pytest.mark.parametrize("name", ["configuration.md", "metrics.md", "troubleshooting.md"])
def test_the_committed_page_is_what_make_docs_writes(make, name):
    """Of troubleshooting.md this fails for a message, an error class or a cause of loss without an entry, too."""
    assert (DOCS / name).read_text() == make.PAGES[name](), "run  python docs/make.py"


def test_the_schema_for_editors_is_that_of_the_models(make):
    assert SCHEMA.read_text() == make.schema_text(), "run  python docs/make.py"


def test_a_sample_keeps_its_lines_and_gets_the_numbers_of_today(make):
    fill = importlib.import_module("samples").fill
    printed = "name  value  us   95 %\na      1.25   13\nb     -0.50  999  0 to 1\nc         3    8\n"
    sample = "name  value  us   95 %\nb      0.75    …  0 to 2\n\nc         1    …\n"
    assert fill(sample, printed) == "name  value  us   95 %\nb     -0.50  …    0 to 1\n\nc         3    …\n"
    with pytest.raises(SystemExit, match="not printed any more: d"):
        fill("d  1\n", printed)


def test_an_entry_for_a_message_that_nothing_prints_is_refused(make, monkeypatch):
    messages = importlib.import_module("messages")
    known = messages.code_messages()
    assert any(text.startswith("anchors configured, but silent") for text in known)
    monkeypatch.setattr(messages, "code_messages", lambda: [text for text in known if "but silent" not in text])
    with pytest.raises(ValueError, match="nothing in the code says"):
        messages.troubleshooting_page()
    monkeypatch.setattr(messages, "code_messages", lambda: [*known, "a new warning"])
    with pytest.raises(ValueError, match=r"no entry for .*a new warning"):
        messages.troubleshooting_page()


def rows(section: str) -> list[list[str]]:
    """The cells of a section's table, without its header."""
    return [
        [cell.strip() for cell in line[1:-1].split(" | ")] for line in section.splitlines() if line.startswith("| `")
    ]


def test_every_key_has_a_row_with_the_default_that_is_used():
    def dotted(model, prefix):
        for name in type(model).model_fields:
            value = getattr(model, name)
            yield from dotted(value, f"{prefix}{name}.") if isinstance(value, Section) else [f"{prefix}{name}"]

    page, told = (DOCS / "configuration.md").read_text(), {}
    for title, text in re.findall(r"^## `(\[+[\w.]+\]+)`\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE):
        told |= {f"{title}.{row[0]}".translate({ord(sign): None for sign in "[]`"}): row for row in rows(text)}
    inside = ("topics.poses.", "uwb.anchors.", "uwb.tags.", "uwb.range_topics.")
    assert {key for key in told if not key.startswith(inside)} == set(dotted(Config(), ""))
    for key, row in told.items():
        if row[1].startswith("`") and not key.startswith(inside):
            used = reduce(getattr, key.split("."), Config())
            said = tomllib.loads(f"x = {row[1].strip('`')}")["x"]
            assert (tuple(said) if isinstance(used, tuple) else said) == used, key
    units = {"uwb.range_std_m": "m", "lidar.field_of_view_deg": "°", "pursuit.fuzzy.lambda_v_s2_per_m": "s²/m",
             "mpc.f_max_n": "N", "grid.size_cells": "cells", "mpc.mu": ""}  # fmt: skip
    assert {key: told[key][2] for key in units} == units


def test_the_site_builds_without_a_warning(tmp_path):
    """A page in no table of contents, or a link to nothing, warns; `make docs` adds the sample pages."""
    for name in ("sphinx", "myst_parser", "furo", "sphinx_click"):
        pytest.importorskip(name)
    words = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-d", tmp_path / "trees"]
    done = subprocess.run([*words, DOCS, tmp_path / "site"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    built = {path.relative_to(tmp_path / "site").with_suffix("") for path in (tmp_path / "site").rglob("*.html")}
    assert {path.relative_to(DOCS).with_suffix("") for path in DOCS.rglob("*.md")} <= built
    assert "quadlog replay" in (tmp_path / "site" / "commands.html").read_text()
    assert "Replay one recording" in (tmp_path / "site" / "python.html").read_text()
