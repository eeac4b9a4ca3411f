from __future__ import annotations

import hashlib

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.errors import InvalidConfigValue, QuadlogError
from quadlog.pipelines.simulation.walk import CURVES, PlannedTrot, plan_trot, planned_peak_m, trot_metrics, trot_once
from quadlog.simulation.robot.trot import TrotRobot

EXACT = ("friction_spread=0", "foot_radius_spread=0", "posture_spread_deg=0")


def _simulation(*keys: str):
    return load_config(None, [f"simulation.trot.{key}" for key in keys], {}).simulation


def _plan(*keys: str, curve: str = "3d-curve", seed: int = 0) -> PlannedTrot:
    return plan_trot(_simulation(*keys), curve, seed)


@pytest.mark.parametrize("settings", [EXACT, ()])
def test_a_symmetric_robot_goes_straight_and_rolls_as_the_paper_has_it(settings):
    for seed in (0, 1) if not settings else (0,):
        metrics = {
            name: each.value for name, each in trot_metrics(trot_once(_simulation(*settings), "baseline", seed)).items()
        }
        assert abs(metrics["yaw_rate_degps"]) <= 0.005
        assert 6 <= metrics["roll_range_deg"] <= 8
        assert abs(metrics["lateral_drift_m"]) < 0.02
        assert metrics["fallen"] == 0
        # Without slip it is 2 S T, and on what it does not rest on.
        assert 2.3 < metrics["forward_m"] < 2.7


def test_the_other_pair_first_mirrors_the_walk_whatever_is_drawn():
    left, right = (
        trot_once(_simulation(f"first_pair={pair}"), "3d-curve", 7).walk for pair in ("left_fore", "right_fore")
    )
    np.testing.assert_allclose(right.position_m, left.position_m * [1, -1, 1], atol=1e-9)
    assert np.abs(left.position_m[:, 1]).max() > 1e-3


def test_the_same_seed_walks_the_same_and_another_one_does_not():
    def digest(seed: int) -> str:
        return hashlib.sha256(trot_once(_simulation(), "baseline", seed).walk.qpos.tobytes()).hexdigest()

    first = digest(3)
    assert digest(3) == first
    assert digest(4) != first


def test_the_baseline_goes_straight_and_the_curve_aside_alternately():
    baseline, curve = (_plan(curve=each) for each in CURVES)
    assert baseline.peak_m == 0
    assert curve.peak_m == pytest.approx(0.01, rel=0.01)
    assert curve.peak_m == planned_peak_m(TrotRobot(), 175.0)
    # The abduction of each leg: right fore and left hind go left in their swing, the others right.
    moved = (curve.targets_rad - baseline.targets_rad)[2000:3000, ::3]
    farthest = moved[np.abs(moved).argmax(axis=0), range(4)]
    assert (np.sign(farthest) == [-1, 1, 1, -1]).all()


def test_to_the_same_side_is_to_the_left_with_k_above_0():
    baseline = _plan(curve="baseline").targets_rad
    for k, sign in ((350, 1), (-350, -1)):
        moved = (_plan(f"foot_curve_k={k}", "lateral=same").targets_rad - baseline)[2000:3000, ::3]
        assert (np.sign(moved[np.abs(moved).argmax(axis=0), range(4)]) == sign).all()


def test_the_eased_curve_is_another_one_of_the_same_peak():
    parabola, eased = _plan(), _plan("lateral_shape=eased")
    assert parabola.peak_m == eased.peak_m
    assert 1e-3 < np.abs(parabola.targets_rad - eased.targets_rad).max() < 0.1


def test_what_the_robot_carries_does_not_reach_its_controller():
    plain, loaded = _plan(), _plan("payload_kg=3", "payload_y_m=0.1", "leg_mass_spread=0.2", "hip_offset_m=0.01")
    np.testing.assert_array_equal(plain.targets_rad, loaded.targets_rad)
    assert plain.peak_m == loaded.peak_m
    robot = loaded.robot
    assert (robot.payload_kg, robot.payload_x_m, robot.payload_y_m) == (3, 0, 0.1)
    assert (robot.leg_mass_spread, robot.hip_offset_m) == (0.2, 0.01)


def test_a_seed_draws_within_what_is_set():
    robots = [_plan("friction_spread=0.5", seed=seed).robot for seed in range(20)]
    friction = np.array([robot.friction for robot in robots])
    assert (np.abs(friction - 0.8) <= 0.4).all()
    assert np.abs(friction - 0.8).max() > 0.25
    assert all(abs(robot.foot_radius_m - 0.02) <= 0.002 for robot in robots)
    exact = _plan(*EXACT, seed=9)
    assert exact.robot == TrotRobot()
    assert not exact.posture_rad.any()


def test_a_trim_to_the_left_turns_to_the_left():
    """0.06 degrees a second for each millimetre, as facts about another model of this robot have it."""
    metrics = trot_metrics(trot_once(_simulation(*EXACT, "foot_curve_k=350", "lateral=same"), "3d-curve", 0))
    assert metrics["yaw_rate_degps"].value == pytest.approx(5 * 0.06, rel=0.2)


@pytest.mark.parametrize("k", ["2", "-0.001"])
def test_a_curve_out_of_reach_names_its_key(k):
    with pytest.raises(InvalidConfigValue, match="foot_curve_k"):
        _plan(f"foot_curve_k={k}")


@pytest.mark.parametrize(
    "key", ["foot_curve_k=0", "payload_kg=-1", "leg_mass_spread=1", "lateral=left", "first_pair=left", "height_m=1"]
)
def test_values_that_make_no_robot_are_refused_by_name(key):
    with pytest.raises(QuadlogError, match=key.split("=", maxsplit=1)[0]):
        _simulation(key)
