from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadlog.mapping.memory import OCCUPIED
from quadlog.pipelines.simulation.courses import LEAST_POINTS, walkable_ground
from quadlog.results.arrays import write_arrays
from quadlog.results.tables import TABLES, write_table
from quadlog.storage.formats.ros_map import write_rosmap

CELL_M = 0.2


def _write(run: Path, height_m, count=None, origin_m=(-2.0, -2.0), cell_m=CELL_M) -> Path:
    run.mkdir(exist_ok=True)
    height_m = np.asarray(height_m, np.float64)
    count = np.full(height_m.shape, LEAST_POINTS, np.int64) if count is None else np.asarray(count, np.int64)
    write_arrays(run, "ground", {"origin_m": origin_m, "cell_m": cell_m, "height_m": height_m, "count": count})
    return run


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
