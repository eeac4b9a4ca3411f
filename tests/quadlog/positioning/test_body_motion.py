"""Odometry of what carries a tag, with the ranges: simulated walks whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.geometry import base_to_tag
from quadlog.positioning.locate import TagResult
from quadlog.positioning.odometry import BodyMotion

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
    return lab.locate_tag(simulated.series, lab.TRIANGLE_M, motion, *lever_m, calibrate=False, smooth=smooth)


def walk(lab, seed=1, **kwargs):
    return lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, seed, **({"duration_s": 30} | kwargs))


def rms(lab, simulated, got: TagResult) -> float:
    return lab.rmse(got.track.position_m - simulated.truth_at(got.track.t_ns))


@pytest.mark.parametrize(
    ("smooth", "changes", "share"),
    [(True, {}, 0.8), (True, {"backwards": True}, 0.8), (False, {}, 1.0), (False, {"scale": 3.0}, 1.1)],
    ids=["forwards", "backwards", "causal", "causal, which cannot refuse it"],
)
def test_odometry_makes_tracks_better_or_hardly_worse(lab, smooth, changes, share):
    with_it, without = [], []
    for seed in range(3 if smooth else 1):
        simulated = walk(lab, seed, rate_hz=5, bursts=True)
        got = run(lab, simulated, odometry(walk(lab, seed), **changes), smooth=smooth)
        assert not got.velocity.reason
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


@pytest.mark.parametrize("spoil", ["short scale", "long scale", "slip"])
def test_a_wrong_scale_or_a_slip_loses_its_say_instead_of_bending_the_track(lab, spoil):
    simulated = walk(lab, 4)
    motion = odometry(simulated, scale={"short scale": 0.6, "long scale": 1.3}.get(spoil, 1.0))
    slipping = np.abs((motion.t_ns - motion.t_ns[0]) * 1e-9 - 13.5) < (1.5 if spoil == "slip" else np.inf)
    if spoil == "slip":
        motion.velocity_mps[slipping] *= 3.0
    got = run(lab, simulated, motion)
    std_mps = got.velocity.odometry.std_mps
    assert std_mps[slipping].min() > (10 * np.median(std_mps) if spoil == "slip" else 0.1)
    assert rms(lab, simulated, got) < (1.0 if spoil == "slip" else 1.1) * rms(lab, simulated, run(lab, simulated))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        ("scale", "is off by"),
        ("turns the other way", "is off by"),
        ("an hour later", "overlap"),
        ("half a minute earlier", "overlap"),
        ("short", "too short"),
    ],
)
def test_odometry_that_disagrees_grossly_is_refused_with_a_reason(lab, spoil, reason):
    simulated = walk(lab, 6, rate_hz=20)
    motion = odometry(simulated, scale=3.0 if spoil == "scale" else 1.0)
    later_s = {"an hour later": 3600, "half a minute earlier": -29}.get(spoil, 0)
    motion = until(replace(motion, t_ns=motion.t_ns + later_s * 10**9), 1 if spoil == "short" else None)
    if spoil == "turns the other way":
        motion = replace(motion, yaw_rad=-motion.yaw_rad, yaw_rate_radps=-motion.yaw_rate_radps)
    assert reason in run(lab, simulated, motion).velocity.reason


def test_causal_motion_knows_nothing_later(lab):
    simulated, cut = walk(lab, 8, rate_hz=10, duration_s=20, bursts=True), 120
    motion, begun = odometry(simulated), replace(simulated, series=simulated.series.rows(slice(3 * cut)))
    whole = run(lab, simulated, motion, smooth=False, lever_m=LEVER_M)
    part = run(lab, begun, until(motion, cut), smooth=False, lever_m=LEVER_M)
    own, of_whole = part.velocity.odometry, whole.velocity.odometry
    np.testing.assert_array_equal(own.way.xy_m, of_whole.way.xy_m[:cut])
    np.testing.assert_array_equal(own.std_mps, of_whole.std_mps[:cut])
    np.testing.assert_allclose(part.track.position_m, whole.track.position_m[:cut], atol=1e-12)


def until(motion: BodyMotion, cut: int | None) -> BodyMotion:
    return BodyMotion(*(getattr(motion, name)[:cut] for name in ("t_ns", "velocity_mps", "yaw_rad", "yaw_rate_radps")))
