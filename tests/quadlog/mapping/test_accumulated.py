from __future__ import annotations

import numpy as np

from quadlog.mapping.accumulated_map import FREE, OCCUPIED, AccumulatedMap
from quadlog.mapping.grid import Window, window_around
from quadlog.mapping.placing import NO_TOP, PlacedScan
from quadlog.mapping.ray_tracing import NO_RAY


def grid(window: Window, *cells: tuple[int, int]) -> np.ndarray:
    occupied = np.zeros(window.shape, dtype=np.bool_)
    for col, row in cells:
        occupied[row, col] = True
    return occupied


def add(whole: AccumulatedMap, window: Window, hit: np.ndarray, crossed: np.ndarray) -> None:
    top_mm = np.where(hit, np.int16(500), NO_TOP)
    # What is seen through above the robot says nothing.
    whole.add(window, PlacedScan(top_mm, np.where(crossed, np.int16(399), np.where(hit, NO_RAY, np.int16(400)))), 400)


def test_a_cell_is_occupied_by_its_share_of_hits() -> None:
    window = Window(0, 0, 1.0, (1, 10))
    nothing = grid(window)
    for hits, passes, expected in ((3, 7, OCCUPIED), (2, 7, FREE), (1, 0, OCCUPIED)):
        whole = AccumulatedMap(1.0)
        for _ in range(hits):
            add(whole, window, grid(window, (4, 0)), nothing)
        for _ in range(passes):
            add(whole, window, nothing, grid(window, (4, 0)))
        assert whole.to_cells()[0][0, 4] == expected


def test_a_cell_counts_once_per_map_and_as_a_hit_first() -> None:
    window = Window(0, 0, 1.0, (3, 9))
    whole = AccumulatedMap(1.0)
    assert whole.to_cells() is None
    seen = np.ones(window.shape, dtype=np.bool_)
    add(whole, window, grid(window, (8, 0), (8, 1), (8, 2)), seen)
    assert whole._lattice.view("passes", window).tolist() == [[1] * 8 + [0]] * 3
    assert whole.to_cells()[0].tolist() == [[FREE] * 8 + [OCCUPIED]] * 3


def test_sliding_windows_agree_with_one_fixed_array() -> None:
    random = np.random.default_rng(0)
    whole = AccumulatedMap(0.5)
    counts = np.zeros((400, 400), dtype=np.int64)
    for position in np.cumsum(random.uniform(-3, 5, (40, 2)), axis=0) - 30:
        window = window_around(position, 0.5, 20)
        occupied = random.random((20, 20)) < 0.1
        add(whole, window, occupied, np.zeros_like(occupied))
        counts[window.row0 + 200 : window.row0 + 220, window.col0 + 200 : window.col0 + 220] += occupied
    cells, held = whole.to_cells()
    rows, cols = held.shape
    inside = counts[held.row0 + 200 : held.row0 + 200 + rows, held.col0 + 200 : held.col0 + 200 + cols]
    assert inside.sum() == counts.sum()
    assert (whole._lattice.view("hits", held) == inside).all()
    assert ((cells == OCCUPIED) == (inside > 0)).all()
    assert whole.skipped == 0


def test_a_pose_far_off_is_skipped_and_counted() -> None:
    whole = AccumulatedMap(0.1)
    for x_m in (0.0, 1e7, 5.0, -1e15):
        window = window_around(np.array([x_m, 0.0]), 0.1, 200)
        add(whole, window, grid(window, (3, 3)), grid(window))
    cells, held = whole.to_cells()
    assert whole.skipped == 2
    assert cells.shape == held.shape == (200, 250)
    assert (cells == OCCUPIED).sum() == 2
