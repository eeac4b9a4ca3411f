from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from quadlog.simulation.sensors.uwb import TagRanges
from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import START_NS, SynthesizedRecording


@pytest.fixture(scope="module")
def recording() -> SynthesizedRecording:
    return follow.synthesize(seed=5, duration_s=80.0, azimuth_steps=16)


def both_tags(recording) -> list[TagRanges]:
    return list(recording.ranges)


def test_true_ranges_are_distances_from_where_the_tag_is(recording):
    for ranges, walk, height_m, lever_m in zip(
        recording.ranges, (recording.site.robot, recording.site.person), (0.6, 1.3), (-0.2, 0.0), strict=True
    ):
        motion = walk.at((ranges.t_ns - START_NS) * 1e-9)
        lever = Rotation.from_euler("z", motion.yaw_rad[:, None]).apply([lever_m, 0.0, height_m])
        place = lever + np.column_stack([motion.position_m, np.zeros(len(lever))])
        distance = np.linalg.norm(place[:, None] - follow.ANCHORS_M, axis=2)
        np.testing.assert_allclose(ranges.true_m, distance, atol=1e-9)


def test_in_sight_the_error_is_the_anchors_bias_and_gaussian_noise(recording):
    for ranges in both_tags(recording):
        for anchor, bias_m in enumerate(recording.bias_m):
            error = (ranges.range_m - ranges.true_m)[ranges.line_of_sight[:, anchor], anchor]
            error = error[np.isfinite(error)] - bias_m
            assert len(error) > 500
            assert stats.kstest(error, "norm", args=(0, 0.08)).pvalue > 1e-3
    assert ((recording.bias_m > 0.05) & (recording.bias_m < 0.3)).all()


def test_out_of_sight_the_path_is_longer_by_an_exponential_delay(recording):
    for ranges in both_tags(recording):
        error = (ranges.range_m - ranges.true_m - recording.bias_m)[~ranges.line_of_sight]
        error = error[np.isfinite(error)]
        assert len(error) > 1000
        assert error.min() > -4.5 * 0.08
        mixed = stats.exponnorm(K=0.4 / 0.08, loc=0, scale=0.08)
        assert stats.kstest(error, mixed.cdf).pvalue > 1e-3


def test_ranges_drop_out_at_the_given_share(recording):
    missing = np.mean([np.isnan(ranges.range_m).mean() for ranges in both_tags(recording)])
    assert missing == pytest.approx(0.02, abs=0.003)
    for ranges in both_tags(recording):
        for message, range_m in zip(list(ranges.messages())[:200], ranges.range_m, strict=False):
            assert message.anchor.tolist() == np.flatnonzero(np.isfinite(range_m)).tolist()
            np.testing.assert_array_equal(message.range_m, range_m[message.anchor])
