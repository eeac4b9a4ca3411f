from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.simulation.sensors.lidar import TruePointClass
from quadlog.simulation.sensors.scene import RayCaster
from quadlog.simulation.synthetic import forest
from quadlog.simulation.synthetic.recording import ROBOT_TRUTH_TOPIC, START_NS


@pytest.fixture(scope="module")
def recording():
    return forest.synthesize(seed=1, duration_s=2.0, azimuth_steps=120)


def test_ground_points_lie_on_the_uneven_ground_from_the_true_pose_of_their_instant(recording, distance_to):
    poses = [m.message for m in recording.messages() if m.topic == ROBOT_TRUTH_TOPIC]
    t_ns = np.array([each.stamp_ns for each in poses])
    place = np.array([each.position_m for each in poses])
    turn = Rotation.from_quat([each.quat_xyzw for each in poses])
    assert np.ptp(place[:, 2]) > 0.01
    errors, tree_errors = [], []
    for scan in recording.scans():
        # At the recorded poses only: between them the robot moves by less than the noise.
        stamps = scan.cloud.stamp_ns + scan.cloud.offset_ns
        nearest = np.searchsorted(t_ns, stamps).clip(0, len(t_ns) - 1)
        at_once = np.abs(t_ns[nearest] - stamps) < 2_000_000
        in_map = turn[nearest].apply(scan.cloud.xyz_m + np.array([0.0, 0.0, 0.45])) + place[nearest]
        above = in_map[:, 2] - recording.site.terrain.height_at(in_map[:, :2])
        errors.append(above[at_once & (scan.point_class == TruePointClass.GROUND)])
        trees = in_map[at_once & (scan.point_class == TruePointClass.OBSTACLE)]
        grown = recording.site.obstacles + recording.site.foliage
        # How high on a trunk or in a crown is another matter.
        amid = [trees * [1, 1, 0] + [0, 0, (each.bottom_m + each.height_m) / 2] for each in grown]
        away = [distance_to(each)(points_m) for each, points_m in zip(grown, amid, strict=True)]
        tree_errors.append(np.min(away, axis=0))
    ground, trees = np.concatenate(errors), np.concatenate(tree_errors)
    assert len(ground) > 1000
    # A ground return's range noise is 2 cm along a ray that falls by at most 15 + 8 degrees.
    assert np.abs(ground).max() < 0.06
    assert np.abs(ground.mean()) < 2e-3
    assert len(trees) > 1000
    assert trees.max() < 0.1


def test_trunks_block_uwb_and_saplings_do_not():
    lap = forest.synthesize(seed=2, duration_s=60.0, azimuth_steps=16)
    trunks = RayCaster(lap.site.obstacles, lap.site.terrain)
    for ranges, tag in zip(lap.ranges, lap.tags, strict=True):
        assert 0.1 < 1 - ranges.line_of_sight.mean() < 0.5
        every = slice(0, None, 53)
        tag_m = tag.position_m((ranges.t_ns[every] - START_NS) * 1e-9)
        for anchor, place_m in enumerate(forest.ANCHORS_M):
            to_m = np.tile(place_m, (len(tag_m), 1))
            np.testing.assert_array_equal(ranges.line_of_sight[every, anchor], trunks.line_of_sight(tag_m, to_m))
