from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.config.file import load_config
from quadlog.errors import NotARun, TooSteep, UnknownName
from quadlog.mapping.accumulated_map import OCCUPIED
from quadlog.pipelines.simulation.courses import (
    LEAST_POINTS,
    MARGIN_M,
    NEAR_M,
    SeenGround,
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
    assert ground_remarks(BEND, config).warnings == ()
    assert "SHA-256" in ground_remarks(BEND, config).notes[0]


def test_steep_ground_is_refused_where_the_course_goes_and_let_be_elsewhere(tmp_path):
    height_m = np.zeros((60, 60))
    height_m[-3:, -3:] = 4.0
    config = _config(_run(tmp_path / "run", height_m))
    assert make_ground("bend", BEND, config, 0).too_steep_for(0.8) is None
    height_m[30:, 36:] = 4.0
    with pytest.raises(TooSteep, match="choose another terrain"):
        make_ground("bend", BEND, _config(_run(tmp_path / "run", height_m)), 0)


def test_what_is_no_terrain_is_refused_with_the_choices(tmp_path):
    for ask in (lambda config: make_ground("bend", BEND, config, 0), lambda config: ground_remarks(BEND, config)):
        with pytest.raises(UnknownName, match="3cm, 6cm, a run folder, course, flat"):
            ask(_config("simulation.terrain=9cm"))
        with pytest.raises(NotARun, match="saw no ground"):
            ask(_config(f"simulation.terrain={tmp_path}"))
        with pytest.raises(NotARun, match=f"none of its cells holds {LEAST_POINTS} points"):
            ask(_config(_run(tmp_path / "empty", np.full((4, 4), np.nan))))


def _seen(run: Path) -> SeenGround:
    seen = seen_ground(run)
    assert seen is not None
    return seen


def test_cells_that_were_seen_often_enough_are_taken_and_the_rest_is_as_the_nearest(tmp_path):
    height_m, count = np.zeros((20, 20)), np.full((20, 20), LEAST_POINTS)
    height_m[:, 10:] = 0.02
    height_m[4, 4], count[4, 4] = 9.0, LEAST_POINTS - 1
    height_m[15, 4] = 9.0  # alone, and no step
    height_m[5, 5] = np.nan
    seen = _seen(_write(tmp_path, height_m, count))
    assert len(seen.seen_m) == 400 - 2
    at = [-2 + 4.5 * CELL_M, -2 + 4.5 * CELL_M]
    assert not (np.abs(seen.seen_m - at).max(axis=1) < 1e-9).any()
    heights = seen.ground.height_at(np.array([at, [-1.1, 1.1], [-1.0, 1.0], [1.0, 1.0]]))
    np.testing.assert_allclose(heights, [0.0, 0.0, 0.0, 0.02], atol=1e-7)


@given(
    st.lists(st.tuples(st.floats(-8, 8), st.floats(-8, 8)), min_size=2, max_size=5, unique=True),
    st.integers(0, 2**32 - 1),
)
def test_what_lies_beyond_is_as_long_as_brute_force_finds(tmp_path, points, seed):
    path_m = np.array(points)
    length_m = np.hypot(*np.diff(path_m, axis=0).T).sum()
    if length_m < 0.2:
        return
    count = np.where(np.random.default_rng(seed).random((20, 20)) < 0.05, LEAST_POINTS, 0)
    count[0, 0] = LEAST_POINTS
    seen = _seen(_write(tmp_path, np.zeros((20, 20)), count))
    rows, cols = np.nonzero(count)
    centres_m = -2 + CELL_M * (np.stack([cols, rows], axis=1) + 0.5)
    fine = np.concatenate([np.linspace(a, b, max(int(np.hypot(*(b - a)) / 0.01), 2)) for a, b in pairwise(path_m)])
    away_m = np.hypot(*(fine[:, None] - centres_m).transpose(2, 0, 1)).min(axis=1)
    said = seen.beyond(path_m)
    if said is None:
        # Nothing but what lies between the middles of pieces of 0.1 m.
        longest = max(map(len, "".join(np.where(away_m > NEAR_M, "x", " ")).split()), default=0)
        assert longest * 0.01 < 0.12
        return
    found = re.match(r"([\d.]+) of the course's ([\d.]+) m, the first at \((\S+), (\S+)\) m", said)
    assert found is not None
    beyond_m, whole_m, x_m, y_m = map(float, found.groups())
    assert whole_m == pytest.approx(length_m, abs=0.06)
    assert beyond_m == pytest.approx((away_m > NEAR_M).mean() * length_m, abs=0.3 + 0.05 * length_m)
    assert np.hypot(*(centres_m - [x_m, y_m]).T).min() > NEAR_M - 0.2


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
