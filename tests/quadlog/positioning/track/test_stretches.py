"""A tag that is lost although ranges keep coming: carried away, or never where its first fix said."""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import Float
from quadlog.positioning.fix.trilateration import solve_gauss_newton
from quadlog.positioning.track import segments as stretches
from quadlog.positioning.track.tracker import TrackedRanges, track_ranges

HALL_M = np.array([[0.0, 0.0, 1.2], [40.0, 0.0, 1.2], [40.0, 35.0, 1.2], [0.0, 35.0, 1.2]])


def walk_and_jump(far_m: float):
    """0.5 m/s; after 8 s carried far_m along x within no time."""
    return lambda t_s: (
        np.array([10.0, 10.0]) + np.array([0.4, 0.3]) * t_s[:, None] + np.where(t_s[:, None] > 8, [far_m, 0.0], 0.0)
    )


def track(lab, simulated, anchors_m: Float, *, smooth: bool, fix_m=None, keep=slice(None)) -> TrackedRanges:
    """Fixes with the noise of single ones, which tracking must live with."""
    noise_m = 0.12 * np.random.default_rng(1).standard_normal(simulated.position_m.shape)
    rows = simulated.series
    return track_ranges(
        rows.t_ns[keep], rows.anchor[keep], rows.range_m[keep], anchors_m, lab.TAG_HEIGHT_M, simulated.t_ns,
        simulated.position_m + noise_m if fix_m is None else fix_m,
        range_std_m=0.1, acceleration_std_mps2=1.0, smooth=smooth,
    )  # fmt: skip


def fixes(lab, simulated) -> Float:
    """What each epoch of three anchors says by itself, blocked paths and all."""
    found = solve_gauss_newton(lab.TRIANGLE_M, simulated.range_m, lab.TAG_HEIGHT_M, 0.1, 10.0)
    assert found.solved.all()
    return found.position_m


def off(simulated, tracked: TrackedRanges) -> tuple[Float, Float]:
    t_ns = tracked.track.t_ns
    at = np.searchsorted(simulated.t_ns, t_ns)
    return (t_ns - simulated.t_ns[0]) * 1e-9, np.hypot(*(tracked.track.position_m - simulated.position_m[at]).T)


@pytest.mark.parametrize("rate_hz", [50, 4])
@pytest.mark.parametrize("far_m", [2.0, 8.0, 20.0])
def test_a_smoothed_track_is_split_where_the_tag_was_carried_away(lab, far_m, rate_hz):
    simulated = lab.simulate(walk_and_jump(far_m), HALL_M, 2, duration_s=20, rate_hz=rate_hz)
    tracked = track(lab, simulated, HALL_M, smooth=True)
    jump_s = np.ceil(8 * rate_hz + 1) / rate_hz
    assert (tracked.restart_ns - simulated.t_ns[0]) * 1e-9 == pytest.approx([jump_s])
    _, off_m = off(simulated, tracked)
    assert len(off_m) == len(simulated.t_ns)
    assert off_m.max() < 0.35
    assert not np.isnan(tracked.predicted_m).any()


@pytest.mark.parametrize("far_m", [8.0, 20.0])
def test_a_causal_track_starts_anew_when_it_can_know(lab, far_m):
    simulated = lab.simulate(walk_and_jump(far_m), HALL_M, 2, duration_s=20)
    tracked = track(lab, simulated, HALL_M, smooth=False)
    restart_s = (tracked.restart_ns - simulated.t_ns[0]) * 1e-9
    assert len(restart_s) == 1
    assert 8.5 < restart_s[0] < 9.2
    t_s, off_m = off(simulated, tracked)
    assert off_m[t_s > 9.5].max() < 0.25
    assert off_m[(t_s > 8.02) & (t_s < 8.3)].min() > 1.0
    # Within the second in which nothing is certain yet, just before and just after it is.
    at = int(np.searchsorted(simulated.t_ns, tracked.restart_ns[0]))
    for count in (420, at, at + 1, at + 30):
        start = track(lab, simulated, HALL_M, smooth=False, keep=slice(4 * count))
        np.testing.assert_array_equal(start.track.position_m, tracked.track.position_m[:count])
        np.testing.assert_array_equal(start.track.covariance_m2, tracked.track.covariance_m2[:count])


def test_a_causal_track_that_finds_back_by_itself_is_left_alone(lab):
    simulated = lab.simulate(walk_and_jump(3.0), HALL_M, 3, duration_s=20)
    tracked = track(lab, simulated, HALL_M, smooth=False)
    assert len(tracked.restart_ns) == 0
    t_s, off_m = off(simulated, tracked)
    assert off_m[t_s > 9.5].max() < 0.25


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("far_m", [9.0, 60.0])
def test_a_wrong_first_fix_does_no_lasting_harm(lab, far_m, smooth):
    simulated = lab.simulate(walk_and_jump(0.0), HALL_M, 4, duration_s=6)
    fix_m = simulated.position_m.copy()
    fix_m[0] += [far_m, far_m]
    tracked = track(lab, simulated, HALL_M, smooth=smooth, fix_m=fix_m)
    t_s, off_m = off(simulated, tracked)
    assert off_m[t_s > 1.1].max() < 0.3
    if smooth:
        assert off_m.max() < 0.3
    if smooth and far_m == 60.0:
        np.testing.assert_array_equal(np.isnan(tracked.predicted_m), np.arange(1200) < 4)
        np.testing.assert_array_equal(tracked.restart_ns, simulated.t_ns[1])


@pytest.mark.parametrize("smooth", [False, True])
def test_a_burst_at_the_very_start_is_not_a_track_of_its_own(lab, smooth):
    simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, 5)
    simulated.range_m[:30, 2] += 1.2
    simulated.series.range_m[2:90:3] += 1.2
    tracked = track(lab, simulated, lab.TRIANGLE_M, smooth=smooth, fix_m=fixes(lab, simulated))
    assert len(tracked.restart_ns) == 0
    t_s, off_m = off(simulated, tracked)
    assert off_m[t_s > 2].max() < 0.35


@pytest.mark.parametrize("smooth", [False, True])
def test_neither_bursts_nor_biases_nor_turns_count_as_a_loss(lab, smooth):
    def zigzag(t_s):
        return np.array([1.0, 3.0]) + np.stack([1.5 * np.abs((t_s % 8) - 4), 0 * t_s], axis=1)

    biased_m = np.array([0.3, 0.0, 0.3])
    for seed in range(12):
        for simulated, anchors_m in (
            (lab.simulate(lab.walk_straight, lab.TRIANGLE_M, seed, bursts=True), lab.TRIANGLE_M),
            (lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, seed, bias_m=biased_m), lab.TRIANGLE_M),
            (lab.simulate(zigzag, lab.SQUARE_M, seed, rate_hz=10, duration_s=20), lab.SQUARE_M),
        ):
            fix_m = fixes(lab, simulated) if len(anchors_m) == 3 else None
            tracked = track(lab, simulated, anchors_m, smooth=smooth, fix_m=fix_m)
            assert len(tracked.restart_ns) == 0
            assert len(tracked.track) == len(simulated.t_ns)


@pytest.mark.parametrize("smooth", [False, True])
def test_looking_in_steps_finds_what_looking_at_once_finds(lab, monkeypatch, smooth):
    simulated = lab.simulate(walk_and_jump(8.0), HALL_M, 5, duration_s=16)
    at_once = track(lab, simulated, HALL_M, smooth=smooth)
    monkeypatch.setattr(stretches, "FIRST_LOOK", 7)
    in_steps = track(lab, simulated, HALL_M, smooth=smooth)
    np.testing.assert_array_equal(in_steps.track.position_m, at_once.track.position_m)
    np.testing.assert_array_equal(in_steps.restart_ns, at_once.restart_ns)
    assert len(at_once.restart_ns) == 1


def test_a_tag_carried_away_again_and_again(lab):
    simulated = lab.simulate(
        lambda t_s: np.array([10.0, 10.0]) + 9.0 * (t_s[:, None] // 3 % 2) * [1.0, 0.5], HALL_M, 6, duration_s=15
    )
    tracked = track(lab, simulated, HALL_M, smooth=True)
    np.testing.assert_allclose((tracked.restart_ns - simulated.t_ns[0]) * 1e-9, [3, 6, 9, 12], atol=0.021)
    assert off(simulated, tracked)[1].max() < 0.35


def test_ranges_across_a_clock_jump_of_one_second(lab):
    """Stamps leap ahead, the tag does not: a gap, which is no loss."""
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 7)
    late = simulated.t_ns + np.where(np.arange(600) >= 300, 1_000_000_000, 0)
    rows = simulated.series
    tracked = track_ranges(
        np.repeat(late, 4), rows.anchor, rows.range_m, lab.SQUARE_M, lab.TAG_HEIGHT_M, late, simulated.position_m,
        range_std_m=0.1, acceleration_std_mps2=1.0, smooth=True,
    )  # fmt: skip
    assert len(tracked.restart_ns) == 0
    assert np.hypot(*(tracked.track.position_m - simulated.position_m).T).max() < 0.35
