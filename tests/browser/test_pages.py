"""What can be done with the pages, each kind opened once in a browser."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.results.figures import drawings_of
from quadlog.results.page.run_page import write_run_page
from quadlog.results.page.runs_page import write_folder_page
from quadlog.results.run import Run
from quadlog.results.tables import TABLES, write_table
from quadlog.results.view import GAP_S, Panel, Scene, Series
from tests.lab.pages import PAGES
from tests.lab.runs import with_many_anchors

Probe = Callable[..., dict[str, Any]]


def test_map_and_curves_are_one_instrument(tiny_run: Path, probe: Probe) -> None:
    with_many_anchors(tiny_run, anchors=2, tags=3)
    say = probe(write_run_page(Run(tiny_run)), "run", fragment="#t=1.85")
    assert say["opened"] == 1.85
    assert say["inSight"]
    assert say["plots"] >= 6
    assert say["first"][0] >= 500  # beside two lines that warn
    assert say["first"][1] >= 0.5
    assert max(say["lines"]) < 50
    assert say["share"] == pytest.approx(0.58, abs=0.02)
    assert say["sideways"] <= 0
    assert say["parts"] == ["range", "Play", True]
    assert say["keys"] == pytest.approx([0.0, 0.1, 1.1, 1.0, 3.98])
    assert say["slider"] == pytest.approx([0.1, 0.1])
    assert say["playing"] == "Pause"
    assert say["played"] == pytest.approx(1.0, abs=0.01)
    assert say["faster"] == pytest.approx(1.0, abs=0.01)
    assert say["end"] == [3.98, "Play"]
    assert say["linked"] == pytest.approx([0, 0])  # the same link twice
    assert say["hidden"] == 0 < say["shown"]  # rings of late ranges
    assert "worst error of tag 1 0.199 m" in say["claim"][0]
    assert say["claim"][1]
    assert say["next"] == [True, False]
    assert say["before"] == pytest.approx(0)
    assert say["address"].startswith("#t=")
    assert say["target"][1] == 0 < say["target"][0] == say["target"][2]
    assert say["zoom"]["fixed"] == pytest.approx([0, 0], abs=0.03)
    assert say["zoom"]["factor"] == pytest.approx(np.e, rel=0.05)
    assert "view=" in say["zoomed"]
    assert say["all"] == pytest.approx([0, 0], abs=0.03)
    assert say["clicked"] == pytest.approx(3.98 / 4, abs=0.05)
    assert say["samples"] == 200
    assert say["fits"] < 0.5
    assert say["whole"] == pytest.approx(1)
    assert say["wheel"] == pytest.approx(np.e, rel=0.01)
    assert say["pressed"] == ["false", "true"]
    assert say["redrawn"] > 0
    panels = [each for of in drawings_of(Run(tiny_run)).values() if not isinstance(of, Scene) for each in of]
    known = {(each.what, one.label): (each, one) for each in panels for one in each.series}
    wrong = [row for row in say["read"] if not is_of_its_instant(row[0], row[3], *known[row[1], row[2]])]
    assert len(say["read"]) >= 1000
    assert wrong == []


def is_of_its_instant(instant: float, text: str, panel: Panel, series: Series) -> bool:
    """Whether the value is that of the nearest sample, and of none that is too far."""
    away = np.abs(series.x - instant)
    if text == "–":
        others = min(np.abs(other.x - instant).min() for other in panel.series if len(other.x))
        nearest_known = np.isfinite(series.y[np.isclose(away, away.min(), atol=2e-3)]).all()
        return bool(away.min() > GAP_S or not nearest_known or (series.events and others < away.min() + 2e-3))
    near, value = np.isclose(away, away.min(), atol=2e-3), float(text.replace("−", "-"))
    span = np.ptp(series.y[np.isfinite(series.y)])
    agrees = (np.abs(series.y[near] - value) <= 0.005 * np.abs(series.y[near]) + 2e-4 * span).any()
    is_near = away.min() <= GAP_S if series.style == "points" else len(series.x) == 2 or away.min() <= GAP_S
    if series.events:
        is_near = all(away.min() <= np.abs(other.x - instant).min() + 2e-3 for other in panel.series)
    return bool(agrees and is_near)


KNOWN = {"one scan": [True, False, False, False], "gap": [True, True, False, True]}


@pytest.mark.parametrize("kind", KNOWN)
def test_a_page_on_a_phone_shows_what_there_is(tiny_run: Path, probe: Probe, kind: str) -> None:
    say = probe(PAGES[kind](tiny_run), "few", size=(390, 844))
    assert max(say["sideways"], say["wide"]) <= 0
    assert (say["stays"], say["known"]) == ("sticky", KNOWN[kind])
    assert (say["curves"] == 0) == (len(say["only"]) > 5) == (kind == "one scan")


def test_runs_are_named_once_above_their_curves(tiny_run: Path, probe: Probe) -> None:
    say = probe(PAGES["side by side"](tiny_run), "names")
    assert len(say["runs"]) == len(set(say["runs"])) == 2
    assert not any(": " in name for name in say["names"])
    assert say["shown"] == sorted(set(say["shown"]))  # of the first panel


def test_a_list_of_runs_is_sorted_and_unfolded(tmp_path: Path, probe: Probe) -> None:
    folder = tmp_path / "season"
    folder.mkdir()
    ate_m = np.arange(120) % 7 + np.arange(120) / 1000
    ate_m[3] = np.nan
    names = [f"walk-{number}" for number in range(120)]
    columns = {"recording": names, "exit_code": [0] * 120, "reason": [""] * 120, "ate_rmse_m": ate_m}
    write_table(folder / "summary.parquet", TABLES["summary"], columns)
    say = probe(write_folder_page(folder), "tables", size=(390, 844))
    assert say["sideways"] <= 0
    assert (say["folded"], say["unfolded"]) == (100, 120)
    rising = [names[at] for at in np.argsort(ate_m)]  # NaN last
    assert say["rising"] == rising[:3]
    assert say["falling"] == [*rising[-2:-5:-1], "walk-3"]
    assert say["sorted"] == "descending"
    above = {name for name, error_m in zip(names, ate_m, strict=True) if error_m > 6.095}
    assert [set(say["filtered"][0]), say["filtered"][1], say["filtered"][2]] == [above, ["walk-119", "walk-112"], 120]
    assert say["command"] == f"quadlog report --side-by-side {rising[-2]} {rising[-3]} -o side_by_side.html"


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
@pytest.mark.parametrize("kind", ["whole", "ingest", "folder", "side by side", "sweep", "planners", "papers"])
def test_axe_finds_nothing_serious(tiny_run: Path, probe: Probe, kind: str, size: tuple[int, int]) -> None:
    """Needs axe.min.js of axe-core, by QUADLOG_AXE or in axe-core-python, which is not imported."""
    package = find_spec("axe_core_python")
    found = Path(package.origin).with_name("axe.min.js") if package and package.origin else None
    if not (library := os.environ.get("QUADLOG_AXE") or found):
        pytest.skip("no axe.min.js: install axe-core-python, or name it by QUADLOG_AXE")
    library = Path(library).read_text()
    assert probe(PAGES[kind](tiny_run), "axe", size, library=library)["bad"] == []


def test_the_policy_stops_what_is_not_ours(tiny_run: Path, browse: Callable[..., tuple[str, list[str]]]) -> None:
    page = PAGES["ingest"](tiny_run)
    page.write_text(page.read_text().replace("</body>", "<script>document.title = 'owned';</script></body>"))
    dom, complaints = browse(page, "--dump-dom")
    assert "<title>owned" not in dom
    assert any("Content Security Policy" in line for line in complaints)
