from __future__ import annotations

import numpy as np
import pytest

from quadlog.simulation.sensors.scene import FLAT, GROUND, RayCaster, ramp, slope, undulating

SENSOR_M = np.array([0.0, 0.0, 0.5])


def looking(elevation_rad: float, azimuth_rad: np.ndarray) -> np.ndarray:
    flat = np.cos(elevation_rad)
    return np.column_stack(
        [flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.full(len(azimuth_rad), np.sin(elevation_rad))]
    )


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


@pytest.mark.parametrize("angle_deg", [-10.0, 15.0, 20.0])
def test_ranges_to_a_slope_are_those_to_a_plane(angle_deg):
    angle = np.deg2rad(angle_deg)
    azimuth = np.linspace(-np.pi, np.pi, 721)
    directions = looking(np.deg2rad(-9.0), azimuth)
    hits = RayCaster((), slope(angle)).cast(np.tile(SENSOR_M, (len(azimuth), 1)), directions)
    normal = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    towards = -directions @ normal
    expected = np.where(towards > 0.01, SENSOR_M @ normal / np.maximum(towards, 1e-9), np.nan)
    near = expected < 50
    assert near.sum() > 200
    np.testing.assert_allclose(hits.range_m[near], expected[near], rtol=1e-5)
    xy = np.random.default_rng(0).uniform(-90, 90, (100, 2))
    np.testing.assert_allclose(slope(angle).height_at(xy), np.tan(angle) * xy[:, 0], atol=1e-12)


def test_ranges_to_a_ramp_are_to_its_three_planes():
    angle, start_m, run_m = np.deg2rad(20.0), 2.0, 4.0
    caster = RayCaster((), ramp(angle, start_m, run_m))
    down = np.deg2rad(np.array([-15.0, -13.0, -5.0, 5.0, 10.0]))
    directions = np.column_stack([np.cos(down), np.zeros(5), np.sin(down)])
    range_m = caster.cast(np.tile(SENSOR_M, (5, 1)), directions).range_m
    flat_m = 0.5 / -np.sin(down)
    # z = tan(angle) (x - start) meets 0.5 + t sin = tan(angle) (t cos - start).
    on_ramp_m = (0.5 + start_m * np.tan(angle)) / (np.tan(angle) * np.cos(down) - np.sin(down))
    expected = np.where((down < 0) & (flat_m * np.cos(down) <= start_m), flat_m, on_ramp_m)
    # The last beam passes over the ramp's end.
    expected[on_ramp_m * np.cos(down) > start_m + run_m] = np.inf
    assert np.isinf(expected).tolist() == [False, False, False, False, True]
    assert (expected == flat_m).tolist() == [True, False, False, False, False]
    np.testing.assert_allclose(range_m, expected, rtol=1e-5)
    top = ramp(angle, start_m, run_m).height_at(np.array([[1.99, 0.0], [4.0, 9.0], [6.0, -3.0], [90.0, 1.0]]))
    np.testing.assert_allclose(top, np.tan(angle) * np.array([0.0, 2.0, 4.0, 4.0]), atol=1e-12)


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
