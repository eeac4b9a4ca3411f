from __future__ import annotations

import numpy as np

from quadlog.mapping.accumulated import FREE, OCCUPIED, UNKNOWN, AccumulatedMap, _carve
from quadlog.mapping.window import Window, window_around


def grid(window: Window, *cells: tuple[int, int]) -> np.ndarray:
    occupied = np.zeros(window.shape, dtype=np.bool_)
    for col, row in cells:
        occupied[row, col] = True
    return occupied


def test_ray_is_free_up_to_the_first_occupied_cell() -> None:
    window = Window(0, 0, 1.0, (5, 10))
    whole = AccumulatedMap(1.0)
    whole.add(window, grid(window, (5, 2), (8, 2)), np.array([1.5, 2.5]))
    cells, held = whole.to_cells()
    assert held == window
    expected = np.full((5, 10), UNKNOWN)
    expected[2, 1:5] = FREE
    expected[2, [5, 8]] = OCCUPIED
    assert cells.tolist() == expected.tolist()
    assert cells.dtype == np.int8


def test_rays_are_lines() -> None:
    """Every cell of a ray lies within half a cell of the straight line, and the ray has no gap."""
    for col in range(41):
        for row in range(41):
            occupied = np.zeros((41, 41), dtype=np.bool_)
            occupied[row, col] = True
            passed = np.zeros_like(occupied)
            _carve(occupied, 20, 20, passed)
            dx, dy = col - 20, row - 20
            assert passed.sum() == max(abs(dx), abs(dy))
            if dx or dy:
                ys, xs = np.nonzero(passed)
                off = np.abs((xs - 20) * dy - (ys - 20) * dx) / max(abs(dx), abs(dy))
                assert off.max() <= 0.5


def test_a_cell_is_occupied_by_its_share_of_hits() -> None:
    window = Window(0, 0, 1.0, (1, 10))
    robot = np.array([0.5, 0.5])
    for hits, passes, expected in ((3, 7, OCCUPIED), (2, 7, FREE), (1, 0, OCCUPIED)):
        whole = AccumulatedMap(1.0)
        for _ in range(hits):
            whole.add(window, grid(window, (4, 0)), robot)
        for _ in range(passes):
            whole.add(window, grid(window, (9, 0)), robot)
        assert whole.to_cells()[0][0, 4] == expected


def test_a_cell_counts_once_per_map_and_as_a_hit_first() -> None:
    window = Window(0, 0, 1.0, (3, 9))
    whole = AccumulatedMap(1.0)
    seen = np.ones(window.shape, dtype=np.bool_)
    whole.add(window, grid(window, (8, 0), (8, 1), (8, 2)), np.array([0.5, 1.5]), seen_free=seen)
    assert whole._lattice.view("passes", window).tolist() == [[1] * 8 + [0]] * 3
    assert whole.to_cells()[0].tolist() == [[FREE] * 8 + [OCCUPIED]] * 3


def test_sliding_windows_agree_with_one_fixed_array() -> None:
    random = np.random.default_rng(0)
    whole = AccumulatedMap(0.5)
    counts = np.zeros((400, 400), dtype=np.int64)
    for position in np.cumsum(random.uniform(-3, 5, (40, 2)), axis=0) - 30:
        window = window_around(position, 0.5, 20)
        occupied = random.random((20, 20)) < 0.1
        whole.add(window, occupied, np.array([1e6, 0.0]))  # seen from outside: no rays
        counts[window.row0 + 200 : window.row0 + 220, window.col0 + 200 : window.col0 + 220] += occupied
    cells, held = whole.to_cells()
    rows, cols = held.shape
    inside = counts[held.row0 + 200 : held.row0 + 200 + rows, held.col0 + 200 : held.col0 + 200 + cols]
    assert inside.sum() == counts.sum()
    assert (whole._lattice.view("hits", held) == inside).all()
    assert ((cells == OCCUPIED) == (inside > 0)).all()
    assert whole.skipped == 0


def test_a_pose_far_off_is_skipped_and_counted() -> None:
    whole = AccumulatedMap(0.1, most_cells=1000 * 1000)
    for x_m in (0.0, 1e7, 5.0, -1e15):
        window = window_around(np.array([x_m, 0.0]), 0.1, 200)
        whole.add(window, grid(window, (3, 3)), np.array([x_m, 0.0]))
    cells, held = whole.to_cells()
    assert whole.skipped == 2
    assert cells.shape == held.shape == (200, 250)
    assert (cells == OCCUPIED).sum() == 2


def test_nothing_added_is_none() -> None:
    assert AccumulatedMap(0.1).to_cells() is None
