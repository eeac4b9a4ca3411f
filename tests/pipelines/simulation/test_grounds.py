from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.errors import NotARun, TooSteep
from quadlog.mapping.memory import OCCUPIED
from quadlog.pipelines.simulation.courses import (
    LEAST_POINTS,
    MARGIN_M,
    ground_remarks,
    make_ground,
    seen_ground,
    walkable_ground,
)
from quadlog.results.arrays import write_arrays
from quadlog.results.tables import TABLES, write_table
from quadlog.simulation.course_walk import Course
from quadlog.storage.formats.ros_map import write_rosmap

CELL_M = 0.2
BEND = Course("bend", np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]), 0.6)


def _config(*given):
    return load_config(None, given, {})


def _write(run: Path, height_m, count=None, origin_m=(-2.0, -2.0), cell_m=CELL_M) -> Path:
    run.mkdir(exist_ok=True)
    height_m = np.asarray(height_m, np.float64)
    count = np.full(height_m.shape, LEAST_POINTS, np.int64) if count is None else np.asarray(count, np.int64)
    write_arrays(run, "ground", {"origin_m": origin_m, "cell_m": cell_m, "height_m": height_m, "count": count})
    return run


def _run(folder: Path, height_m, origin_m=(-6.0, -6.0), cell_m=CELL_M) -> str:
    return f"simulation.terrain={_write(folder, height_m, None, origin_m, cell_m)}"


def test_a_run_folder_is_the_ground_it_saw(tmp_path):
    rng = np.random.default_rng(0)
    height_m = rng.uniform(0, 0.02, (60, 60))
    config = _config(_run(tmp_path / "run", height_m))
    ground = make_ground("bend", BEND, config, 0)
    rows, cols = np.meshgrid(np.arange(16, 47), np.arange(16, 47), indexing="ij")
    centres_m = -6 + 0.2 * (np.stack([cols.ravel(), rows.ravel()], axis=1) + 0.5)
    inside = (centres_m > -MARGIN_M).all(axis=1) & (centres_m < [2 + MARGIN_M, 1 + MARGIN_M]).all(axis=1)
    np.testing.assert_allclose(
        ground.height_at(centres_m[inside]), height_m[rows.ravel(), cols.ravel()][inside], atol=1e-6
    )
    again = make_ground("bend", BEND, config, 5)
    assert again.height_m.tobytes() == ground.height_m.tobytes()
    notes, warnings = ground_remarks(BEND, config)
    assert ("SHA-256" in notes[0], warnings) == (True, [])


def test_steep_ground_is_refused_where_the_course_goes_and_let_be_elsewhere(tmp_path):
    height_m = np.zeros((60, 60))
    height_m[-3:, -3:] = 4.0
    config = _config(_run(tmp_path / "run", height_m))
    assert make_ground("bend", BEND, config, 0).too_steep_for(0.8) is None
    height_m[30:, 36:] = 4.0
    with pytest.raises(TooSteep, match="choose another terrain"):
        make_ground("bend", BEND, _config(_run(tmp_path / "run", height_m)), 0)


def _walked(run: Path, y_m: float) -> Path:
    """A run that went along x at y_m."""
    x_m = np.linspace(-1.5, 1.5, 50)
    columns = {name: np.zeros(50) for name in TABLES["poses"].names} | {"x_m": x_m, "y_m": np.full(50, y_m)}
    write_table(run / "poses.parquet", TABLES["poses"], columns | {"t_ns": np.arange(50), "source": ["tf"] * 50})
    return run


@pytest.mark.parametrize(("y_m", "is_plane"), [(-1.5, False), (1.0, True)])
def test_a_replay_walks_on_what_it_saw_unless_that_is_steep_where_it_went(tmp_path, y_m, is_plane):
    height_m = np.zeros((20, 20))
    height_m[15:, 8:12] = 2.0
    ground, why_plane = walkable_ground(_walked(_write(tmp_path, height_m), y_m), 0.8)
    assert ground.is_plane == is_plane
    assert why_plane.startswith("the re-simulated robot walks on a plane: the ground rises") == is_plane


def test_what_looks_like_ground_upon_an_obstacle_of_the_map_is_none(tmp_path):
    height_m, cells = np.zeros((20, 20)), np.zeros((40, 40), np.int8)
    height_m[8:12, 8:12] = 2.0
    cells[16:24, 16:24] = OCCUPIED
    run = _walked(_write(tmp_path, height_m), 0.0)
    assert walkable_ground(run, 0.8)[0].is_plane
    write_rosmap(run, cells, np.array([-2.0, -2.0]), 0.1)
    ground, why_plane = walkable_ground(run, 0.8)
    assert not why_plane
    assert not ground.height_m.any()


def _with(row: int, value: float) -> np.ndarray:
    height_m = np.zeros((5, 5))
    height_m[row, row] = value
    return height_m


@pytest.mark.parametrize(
    "damage",
    [
        {"height_m": _with(2, 1e300)},
        {"height_m": _with(2, np.inf)},
        {"height_m": np.zeros((5, 5)), "origin_m": (1e300, 0.0)},
        {"height_m": np.zeros((5, 5)), "cell_m": 1e-9},
        {"height_m": np.zeros((5, 5)), "cell_m": 1e9},
    ],
)
def test_a_ground_that_is_nowhere_is_refused(tmp_path, damage):
    with pytest.raises(NotARun, match=r"ground\.npz: is damaged"):
        seen_ground(_write(tmp_path, **damage))
