from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from quadlog.errors import NotARun
from quadlog.pipelines import report as reports
from quadlog.pipelines.report import rebuild_reports
from quadlog.results.run.tables import read_table


@pytest.fixture
def run(located_run, tmp_path) -> Path:
    """A run with few figures: how many there are plays no part."""
    return Path(shutil.copytree(located_run.run, tmp_path / "follow"))


@pytest.mark.nightly
def test_two_processes_write_what_one_does(run, monkeypatch):
    pages = {}
    for count in (1, 2):
        monkeypatch.setattr(reports, "cores", lambda count=count: count)
        for old in [run / "report.html", *(run / "plots").iterdir()]:
            old.unlink()
        assert list(rebuild_reports([run])) == [run / "report.html"]
        pages[count] = {path.name: path.read_bytes() for path in [run / "report.html", *(run / "plots").iterdir()]}
    assert len(pages[1]) > 5
    assert pages[1] == pages[2]


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_no_run_is_said_and_those_before_it_are_done(run, tmp_path, monkeypatch, count):
    monkeypatch.setattr(reports, "cores", lambda: count)
    (tmp_path / "empty").mkdir()
    written = rebuild_reports([run, tmp_path / "empty"])
    assert next(written) == run / "report.html"
    with pytest.raises(NotARun):
        next(written)


def test_the_page_of_a_folder_has_the_runs_that_are_in_it_now(run, tmp_path):
    season = tmp_path / "season"
    for name in ("first", "second"):
        shutil.copytree(run, season / name)
    assert list(rebuild_reports([season])) == [season / "report.html"]
    assert read_table(season, "summary")["recording"].tolist() == ["first", "second"]
    shutil.rmtree(season / "first")
    shutil.copytree(run, season / "third")
    list(rebuild_reports([season]))
    assert read_table(season, "summary")["recording"].tolist() == ["second", "third"]
    assert "first" not in (season / "report.html").read_text()
