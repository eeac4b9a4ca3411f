"""`quadlog report`: pages of runs and folders made again, and runs side by side as a user asks for them."""

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
from quadlog.errors import NotARun
from quadlog.pipelines.evaluation.reports import rebuild_reports
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.results.tables import read_table
from quadlog.results.text import value_text
from tests.lab.runs import change_json
from tests.pipelines.conftest import FIXTURES, fixture_request


def test_the_page_of_a_folder_has_the_runs_that_are_in_it_now(located_run, tmp_path):
    season, run = tmp_path / "season", located_run.run
    for name in ("first", "second"):
        shutil.copytree(run, season / name)
    assert list(rebuild_reports([season])) == [season / "report.html"]
    assert read_table(season, "summary")["recording"].tolist() == ["first", "second"]
    shutil.rmtree(season / "first")
    shutil.copytree(run, season / "third")
    (tmp_path / "empty").mkdir()
    written = rebuild_reports([season / "third", season, tmp_path / "empty"])
    assert (next(written), next(written)) == (season / "third" / "report.html", season / "report.html")
    with pytest.raises(NotARun):
        next(written)  # and those before it are done
    assert read_table(season, "summary")["recording"].tolist() == ["second", "third"]
    page = (season / "report.html").read_text()
    assert ("./first/" in page, "./third/" in page) == (False, True)


@pytest.fixture(scope="module")
def runs(short_run: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The short run and one of the same seconds with other settings; not to be changed."""
    config = load_config(FIXTURES / "follow.toml", ["planner.name=astar", "simulation.controller=kinematic"])
    request = replace(fixture_request(tmp_path_factory.mktemp("other") / "follow"), config=config, plots=False)
    return SimpleNamespace(a=short_run.run, b=replay(request, Silent()).run)


@pytest.fixture
def show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    """Runs the command on the paths; gives the page."""

    def show(*paths: Path) -> str:
        page = str(tmp_path / "new" / "page.html")
        assert run_cli(["report", *map(str, paths), "--side-by-side", "--force", "-o", page]) == 0
        assert capsys.readouterr().out == f"{page}\n"
        return Path(page).read_text()

    return show


def row(page: str, name: str) -> list[tuple[str, str]]:
    """The value in full and the text of each run, and of the difference."""
    (found,) = re.findall(rf"<tr[^>]*>\s*<th[^>]*>[^<]*<small>{name}</small></th>(.*?)</tr>", page, re.DOTALL)
    cells = re.findall(r'<td class="[^"]*"(?: data-value="([^"]*)")?>([^<]*)', found)
    return [(value, html.unescape(text)) for value, text in cells]


def test_metrics_are_paired_on_common_instants_and_what_differs_is_named(runs, show, capsys):
    page = show(runs.a, runs.b)
    a, b = (read_table(run, "control") for run in (runs.a, runs.b))
    _, in_a, in_b = np.intersect1d(a["t_ns"], b["t_ns"], return_indices=True)
    apart_m = float(np.nanmean(b["error_m"][in_b] - a["error_m"][in_a]))
    assert value_text("eta_m", apart_m, "m", 2) in row(page, "eta_m")[2][1]
    metrics = [json.loads((run / "metrics.json").read_text()) for run in (runs.a, runs.b)]
    for name in metrics[0].keys() & metrics[1].keys():
        assert [float(value) for value, _ in row(page, name)[:2]] == [of[name]["value"] for of in metrics], name
    assert row(page, "uwb_rmse_m")[2][1] == "the same"
    assert run_cli(["diff", str(runs.a), str(runs.b), "--json"]) == 4
    made = {each["column"] for each in json.loads(capsys.readouterr().out) if each["stage"] == "made"}
    shown = set(re.findall(r"<code>([^<]*)</code></th>", page))
    assert {"planner.name", "simulation.controller"} <= {each.removeprefix("config.") for each in made} & shown
    assert "replans differ first" in page
    assert len(page.encode()) < 2_000_000  # of 3 s; the limit is 6 MB for 60 s


def test_a_copy_is_the_same_and_runs_that_lack_stages_or_are_of_other_recordings_say_so(
    runs, located_run, show, tmp_path
):
    page = show(runs.a, Path(shutil.copytree(runs.a, tmp_path / "copy")))
    assert {row(page, name)[2][1] for name in ("eta_m", "collisions", "expanded_mean")} == {"the same"}
    assert "differ first" not in page
    assert [bool(value) for value, _ in row(show(runs.a, located_run.run), "eta_m")[:2]] == [True, False]
    other = Path(shutil.copytree(located_run.run, tmp_path / "other"))
    change_json(other / "run.json", input__sha256="0" * 64)
    assert re.search(r"is not paired with [^:<]*: they are of different recordings", show(other, runs.a))


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ("A --side-by-side -o new.html", 2, "two runs or more"),
        ("A B A --side-by-side -o new.html", 2, "none twice"),
        ("A B --side-by-side", 2, "needs -o"),
        ("A B -o new.html", 2, "--side-by-side"),
        ("A missing --side-by-side -o new.html", 1, "no such folder"),
        ("A B --side-by-side -o old.html", 1, "--force"),
        ("A B --side-by-side --force -o folder", 1, "folder"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(runs, tmp_path, capsys, arguments, code, words):
    (tmp_path / "old.html").write_text("mine")
    (tmp_path / "folder").mkdir()
    places = {"A": str(runs.a), "B": str(runs.b)}
    places |= {name: str(tmp_path / name) for name in ("missing", "old.html", "new.html", "folder")}
    assert run_cli(["report", *(places.get(each, each) for each in arguments.split())]) == code
    done = capsys.readouterr()
    assert (done.out, words in done.err, "Traceback" in done.err) == ("", True, False), done.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "old.html"]
    assert (tmp_path / "old.html").read_text() == "mine"
