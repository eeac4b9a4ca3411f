from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from quadlog.simulation.sensors.uwb import TagRanges, UwbErrors, measure_ranges
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


class Blocked:
    """Hides every anchor."""

    def line_of_sight(self, start_m, end_m):
        return np.zeros(len(start_m), dtype=bool)


def test_out_of_sight_the_path_is_longer_by_a_delay_that_belongs_to_the_place(recording):
    uwb, t_ns = UwbErrors(range_std_m=0.0, dropout_share=0.0), START_NS + np.arange(0, 30_000, 20) * 1_000_000
    anchors_m, none = np.tile([50.0, 0.0, 1.0], (300, 1)), np.zeros(300)
    there = measure_ranges(uwb, recording.tags[0], anchors_m, none, Blocked(), START_NS, t_ns, np.random.default_rng(3))
    delay_m = there.range_m - there.true_m
    assert (delay_m > 0).all()
    single = [stats.gamma(2, scale=mean / 2).cdf for mean in (0.15, 0.4, 1.0)]
    assert stats.kstest(delay_m[0], lambda m: sum(cdf(m) for cdf in single) / 3).pvalue > 1e-3
    constant = np.ptp(delay_m, axis=0) < 1e-9
    assert stats.binomtest(int(constant.sum()), 300, 0.25).pvalue > 1e-3
    # One step of the walk changes it little, a metre makes another of it.
    place_m = recording.tags[0].position_m((t_ns - START_NS) * 1e-9)[:, :2]
    moved = delay_m[:, ~constant] / delay_m[:, ~constant].mean(axis=0)
    far = np.hypot(*(place_m - place_m[0]).T) > 1.0
    assert np.abs(np.diff(moved, axis=0)).mean() < 0.1
    assert abs(np.corrcoef(moved[0], moved[np.flatnonzero(far)[0]])[0, 1]) < 0.2


def test_who_stands_keeps_the_delay(recording):
    class Standing:
        def at(self, t_s):
            return recording.site.robot.at(0 * t_s)

    uwb, t_ns = UwbErrors(range_std_m=0.0, dropout_share=0.0), START_NS + np.arange(0, 1000, 20) * 1_000_000
    tag = replace(recording.tags[0], walk=Standing())
    seen = measure_ranges(uwb, tag, follow.ANCHORS_M, np.zeros(4), Blocked(), START_NS, t_ns, np.random.default_rng(3))
    assert np.ptp(seen.range_m, axis=0).max() < 1e-9


def test_ranges_drop_out_at_the_given_share(recording):
    missing = np.mean([np.isnan(ranges.range_m).mean() for ranges in both_tags(recording)])
    assert missing == pytest.approx(0.02, abs=0.003)
    for ranges in both_tags(recording):
        for message, range_m in zip(list(ranges.messages())[:200], ranges.range_m, strict=False):
            assert message.anchor.tolist() == np.flatnonzero(np.isfinite(range_m)).tolist()
            np.testing.assert_array_equal(message.range_m, range_m[message.anchor])
