from __future__ import annotations

import numpy as np
import pytest

from quadlog.simulation.sensors.scene import FLAT, GROUND, RayCaster, ramp, slope, undulating


def wavy(seed: int = 0):
    return undulating(np.random.default_rng(seed), (3.0, -2.0), 15.0, band_m=0.06, correlation_m=1.0)


@pytest.mark.parametrize(
    "terrain", [FLAT, slope(0.3), ramp(0.3, 2.0, 4.0), wavy()], ids=["flat", "slope", "ramp", "wavy"]
)
def test_a_ray_straight_down_ends_at_the_height_that_is_told(terrain):
    rng = np.random.default_rng(1)
    xy = np.concatenate([rng.uniform(-20, 20, (3000, 2)), rng.uniform(-150, 150, (300, 2))])
    above = np.column_stack([xy, np.full(len(xy), 60.0)])
    hits = RayCaster((), terrain).cast(above, np.tile([0.0, 0.0, -1.0], (len(xy), 1)))
    assert (hits.what == GROUND).all()
    np.testing.assert_allclose(60.0 - hits.range_m, terrain.height_at(xy), atol=5e-5)


def test_a_slope_and_a_ramp_rise_by_their_angle():
    xy = np.random.default_rng(0).uniform(-90, 90, (100, 2))
    np.testing.assert_allclose(slope(0.3).height_at(xy), np.tan(0.3) * xy[:, 0], atol=1e-12)
    climbed_m = np.clip(xy[:, 0] - 2.0, 0.0, 4.0)
    np.testing.assert_allclose(ramp(0.3, 2.0, 4.0).height_at(xy), np.tan(0.3) * climbed_m, atol=1e-12)


def test_undulation_has_the_band_and_the_correlation_it_says():
    inner = np.arange(-10.0, 10.0, 0.2)
    grids = []
    for seed in range(12):
        x, y = np.meshgrid(inner + 3.0, inner - 2.0, indexing="ij")
        grids.append(wavy(seed).height_at(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape))
    heights = np.stack(grids)
    assert np.mean(np.abs(heights) < 0.06) == pytest.approx(0.95, abs=0.01)
    assert heights.std() == pytest.approx(0.06 / 1.96, rel=0.04)
    for lag, expected in ((5, np.exp(-1)), (2, np.exp(-0.16)), (12, np.exp(-(2.4**2)))):
        for axis in (1, 2):
            first = np.take(heights, range(len(inner) - lag), axis=axis)
            second = np.take(heights, range(lag, len(inner)), axis=axis)
            assert np.mean(first * second) / heights.var() == pytest.approx(expected, abs=0.05)


def test_undulation_fades_to_flat_ground_and_is_its_seeds():
    edge = np.array([[3.0 + 15.0, 0.0], [3.0 - 16.0, 5.0], [0.0, 40.0], [150.0, 150.0]])
    np.testing.assert_allclose(wavy().height_at(edge), 0.0, atol=1e-12)
    np.testing.assert_array_equal(wavy(4).height_m, wavy(4).height_m)
    assert not np.array_equal(wavy(4).height_m, wavy(5).height_m)
