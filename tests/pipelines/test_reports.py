from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from quadlog.errors import NotARun
from quadlog.pipelines.report import rebuild_reports
from quadlog.results.tables import read_table


@pytest.fixture
def run(located_run, tmp_path) -> Path:
    """A run with few figures: how many there are plays no part."""
    return Path(shutil.copytree(located_run.run, tmp_path / "follow"))


def test_what_is_no_run_is_said_and_those_before_it_are_done(run, tmp_path):
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
    page = (season / "report.html").read_text()
    assert ("./first/" in page, "./third/" in page) == (False, True)
