"""Lidar odometry on simulated sweeps, whose poses are known."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core.geometry import umeyama_alignment
from scipy.spatial.transform import Rotation

from quadlog.geometry import seconds_since
from quadlog.positioning.lidar_odometry import LidarOdometry, LidarTrack, ScanMatch, body_motion
from quadlog.simulation.synthetic import corridor, follow, forest
from quadlog.simulation.synthetic.recording import START_NS

LIDAR_HEIGHT_M = 0.45


def scans_of(scenario, seed, duration_s, azimuth_steps=400):
    """Points in base's axes with their times, and what tells the true position (N, 2) at instants."""
    recording = scenario.synthesize(seed, duration_s, azimuth_steps)
    scans = [
        (scan.cloud.stamp_ns, scan.cloud.xyz_m + np.float32([0, 0, LIDAR_HEIGHT_M]), scan.cloud.offset_ns)
        for scan in recording.scans()
    ]
    return scans, lambda t_ns: recording.site.robot.at(seconds_since(t_ns, START_NS)).position_m


def odometry(scans) -> LidarTrack:
    odometry = LidarOdometry()
    for scan in scans:
        odometry.take(*scan)
    return odometry.track()


def ate_m(track: LidarTrack, true_at) -> float:
    true_m = true_at(track.t_ns)
    rotation, shift, _ = umeyama_alignment(track.position_m[:, :2].T, true_m.T)
    return float(np.sqrt(((track.position_m[:, :2] @ rotation.T + shift - true_m) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize(("scenario", "limit_m"), [(follow, 0.02), (forest, 0.03), (corridor, 0.05)])
def test_the_track_of_a_walk_is_the_true_one_but_for_where_it_began(scenario, limit_m):
    scans, true_at = scans_of(scenario, 21, 8.0)
    track = odometry(scans)
    assert len(track.t_ns) == len(scans)
    assert ate_m(track, true_at) < limit_m
    flagged = (track.match == ScanMatch.DEGENERATE).mean()
    assert flagged > 0.3 if scenario is corridor else flagged < 0.05


def test_scans_that_show_nothing_or_another_place_are_lost_and_the_next_is_found_again():
    """At 11 one is half a metre further, which no robot walks in .1 s; at 20 they are empty, at 30 of another place."""
    scans, true_at = scans_of(follow, 26, 4.0)
    stamps = np.array([t_ns for t_ns, _, _ in scans])
    further = 10 + int(np.argmax(np.linalg.norm(true_at(stamps[10:]) - true_at(stamps[10:11]), axis=1) > 0.55))
    scans[11] = scans[11][0], *scans[further][1:]
    scans[20:22] = [(t_ns, np.full((5, 3), np.nan, np.float32), None) for t_ns, _, _ in scans[20:22]]
    scans[30] = scans[30][0], *scans_of(forest, 24, 3.2)[0][30][1:]
    track = odometry(scans)
    assert np.flatnonzero(track.match == ScanMatch.LOST).tolist() == [11, 20, 21, 30]
    assert ate_m(track, true_at) < 0.1


def test_scans_that_come_late_or_twice_are_left_out():
    scans, _ = scans_of(follow, 25, 1.0)
    track = odometry([scans[0], scans[2], scans[1], scans[2], scans[3]])
    assert track.t_ns.tolist() == odometry([scans[0], scans[2], scans[3]]).t_ns.tolist()
    assert len(odometry([]).t_ns) == len(odometry([(0, np.empty((0, 3), np.float32), None)]).t_ns) == 0


@pytest.mark.parametrize("causal", [False, True])
def test_velocities_of_the_body_are_those_of_the_walk(causal):
    """A circle to the left at 0.6 m/s, sidestepping at 0.1 m/s; one scan was lost, three metres away."""
    t_s = np.arange(0.0, 6.0, 0.1)
    yaw_rad, match = 2.0 + 0.5 * t_s, np.where(np.arange(60) == 20, ScanMatch.LOST, ScanMatch.MATCHED)
    place = -2j * (0.6 + 0.1j) * (np.exp(1j * yaw_rad) - np.exp(2j)) + 3.0 * (match == ScanMatch.LOST)
    rotation = Rotation.from_euler("z", yaw_rad[:, None]).as_matrix()
    position_m = np.column_stack([place.real, place.imag, 0 * t_s])
    motion = body_motion(LidarTrack((t_s * 1e9).astype(np.int64), position_m, rotation, match), causal=causal)
    assert motion.velocity_mps == pytest.approx(np.tile([0.6, 0.1], (57, 1)), abs=1e-3)
    assert motion.yaw_rate_radps == pytest.approx(0.5)
    assert motion.t_ns[0] * 1e-9 == pytest.approx(0.1 if causal else 0.05)
