from __future__ import annotations

import numpy as np
import pytest

from quadlog.lidar.ground_columns import drop_pieces

COLUMNS = 360
PIECE = slice(100, 110)
POSSIBLE, DROPPED = 2, 3


def after_dropping(
    piece: slice | np.ndarray = PIECE, piece_range_m=4.5, off_m=0.12, seen=None, slope_on: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """ground and kind of a beam on flat ground 5 m away, of which a piece stands out by off_m at another range.

    slope_on: how the next beam goes on from the piece, None where it sees nothing.
    """
    kind, ground = np.full(COLUMNS, POSSIBLE, np.int8), np.ones(COLUMNS, np.int8)
    range_m, off = np.full(COLUMNS, 5.0, np.float32), np.zeros(COLUMNS, np.float32)
    range_m[piece], off[piece] = piece_range_m, off_m
    if seen is not None:
        kind[~seen], ground[~seen] = 0, 0
    gap_m, rise_m = np.full(COLUMNS, 0.5, np.float32), off.copy()
    good = np.ones((2, COLUMNS), np.int8)
    distance_m, z_m = np.tile(range_m, (2, 1)), np.tile(rise_m, (2, 1))
    if slope_on is None:
        good[1] = 0
    else:
        distance_m[1] += 0.5
        z_m[1] += 0.5 * np.float32(slope_on)
    room = *np.zeros((2, COLUMNS + 1), np.int32), np.zeros(COLUMNS + 1, np.float32), np.zeros(COLUMNS + 1, np.int8)
    drop_pieces(kind, good, distance_m, z_m, range_m, 0, off, gap_m, rise_m, *room, ground)
    return ground, kind


@pytest.mark.parametrize("shift", [0, 95, 255])
def test_a_short_piece_that_stands_out_is_no_ground(shift: int) -> None:
    """Also across the seam of the turn."""
    piece = (np.arange(PIECE.start, PIECE.stop) + shift) % COLUMNS
    ground, kind = after_dropping(piece)
    assert np.flatnonzero(ground == 0).tolist() == sorted(piece.tolist())
    assert np.flatnonzero(kind == DROPPED).tolist() == sorted(piece.tolist())


def test_ground_seen_between_two_objects_remains_ground() -> None:
    """It has something nearer at both ends: the ground seen between two things."""
    ground, _ = after_dropping(piece_range_m=5.5)
    assert ground.all()


def test_nothing_beside_it_is_as_good_as_something_farther() -> None:
    seen = np.ones(COLUMNS, dtype=bool)
    seen[90:100] = seen[110:120] = False
    ground, _ = after_dropping(piece_range_m=5.0, seen=seen)
    assert not ground[PIECE].any()
    gap_of_two = np.ones(COLUMNS, dtype=bool)
    gap_of_two[98:100] = gap_of_two[110:112] = False
    ground, _ = after_dropping(piece_range_m=5.0, seen=gap_of_two)
    assert ground[PIECE].all(), "a gap of two returns is none"


@pytest.mark.parametrize(
    ("piece", "off_m"), [(slice(100, 140), 0.12), (PIECE, 0.065)], ids=["wider than a thing", "no higher than noise"]
)
def test_wide_or_low_pieces_remain_ground(piece: slice, off_m: float) -> None:
    ground, _ = after_dropping(piece, off_m=off_m)
    assert ground.all()


@pytest.mark.parametrize(("slope_on", "stays"), [(0.24, True), (0.0, False), (0.6, False)])
def test_a_piece_that_goes_on_as_it_came_is_a_ramp(slope_on: float, stays: bool) -> None:
    """It rises by 0.12 m in 0.5 m."""
    ground, _ = after_dropping(slope_on=slope_on)
    assert ground[PIECE].all() == stays


def test_a_beam_without_edges_or_returns_is_left_alone() -> None:
    ground, _ = after_dropping(piece_range_m=5.0)
    assert ground.all()
    ground, _ = after_dropping(seen=np.zeros(COLUMNS, dtype=bool))
    assert not ground.any()
