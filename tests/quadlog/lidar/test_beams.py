from __future__ import annotations

import numpy as np
import pytest

from quadlog.lidar.range_image import ELEVATION_BINS, beams_by_elevation, beams_by_ring, to_polar

RANGES_M = (0.3, 30.0)


@pytest.mark.parametrize("upright", [True, False])
def test_rows_go_from_the_lowest_beam_up(sweep, upright: bool) -> None:
    xyz_m, ring = sweep(360, 0.0, [3.0, -9.0, 11.0, -1.0])
    beams = beams_by_ring(to_polar(xyz_m, RANGES_M), ring, upright)
    assert beams is not None
    assert (beams.first_cell[:4] // beams.columns).tolist() == ([2, 0, 3, 1] if upright else [1, 3, 0, 2])
    assert beams.descending.tolist() == [True, True, False, False]
    assert (beams.first_cell[4:] == -1).all()


def test_beams_show_in_the_elevations(sweep) -> None:
    xyz_m, ring = sweep(360, 0.0, [-15.0, -13.0, -7.0, 2.0])
    polar = to_polar(xyz_m, RANGES_M)
    beams = beams_by_elevation(polar, upright=True)
    assert beams is not None
    bins = ((polar.sine + 1) * (ELEVATION_BINS / 2)).astype(int)
    assert (beams.first_cell[bins] // beams.columns).tolist() == ring.tolist()


def test_elevations_of_any_size_show_no_beams() -> None:
    random = np.random.default_rng(0)
    polar = to_polar(tuple(random.normal(0, 3, (3, 5000)).astype(np.float32)), RANGES_M)
    assert beams_by_elevation(polar, upright=True) is None
    assert beams_by_ring(polar, random.integers(0, 16, 5000).astype(np.uint16), upright=True) is None
