from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.control.following.path import lookahead_within, nearest_on_path
from quadlog.metrics.summary import worst_instants
from quadlog.results.player.moments import moments_of
from quadlog.results.player.scene import MAX_POSES, STEP_S, Scene, lookahead_point, pose_at, row_at, scene_of
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.maps import load_maps
from quadlog.results.run.tables import TABLES, read_table, write_table


def _scene(run: Path) -> Scene:
    scene = scene_of(RunData(run))
    assert scene is not None
    return scene


def test_everything_stands_where_the_tables_have_it(tiny_original: Path) -> None:
    scene, run = _scene(tiny_original), RunData(tiny_original)
    assert [track.key for track in scene.tracks] == ["target", "poses", "control"]
    for track in scene.tracks:
        table = read_table(tiny_original, track.key)
        for instant_s, x_m, y_m in zip(run.seconds(table["t_ns"]), table["x_m"], table["y_m"], strict=True):
            pose = pose_at(track, float(instant_s))
            assert pose is not None
            assert pose[:2] == pytest.approx((x_m, y_m), abs=0.02)  # poses in between are left out
        assert pose_at(track, float(track.seconds[0]) - 0.01) is None
        assert pose_at(track, float(track.seconds[-1]) + 1.5) is None
    (windows,) = scene.windows
    for k, window in enumerate(load_maps(tiny_original)):
        instant_s = float(run.seconds(np.array([window.t_ns]))[0])
        row = row_at(windows.seconds, instant_s)
        assert row == k
        corner_m = windows.origin_m + windows.cell[row] * windows.maps.cell_m
        assert corner_m == pytest.approx(window.origin_m, abs=1e-6)
    assert [(round(each.seconds, 3), each.collision) for each in scene.contacts] == [(0.8, False), (1.8, True)]
    assert scene.thinned == []


def test_turning_through_south_takes_the_short_way(tiny_run: Path, change: Callable[..., None]) -> None:
    change(tiny_run, "poses", yaw_rad=np.where(np.arange(40) % 2, 3.1, -3.1))
    (robot,) = [track for track in _scene(tiny_run).tracks if track.key == "poses"]
    pose = pose_at(robot, 0.05)
    assert pose is not None
    assert abs(np.cos(pose[2]) + 1) < 1e-6


@pytest.mark.parametrize(
    ("gone", "left"),
    [
        (
            ("maps.npz", "control.parquet", "paths.parquet", "resim_paths.parquet", "contacts.parquet"),
            {"target", "poses"},
        ),
        (("poses.parquet", "target.parquet", "cloud_samples.npz"), {"control"}),
        (("poses.parquet", "target.parquet", "control.parquet"), set()),
    ],
)
def test_a_run_that_stopped_early_shows_what_there_is(tiny_run: Path, gone: tuple[str, ...], left: set[str]) -> None:
    for name in gone:
        (tiny_run / name).unlink()
    run = RunData(tiny_run)
    scene = scene_of(run)
    assert {track.key for track in scene.tracks} == left if scene else not left
    if scene:
        assert all(scene.from_s <= each.seconds <= scene.until_s for each in moments_of(run, scene))


def test_a_long_run_is_thinned_and_says_so(tiny_run: Path) -> None:
    poses = read_table(tiny_run, "poses")
    rows = 2 * MAX_POSES
    first_ns = int(poses["t_ns"][0])
    t_ns = first_ns + np.arange(rows, dtype=np.int64) * round(STEP_S * 1e9)
    long: dict[str, Any] = {"t_ns": t_ns, "x_m": np.linspace(0, 400, rows), "y_m": 0.0, "yaw_rad": 0.0, "source": "tf"}
    long |= dict.fromkeys(("z_m", "roll_rad", "pitch_rad"), np.nan)
    write_table(tiny_run / "poses.parquet", TABLES["poses"], long)
    scene = _scene(tiny_run)
    (robot,) = [track for track in scene.tracks if track.key == "poses"]
    assert len(robot.seconds) <= MAX_POSES + 1
    assert robot.seconds[-1] == scene.until_s
    assert scene.thinned == ["a pose of the logged robot every 0.08 s"]


def test_places_far_beyond_a_map_are_not_drawn(tiny_run: Path, change: Callable[..., None]) -> None:
    change(tiny_run, "poses", x_m=lambda x_m: np.where(np.arange(40) == 7, 1e11, x_m))
    assert abs(np.array(_scene(tiny_run).extent_m())).max() < 100


def test_the_lookahead_point_is_that_of_the_controller() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        path_m = np.cumsum(rng.uniform(0.01, 0.2, (40, 2)), axis=0)  # never turns back
        x_m, y_m = path_m[0] + rng.normal(0, 0.05, 2)
        reach_m = float(rng.uniform(0.3, 3.0))
        near = nearest_on_path(path_m, x_m, y_m)
        x, y, _ = lookahead_within(path_m, x_m, y_m, near, reach_m, np.inf)
        assert lookahead_point(path_m, x_m, y_m, reach_m) == pytest.approx((x, y), abs=0.01)


def test_worst_instants_are_the_largest_samples(tiny_original: Path) -> None:
    run = RunData(tiny_original)
    run.metrics  # noqa: B018
    moments = moments_of(run, _scene(tiny_original))
    control = read_table(tiny_original, "control")
    (row,) = worst_instants(control["t_ns"], control["error_m"], 1)
    (worst,) = [each for each in moments if each.what == "eta_m"]
    assert worst.seconds == pytest.approx(float(run.seconds(control["t_ns"])[row]))
    assert worst.value == control["error_m"][row] == control["error_m"].max()
    assert [each.what for each in moments if each.kind == "contacts"] == [
        "collision: the robot cut a corner of its plan",
        "no collision: appeared inside the body",
    ]
