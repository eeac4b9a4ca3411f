from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import TooLarge
from quadlog.simulation.robot import height_field as ground_module
from quadlog.simulation.robot.height_field import (
    Extent,
    HeightField,
    from_height_map,
    s_course,
    slope,
    undulating,
)
from quadlog.simulation.robot.model import add_world

SMALL = Extent(-6.0, -5.0, 6.0, 7.0)


@given(st.integers(3, 9), st.integers(3, 9), st.integers(0, 1000))
def test_heights_are_those_of_mujocos_own_surface(rows, cols, seed):
    rng = np.random.default_rng(seed)
    ground = HeightField(rng.uniform(0, 1, (rows, cols)).astype(np.float32), 0.25, (1.0, -2.0))
    spec = mujoco.MjSpec()
    add_world(spec, ground, 0.8, 0.002)
    model = spec.compile()
    data, what = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_forward(model, data)
    xy_m = rng.uniform([1.0, -2.0], [0.75 + 0.25 * cols, -2.25 + 0.25 * rows], size=(20, 2))
    down = np.array([0.0, 0.0, -1.0])
    away = [mujoco.mj_ray(model, data, np.array([*xy, 5.0]), down, None, 1, -1, what) for xy in xy_m]
    np.testing.assert_allclose(ground.height_at(xy_m), 5.0 - np.array(away), atol=1e-6)
    outside = np.array([[9.0, -9.0]])
    assert ground.height_at(outside)[0] == pytest.approx(ground.height_m[0, -1], abs=1e-6)


@pytest.mark.parametrize("band_m", [0.03, 0.06])
def test_the_band_of_an_undulation_holds_95_percent_of_its_heights(band_m):
    heights = undulating(band_m, seed=3).height_m
    low, high = np.percentile(heights, [2.5, 97.5])
    assert high - low == pytest.approx(band_m, rel=1e-5)
    assert abs(np.median(heights)) < 1e-6
    assert np.mean(np.abs(heights) <= band_m / 2) == pytest.approx(0.95, abs=0.01)


def test_the_s_course_climbs_15_degrees_and_descends_20():
    level = s_course(band_m=0.0)
    x_m = np.array([0.0, 2.0, 4.0, 6.0, 12.0, 18.0, 20.0, 22.0, 24.0])
    heights = level.height_at(np.column_stack([x_m, np.linspace(-3, 9, len(x_m))]))
    assert (heights[2] - heights[1]) / 2 == pytest.approx(math.tan(math.radians(15)), abs=1e-6)
    assert (heights[7] - heights[6]) / 2 == pytest.approx(-math.tan(math.radians(20)), abs=1e-6)
    assert heights[0] == 0
    np.testing.assert_allclose(heights[3:6], 4 * math.tan(math.radians(15)), atol=1e-6)
    rough = s_course(seed=2)
    low, high = np.percentile(rough.height_m - level.height_m, [2.5, 97.5])
    assert high - low == pytest.approx(0.045, rel=1e-4)
    assert rough.too_steep_for() is None


def test_a_runs_height_map_becomes_ground():
    seen = np.array([[0.1, np.nan, 0.3], [0.2, np.nan, np.nan]])
    ground = from_height_map(seen, 0.2, np.array([1.0, 2.0]))
    centres = np.array([[1.1, 2.1], [1.5, 2.1], [1.1, 2.3], [1.5, 2.3]])
    np.testing.assert_allclose(ground.height_at(centres), [0.1, 0.3, 0.2, 0.3], atol=1e-7)
    single = from_height_map(np.array([[0.4]]), 0.2, np.zeros(2))
    assert not single.is_plane
    assert single.height_at(np.array([[9.0, 9.0]]))[0] == np.float32(0.4)
    with pytest.raises(ValueError, match="no height is known"):
        from_height_map(np.full((2, 2), np.nan), 0.2, np.zeros(2))


def test_slopes_beyond_the_friction_cone_are_reported():
    assert slope(math.radians(38)).too_steep_for(0.8) is None
    reason = slope(math.radians(40)).too_steep_for(0.8)
    assert reason is not None
    assert "40 degrees" in reason
    assert "up to 39 degrees" in reason
    step = np.zeros((10, 10), np.float32)
    step[:, 6:] = 0.2
    reason = HeightField(step, 0.1, (0.0, 0.0)).too_steep_for()
    assert reason is not None
    assert "63 degrees at (0.6, " in reason
    # Each side alone would hold.
    assert slope(math.atan(0.9), math.radians(45)).too_steep_for() is not None


def test_a_part_has_the_heights_of_the_whole_also_outside():
    whole = undulating(0.06, seed=2, extent=SMALL)
    for extent in (Extent(-1.0, 0.0, 1.02, 1.5), Extent(4.0, 5.0, 9.0, 9.0), Extent(-9.0, -9.0, -8.0, -8.0)):
        part, rng = whole.over(extent), np.random.default_rng(0)
        xy_m = rng.uniform(extent[:2], extent[2:], size=(50, 2))
        np.testing.assert_allclose(part.height_at(xy_m), whole.height_at(xy_m), atol=1e-7)
        assert part.height_m.size < whole.height_m.size / 5


def test_sizes_are_bounded_before_anything_is_allocated(monkeypatch):
    monkeypatch.setattr(ground_module, "MOST_CORNERS", 100)
    with pytest.raises(TooLarge):
        undulating(0.03, extent=SMALL)
    with pytest.raises(TooLarge):
        from_height_map(np.zeros((20, 20)), 0.2, np.zeros(2))
    with pytest.raises(TooLarge):
        HeightField(np.zeros((20, 20), np.float32), 0.1, (0.0, 0.0))
