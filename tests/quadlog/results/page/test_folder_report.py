import json
import re
import shutil
import statistics
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import NotARun
from quadlog.results.page.folder_report import (
    HEIGHT,
    MAX_RUNS,
    MAX_THUMBNAILS,
    SIDE,
    WIDTH,
    metric_charts,
    thumbnails,
    write_folder_report,
)
from quadlog.results.run.find_runs import find_runs
from quadlog.results.run.tables import METRIC_NAMES, TABLES, write_table

HOSTILE = "</script><script>alert(1)</script>"


def _summary(folder: Path, **columns: Any) -> None:
    write_table(folder / "summary.parquet", TABLES["summary"], columns)


def _rows(page: str) -> list[str]:
    body = re.search(r"<tbody>(.*)</tbody>", page, re.DOTALL)
    return body[1].split("</tr>")[:-1]


def test_a_row_for_each_recording_with_its_outcome_and_metrics(tmp_path: Path) -> None:
    (tmp_path / "walk #1").mkdir()
    (tmp_path / "walk #1" / "report.html").write_text("")
    _summary(
        tmp_path,
        recording=["walk #1", "torn", "empty"],
        exit_code=[0, 3, 1],
        reason=["", "12 messages lost", "nothing readable"],
        eta_m=[0.0345678, 0.5, np.nan],
        expanded_total=[1234567.0, np.nan, np.nan],
    )
    page = write_folder_report(tmp_path).read_text()
    first, second, third = _rows(page)
    assert '<a href="./walk%20%231/report.html">walk #1</a>' in first
    assert ">0 done<" in first
    assert 'data-value="0.0345678">0.03457<' in first
    assert "1\u2009234\u2009567" in first
    assert ">3 with loss<" in second
    assert "12 messages lost" in second
    assert "<a " not in second
    assert ">1 failed<" in third
    assert third.count('data-value="">–<') == 2
    assert "sigma_m" not in page  # a metric that no run has


def test_hostile_names_stay_text_and_lead_nowhere(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "report.html").write_text("")
    names = ["..", HOSTILE, "javascript:alert(1)", "a/../..", "."]
    _summary(tmp_path / "runs", recording=names, exit_code=[1] * 5, reason=[HOSTILE] * 5, eta_m=[5, 1, 2, 3, 4])
    page = write_folder_report(tmp_path / "runs").read_text()
    assert page.count("<script>") == 1
    assert page.count("<title>") == 6  # of the page, and of each dot of the chart
    assert "<a " not in page
    assert len(_rows(page)) == 5


def test_an_empty_summary_is_a_page_and_a_missing_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotARun, match=r"summary\.parquet"):
        write_folder_report(tmp_path)
    _summary(tmp_path, recording=np.array([], object), exit_code=np.array([], int), reason=np.array([], object))
    assert "no recordings" in write_folder_report(tmp_path).read_text()


def _walks(folder: Path, *names: str, option: str = "course") -> None:
    for name in names:
        (folder / name).mkdir()
        (folder / name / "run.json").write_text(json.dumps({"options": {option: "line"}}))


def test_seeds_of_a_course_are_walks_with_their_mean_and_deviation(tmp_path: Path) -> None:
    _walks(tmp_path, "seed-000", "seed-001", "seed-002")
    names = ["seed-000", "seed-001", "seed-002"]
    columns = {"eta_m": [1.0, 2.0, 6.0], "completion_time_s": [np.nan, 30.0, np.nan]}
    _summary(tmp_path, recording=names, exit_code=[0, 0, 0], reason=["", "fell", ""], **columns)
    page = write_folder_report(tmp_path).read_text()
    assert f"{tmp_path.name}: 3 walks" in page
    assert ">Walks</h2>" in page
    assert "recording" not in page.lower()
    foot = re.search(r"<tfoot>(.*)</tfoot>", page, re.DOTALL)
    mean, std = (re.findall(r"<t[hd][^>]*>([^<]*)</t", row) for row in foot[1].split("</tr>")[:-1])
    assert mean == ["mean", "", "", "3", "30"]
    assert std == ["std", "", "", f"{statistics.stdev([1, 2, 6]):.4g}", "–"]


def test_one_walk_has_no_mean_and_a_column_without_a_reason_is_left_out(tmp_path: Path) -> None:
    _walks(tmp_path, "seed-000")
    _summary(tmp_path, recording=["seed-000"], exit_code=[0], reason=[""], eta_m=[1.0])
    page = write_folder_report(tmp_path).read_text()
    assert f"{tmp_path.name}: 1 walk<" in page or f"{tmp_path.name}: 1 walk " in page
    assert "<tfoot>" not in page
    assert ">reason<" not in page
    assert [len(re.findall(r"<t[hd]", row)) for row in _rows(page)] == [3]


@pytest.mark.parametrize("other", ["replay", "damaged", "missing", "hostile"])
def test_walks_beside_anything_else_are_recordings(tmp_path: Path, other: str) -> None:
    _walks(tmp_path, "seed-000")
    if other == "replay":
        _walks(tmp_path, other, option="until")
    elif other == "damaged":
        (tmp_path / other).mkdir()
        (tmp_path / other / "run.json").write_text("{")
    name = "./seed-000" if other == "hostile" else other
    _summary(tmp_path, recording=["seed-000", name], exit_code=[0, 0], reason=["", ""], eta_m=[1.0, 2.0])
    page = write_folder_report(tmp_path).read_text()
    assert ": 2 recordings" in page
    assert "<tfoot>" not in page


@pytest.mark.parametrize("count", [8, 9])
def test_on_paper_every_number_of_a_broad_table_has_its_name_beside_it(tmp_path: Path, count: int) -> None:
    columns = {name: [1.0, 2.0] for name in METRIC_NAMES[:count]}
    _summary(tmp_path, recording=["a", "b"], exit_code=[0, 0], reason=["", ""], **columns)
    page = write_folder_report(tmp_path).read_text()
    assert ('<table class="broad">' in page) == (count > 8)
    for row in _rows(page):
        assert re.findall(r'<td class="number" data-name="(\w+)"', row)[:count] == list(METRIC_NAMES[:count])


VALUES = st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), min_size=2, max_size=30)


@given(VALUES)
def test_dots_stand_in_order_and_as_high_as_their_values(values: list[float]) -> None:
    present = [value for value in values if value == value]
    charts = metric_charts({"eta_m": np.array(values)}, ["eta_m"])
    if len(set(present)) < 2:
        assert charts == []
        return
    (chart,) = charts
    assert [values[dot.run] for dot in chart.dots] == [dot.value for dot in chart.dots] == present
    assert all(0 <= dot.x <= WIDTH and 0 <= dot.y <= HEIGHT for dot in chart.dots)
    ordered = sorted(chart.dots, key=lambda dot: dot.value)
    assert [dot.y for dot in ordered] == sorted((dot.y for dot in ordered), reverse=True)
    assert (chart.low, chart.high) == (min(present), max(present))
    assert chart.median == np.median(present)
    assert chart.left_out == 0


def test_of_many_runs_those_that_stand_out_are_drawn() -> None:
    values = np.ones(5000)
    values[1234], values[4000] = 9.0, -9.0
    (chart,) = metric_charts({"eta_m": values}, ["eta_m"])
    assert len(chart.dots) <= MAX_RUNS + 2
    assert {1234, 4000} <= {dot.run for dot in chart.dots}
    assert chart.left_out == 5000 - len(chart.dots)


def test_thumbnails_show_every_walk_at_one_scale_the_right_way_up(tiny_original: Path) -> None:
    (thumbnail,) = thumbnails(tiny_original.parent, [tiny_original.name])
    assert [color for color, _ in thumbnail.lines] == ["robot", "target", "resim"]
    points = np.array([pair.split(",") for pair in thumbnail.lines[0][1].split()], dtype=float)
    assert points.min() >= 0
    assert points.max() <= SIDE
    # It walks from the origin forward and to the left: to the right and up in the picture, a quarter circle of 3 m.
    assert points[-1] - points[0] == pytest.approx(
        [3 * SIDE / thumbnail.across_m, -3 * SIDE / thumbnail.across_m], abs=0.2
    )


def test_a_walk_along_a_course_shows_the_course(tiny_run: Path) -> None:
    for name in ("poses", "target"):
        (tiny_run / f"{name}.parquet").unlink()
    (thumbnail,) = thumbnails(tiny_run.parent, [tiny_run.name])
    assert [color for color, _ in thumbnail.lines] == ["note", "resim"]


def test_damaged_foreign_and_hostile_folders_have_no_thumbnail(tiny_run: Path) -> None:
    shutil.copytree(tiny_run, tiny_run.parent / "torn")
    (tiny_run.parent / "torn" / "target.parquet").write_bytes(b"PAR1")
    (tiny_run.parent / "runs").mkdir()
    names = ["torn", "missing", "..", f"../{tiny_run.parent.name}/walk", "</svg><script>"]
    assert thumbnails(tiny_run.parent, names) == []
    assert thumbnails(tiny_run.parent / "runs", ["../walk"]) == []
    assert len(thumbnails(tiny_run.parent, ["walk"] * (MAX_THUMBNAILS + 5))) == MAX_THUMBNAILS


def test_runs_of_inner_folders_are_rows_linked_to_their_pages(tiny_original: Path, tmp_path: Path) -> None:
    _summary(tmp_path, recording=["walk"], exit_code=[0], reason=[""], eta_m=[1.0])
    for name in ("walk", "line-fpmw/seed-000", "line-fpmw/seed-001"):
        shutil.copytree(tiny_original, tmp_path / name)
    (tmp_path / "line-fpmw" / "seed-000" / "report.html").write_text("")
    (tmp_path / "line-fpmw" / "seed-001" / "run.json").unlink()
    page = write_folder_report(tmp_path).read_text()
    assert f"{tmp_path.name}: 3 recordings" in page
    assert len(find_runs([tmp_path])) == 3
    _, inner, stopped = _rows(page)
    assert '<a href="./line-fpmw/seed-000/report.html">line-fpmw/seed-000</a>' in inner
    assert 'data-value="0.123">0.123<' in inner
    assert ">3 with loss<" in inner
    assert ">1 failed<" in stopped
    assert "no run.json" in stopped
