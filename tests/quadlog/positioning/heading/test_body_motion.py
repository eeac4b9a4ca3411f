from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.geometry import base_to_tag
from quadlog.messages import Float
from quadlog.positioning.heading.odometry_velocity import BodyMotion, MeasuredVelocity, measure_velocity
from quadlog.positioning.track.tracker import TrackedRanges, track_ranges

LEVER_M = (0.3, -0.2)
TURNED_RAD = 2.1


def odometry(simulated, *, scale=1.0, noise_mps=0.03, backwards=False) -> BodyMotion:
    """A base that walks its figure, seen by wheels at 50 Hz in a frame of their own."""
    t_s = (simulated.t_ns - simulated.t_ns[0]) * 1e-9
    velocity = np.gradient(simulated.position_m, t_s, axis=0)
    yaw_rad = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0])) + (np.pi if backwards else 0.0)
    rng = np.random.default_rng(7)
    forward = np.hypot(*velocity.T) * (-scale if backwards else scale)
    own = np.stack([forward, np.zeros(len(t_s))], axis=1) + noise_mps * rng.standard_normal((len(t_s), 2))
    return BodyMotion(simulated.t_ns, own, yaw_rad - TURNED_RAD, np.gradient(yaw_rad, t_s))


def base_yaw(motion: BodyMotion) -> Float:
    return motion.yaw_rad + TURNED_RAD


def track(lab, simulated, *, smooth: bool, velocity=None) -> TrackedRanges:
    rows = simulated.series
    return track_ranges(
        rows.t_ns, rows.anchor, rows.range_m, lab.TRIANGLE_M, lab.TAG_HEIGHT_M, simulated.t_ns, simulated.position_m,
        range_std_m=0.1, acceleration_std_mps2=1.0, smooth=smooth, velocity=velocity,
    )  # fmt: skip


def walk(lab, seed=1, **kwargs):
    return lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, seed, duration_s=30, **kwargs)


def measured(lab, simulated, motion: BodyMotion, *, smooth: bool, lever_m=(0.0, 0.0)) -> MeasuredVelocity:
    return measure_velocity(motion, track(lab, simulated, smooth=smooth).track, *lever_m, causal=not smooth)


def rms(lab, simulated, tracked: TrackedRanges) -> float:
    return lab.rmse(tracked.track.position_m - simulated.truth_at(tracked.track.t_ns))


@pytest.mark.parametrize("rate_hz", [50, 5])
@pytest.mark.parametrize("smooth", [True, False])
def test_odometry_makes_tracks_better(lab, smooth, rate_hz):
    for seed in range(3):
        simulated = walk(lab, seed, rate_hz=rate_hz, bursts=True)
        got = measured(lab, simulated, odometry(walk(lab, seed)), smooth=smooth)
        assert got.reason is None
        with_it = rms(lab, simulated, track(lab, simulated, smooth=smooth, velocity=got.series))
        without = rms(lab, simulated, track(lab, simulated, smooth=smooth))
        assert with_it < (0.8 if smooth else 0.97) * without


def test_the_series_is_the_tags_velocity_in_map(lab):
    simulated = walk(lab)
    t_s = (simulated.t_ns - simulated.t_ns[0]) * 1e-9
    got = measured(lab, simulated, odometry(simulated, noise_mps=0.0), smooth=True)
    assert got.series is not None
    true_mps = np.gradient(simulated.position_m, t_s, axis=0)
    np.testing.assert_allclose(got.series.velocity_mps, true_mps, atol=0.05)
    assert got.std_mps < 0.05


def test_a_tag_off_the_middle_swings(lab):
    """The same odometry of base; the tag sits 0.36 m away from it."""
    base = walk(lab, 2)
    motion = odometry(base, noise_mps=0.0)
    tag_m = base_to_tag(base.position_m, base_yaw(motion), *LEVER_M)
    range_m = lab.true_ranges(tag_m, lab.TRIANGLE_M)
    range_m = range_m + 0.1 * np.random.default_rng(2).standard_normal(range_m.shape)
    tag = replace(base, position_m=tag_m, range_m=range_m, series=replace(base.series, range_m=range_m.ravel()))
    got = measured(lab, tag, motion, smooth=True, lever_m=LEVER_M)
    wrong = measured(lab, tag, motion, smooth=True, lever_m=(-LEVER_M[0], -LEVER_M[1]))
    assert got.series is not None
    true_mps = np.gradient(tag_m, (base.t_ns - base.t_ns[0]) * 1e-9, axis=0)
    np.testing.assert_allclose(got.series.velocity_mps[5:-5], true_mps[5:-5], atol=0.06)
    assert wrong.std_mps > 2 * got.std_mps


def test_walking_backwards_is_no_disagreement(lab):
    simulated = walk(lab, 3)
    got = measured(lab, simulated, odometry(simulated, backwards=True), smooth=True)
    assert got.reason is None
    assert got.std_mps < 0.05


@pytest.mark.parametrize("scale", [0.8, 0.6, 1.3])
def test_a_wrong_scale_loses_its_say_instead_of_bending_the_track(lab, scale):
    simulated = walk(lab, 4)
    got = measured(lab, simulated, odometry(simulated, scale=scale), smooth=True)
    assert got.std_mps > 0.1
    with_it = track(lab, simulated, smooth=True, velocity=got.series)
    assert rms(lab, simulated, with_it) < 1.1 * rms(lab, simulated, track(lab, simulated, smooth=True))


def test_a_slip_has_no_say_while_it_lasts(lab):
    simulated = walk(lab, 5)
    motion = odometry(simulated)
    seconds = (motion.t_ns - motion.t_ns[0]) * 1e-9
    slipping = (seconds > 12) & (seconds < 15)
    motion.velocity_mps[slipping] *= 3.0
    got = measured(lab, simulated, motion, smooth=True)
    assert got.series is not None
    assert got.series.std_mps[slipping].min() > 10 * np.median(got.series.std_mps)
    with_it = track(lab, simulated, smooth=True, velocity=got.series)
    assert rms(lab, simulated, with_it) < rms(lab, simulated, track(lab, simulated, smooth=True))


@pytest.mark.parametrize("spoil", ["scale", "turns the other way"])
def test_odometry_that_disagrees_grossly_is_refused_with_a_reason(lab, spoil):
    simulated = walk(lab, 6)
    motion = odometry(simulated, scale=3.0 if spoil == "scale" else 1.0)
    if spoil == "turns the other way":
        motion = replace(motion, yaw_rad=-motion.yaw_rad, yaw_rate_radps=-motion.yaw_rate_radps)
    got = measured(lab, simulated, motion, smooth=True)
    assert got.series is None
    assert got.reason is not None
    assert "misses" in got.reason
    causal = measured(lab, simulated, motion, smooth=False)
    assert causal.series is not None
    with_it = track(lab, simulated, smooth=False, velocity=causal.series)
    assert rms(lab, simulated, with_it) < 1.05 * rms(lab, simulated, track(lab, simulated, smooth=False))


def test_causal_velocities_know_nothing_later(lab):
    simulated = walk(lab, 8, bursts=True)
    motion = odometry(simulated)
    cut = 900
    columns = motion.t_ns, motion.velocity_mps, motion.yaw_rad, motion.yaw_rate_radps
    until = BodyMotion(*(each[:cut] for each in columns))
    whole = track(lab, simulated, smooth=False).track
    rows = simulated.series
    early = replace(
        simulated,
        series=replace(rows, **{name: getattr(rows, name)[: 3 * cut] for name in ("t_ns", "tag", "anchor", "range_m")}),
    )
    part = track(lab, early, smooth=False).track
    all_of_it = measure_velocity(motion, whole, *LEVER_M, causal=True).series
    then = measure_velocity(until, part, *LEVER_M, causal=True).series
    assert all_of_it is not None
    assert then is not None
    np.testing.assert_array_equal(then.velocity_mps, all_of_it.velocity_mps[:cut])
    np.testing.assert_array_equal(then.std_mps, all_of_it.std_mps[:cut])
    with_all = track(lab, simulated, smooth=False, velocity=all_of_it).track
    with_then = track(lab, early, smooth=False, velocity=then).track
    np.testing.assert_array_equal(with_then.position_m, with_all.position_m[:cut])


def test_odometry_from_another_time_is_refused(lab):
    simulated = walk(lab, 9)
    motion = odometry(simulated)
    for t_ns in (motion.t_ns + 3600 * 10**9, motion.t_ns - 29 * 10**9):
        got = measured(lab, simulated, replace(motion, t_ns=t_ns), smooth=True)
        assert got.series is None
        assert got.reason is not None
        assert "overlap" in got.reason
    short = BodyMotion(motion.t_ns[:1], motion.velocity_mps[:1], motion.yaw_rad[:1], motion.yaw_rate_radps[:1])
    assert measured(lab, simulated, short, smooth=True).series is None
