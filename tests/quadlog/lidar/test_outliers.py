from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from quadlog.lidar.outliers import statistical_outliers


def by_definition(xyz_m: np.ndarray, neighbours: int, std_ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """D_i > mu + n sigma with scipy, and which points lie so near to the limit that rounding may decide."""
    distances, _ = cKDTree(xyz_m).query(xyz_m, neighbours + 1)
    mean = distances[:, 1:].mean(axis=1)
    limit = mean.mean() + std_ratio * mean.std(ddof=1)
    return mean > limit, np.abs(mean - limit) < 1e-9 * max(limit, 1e-9)


@pytest.mark.parametrize(("neighbours", "std_ratio"), [(20, 2.0), (5, 1.0), (1, 0.5)])
def test_ring_scan_agrees_with_scipy(ring_scan, neighbours: int, std_ratio: float) -> None:
    xyz_m, _ = ring_scan
    expected, _ = by_definition(xyz_m, neighbours, std_ratio)
    found = statistical_outliers(xyz_m, neighbours, std_ratio)
    assert found.any()
    assert (found == expected).all()


def test_real_scans_agree_with_scipy(real_scans) -> None:
    for scans in real_scans.values():
        scan = scans[0].astype(np.float64)
        scan = scan[np.isfinite(scan).all(axis=1) & (np.abs(scan).sum(axis=1) > 0)]
        expected, near = by_definition(scan, 20, 2.0)
        found = statistical_outliers(scan, 20, 2.0)
        assert (found == expected)[~near].all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 80), st.integers(1, 6), st.sampled_from([0.5, 1.0, 2.0]), st.booleans())
def test_small_clouds_and_duplicates_agree_with_scipy(
    seed: int, n_points: int, neighbours: int, std_ratio: float, on_few_places: bool
) -> None:
    random = np.random.default_rng(seed)
    if on_few_places:
        xyz_m = random.integers(0, 3, (n_points, 3)).astype(np.float64)
    else:
        xyz_m = random.normal(0, 1, (n_points, 3))
    found = statistical_outliers(xyz_m, neighbours, std_ratio)
    if n_points <= neighbours:
        assert not found.any()
        return
    expected, near = by_definition(xyz_m, neighbours, std_ratio)
    assert (found == expected)[~near].all()


def test_evenly_spaced_points_have_no_outliers() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    assert not statistical_outliers(corners, 3, 1.0).any()


@pytest.mark.parametrize("n_points", [0, 1, 20])
def test_too_few_points_have_no_outliers(n_points: int) -> None:
    assert not statistical_outliers(np.random.default_rng(0).normal(0, 1, (n_points, 3)), 20, 2.0).any()
