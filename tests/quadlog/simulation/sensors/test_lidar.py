from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.simulation.sensors.lidar import BODY, Lidar, TruePointClass, part_centres, ray_ranges
from quadlog.simulation.sensors.scene import import_open3d
from quadlog.simulation.sensors.trajectory import PacingWalk
from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import START_NS, SynthesizedRecording

MOUNT_M = [0.0, 0.0, 0.45]


@pytest.fixture(scope="module")
def recording() -> SynthesizedRecording:
    return follow.synthesize(seed=1, duration_s=6.0, azimuth_steps=180)


@pytest.fixture(scope="module")
def scans(recording):
    return list(recording.scans())


def instants_s(scan):
    return (scan.cloud.stamp_ns - START_NS + scan.cloud.offset_ns) * 1e-9


def in_map(recording, scan, range_m):
    """The points at range_m along their rays, from the true pose at each point's own time."""
    motion = recording.site.robot.at(instants_s(scan))
    measured = scan.cloud.xyz_m.astype(np.float64)
    unit = measured / np.linalg.norm(measured, axis=1, keepdims=True)
    turned = Rotation.from_euler("z", motion.yaw_rad[:, None]).apply(unit * range_m[:, None] + MOUNT_M)
    return turned + np.column_stack([motion.position_m, np.zeros(len(turned))])


def test_every_static_point_lies_on_a_surface(recording, scans, distance_to_yard):
    for scan in scans[::10]:
        static = np.isin(scan.point_class, [TruePointClass.GROUND, TruePointClass.OBSTACLE])
        assert static.sum() > 1000
        true = in_map(recording, scan, scan.range_m)[static]
        assert distance_to_yard(true).max() < 2e-3
        ground = scan.point_class[static] == TruePointClass.GROUND
        assert np.abs(true[ground, 2]).max() < 2e-3
        assert (distance_to_yard(true[~ground]) < 2e-3).all()
        measured = in_map(recording, scan, np.linalg.norm(scan.cloud.xyz_m, axis=1))[static]
        assert distance_to_yard(measured).max() < 6 * 0.02


def test_the_persons_points_move_with_the_person(recording, scans):
    seen = 0
    for scan in scans[::5]:
        person = scan.point_class == TruePointClass.PERSON
        seen += person.sum()
        points = in_map(recording, scan, scan.range_m)[person]
        centres = part_centres(recording.site.person, instants_s(scan)[person])
        outside = []
        for index, part in enumerate(BODY):
            radial = np.hypot(*(points[:, :2] - centres[:, index]).T) - part.radius_m
            level = np.maximum(part.low_m - points[:, 2], points[:, 2] - part.high_m)
            outside.append(np.abs(np.maximum(radial, level)))
        assert np.min(outside, axis=0).max() < 1e-5
    assert seen > 400


def test_noise_false_points_and_dropouts_match_the_settings(recording, scans):
    error = np.concatenate([np.linalg.norm(s.cloud.xyz_m, axis=1) - s.range_m for s in scans])
    false = np.isnan(error)
    count = len(error)
    assert false.mean() == pytest.approx(0.007, abs=4 * np.sqrt(0.007 / count))
    assert np.nanmean(error) == pytest.approx(0, abs=4 * 0.02 / np.sqrt(count))
    assert np.nanstd(error) == pytest.approx(0.02, rel=0.02)

    whole = follow.synthesize(seed=1, duration_s=6.0, azimuth_steps=180)
    object.__setattr__(whole, "lidar", Lidar(azimuth_steps=180, dropout_share=0.0))
    kept = count / sum(len(s.range_m) for s in whole.scans())
    assert kept == pytest.approx(0.99, abs=0.002)


def test_beams_rings_and_times_are_those_of_the_sensor(scans):
    lidar = Lidar(azimuth_steps=180)
    scan = scans[7]
    assert scan.cloud.stamp_ns == START_NS + 7 * 100_000_000
    xyz = scan.cloud.xyz_m.astype(np.float64)
    elevation_deg = np.rad2deg(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))
    np.testing.assert_allclose(elevation_deg, -15 + 2 * scan.cloud.ring.astype(float), atol=1e-3)
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    swept = np.mod(np.pi - azimuth + 1e-9, 2 * np.pi)
    np.testing.assert_allclose(scan.cloud.offset_ns, swept / (2 * np.pi) * lidar.sweep_ns, atol=lidar.sweep_ns / 1e4)
    assert (np.diff(scan.cloud.offset_ns) >= 0).all()
    assert scan.cloud.offset_ns.max() < lidar.sweep_ns


WALK = PacingWalk((2.0, 0.0), (6.0, 1.0), period_s=8.0)


def test_rays_meet_the_body_where_open3d_meets_its_cylinders():
    open3d = import_open3d()
    centres = part_centres(WALK, np.array([1.3]))[0]
    scene = open3d.t.geometry.RaycastingScene()
    for part, (x, y) in zip(BODY, centres, strict=True):
        mesh = open3d.geometry.TriangleMesh.create_cylinder(part.radius_m, part.high_m - part.low_m, resolution=256)
        mesh.translate([x, y, (part.high_m + part.low_m) / 2])
        scene.add_triangles(open3d.t.geometry.TriangleMesh.from_legacy(mesh))

    rng = np.random.default_rng(0)
    origins = np.column_stack([rng.uniform(-1, 1, (3000, 2)), rng.uniform(0.1, 2.5, 3000)])
    aims = np.column_stack([centres.mean(axis=0) + rng.normal(0, 0.3, (3000, 2)), rng.uniform(-0.2, 2.0, 3000)])
    directions = (aims - origins) / np.linalg.norm(aims - origins, axis=1, keepdims=True)
    ours = ray_ranges(origins, directions, np.broadcast_to(centres, (3000, *centres.shape)))
    theirs = scene.cast_rays(open3d.core.Tensor(np.hstack([origins, directions]).astype(np.float32)))["t_hit"].numpy()
    assert 500 < np.isfinite(theirs).sum() < 2900
    # Only rays that graze an edge may differ: theirs has corners.
    assert np.mean(np.isfinite(ours) != np.isfinite(theirs)) < 0.003
    both = np.isfinite(ours) & np.isfinite(theirs)
    assert np.quantile(np.abs(ours[both] - theirs[both]), 0.995) < 2e-3
