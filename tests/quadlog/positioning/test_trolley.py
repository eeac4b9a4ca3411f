"""Three tags on a real trolley among eight real anchors (uwb_lias), judged by motion capture it does not see."""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.geometry import wrap_angle
from quadlog.messages import RangeSeries
from quadlog.positioning.heading import IMU_DRIFT, YawSensor, align_yaw
from quadlog.positioning.locate import Anchors, Located, LocateSettings, TagInfo, locate


@pytest.fixture(scope="module")
def calibrated(trolley) -> Located:
    return run(trolley, trolley.series, LocateSettings())


def run(trolley, series: RangeSeries, settings: LocateSettings, tags=range(3)) -> Located:
    anchors = Anchors(np.arange(8), trolley.anchors_m, np.zeros(8))
    return locate(series, anchors, [TagInfo(tag, 0.97) for tag in tags], settings)


@pytest.mark.parametrize(("tag", "fixes_m", "track_m"), [(0, 0.086, 0.0625), (1, 0.082, 0.044), (2, 0.075, 0.041)])
def test_fixes_tracks_biases_and_ellipses(lab, trolley, calibrated, tag, fixes_m, track_m):
    """The first tag's stamps are 0.08 s off, which makes half of its error."""
    assert calibrated.counts.not_positive == calibrated.counts.total - calibrated.counts.used == 30
    got = calibrated.tags[tag]
    fixed = got.fixes.solved
    assert lab.rmse((got.fixes.position_m - trolley.truth_at(tag, got.fix_t_ns))[fixed]) < fixes_m
    error_m = got.track.position_m - trolley.truth_at(tag, got.track.t_ns)
    assert lab.rmse(error_m) < track_m
    assert lab.share_in_ellipses(error_m, got.track.covariance_m2) > 0.95
    mine = trolley.series.tag == tag
    t_ns, anchor, range_m = (getattr(trolley.series, name)[mine] for name in ("t_ns", "anchor", "range_m"))
    excess_m = range_m - lab.true_ranges(trolley.truth_at(tag, t_ns), trolley.anchors_m, 0.97)[range(len(t_ns)), anchor]
    true_m = [np.mean(excess_m[(anchor == a) & (range_m > 0)]) for a in range(8)]
    assert got.bias.applied.all()
    np.testing.assert_allclose(got.bias.bias_m, true_m, atol=0.03)


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
    sensor = YawSensor(trolley.t_ns, wrap_angle(true_yaw - np.radians(50)), IMU_DRIFT)
    for tag in calibrated.tags:
        aligned = align_yaw(tag.track, sensor, float(trolley.lever_m[tag.tag, 0]))
        off = abs(aligned.fit.offset_rad - np.radians(50) - slip)
        assert off < np.radians(2)
        # Tag 0's courses err for tens of seconds at a time, which its std must know: by 1.7 degrees on this walk.
        assert off < 2 * np.median(aligned.yaw_std_rad) < np.radians(5)
