"""Whatever the README tells a reader to type, typed."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from quadlog.cli.main import COMMANDS, run

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
LINES = [line.split("  #")[0].strip() for block in BLOCKS for line in block.splitlines()]
TOLD = [shlex.split(line)[1:] for line in LINES if line.startswith("quadlog ")]


@pytest.fixture(scope="module")
def yesterday(tmp_path_factory):
    """A folder with the log of the README's reader: a bag, and a folder of bags."""
    folder = tmp_path_factory.mktemp("reader")
    arguments = ["--duration", "1.5", "--azimuth-steps", "120"]
    assert run(["synthesize", "follow", "-o", str(folder / "yesterday.bag"), *arguments]) == 0
    (folder / "bags").mkdir()
    for name in ("one.bag", "two.bag"):
        shutil.copy(folder / "yesterday.bag", folder / "bags" / name)
    return folder


def test_the_tour_is_long_enough_to_mean_something():
    assert len(TOLD) >= 8
    assert {words[0] for words in TOLD} <= set(COMMANDS)


def test_every_command_of_the_tour_runs(yesterday, monkeypatch):
    monkeypatch.chdir(yesterday)
    for words in TOLD:
        shortened = [{"20": "0.5", "30": "0.5"}.get(word, word) for word in words]
        assert run(shortened) in (0, 3), words
    assert (yesterday / "runs" / "yesterday" / "report.html").is_file()
    assert (yesterday / "season" / "summary.parquet").is_file()


def test_the_files_it_lists_are_the_files_there_are(yesterday, monkeypatch):
    monkeypatch.chdir(yesterday)
    if not (yesterday / "runs" / "yesterday").exists():
        assert run(["replay", "yesterday.bag"]) == 0
    listed = README.split("leaves `runs/yesterday/`:")[1].split("Some things to try")[0]
    for name in re.findall(r"`([\w-]+\.(?:html|npz|tum|pgm|yaml|mcap|json|toml))`", listed):
        assert (yesterday / "runs" / "yesterday" / name).exists() or name == "truth.tum", name


def test_every_command_is_in_its_table():
    table = README.split("## Commands")[1].split("##")[0]
    assert set(re.findall(r"`quadlog ([a-z-]+)", table)) == set(COMMANDS)


def test_make_demo_is_what_the_readme_says(tmp_path, monkeypatch, capsys):
    recipe = (ROOT / "Makefile").read_text().split("\ndemo:")[1].splitlines()[1].strip()
    words = shlex.split(recipe)
    assert words[0].endswith("/quadlog")
    monkeypatch.chdir(ROOT)
    words[words.index("runs")] = str(tmp_path / "runs")
    assert run(words[1:]) == 0
    printed = capsys.readouterr().out
    assert "eta_m" in printed
    assert "report.html" in printed


@pytest.mark.parametrize("path", re.findall(r"`((?:docs|fixtures)/[\w./-]*)`|\]\(([\w./-]+)\)", README))
def test_what_it_points_at_exists(path):
    assert (ROOT / next(filter(None, path))).exists()
