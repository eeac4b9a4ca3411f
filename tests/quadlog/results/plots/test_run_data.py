from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from quadlog.results.plots import run_data as occupancy
from quadlog.results.plots.run_data import accumulate, seen_around
from quadlog.results.run.maps import MapsWriter, load_maps


def _write(path: Path, maps: list[tuple[tuple[float, float], np.ndarray]], cell_m: float = 0.5) -> None:
    with MapsWriter(path / "maps.npz", cell_m, (4, 6)) as writer:
        for t_ns, (origin_m, occupied) in enumerate(maps):
            writer.append(t_ns, np.array(origin_m), occupied)


def test_share_is_occupied_maps_over_covering_maps(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    corners = [(0, 0), (3, -1), (3, -1), (-2, 5)]  # column, row
    maps = [((c * 0.5, r * 0.5), rng.random((4, 6)) < 0.5) for c, r in corners]
    _write(tmp_path, maps)
    hits: Counter[tuple[int, int]] = Counter()
    seen: Counter[tuple[int, int]] = Counter()
    for (column, row), (_, occupied) in zip(corners, maps, strict=True):
        for i in range(4):
            for j in range(6):
                seen[row + i, column + j] += 1
                hits[row + i, column + j] += int(occupied[i, j])
    share = accumulate(load_maps(tmp_path))
    assert share.origin_m.tolist() == [-1.0, -0.5]
    assert share.extent_m == (-1.0, 4.5, -0.5, 4.5)
    assert share.share.shape == (10, 11)
    for i in range(10):
        for j in range(11):
            cell = (i - 1, j - 2)
            expected = hits[cell] / seen[cell] if seen[cell] else np.nan
            np.testing.assert_equal(share.share[i, j], expected)


def test_a_vast_area_is_drawn_coarser_instead_of_filling_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(occupancy, "MAX_CELLS", 400)
    _write(tmp_path, [((0.0, 0.0), np.ones((4, 6), bool)), ((100.0, 50.0), np.ones((4, 6), bool))])
    share = accumulate(load_maps(tmp_path))
    assert share.share.size <= 400
    assert share.cell_m > 0.5
    assert share.share[0, 0] == 1
    assert share.share[-1, -1] == 1
    assert np.isnan(share.share[0, -1])


def test_windows_absurdly_far_away_are_left_out(tmp_path: Path) -> None:
    _write(tmp_path, [((1e300, 0.0), np.ones((4, 6), bool)), ((0.0, 0.0), np.ones((4, 6), bool))])
    share = accumulate(load_maps(tmp_path))
    assert share.share.shape == (4, 6)
    (tmp_path / "far").mkdir()
    _write(tmp_path / "far", [((1e300, 0.0), np.ones((4, 6), bool))])
    assert accumulate(load_maps(tmp_path / "far")) is None


def test_what_a_standing_robot_saw_is_shown_around_it(tmp_path: Path) -> None:
    occupied = np.zeros((4, 6), bool)
    occupied[1, 2] = occupied[3, 4] = True  # rows and columns: y and x
    _write(tmp_path, [((10.0, -20.0), occupied)])
    share = accumulate(load_maps(tmp_path))
    standing_m, walking_m = np.array([[0.0, 0.0], [0.9, 0.1]]), np.array([[0.0, 0.0], [0.0, 1.0]])
    assert seen_around(standing_m, share).tolist() == [[11.0, -19.5], [12.5, -18.0]]
    assert len(seen_around(walking_m, share)) == 0
    assert len(seen_around(np.zeros((0, 2)), share)) == 0
    assert len(seen_around(standing_m, None)) == 0


def test_a_map_without_obstacles_has_no_corners(tmp_path: Path) -> None:
    _write(tmp_path, [((0.0, 0.0), np.zeros((4, 6), bool))])
    share = accumulate(load_maps(tmp_path))
    assert share.corners_m.shape == (0, 2)
