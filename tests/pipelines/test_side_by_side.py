"""`quadlog report A B --side-by-side -o FILE` as a user runs it, on two replays of the committed recording."""

from __future__ import annotations

import html
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from quadlog.cli.main import run as run_cli
from quadlog.config.file import load_config
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.results.tables import read_table
from quadlog.results.text import value_text


@pytest.fixture(scope="module")
def runs(short_run: Any, follow_request: Any, fixtures: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The short run and one of the same seconds with other settings; not to be changed."""
    folder = tmp_path_factory.mktemp("other")
    config = load_config(fixtures / "follow.toml", ["planner.name=astar", "simulation.controller=kinematic"], {})
    other = replay(replace(follow_request(folder / "follow"), config=config), Silent()).run
    return SimpleNamespace(a=short_run.run, b=other)


@pytest.fixture
def show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    """Runs the command on the paths; gives the page."""

    def show(*paths: Path) -> str:
        assert run_cli(["report", *map(str, paths), "--side-by-side", "-o", str(tmp_path / "new" / "page.html")]) == 0
        assert capsys.readouterr().out == f"{tmp_path / 'new' / 'page.html'}\n"
        return (tmp_path / "new" / "page.html").read_text()

    return show


def row(page: str, name: str) -> list[tuple[str, str]]:
    """The value in full and the line below it, of each run."""
    (found,) = re.findall(rf"<tr[^>]*>\s*<th[^>]*>[^<]*<small>{name}</small></th>(.*?)</tr>", page, re.DOTALL)
    cells = re.findall(r'<td class="[^"]*"(?: data-value="([^"]*)")?>[^<]*(?:<small>([^<]*)</small>)?', found)
    return [(value, html.unescape(below)) for value, below in cells]


def test_metrics_are_paired_on_common_instants(runs: Any, show: Any) -> None:
    page = show(runs.a, runs.b)
    a, b = (read_table(run, "control") for run in (runs.a, runs.b))
    _, in_a, in_b = np.intersect1d(a["t_ns"], b["t_ns"], return_indices=True)
    apart_m = float(np.nanmean(b["error_m"][in_b] - a["error_m"][in_a]))
    assert value_text("eta_m", apart_m, "m", 2) in row(page, "eta_m")[1][1]
    metrics = [json.loads((run / "metrics.json").read_text()) for run in (runs.a, runs.b)]
    for name in metrics[0].keys() & metrics[1].keys():
        assert [float(value) for value, _ in row(page, name)] == [of[name]["value"] for of in metrics], name
    assert row(page, "uwb_rmse_m")[1][1] == "the same"


def test_the_page_says_what_differs_and_where(runs: Any, show: Any, capsys: pytest.CaptureFixture[str]) -> None:
    page = show(runs.a, runs.b)
    assert run_cli(["diff", str(runs.a), str(runs.b), "--json"]) == 4
    differences = json.loads(capsys.readouterr().out)
    assert "first difference of plans" in page
    made = {each["column"] for each in differences if each["stage"] == "made"}
    shown = set(re.findall(r"<code>([^<]*)</code></th>", page))
    assert {"planner.name", "simulation.controller"} <= {each.removeprefix("config.") for each in made} & shown
    assert len(page.encode()) < 2_000_000  # of 3 s; the limit is 6 MB for 60 s
    assert not re.search(r"(?:src|href)=\"?(?:https?:|//)", page)


def test_a_run_beside_its_copy_is_the_same(runs: Any, show: Any, tmp_path: Path) -> None:
    page = show(runs.a, Path(shutil.copytree(runs.a, tmp_path / "copy")))
    assert {row(page, name)[1][1] for name in ("eta_m", "collisions", "expanded_mean")} == {"the same"}
    assert "first difference of" not in page
    assert 'id="settings"' not in page


def test_runs_that_lack_stages_and_of_other_recordings_say_so(
    runs: Any, located_run: Any, show: Any, tmp_path: Path
) -> None:
    page = show(runs.a, located_run.run)
    assert [bool(value) for value, _ in row(page, "eta_m")] == [True, False]
    other = shutil.copytree(located_run.run, tmp_path / "other")
    record = json.loads((other / "run.json").read_text())
    record["input"]["sha256"] = "0" * 64
    (other / "run.json").write_text(json.dumps(record))
    shutil.rmtree(tmp_path / "new")
    assert re.search(r"is not paired with [^:<]*: they are of different recordings", show(other, runs.a))


def test_names_stay_text(runs: Any, show: Any, tmp_path: Path) -> None:
    hostile = tmp_path / "<img src=x onerror=alert(1)>"
    shutil.copytree(runs.b, hostile)
    record = json.loads((hostile / "run.json").read_text())
    script = "</script><script>alert(1)</script>"
    record["warnings"].append(script)
    record["options"]["until"] = script
    record["input"]["path"] = f"{script}.mcap"
    (hostile / "run.json").write_text(json.dumps(record))
    for pair in ((hostile, runs.a), (runs.a, hostile)):
        page = show(*pair)
        assert "<img" not in page
        assert "<script>alert" not in page
        assert "&lt;script&gt;alert(1)" in page
        shutil.rmtree(tmp_path / "new")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("A", "--side-by-side", "-o", "new.html"), 2, "two runs or more"),
        (("A", "B", "A", "--side-by-side", "-o", "new.html"), 2, "none twice"),
        (("A", "B", "--side-by-side"), 2, "needs -o"),
        (("A", "B", "-o", "new.html"), 2, "--side-by-side"),
        (("A", "missing", "--side-by-side", "-o", "new.html"), 1, "no such folder"),
        (("A", "B", "--side-by-side", "-o", "old.html"), 1, "--force"),
        (("A", "B", "--side-by-side", "--force", "-o", "A/run.json"), 2, "a file of the run"),
        (("A", "B", "--side-by-side", "--force", "-o", "folder"), 1, "folder"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(
    runs: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], code: int, words: str
) -> None:
    (tmp_path / "old.html").write_text("mine")
    (tmp_path / "folder").mkdir()
    places = {"A": str(runs.a), "B": str(runs.b), "A/run.json": str(runs.a / "run.json")}
    places |= {name: str(tmp_path / name) for name in ("missing", "old.html", "new.html", "folder")}
    assert run_cli(["report", *(places.get(each, each) for each in arguments)]) == code
    done = capsys.readouterr()
    assert (done.out, words in done.err, "Traceback" in done.err) == ("", True, False), done.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "old.html"]
    assert (tmp_path / "old.html").read_text() == "mine"


def test_force_replaces_a_page(runs: Any, tmp_path: Path) -> None:
    (tmp_path / "old.html").write_text("mine")
    page = ["--side-by-side", "--force", "-o", str(tmp_path / "old.html")]
    assert run_cli(["report", str(runs.a), str(runs.b), *page]) == 0
    assert "follow.mcap" in (tmp_path / "old.html").read_text()
