from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.lidar.beams import beams_by_ring
from quadlog.lidar.image import range_image
from quadlog.lidar.polar import Polar


@pytest.mark.parametrize("columns", [360, 900, 1800, 1875])
@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, -0.4])
def test_every_point_gets_a_cell_of_its_own(sweep, columns: int, phase: float) -> None:
    polar, ring = sweep(columns, phase, [-15, -5, 5, 15])
    beams = beams_by_ring(polar, ring, upright=True)
    assert beams is not None
    assert beams.columns == columns
    image = range_image(polar, beams, 0.0, 0.0)
    assert not image.doubled
    assert sorted(image.point.ravel().tolist()) == list(range(4 * columns))
    assert (image.point.ravel()[image.cell] == np.arange(4 * columns)).all()


def test_of_two_points_in_a_cell_the_nearer_stands_for_it(sweep) -> None:
    far, ring = sweep(360, 0.0, [-15.0, -5.0, 5.0], 8.0)
    near, _ = sweep(360, 0.0, [-15.0, -5.0, 5.0], 3.0)
    both = Polar(*(np.concatenate(pair) for pair in zip(far, near, strict=True)))
    beams = beams_by_ring(far, ring, upright=True)
    assert beams is not None
    image = range_image(both, replace(beams, beam=np.tile(ring, 2)), 0.0, 0.0)
    assert image.doubled
    assert image.range_m[0] == pytest.approx(3.0)
    assert image.range_m[1] == pytest.approx(8.0)
    assert (image.point >= len(ring)).all()
