"""Three tags on a real trolley among eight real anchors (uwb_lias), judged by motion capture it does not see."""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.geometry import tag_to_base, wrap_angle
from quadlog.positioning.heading.heading import align_yaw
from quadlog.positioning.locate import Anchors, Located, LocateSettings, TagInfo, locate


@pytest.fixture(scope="module")
def calibrated(trolley) -> Located:
    return run(trolley, LocateSettings())


def run(trolley, settings: LocateSettings) -> Located:
    anchors = Anchors(np.arange(8), trolley.anchors_m, np.zeros(8))
    return locate(trolley.series, anchors, [TagInfo(tag, 0.97) for tag in range(3)], settings)


def fix_errors(lab, trolley, located: Located) -> np.ndarray:
    return np.array(
        [
            lab.rmse((tag.fixes.position_m - trolley.truth_at(tag.tag, tag.fix_t_ns))[tag.fixes.solved])
            for tag in located.tags
        ]
    )


def track_errors(lab, trolley, located: Located) -> np.ndarray:
    return np.array(
        [lab.rmse(tag.track.position_m - trolley.truth_at(tag.tag, tag.track.t_ns)) for tag in located.tags]
    )


def test_calibration_halves_the_error_of_a_fix(lab, trolley, calibrated):
    assert (fix_errors(lab, trolley, calibrated) <= [0.086, 0.082, 0.075]).all()
    assert calibrated.counts.not_positive == calibrated.counts.total - calibrated.counts.used == 30


def test_smoothed_tracks(lab, trolley, calibrated):
    assert (track_errors(lab, trolley, calibrated) <= [0.066, 0.058, 0.048]).all()


def test_biases_are_those_that_the_truth_shows(trolley, calibrated):
    for tag in calibrated.tags:
        mine = trolley.series.tag == tag.tag
        t_ns, anchor, range_m = (getattr(trolley.series, name)[mine] for name in ("t_ns", "anchor", "range_m"))
        place_m = np.column_stack([trolley.truth_at(tag.tag, t_ns), np.full(len(t_ns), 0.97)])
        excess_m = range_m - np.linalg.norm(place_m - trolley.anchors_m[anchor], axis=1)
        true_m = [np.mean(excess_m[(anchor == a) & (range_m > 0)]) for a in range(8)]
        assert tag.bias is not None
        assert tag.bias.applied.all()
        np.testing.assert_allclose(tag.bias.bias_m, true_m, atol=0.03)


def test_yaw_of_another_sensor_is_aligned_by_every_tag(trolley, calibrated):
    """Motion capture's yaw, turned by 50 degrees, plays the IMU. What its own course says is the oracle.

    The trolley drives about 5.5 degrees to the right of its x axis, and tag 2 sits 0.2 m ahead.
    """
    true_yaw = trolley.rotation.as_euler("ZYX")[:, 0]
    seconds = (trolley.t_ns - trolley.t_ns[0]) * 1e-9
    velocity = np.gradient(trolley.position_m[:, :2], seconds, axis=0)
    velocity = np.stack([np.convolve(velocity[:, i], np.ones(25) / 25, mode="same") for i in range(2)], axis=1)
    moving = np.hypot(*velocity.T) > 0.2
    slip = float(np.median(wrap_angle(np.arctan2(velocity[:, 1], velocity[:, 0]) - true_yaw)[moving]))
    for tag in calibrated.tags:
        ahead_m = float(trolley.lever_m[tag.tag, 0])
        aligned = align_yaw(tag.track, trolley.t_ns, wrap_angle(true_yaw - np.radians(50)), ahead_m)
        assert aligned.offset_rad == pytest.approx(np.radians(50) + slip, abs=np.radians(2))
        # Tag 0's courses err for tens of seconds at a time, which its std must know: by 1.7 degrees on this walk.
        assert abs(aligned.offset_rad - np.radians(50) - slip) < 2 * aligned.std_rad < np.radians(5)


def test_the_lever_arm_leads_to_the_trolleys_origin(lab, trolley, calibrated):
    tag = calibrated.tags[2]
    true_yaw = np.unwrap(trolley.rotation.as_euler("ZYX")[:, 0])
    base_m = tag_to_base(tag.track.position_m, np.interp(tag.track.t_ns, trolley.t_ns, true_yaw), 0.2034, 0.1451)
    truth_m = np.stack([np.interp(tag.track.t_ns, trolley.t_ns, trolley.position_m[:, i]) for i in range(2)], axis=1)
    assert lab.rmse(base_m - truth_m) < 0.048
    assert lab.rmse(tag.track.position_m - truth_m) > 0.2
