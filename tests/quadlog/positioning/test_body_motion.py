"""Odometry of what carries a tag, with the ranges: simulated walks whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.geometry import base_to_tag
from quadlog.messages import Float, RangeSeries
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, TagResult, locate
from quadlog.positioning.odometry import BodyMotion, MeasuredMotion, measure_motion

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


def run(lab, simulated, motion=None, *, smooth=True, lever_m=(0.0, 0.0)) -> TagResult:
    anchors = Anchors(np.arange(3), lab.TRIANGLE_M, np.zeros(3))
    tag = TagInfo(0, lab.TAG_HEIGHT_M, motion, *lever_m)
    return locate(simulated.series, anchors, [tag], LocateSettings(calibrate=False, smooth=smooth)).tags[0]


def walk(lab, seed=1, **kwargs):
    return lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, seed, **({"duration_s": 30} | kwargs))


def measured(lab, simulated, motion: BodyMotion, *, smooth=True, lever_m=(0.0, 0.0)) -> MeasuredMotion:
    return measure_motion(motion, run(lab, simulated, smooth=smooth).track, *lever_m, causal=not smooth)


def rms(lab, simulated, got: TagResult) -> float:
    return lab.rmse(got.track.position_m - simulated.truth_at(got.track.t_ns))


@pytest.mark.parametrize(("smooth", "backwards", "share"), [(True, False, 0.8), (True, True, 0.8), (False, False, 1.0)])
def test_odometry_makes_tracks_better_also_of_one_that_drives_backwards(lab, smooth, backwards, share):
    with_it, without = [], []
    for seed in range(3 if smooth else 1):
        simulated = walk(lab, seed, rate_hz=5, bursts=True)
        got = run(lab, simulated, odometry(walk(lab, seed), backwards=backwards), smooth=smooth)
        assert got.velocity.reason is None
        with_it.append(rms(lab, simulated, got))
        without.append(rms(lab, simulated, run(lab, simulated, smooth=smooth)))
    assert np.mean(with_it) < share * np.mean(without)


def test_a_tag_off_the_middle_swings(lab):
    """The same odometry of base; the tag sits 0.36 m away from it."""
    base = walk(lab, 2, rate_hz=20)
    motion = odometry(base, noise_mps=0.0)
    tag_m = base_to_tag(base.position_m, motion.yaw_rad + TURNED_RAD, *LEVER_M)
    range_m = lab.true_ranges(tag_m, lab.TRIANGLE_M)
    range_m = range_m + 0.1 * np.random.default_rng(2).standard_normal(range_m.shape)
    tag = replace(base, position_m=tag_m, range_m=range_m, series=replace(base.series, range_m=range_m.ravel()))
    right, wrong = (run(lab, tag, motion, lever_m=(s * LEVER_M[0], s * LEVER_M[1])) for s in (1, -1))
    assert rms(lab, tag, right) < 0.75 * rms(lab, tag, run(lab, tag))
    assert rms(lab, tag, right) < 0.75 * rms(lab, tag, wrong)


@pytest.mark.parametrize("scale", [0.6, 1.3])
def test_a_wrong_scale_loses_its_say_instead_of_bending_the_track(lab, scale):
    simulated = walk(lab, 4)
    got = run(lab, simulated, odometry(simulated, scale=scale))
    assert got.velocity.typical_std_mps > 0.1
    assert rms(lab, simulated, got) < 1.1 * rms(lab, simulated, run(lab, simulated))


def test_a_slip_has_no_say_while_it_lasts(lab):
    simulated = walk(lab, 5)
    motion = odometry(simulated)
    seconds = (motion.t_ns - motion.t_ns[0]) * 1e-9
    slipping = (seconds > 12) & (seconds < 15)
    motion.velocity_mps[slipping] *= 3.0
    got = measured(lab, simulated, motion)
    assert got.std_mps[slipping].min() > 10 * np.median(got.std_mps)
    assert rms(lab, simulated, run(lab, simulated, motion)) < rms(lab, simulated, run(lab, simulated))


@pytest.mark.parametrize("spoil", ["scale", "turns the other way", "an hour later", "half a minute earlier", "short"])
def test_odometry_that_disagrees_grossly_is_refused_with_a_reason(lab, spoil):
    simulated = walk(lab, 6, rate_hz=20)
    motion = odometry(simulated, scale=3.0 if spoil == "scale" else 1.0)
    if spoil == "turns the other way":
        motion = replace(motion, yaw_rad=-motion.yaw_rad, yaw_rate_radps=-motion.yaw_rate_radps)
    elif spoil == "short":
        motion = BodyMotion(*(each[:1] for each in columns_of(motion)))
    else:
        later_s = {"an hour later": 3600, "half a minute earlier": -29}.get(spoil, 0)
        motion = replace(motion, t_ns=motion.t_ns + later_s * 10**9)
    reason = {"scale": "is off by", "turns the other way": "is off by", "short": "too short"}.get(spoil, "overlap")
    assert reason in (measured(lab, simulated, motion).reason or "")


def test_a_causal_track_is_not_made_worse_by_odometry_that_it_cannot_refuse(lab):
    slow = walk(lab, 6, rate_hz=5, duration_s=20)
    with_it, without = (run(lab, slow, each, smooth=False) for each in (odometry(slow, scale=3.0), None))
    assert with_it.velocity.reason is None
    assert rms(lab, slow, with_it) < 1.1 * rms(lab, slow, without)


def test_causal_motion_knows_nothing_later(lab):
    simulated = walk(lab, 8, rate_hz=10, duration_s=20, bursts=True)
    motion, cut = odometry(simulated), 120
    until = BodyMotion(*(each[:cut] for each in columns_of(motion)))
    rows = simulated.series
    begun = RangeSeries(*(getattr(rows, name)[: 3 * cut] for name in ("t_ns", "tag", "anchor", "range_m")))
    whole = run(lab, simulated, motion, smooth=False, lever_m=LEVER_M)
    part = run(lab, replace(simulated, series=begun), until, smooth=False, lever_m=LEVER_M)
    np.testing.assert_array_equal(part.velocity.velocity_mps, whole.velocity.velocity_mps[:cut])
    np.testing.assert_array_equal(part.velocity.std_mps, whole.velocity.std_mps[:cut])
    np.testing.assert_allclose(part.track.position_m, whole.track.position_m[:cut], atol=1e-12)


def columns_of(motion: BodyMotion) -> tuple[Float, ...]:
    return motion.t_ns, motion.velocity_mps, motion.yaw_rad, motion.yaw_rate_radps
