from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.geometry import transform_from_rpy
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass
from quadlog.lidar.paper_method import PaperSettings, classify_scan_paper

LEVEL = transform_from_rpy(np.array([0.0, 0.0, 0.5]), 0.0, 0.0, 0.0)
ALL_ROUND = PaperSettings(field_of_view_deg=360.0)
NO_RETURN = [np.nan, np.inf, 0.0, 1e30, -3e38]


def counts(scan: ClassifiedScan) -> list[int]:
    """Invalid, cropped, outliers, ground and obstacles."""
    return np.bincount(scan.label, minlength=len(PointClass)).tolist()


def test_room_is_split_into_floor_and_walls(ring_scan) -> None:
    xyz_m, kinds = ring_scan
    scan = classify_scan_paper(xyz_m.astype(np.float32), LEVEL, ALL_ROUND, seed=0)

    assert scan.route == "paper"
    assert len(scan.label) == len(xyz_m)
    assert counts(scan)[:2] == [0, 0]
    assert scan.ground is not None
    assert scan.ground.normal == pytest.approx([0, 0, 1], abs=0.01)
    assert scan.ground.d_m == pytest.approx(0.0, abs=0.03)  # base is on the floor
    assert (scan.label[kinds["floor"]] == PointClass.GROUND).mean() > 0.98
    high = kinds["wall"] & (xyz_m[:, 2] > -0.3)
    assert (scan.label[high] == PointClass.OBSTACLE).mean() > 0.95
    assert (scan.label[kinds["false"]] == PointClass.OUTLIER).mean() > 0.1
    height_m = np.abs(scan.xyz_base_m @ scan.ground.normal + scan.ground.d_m)
    assert height_m[scan.label == PointClass.GROUND].max() <= 0.1
    assert height_m[scan.label == PointClass.OBSTACLE].min() > 0.1
    assert scan.ground.inliers.tolist() == (scan.label == PointClass.GROUND).tolist()


def test_only_the_front_is_kept_by_default(ring_scan) -> None:
    scan = classify_scan_paper(ring_scan[0].astype(np.float32), LEVEL, PaperSettings(), seed=0)
    kept = scan.label > PointClass.CROPPED
    assert (scan.xyz_base_m[kept, 0] >= -1e-12).all()
    assert (scan.xyz_base_m[~kept, 0] <= 1e-12).all()
    assert 0 < kept.sum() < len(kept)


def test_result_depends_on_scan_and_seed_alone(ring_scan) -> None:
    xyz_m = ring_scan[0].astype(np.float32)
    first = classify_scan_paper(xyz_m, LEVEL, ALL_ROUND, seed=4)
    classify_scan_paper(xyz_m[::2], LEVEL, ALL_ROUND, seed=9)
    again = classify_scan_paper(xyz_m, LEVEL, ALL_ROUND, seed=4)
    assert first.label.tobytes() == again.label.tobytes()
    assert first.ground is not None and again.ground is not None  # noqa: PT018
    assert first.ground.normal.tobytes() == again.ground.normal.tobytes()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, 1e30])
def test_bad_points_change_nothing_about_the_good_ones(ring_scan, bad: float) -> None:
    xyz_m = ring_scan[0].astype(np.float32)
    spoilt = np.concatenate([np.full((len(xyz_m) * 2 // 3, 3), bad, dtype=np.float32), xyz_m])
    clean = classify_scan_paper(xyz_m, LEVEL, ALL_ROUND, seed=0)
    scan = classify_scan_paper(spoilt, LEVEL, ALL_ROUND, seed=0)
    assert scan.label[-len(xyz_m) :].tolist() == clean.label.tolist()
    assert counts(scan)[1:] == counts(clean)[1:]


@given(
    arrays(np.float32, st.tuples(st.integers(0, 150), st.just(3)), elements=st.floats(width=32))
    | st.builds(np.full, st.tuples(st.integers(0, 500), st.just(3)), st.sampled_from(NO_RETURN), st.just(np.float32)),
    st.integers(0, 2**32),
)
def test_any_cloud_is_classified(cloud: np.ndarray, seed: int) -> None:
    settings_small = replace(ALL_ROUND, ground_min_points=3, outlier_neighbours=2)
    scan = classify_scan_paper(cloud, LEVEL, settings_small, seed)
    assert len(scan.label) == len(cloud)
    assert np.isnan(scan.xyz_base_m).any(axis=1).sum() == counts(scan)[PointClass.INVALID]
    assert scan.ground is None or counts(scan)[PointClass.GROUND] >= 3


def test_real_scans_have_ground_and_obstacles(real_scans) -> None:
    assert set(real_scans) == {"vlp16", "helios16p"}
    for scans in real_scans.values():
        for cloud in scans:
            scan = classify_scan_paper(cloud, np.eye(4), ALL_ROUND, seed=0)
            assert len(scan.label) - counts(scan)[PointClass.INVALID] > 3000
            assert scan.ground is not None
            assert counts(scan)[PointClass.OBSTACLE] > 500


def test_without_a_plane_heights_are_those_of_base() -> None:
    scan = classify_scan_paper(np.array([[3.0, 0, 0.2], [np.nan, 0, 0]], np.float32), LEVEL, ALL_ROUND, seed=0)
    assert scan.height_m == pytest.approx([0.7, np.nan], nan_ok=True)


@pytest.mark.parametrize(("mount", "height_m"), [(LEVEL, 0.5), (np.eye(4), 0.1)])
def test_the_plane_of_a_2d_scan_is_no_ground(mount: np.ndarray, height_m: float) -> None:
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    xyz_m = (4.0 * np.stack([np.cos(turn), np.sin(turn), np.zeros(720)], axis=1)).astype(np.float32)
    scan = classify_scan_paper(xyz_m, mount, ALL_ROUND, seed=0)
    assert scan.ground is None
    *none, outliers, ground, obstacles = counts(scan)
    assert (none, outliers + obstacles, ground) == ([0, 0], 720, 0)
    assert obstacles > 600
    assert scan.height_m == pytest.approx(height_m)
