from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_bvp

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.errors import InvalidConfigValue
from quadlog.messages import Float
from quadlog.pipelines.simulation.trot import (
    LIFT_M,
    PAIRS,
    PLAN,
    SAMPLES_HZ,
    STEP_M,
    FootCycle,
    TrotRobot,
    gravity_moment_nm,
    hip_inertia_kgm2,
    joint_targets,
    lateral_peak_m,
    trot_model,
    walk_trot,
)

LINK_M, ASIDE_M, LEG_KG, HEIGHT_M = 0.21, 0.07, 0.4, 0.2


def _knee() -> tuple[float, float]:
    """How far the knee is behind and below the hip: thigh and shank are as long as one another."""
    down = (PLAN.standing_height_m - 0.02) / 2
    return math.sqrt(LINK_M**2 - down**2), down


def test_the_gravity_moment_is_that_of_eq_8():
    """M about x with M = 4 m, d of even rods: half as far behind as the knee, for thigh and shank alike."""
    behind, _ = _knee()
    moment = 4 * LEG_KG * 9.81 * behind / 2
    length, width = 0.36, 0.12 + 2 * ASIDE_M
    expected = -moment * length * width / (length**2 + width**2)
    assert gravity_moment_nm(trot_model(TrotRobot())) == pytest.approx(expected, rel=1e-4)


def test_the_hip_inertia_is_that_of_two_rods():
    """Even rods from z = 0 to -down and on to -2 down, at the side of the axis; the rod's own girth is small."""
    _, down = _knee()
    heights = (down**2 / 3, 7 * down**2 / 3)
    expected = sum(LEG_KG / 2 * (ASIDE_M**2 + height) for height in heights)
    assert hip_inertia_kgm2(trot_model(TrotRobot())) == pytest.approx(expected, rel=0.01)


def test_a_payload_shifts_the_centre_of_mass_to_where_it_is():
    def centre(robot: TrotRobot) -> np.ndarray:
        model = trot_model(robot)
        data = mujoco.MjData(model.model)
        data.qpos[model.joint_qpos] = model.robot.standing_joints_rad
        mujoco.mj_forward(model.model, data)
        return data.subtree_com[model.trunk_body].copy()

    empty, loaded = centre(TrotRobot()), centre(TrotRobot(payload_kg=2.5, payload_x_m=0.15, payload_y_m=-0.1))
    assert loaded[:2] == pytest.approx((10 * empty[:2] + 2.5 * np.array([0.15, -0.1])) / 12.5, abs=1e-6)
    assert loaded[2] > empty[2]


RESTING, CYCLE = 2000, 1000


def _feet(joints: Float) -> Float:
    """(N, 4, 3) beside where they stand."""
    feet = np.empty((len(joints), 4, 3))
    for row, angles in zip(feet, joints, strict=True):
        foot_positions(angles, PLAN.hips_m, PLAN.lengths, row)
    return feet - PLAN.standing_feet_m


def _walk(first_pair: int = 0, ticks: int | None = None) -> dict[str, Float]:
    # Mirrored, this curve is itself.
    targets = joint_targets(np.array([-0.01, 0.01, 0.01, -0.01]), first_pair)
    return walk_trot(trot_model(TrotRobot()), targets[:ticks], np.zeros(12))


@pytest.fixture(scope="module")
def walk() -> dict[str, Float]:
    return _walk()


def test_feet_are_sent_along_the_curve():
    targets = joint_targets(np.array([-0.01, 0.02, 0.01, 0.0]))
    assert targets.shape == (32_000, 12)
    assert (targets[: RESTING + 1] == targets[0]).all()
    np.testing.assert_array_equal(targets[RESTING : RESTING + CYCLE], targets[-CYCLE:])
    feet = _feet(targets[RESTING : RESTING + CYCLE : 10])
    first, second = feet[:, PAIRS == 0], feet[:, PAIRS == 1]
    # Half a period later the other pair does the same.
    np.testing.assert_allclose(first[..., ::2], np.roll(second, 50, axis=0)[..., ::2], atol=1e-12)
    assert first[0, :, 0] == pytest.approx(-STEP_M / 2)
    assert second[0, :, 0] == pytest.approx(STEP_M / 2)
    assert feet[..., 2].max(axis=0) == pytest.approx(LIFT_M, abs=1e-6)
    assert feet[:50, PAIRS == 1, 2] == pytest.approx(0, abs=1e-12)
    assert feet[25, 0, 1] == pytest.approx(-0.01)
    assert feet[75, 1:3, 1] == pytest.approx([0.02, 0.01])
    assert np.abs(feet[:, 3, 1]).max() < 1e-12


def test_a_curve_out_of_reach_is_refused():
    with pytest.raises(InvalidConfigValue, match="500 mm aside"):
        joint_targets(np.full(4, 0.5))


def columns(walk, *names):
    return np.column_stack([walk[name] for name in names])


def test_starting_with_the_other_pair_mirrors_the_walk(walk):
    other = _walk(1, 8 * CYCLE)
    rows = len(other["x_m"])
    for names, mirror, atol in (
        (("x_m", "y_m", "z_m"), [1, -1, 1], 1e-9),
        (("roll_rad", "pitch_rad", "yaw_rad"), [-1, 1, -1], 1e-8),
    ):
        np.testing.assert_allclose(columns(other, *names), columns(walk, *names)[:rows] * mirror, atol=atol)
    assert np.abs(other["y_m"]).max() > 0.005


def test_the_walk_rests_first_and_then_moves_forward(walk):
    assert len(walk["t_ns"]) == 32 * SAMPLES_HZ + 1
    assert walk["t_ns"][-1] == 32_000_000_000
    assert np.ptp(walk["x_m"][10:100]) < 1e-3
    assert walk["x_m"][-1] == pytest.approx(2 * STEP_M * 30, rel=0.1)
    assert not walk["fallen"].any()


def test_feet_carry_the_robot(walk):
    """Momentum: over whole cycles the mean of the feet's loads is the weight, as the body's height comes back."""
    loads = columns(walk, *(f"fz_{leg}_n" for leg in range(4))).sum(axis=1)
    assert loads[501:1601].mean() == pytest.approx(10 * 9.81, rel=0.03)
    # Standing, the load is the weight at every instant.
    assert loads[90] == pytest.approx(10 * 9.81, rel=1e-3)


T, S, H = 1.0, 0.04, 0.02


def _printed_swing(t, lam):
    """Eq. 9 as printed, but for its domains."""
    u = t / (lam * T)
    x = S * (u - np.sin(2 * np.pi * u) / (2 * np.pi))
    half = np.sin(4 * np.pi * u) / (2 * np.pi)
    return x, np.where(t < lam * T / 2, H * (2 * u - half), H * (2 - 2 * u + half))


def _printed_stance(t, lam):
    """Eq. 10."""
    return S * ((T - t) / ((1 - lam) * T) + np.sin(2 * np.pi * (t - lam * T) / ((1 - lam) * T)) / (2 * np.pi))


@pytest.mark.parametrize("lam", [0.3, 0.5, 0.7])
def test_the_cycle_is_that_of_eqs_9_and_10_about_the_middle_of_the_step(lam):
    cycle = FootCycle(T, S, H, swing_share=lam)
    swing = np.linspace(0, lam * T, 200, endpoint=False)
    x, z = _printed_swing(swing, lam)
    position = cycle.at(swing)
    np.testing.assert_allclose(position, np.column_stack([x - S / 2, 0 * x, z]), atol=1e-15)
    stance = np.linspace(lam * T, T, 200, endpoint=False)
    position = cycle.at(stance)
    x = _printed_stance(stance, lam)
    np.testing.assert_allclose(position, np.column_stack([x - S / 2, 0 * x, 0 * x]), atol=1e-15)


def test_the_bulge_solves_eq_11():
    """2 J1 k y'' = M, y(0) = y(T/2) = 0, solved by scipy."""
    moment, k, inertia, period_s = -0.7, 120.0, 0.0063, 0.8
    t_s = np.linspace(0, period_s / 2, 50, endpoint=False)
    solved = solve_bvp(
        lambda _, y: np.vstack([y[1], np.full_like(y[0], moment / (2 * inertia * k))]),
        lambda start, end: np.array([start[0], end[0]]),
        np.array([0.0, period_s / 2]),
        np.zeros((2, 2)),
    )
    cycle = FootCycle(period_s, S, H, aside_m=lateral_peak_m(moment, k, inertia, period_s))
    np.testing.assert_allclose(cycle.at(t_s)[:, 1], solved.sol(t_s)[0], atol=1e-12)
    assert lateral_peak_m(moment, k, inertia, period_s) == pytest.approx(solved.sol(period_s / 4)[0])
