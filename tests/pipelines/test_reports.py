from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

from quadlog.errors import NotARun, WorkerDied
from quadlog.pipelines import reports
from quadlog.pipelines.engine.local_pool import LocalPool
from quadlog.pipelines.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.reports import draw_in_two, rebuild_reports
from quadlog.results.plots.figures import PLOTS, render_plots
from quadlog.results.plots.run_data import RunData


class Dying(Executor):
    """A helper that is killed by every task."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(WorkerDied(-9))
        return future


@pytest.fixture(scope="module")
def located(follow_request, tmp_path_factory) -> Path:
    """A run with few figures: how many there are plays no part."""
    request = follow_request(tmp_path_factory.mktemp("runs") / "follow", until="position")
    return replay(request, Silent()).run


@pytest.fixture
def run(located, tmp_path) -> Path:
    return Path(shutil.copytree(located, tmp_path / "follow"))


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


def test_each_figure_is_drawn_once_and_in_the_order_of_the_report(run):
    data = RunData(run)
    with LocalPool(1) as helper:
        drawn = draw_in_two(helper, data)
    assert drawn == render_plots(data)
    assert list(drawn) == [plot.name for plot in PLOTS if plot.name in drawn]


def test_a_killed_helper_costs_time_only(run):
    data = RunData(run)
    assert draw_in_two(Dying(), data) == render_plots(data)


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_no_run_is_said_and_those_before_it_are_done(run, tmp_path, monkeypatch, count):
    monkeypatch.setattr(reports, "cores", lambda: count)
    written = rebuild_reports([run, tmp_path])
    assert next(written) == run / "report.html"
    with pytest.raises(NotARun):
        next(written)
