import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.page.folder_report import HEIGHT, MAX_RUNS, MAX_THUMBNAILS, SIDE, WIDTH, metric_charts, thumbnails

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
