from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.lidar.organise import beams_by_elevation, beams_by_ring, range_image
from quadlog.lidar.polar import Polar, to_polar


def sweep(columns: int, phase: float, elevations_deg: list[float], range_m: float = 5.0) -> tuple[Polar, np.ndarray]:
    """Every beam at every step, phase steps off the x axis."""
    turn = 2 * np.pi * (np.arange(columns) + phase) / columns
    azimuth, elevation = np.meshgrid(turn, np.deg2rad(elevations_deg), indexing="ij")
    flat = np.cos(elevation)
    xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
    ring = np.tile(np.arange(len(elevations_deg), dtype=np.uint16), columns)
    return to_polar((range_m * xyz).astype(np.float32), np.eye(4), 0.3, 30.0), ring


@pytest.mark.parametrize("columns", [360, 900, 1800, 1875])
@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, -0.4])
def test_every_point_gets_a_cell_of_its_own(columns: int, phase: float) -> None:
    polar, ring = sweep(columns, phase, [-15, -5, 5, 15])
    beams = beams_by_ring(polar, ring, upright=True)
    assert beams is not None
    assert beams.columns == columns
    image = range_image(polar, beams, 0.0, 0.0)
    assert not image.doubled
    assert sorted(image.point.ravel().tolist()) == list(range(4 * columns))
    assert (image.point.ravel()[image.cell] == np.arange(4 * columns)).all()


@pytest.mark.parametrize("upright", [True, False])
def test_rows_go_from_the_lowest_beam_up(upright: bool) -> None:
    polar, ring = sweep(360, 0.0, [3.0, -9.0, 11.0, -1.0])
    beams = beams_by_ring(polar, ring, upright)
    assert beams is not None
    assert beams.row[:4].tolist() == ([2, 0, 3, 1] if upright else [1, 3, 0, 2])
    assert beams.descending.tolist() == [True, True, False, False]
    assert (beams.row[4:] == -1).all()


def test_beams_show_in_the_elevations() -> None:
    polar, ring = sweep(360, 0.0, [-15.0, -13.0, -7.0, 2.0])
    beams = beams_by_elevation(polar, upright=True)
    assert beams is not None
    assert beams.beam.tolist() == ring.tolist()


def test_elevations_of_any_size_show_no_beams() -> None:
    random = np.random.default_rng(0)
    polar = to_polar(random.normal(0, 3, (5000, 3)).astype(np.float32), np.eye(4), 0.3, 30.0)
    assert beams_by_elevation(polar, upright=True) is None
    assert beams_by_ring(polar, random.integers(0, 16, 5000).astype(np.uint16), upright=True) is None


def test_of_two_points_in_a_cell_the_nearer_stands_for_it() -> None:
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
