from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

from quadlog.errors import NotARun, WorkerDied
from quadlog.results.plots import figures as shared_drawing
from quadlog.results.plots.figures import PLOTS, SharedDrawing
from quadlog.results.plots.run_data import RunData


class Helper(Executor):
    """One that does so many tasks before anyone asks, and is killed amid all others or never comes to them."""

    def __init__(self, does: int, *, dies: bool = False) -> None:
        self._left, self._dies = does, dies

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if self._left > 0 and future.set_running_or_notify_cancel():
            try:
                future.set_result(fn(*args, **kwargs))
            except NotARun as error:
                future.set_exception(error)
        elif self._dies and future.set_running_or_notify_cancel():
            future.set_exception(WorkerDied(-9))
        self._left -= 1
        return future


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names in the order in which anyone draws them; the pictures are the names."""
    names: list[str] = []

    def render(run: RunData, wanted: list[str] | None = None) -> dict[str, bytes]:
        mine = [plot.name for plot in PLOTS if wanted is None or plot.name in wanted]
        names.extend(mine)
        return {name: name.encode() for name in mine if name != "terrain"}

    monkeypatch.setattr(shared_drawing, "render_plots", render)
    return names


ALL = [plot.name for plot in PLOTS]
HAVE = {name: name.encode() for name in ALL if name != "terrain"}


def test_alone_all_is_drawn_once(tiny_run: Path, drawn: list[str]) -> None:
    pictures = SharedDrawing(RunData(tiny_run)).finish()
    assert list(pictures.items()) == list(HAVE.items())
    assert drawn == ALL


@pytest.mark.parametrize("does", [0, 1, 7, len(ALL)])
@pytest.mark.parametrize("dies", [False, True])
def test_each_figure_is_drawn_once_wherever_they_meet(tiny_run: Path, drawn: list[str], does: int, dies: bool) -> None:
    pictures = SharedDrawing(RunData(tiny_run), Helper(does, dies=dies)).finish()
    assert list(pictures.items()) == list(HAVE.items())
    assert sorted(drawn) == sorted(ALL)
    assert drawn[:does] == ALL[:does]


def test_what_the_helper_finds_damaged_is_named(tiny_run: Path) -> None:
    (tiny_run / "poses.parquet").write_bytes(b"PAR1")
    with pytest.raises(NotARun, match=r"poses\.parquet"):
        SharedDrawing(RunData(tiny_run), Helper(len(ALL))).finish()
