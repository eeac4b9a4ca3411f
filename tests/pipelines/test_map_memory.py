"""What maps remember of a walk behind a person, against where everybody really was and what the lidar could see."""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.results.arrays import load_maps
from quadlog.simulation.sensors.lidar import part_centres, ray_ranges
from quadlog.simulation.sensors.trajectory import Walk
from quadlog.simulation.synthetic.follow import synthesize
from quadlog.simulation.synthetic.recording import IMU_TOPIC, LIDAR_TOPIC, ROBOT_TRUTH_TOPIC, START_NS, TF_STATIC_TOPIC
from quadlog.simulation.synthetic.writer import McapRecording, write_recording
from tests.lab.clouds import from_obstacle

RECORDING = synthesize(seed=0, duration_s=4.5, azimuth_steps=450)
SITE = RECORDING.site
CELL_M, HALF_WINDOW_M = 0.1, 10.0
REACH_M = 0.3
"""How far a person's body reaches, legs in mid-stride included."""
NOISE_M = 0.15
"""Range noise and half a cell spread what is seen."""

Cells = set[tuple[int, int]]


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Cells]:
    """Occupied cells of the lattice at every map's time. The target has no body: people block as all else does."""
    folder = tmp_path_factory.mktemp("memory")
    wanted = (TF_STATIC_TOPIC, IMU_TOPIC, ROBOT_TRUTH_TOPIC, LIDAR_TOPIC)
    messages = (each for each in RECORDING.messages() if each.topic in wanted)
    write_recording(McapRecording(folder / "follow.mcap"), messages)
    config = load_config(None, [f"topics.position={ROBOT_TRUTH_TOPIC}", "topics.target=ahead"], {})
    request = ReplayRequest(folder / "follow.mcap", folder / "run", config, ReplayOptions(until="map"), plots=False)
    assert replay(request, Silent()).exit_code == 0
    return {each.t_ns: on_lattice(each) for each in load_maps(folder / "run")}


def on_lattice(each) -> Cells:
    cells = np.argwhere(each.occupied)[:, ::-1] + np.rint(each.origin_m / CELL_M).astype(int)
    return {(col, row) for col, row in cells.tolist()}


def seconds(t_ns: int) -> float:
    """When a scan at t_ns is half done."""
    return (t_ns - START_NS) * 1e-9 + 0.05


def centres(cells: np.ndarray) -> np.ndarray:
    return (cells + 0.5) * CELL_M


def lidar_m(t_s: float) -> np.ndarray:
    place_m = RECORDING.transform_lidar_to_base[:3, 3]
    assert place_m[:2].tolist() == [0, 0]
    return np.append(SITE.robot.at(np.array([t_s])).position_m[0], place_m[2])


def in_the_way_m(points_m: np.ndarray, t_s: float) -> np.ndarray:
    """How much of the way from the lidar to points (N, 3) is left behind the first thing on it; below 0: none on it."""
    origin_m = np.broadcast_to(lidar_m(t_s), points_m.shape)
    far_m = np.linalg.norm(points_m - origin_m, axis=1)
    direction = (points_m - origin_m) / far_m[:, None]
    first_m = RECORDING.caster.cast(origin_m, direction).range_m
    for person in (SITE.person, SITE.passer_by):
        parts_m = np.repeat(part_centres(person, np.array([t_s])), len(points_m), axis=0)
        first_m = np.minimum(first_m, ray_ranges(origin_m, direction, parts_m))
    return far_m - first_m


def hidden(cells: np.ndarray, t_s: float) -> np.ndarray:
    """Which cells (N, 2) no ray can reach, at whatever height that blocks a robot, nor a cell beside them."""
    xy_m, origin_m = centres(cells), lidar_m(t_s)[:2]
    aside = (xy_m - origin_m)[:, ::-1] * [-1, 1] / np.linalg.norm(xy_m - origin_m, axis=1)[:, None]
    left_m = [
        in_the_way_m(np.column_stack([xy_m + across_m * aside, np.full(len(xy_m), height_m)]), t_s)
        for height_m in (0.1, 0.4, 0.8, 1.2, 1.5)
        for across_m in (-CELL_M, 0.0, CELL_M)
    ]
    return np.min(left_m, axis=0) > 0.3


def from_what_stands(places_m: np.ndarray) -> np.ndarray:
    return np.min([from_obstacle(each, places_m) for each in SITE.obstacles], axis=0)


def left_for_good(person: Walk, t_ns: list[int], after_s: float) -> list[tuple[int, tuple[int, int]]]:
    """Every time and cell that the person was in, left at least after_s ago, and that was in sight ever since."""
    fine_s = np.arange(0, seconds(t_ns[-1]), 0.02)
    way_m = person.at(fine_s).position_m
    low, high = np.floor(way_m.min(axis=0) / CELL_M) - 4, np.ceil(way_m.max(axis=0) / CELL_M) + 4
    cols, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    cells = np.column_stack([cols.ravel(), rows.ravel()]).astype(int)
    xy_m = centres(cells)
    away_m = np.linalg.norm(xy_m[:, None] - way_m, axis=2)
    clear = from_what_stands(xy_m) > 0.3
    for other in (SITE.person, SITE.passer_by):
        if other is not person:
            clear &= np.linalg.norm(xy_m[:, None] - other.at(fine_s).position_m, axis=2).min(axis=1) > 1.0
    floor = np.column_stack([xy_m, np.full(len(xy_m), 0.2)])
    in_sight = np.array([in_the_way_m(floor, seconds(each)) < -NOISE_M for each in t_ns])
    found = []
    for index, now_ns in enumerate(t_ns):
        past = fine_s <= seconds(now_ns)
        near = away_m[:, past] <= REACH_M + NOISE_M
        last_s = np.where(near, fine_s[past], -np.inf).max(axis=1)
        gone = clear & (away_m[:, past] <= REACH_M).any(axis=1) & (last_s <= seconds(now_ns) - after_s)
        since = np.array([seconds(each) for each in t_ns[: index + 1]])[:, None] >= last_s
        gone &= (in_sight[: index + 1] | ~since).all(axis=0)
        found += [(now_ns, (int(col), int(row))) for col, row in cells[gone]]
    return found


def test_who_walked_away_leaves_nothing_behind_for_half_a_second(maps):
    """Wherever the lidar can see that it is free; a person who is still there is in the map."""
    times = sorted(maps)
    left = [each for who in (SITE.person, SITE.passer_by) for each in left_for_good(who, times, 0.5)]
    assert len(left) > 2000
    assert [(t_ns, cell) for t_ns, cell in left if cell in maps[t_ns]] == []
    for t_ns in times:
        person_m = SITE.person.at(np.array([seconds(t_ns)])).position_m[0]
        occupied_m = centres(np.array(sorted(maps[t_ns])))
        assert np.linalg.norm(occupied_m - person_m, axis=1).min() < REACH_M


def hidden_since(cells: np.ndarray, t_ns: list[int]) -> np.ndarray:
    """(T, N) seconds for which each cell was hidden without a break, at every time; 0 where it is not."""
    since_s = np.zeros((len(t_ns), len(cells)))
    for index, now_ns in enumerate(t_ns):
        step_s = 0.0 if index == 0 else seconds(now_ns) - seconds(t_ns[index - 1])
        before_s = since_s[index - 1] if index else np.zeros(len(cells))
        since_s[index] = np.where(hidden(cells, seconds(now_ns)), before_s + step_s, 0.0)
    return since_s


def test_what_is_hidden_for_two_seconds_stays(maps):
    """Behind a person, a tree or a box; what the window has left behind is another matter."""
    times = sorted(maps)
    cells = np.array(sorted(set.union(*maps.values())))
    cells = cells[from_what_stands(centres(cells)) < 0.1]
    hidden_s = hidden_since(cells, times)
    occupied = np.array([[tuple(cell) in maps[t_ns] for cell in cells.tolist()] for t_ns in times])
    robot_m = SITE.robot.at(np.array([seconds(t_ns) - 0.05 for t_ns in times])).position_m
    inside = np.abs(centres(cells) - robot_m[:, None]).max(axis=2) < HALF_WINDOW_M - CELL_M
    checked = 0
    for index in range(1, len(times)):
        scans_ago = np.rint(hidden_s[index] * 10).astype(int)
        chosen = np.flatnonzero((scans_ago > 0) & (scans_ago <= 20) & (scans_ago <= index))
        seen_at = index - scans_ago[chosen]
        stayed = chosen[occupied[seen_at, chosen] & inside[:, chosen].all(axis=0)]
        checked += len(stayed)
        lost = stayed[~occupied[index, stayed]]
        assert cells[lost].tolist() == [], f"gone at {seconds(times[index]):.2f} s"
    assert checked > 500
