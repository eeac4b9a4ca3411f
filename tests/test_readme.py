"""What the README says of quadlog, held against quadlog; its commands are typed in test_docs.py."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest
import yaml

from quadlog.cli.main import COMMANDS, run
from quadlog.errors import ExitCode
from quadlog.results.record import read_metrics
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


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The run that `make demo` leaves, and what it prints."""
    recipe = (ROOT / "Makefile").read_text().split("\ndemo:")[1].split("\n\n")[0].splitlines()
    words = shlex.split(next(line for line in recipe if "quadlog replay" in line).strip().lstrip("@"))
    assert words[0].endswith("/quadlog")
    runs = tmp_path_factory.mktemp("demo") / "runs"
    words[words.index("runs")] = str(runs)
    return runs / "follow", printed(words[1:])


def printed(words: list[str]) -> str:
    """What a command prints, typed in the checkout."""
    out = io.StringIO()
    with contextlib.chdir(ROOT), contextlib.redirect_stdout(out):
        assert run(words) == 0
    return out.getvalue()


def test_make_demo_is_what_the_readme_says(demo):
    folder, said = demo
    assert "The robot followed its target" in said
    assert said.splitlines()[-1].endswith("report.html")
    # The robot follows the person round the end of a wall, and touches nothing.
    metrics = {name: each["value"] for name, each in read_metrics(folder).items()}
    assert metrics["fallen"] == metrics["collisions"] == 0
    assert metrics["clearance_min_m"] >= 0.05
    assert metrics["heading_rmse_rad"] <= 0.3
    assert metrics["plan_error_m"] < metrics["eta_m"] < 0.2


def test_the_sample_outputs_are_what_is_printed_of_the_fixture(demo):
    info, metrics = (block.splitlines() for block in re.findall(r"```text\n(.*?)```", README, re.DOTALL))
    rows = printed(["info", "fixtures/follow.mcap", "-c", "fixtures/follow.toml"]).splitlines()
    assert [line for line in info if line] == [row for row in rows if row and row in info]
    rows = {row.split()[0]: row for row in printed(["metrics", str(demo[0])]).splitlines() if row}
    for line in metrics:
        told, measured = (each.split() for each in (line, rows[line.split()[0]]))
        assert len(told) == len(measured)
        for one, other in zip(told, measured, strict=True):
            if re.fullmatch(r"[\d.]+", one):  # another processor rounds otherwise, and a walk adds that up
                assert float(one) == pytest.approx(float(other), rel=0.1, abs=0.02)
            else:
                assert one == other


@pytest.mark.parametrize("key", ["title", "authors", "version", "license", "message", "cff-version"])
def test_it_can_be_cited(key):
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation[key]
    assert (citation["version"], citation["license"]) == (__version__, "Apache-2.0")
