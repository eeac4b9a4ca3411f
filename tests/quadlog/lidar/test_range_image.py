from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.lidar.classified_scan import valid_points
from quadlog.lidar.range_image import (
    ELEVATION_BINS,
    Image,
    beams_by_elevation,
    beams_by_ring,
    phase_and_strangers,
    to_polar,
)

RANGES_M = (0.3, 30.0)
LEVEL = np.stack([np.eye(4, dtype=np.float32)[:3], np.zeros((3, 4), np.float32)])


@given(arrays(np.float32, (30, 3), elements=st.floats(-40, 40, width=32) | st.sampled_from([0, np.nan, np.inf, 1e30])))
def test_directions_agree_with_numpy(cloud: np.ndarray) -> None:
    polar = to_polar(tuple(cloud.T.copy()), (0.3, 30.0))
    # Distances are computed in float32: those at a limit may fall on either side.
    sure = valid_points(cloud, 0.300001, 29.9999) | ~valid_points(cloud, 0.299999, 30.0001)
    assert ((polar.range_m > 0) == valid_points(cloud, 0.3, 30.0))[sure].all()
    valid = polar.range_m > 0
    points = cloud[valid].astype(np.float64)
    range_m = np.linalg.norm(points, axis=1)
    assert np.allclose(polar.range_m[valid], range_m, rtol=1e-6)
    assert np.allclose(polar.sine[valid], points[:, 2] / range_m, atol=1e-6)
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    assert np.abs((polar.turn[valid] - turn + 0.5) % 1 - 0.5).max(initial=0) < 1e-6
    assert ((polar.turn >= 0) & (polar.turn < 1)).all()


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


def test_random_elevations_show_no_beams() -> None:
    random = np.random.default_rng(0)
    polar = to_polar(tuple(random.normal(0, 3, (3, 5000)).astype(np.float32)), RANGES_M)
    assert beams_by_elevation(polar, upright=True) is None
    assert beams_by_ring(polar, random.integers(0, 16, 5000).astype(np.uint16), upright=True) is None


def laid(xyz_m, ring, beams) -> tuple[Image, np.ndarray]:
    """The image of the points, and which point is in every cell and behind them."""
    phase, strangers = phase_and_strangers(xyz_m, ring, beams, RANGES_M)
    assert strangers == 0.0
    image = Image(beams.rows, beams.columns, len(ring))
    point = np.full(image.rows * image.columns + image.room, -1, np.int32)
    image.lay(xyz_m, ring, np.zeros(len(ring), np.uint8), beams, LEVEL, RANGES_M, phase, point)
    return image, point[: image.rows * image.columns + image.n_others]


@pytest.mark.parametrize("columns", [360, 900, 1800, 1875])
@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, -0.4])
def test_every_point_gets_a_cell_of_its_own(sweep, columns: int, phase: float) -> None:
    xyz_m, ring = sweep(columns, phase, [-15, -5, 5, 15])
    beams = beams_by_ring(to_polar(xyz_m, RANGES_M), ring, upright=True)
    assert beams is not None
    assert beams.columns == columns
    image, point = laid(xyz_m, ring, beams)
    assert (image.n_others, image.n_valid) == (0, 4 * columns)
    assert sorted(point.tolist()) == list(range(4 * columns))
    for axis, place_m in enumerate((image.dx_m, image.dy_m, image.z_m)):
        np.testing.assert_array_equal(place_m[: 4 * columns], xyz_m[axis][point])


@pytest.mark.parametrize("nearer_first", [True, False])
def test_a_cell_holds_its_nearest_return(sweep, nearer_first: bool) -> None:
    far, ring = sweep(360, 0.0, [-15.0, -5.0, 5.0], 8.0)
    near, _ = sweep(360, 0.0, [-15.0, -5.0, 5.0], 3.0)
    beams = beams_by_ring(to_polar(far, RANGES_M), ring, upright=True)
    assert beams is not None
    order = (near, far) if nearer_first else (far, near)
    both = tuple(np.concatenate(pair) for pair in zip(*order, strict=True))
    image, point = laid(both, np.tile(ring, 2), beams)
    n = len(ring)
    assert (image.n_others, image.layers) == (n, 2)
    assert image.range_m[0] == pytest.approx(3.0)
    assert image.range_m[1] == pytest.approx(8.0)
    assert ((point[:n] < n) == nearer_first).all()
    assert sorted(point.tolist()) == list(range(2 * n))
    np.testing.assert_array_equal(image.dx_m[: 2 * n], both[0][point])
