from __future__ import annotations

import numpy as np
import pytest

from quadlog.lidar.range_image import Image, beams_by_ring, phase_and_strangers, to_polar

RANGES_M = (0.3, 30.0)
LEVEL = np.stack([np.eye(4, dtype=np.float32)[:3], np.zeros((3, 4), np.float32)])


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
def test_of_two_points_in_a_cell_the_nearer_stands_for_it(sweep, nearer_first: bool) -> None:
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
