"""What the README says of quadlog, held against quadlog; its commands are typed in test_docs.py."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import yaml

from quadlog.cli.main import COMMANDS, run
from quadlog.errors import ExitCode
from quadlog.results.run.run_folder import read_metrics
from quadlog.version import __version__

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_every_command_is_in_its_table():
    table = README.split("## Commands")[1].split("##")[0]
    assert sorted(re.findall(r"^\| `quadlog ([a-z-]+)", table, re.MULTILINE)) == sorted(COMMANDS)


def test_every_exit_code_is_told():
    told = README.split("Exit codes:")[1].split("Completion")[0]
    assert re.findall(r"\b(\d) [a-z]", told) == [str(int(code)) for code in ExitCode]


def test_the_example_from_python_is_short():
    example = README.split("```python\n")[1].split("```")[0]
    assert len(example.strip().splitlines()) <= 8


def test_make_demo_is_what_the_readme_says(tmp_path, monkeypatch, capsys):
    recipe = (ROOT / "Makefile").read_text().split("\ndemo:")[1].split("\n\n")[0].splitlines()
    words = shlex.split(next(line for line in recipe if "quadlog replay" in line).strip().lstrip("@"))
    assert words[0].endswith("/quadlog")
    monkeypatch.chdir(ROOT)
    words[words.index("runs")] = str(tmp_path / "runs")
    assert run(words[1:]) == 0
    printed = capsys.readouterr().out
    assert "eta_m" in printed
    assert printed.splitlines()[-1].endswith("report.html")
    # The robot follows the person round the end of a wall, and touches nothing.
    metrics = {name: each["value"] for name, each in read_metrics(tmp_path / "runs" / "follow").items()}
    assert metrics["fallen"] == metrics["collisions"] == 0
    assert metrics["clearance_min_m"] >= 0.05
    assert metrics["heading_rmse_rad"] <= 0.3
    assert metrics["plan_error_m"] < metrics["eta_m"] < 0.2


@pytest.mark.parametrize("key", ["title", "authors", "version", "license", "message", "cff-version"])
def test_it_can_be_cited(key):
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation[key]
    assert (citation["version"], citation["license"]) == (__version__, "Apache-2.0")
