from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import Float
from quadlog.positioning.tracker import TrackedRanges, track_ranges


def track(lab, simulated, anchors_m: Float, *, smooth: bool, keep=slice(None)) -> TrackedRanges:
    """Started at the truth, so that only tracking is tested; the start is a fix known at once."""
    rows = simulated.series
    return track_ranges(
        rows.t_ns[keep],
        rows.anchor[keep],
        rows.range_m[keep],
        anchors_m,
        lab.TAG_HEIGHT_M,
        simulated.t_ns,
        simulated.position_m,
        range_std_m=0.1,
        acceleration_std_mps2=1.0,
        smooth=smooth,
    )


def errors(lab, tracked: TrackedRanges, simulated) -> float:
    return lab.rmse(tracked.track.position_m - simulated.truth_at(tracked.track.t_ns))


def test_clean_ranges_are_smoothed_far_below_their_noise(lab):
    simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, 1)
    assert errors(lab, track(lab, simulated, lab.TRIANGLE_M, smooth=False), simulated) < 0.08
    tracked = track(lab, simulated, lab.TRIANGLE_M, smooth=True)
    assert errors(lab, tracked, simulated) < 0.05
    np.testing.assert_allclose(tracked.track.velocity_mps[100:-100].mean(axis=0), [0.4, 0.3], atol=0.02)


def test_bursts_with_three_anchors_are_survived(lab):
    """50 Hz, constant velocity, 0.6 s bursts: facts ask for a smoothed RMSE of at most 0.11 m, and no lock-out."""
    squares, worst = [], 0.0
    for seed in range(40):
        simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, seed, bursts=True)
        tracked = track(lab, simulated, lab.TRIANGLE_M, smooth=True)
        squares.append(errors(lab, tracked, simulated) ** 2)
        end_m = tracked.track.position_m[-1] - simulated.position_m[-1]
        worst = max(worst, float(np.hypot(*end_m)))
    assert np.sqrt(np.mean(squares)) <= 0.11
    assert worst < 1.0


def test_no_gate_locks_out_a_tag_that_was_carried_away(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 2, duration_s=20)
    jumped = lab.simulate(
        lambda t_s: lab.walk_straight(t_s) + np.where(t_s[:, None] > 8, -3.0, 0.0), lab.SQUARE_M, 2, duration_s=20
    )
    for smooth in (False, True):
        got = track(lab, jumped, lab.SQUARE_M, smooth=smooth).track
        late = got.t_ns > got.t_ns[0] + 14e9
        assert lab.rmse((got.position_m - jumped.position_m)[late]) < 0.1
    assert not np.allclose(simulated.position_m, jumped.position_m)


@pytest.mark.parametrize("cut", [150, 437])
def test_causal_poses_do_not_change_with_what_comes_later(lab, cut):
    simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, 3, bursts=True)
    whole = track(lab, simulated, lab.TRIANGLE_M, smooth=False)
    start = track(lab, simulated, lab.TRIANGLE_M, smooth=False, keep=slice(3 * cut))
    np.testing.assert_array_equal(start.track.position_m, whole.track.position_m[:cut])
    np.testing.assert_array_equal(start.weight, whole.weight[: 3 * cut])


def test_ranges_that_come_one_by_one_are_tracked_as_well(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 4, rate_hz=80)
    one_by_one = np.arange(len(simulated.t_ns)) * 4 + np.arange(len(simulated.t_ns)) % 4
    tracked = track(lab, simulated, lab.SQUARE_M, smooth=True, keep=one_by_one)
    assert len(tracked.track) == len(simulated.t_ns)
    assert errors(lab, tracked, simulated) < 0.06


def test_weights_point_at_the_late_ranges(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 5)
    late = (simulated.series.anchor == 2) & (simulated.series.t_ns > simulated.t_ns[200])
    late &= simulated.series.t_ns < simulated.t_ns[230]
    simulated.series.range_m[late] += 1.0
    for smooth in (False, True):
        tracked = track(lab, simulated, lab.SQUARE_M, smooth=smooth)
        assert tracked.weight[late].max() < 0.2
        assert np.median(tracked.weight[~late]) > 0.8
        residual_m = simulated.series.range_m - tracked.predicted_m
        assert residual_m[late].mean() == pytest.approx(1.0, abs=0.15)


def test_a_long_gap_starts_a_new_track_at_the_next_fix(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 6, duration_s=20)
    seconds = (simulated.series.t_ns - simulated.t_ns[0]) * 1e-9
    keep = np.flatnonzero((seconds < 5) | (seconds > 9))
    known = (simulated.t_ns - simulated.t_ns[0]) * 1e-9
    fixes = np.flatnonzero((known < 1) | (known > 9.5))
    rows = simulated.series
    tracked = track_ranges(
        rows.t_ns[keep], rows.anchor[keep], rows.range_m[keep], lab.SQUARE_M, lab.TAG_HEIGHT_M,
        simulated.t_ns[fixes], simulated.position_m[fixes], range_std_m=0.1, acceleration_std_mps2=1.0, smooth=True,
    )  # fmt: skip
    between = (seconds[keep] > 5) & (seconds[keep] < 9.51)
    np.testing.assert_array_equal(np.isnan(tracked.predicted_m), between)
    np.testing.assert_array_equal(tracked.weight == 0, between)
    after = tracked.track.t_ns - simulated.t_ns[0] > 9e9
    assert (tracked.track.t_ns[after][0] - simulated.t_ns[0]) * 1e-9 == pytest.approx(9.52, abs=0.02)
    assert errors(lab, tracked, simulated) < 0.06


def test_covariance_of_clean_tracks_is_honest(lab):
    """The normalised error of a causal track, at instants far enough apart, averages two; weights make it cautious."""
    normalised = []
    for seed in range(30):
        simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, seed)
        got = track(lab, simulated, lab.SQUARE_M, smooth=False).track
        for k in (200, 400, 599):
            error_m = got.position_m[k] - simulated.position_m[k]
            normalised.append(error_m @ np.linalg.inv(got.covariance_m2[k]) @ error_m)
    assert 1.0 < np.mean(normalised) < 2.5


def test_nothing_to_track(lab):
    none = np.empty(0, dtype=np.int64)
    tracked = track_ranges(
        none,
        none,
        np.empty(0),
        lab.SQUARE_M,
        0.6,
        none,
        np.empty((0, 2)),
        range_std_m=0.1,
        acceleration_std_mps2=1.0,
        smooth=True,
    )
    assert len(tracked.track) == 0
    assert tracked.track.covariance_m2.shape == (0, 2, 2)
