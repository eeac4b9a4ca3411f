"""Clock and frame of a reference, against walks shifted by known amounts, and the errors against evo."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from evo import main_ape
from evo.core import metrics as evo_metrics
from evo.core import sync
from evo.core.trajectory import PoseTrajectory3D
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from quadlog.messages import PoseSeries
from quadlog.metrics.reference_offset import compare_trajectories, estimate_time_offset
from quadlog.metrics.summary import value_of
from quadlog.storage.formats.tum import read_tum

S = 1_000_000_000
EPOCH_NS = 1_700_000_000 * S


def trajectory(at_s, xyz_m) -> PoseSeries:
    t_ns = EPOCH_NS + np.round(np.asarray(at_s) * S).astype(np.int64)
    return PoseSeries(t_ns, np.asarray(xyz_m), np.tile([0.0, 0, 0, 1], (len(at_s), 1)))


def walk(seed: int, seconds: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and positions (N, 3) at 100 Hz, on a plane, of a walk that turns, stops and goes."""
    rng, at_s = np.random.default_rng(seed), np.arange(-5, seconds + 5, 0.01)
    knots = np.arange(-5, seconds + 9, 3)
    course_rad = np.cumsum(np.interp(at_s, knots, rng.normal(0, 0.4, len(knots)))) * 0.01
    speed_mps = np.clip(np.interp(at_s, knots, rng.normal(0.6, 0.3, len(knots))), 0, None)
    steps_m = 0.01 * speed_mps[:, None] * np.column_stack([np.cos(course_rad), np.sin(course_rad), 0 * at_s])
    return at_s, np.cumsum(steps_m, axis=0)


def noisy(at_s, xyz_m, offset_s: float, std_m: float, seconds: float, hz=20, seed=9, correlation_s=0.5) -> PoseSeries:
    """What a positioning system would give of it, its clock behind by offset_s, its errors correlated in time."""
    own_s = np.arange(0, seconds, 1 / hz)
    decay = np.exp(-1 / hz / correlation_s)
    white = np.random.default_rng(seed).normal(0, std_m, (len(own_s) + 200, 2))
    error_m = lfilter([np.sqrt(1 - decay**2)], [1, -decay], white, axis=0)[200:]
    true_m = np.column_stack([np.interp(own_s + offset_s, at_s, axis_m) for axis_m in xyz_m.T])
    return trajectory(own_s, true_m + np.column_stack([error_m, 0 * own_s]))


def moved(poses: PoseSeries, turn: Rotation, shift_m) -> PoseSeries:
    return PoseSeries(poses.t_ns, turn.apply(poses.position_m) + shift_m, poses.quat_xyzw)


@given(
    st.floats(0, 10), st.floats(45, 60), st.sampled_from([(100, 20), (100, 1), (5, 20), (20, 5), (20, 20)]),
    st.sampled_from([-1e9, -12.3, -0.4, 0.9, 3600, 1e9]), st.integers(0, 9), st.booleans(),
)  # fmt: skip
@settings(max_examples=25)
def test_clocks_of_any_epoch_are_brought_together_by_part_of_a_walk(first_s, last_s, rates_hz, clock_s, seed, holed):
    """In whatever frame of space, at whatever rate; with noise of which speeds would be made, and over a gap."""
    at_s, xyz_m = walk(seed)
    reference = trajectory(at_s + clock_s, xyz_m).rows(np.arange(0, len(at_s), 100 // rates_hz[0]))
    hz, own_s = rates_hz[1], last_s - first_s
    part = noisy(at_s + clock_s, xyz_m, clock_s + first_s, 0.02, own_s, hz)
    kept = np.arange(len(part.t_ns))
    part = part.rows(kept[(kept < 15 * hz) | (kept > 20 * hz)] if holed else kept)
    tilted = moved(part, Rotation.from_rotvec([0.3, -1.2, 2.0]), [3, -2, 1])
    for one, other, expected_s in ((reference, tilted, clock_s + first_s), (tilted, reference, -clock_s - first_s)):
        found = estimate_time_offset(one, other)
        width_s = found.interval[1] - found.interval[0]
        assert found.offset_s == pytest.approx(expected_s, abs=0.03)
        assert found.offset_s == pytest.approx(expected_s, abs=2.5 * width_s + 1e-3)
        assert width_s < 0.1


def test_the_interval_holds_the_truth_about_as_often_as_it_says():
    """Errors of 5 cm correlated over half a second, 60 s: of 30 walks, 28.5 would be expected."""
    held = 0
    for seed in range(30):
        at_s, xyz_m = walk(seed)
        found = estimate_time_offset(trajectory(at_s, xyz_m), noisy(at_s, xyz_m, 0.1, 0.05, 60, seed=seed))
        held += found.interval[0] <= 0.1 <= found.interval[1]
    assert held >= 25


def test_no_offset_is_seldom_taken_for_one():
    """Also on short walks, whose intervals are too narrow."""
    for seed in range(20):
        at_s, xyz_m = walk(seed, 20)
        found = estimate_time_offset(trajectory(at_s, xyz_m), noisy(at_s, xyz_m, 0.0, 0.05, 20, seed=seed))
        assert not found.differs_from(0.0), seed


AT_S = np.arange(0, 60, 0.05)
NOTHING = 0 * AT_S


@pytest.mark.parametrize("noise_m", [0.0, 0.1])
@pytest.mark.parametrize(
    ("x_m", "y_m", "observes"),
    [
        (NOTHING, NOTHING, False),
        (0.6 * AT_S, 0.3 * AT_S, False),
        (3 * np.cos(0.2 * AT_S), 3 * np.sin(0.2 * AT_S), False),
        (np.abs((AT_S / 10) % 2 - 1) * 5, NOTHING, True),
        (3 * np.sin(0.5 * AT_S), np.sin(AT_S), True),
    ],
    ids=["still", "straight", "circle", "to and fro", "figure of eight"],
)
def test_a_motion_that_does_not_observe_it_tells_no_offset_and_one_that_repeats_itself_a_near_one(
    x_m, y_m, observes, noise_m
):
    rng = np.random.default_rng(1)
    both = [np.column_stack([x_m, y_m, NOTHING]) + noise_m * rng.normal(size=(len(AT_S), 3)) * [1, 1, 0] for _ in "ab"]
    reference, estimate = trajectory(AT_S, both[0]), trajectory(AT_S - 0.2, both[1])
    compared = compare_trajectories(reference, estimate, 0.03)
    assert (compared.offset.offset_s is not None) == observes
    if observes:
        assert compared.offset.offset_s == pytest.approx(0.2, abs=0.05)
        return
    assert compared.offset.why_not
    assert not {"reference_time_offset_s", "ate_time_corrected_rmse_m"} & set(compared.samples)


def test_other_walks_and_few_poses_tell_no_offset():
    at_s, xyz_m = walk(0)
    one, others = trajectory(at_s, xyz_m), [noisy(at_s, xyz_m, 0.1, 0.05, n / 20) for n in (1, 2, 12, 99)]
    others += [trajectory(*walk(seed)) for seed in (20, 21, 22)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for other in others:
            assert estimate_time_offset(one, other).offset_s is None
            assert estimate_time_offset(other, one).offset_s is None


def rmse_by_evo(reference: PoseSeries, estimate: PoseSeries, offset_s: float, align: bool) -> float:
    pair = sync.associate_trajectories(as_evo(reference), as_evo(estimate), max_diff=0.01, offset_2=offset_s)
    return float(main_ape.ape(*pair, evo_metrics.PoseRelation.translation_part, align=align).stats["rmse"])


def as_evo(poses: PoseSeries) -> PoseTrajectory3D:
    return PoseTrajectory3D(poses.position_m, np.roll(poses.quat_xyzw, 1, axis=1), poses.t_ns / S)


@pytest.mark.parametrize(("offset_s", "heights"), [(0.11, False), (-0.4, True)])
def test_errors_equal_evos_with_that_offset_and_alignment(offset_s, heights):
    at_s, xyz_m = walk(5)
    if heights:
        xyz_m = xyz_m + np.column_stack([0 * at_s, 0 * at_s, 0.5 * np.sin(at_s)])
    turn, shift_m = Rotation.from_euler("z", 0.05), (0.2, -0.1, 0.3 if heights else 0)
    estimate = moved(noisy(at_s, xyz_m, offset_s, 0.05, 60), turn, shift_m)
    reference = trajectory(at_s, xyz_m)
    compared = compare_trajectories(reference, estimate)
    values = {name: value_of(each) for name, each in compared.samples.items()}
    found_s = values["reference_time_offset_s"]
    assert found_s == pytest.approx(offset_s, abs=0.05)
    for name, shift_s, align in (
        ("ate_rmse_m", 0.0, False),
        ("ate_time_corrected_rmse_m", found_s, False),
        ("ate_aligned_rmse_m", found_s, True),
    ):
        assert values[name] == pytest.approx(rmse_by_evo(reference, estimate, shift_s, align), abs=1e-6), name
    words = compared.warnings()
    assert "the reference's clock is not that of the poses" in words[0]
    assert f"time offset {found_s:+.3f} s" in words[0]


@pytest.fixture(scope="module")
def trolley() -> PoseSeries:
    if "QUADLOG_DATASETS" not in os.environ:
        pytest.skip("QUADLOG_DATASETS is not set")
    poses = read_tum(Path(os.environ["QUADLOG_DATASETS"]) / "uwb_lias" / "lias_fast_mocap.tum")
    return PoseSeries(poses.t_ns, poses.position_m, poses.quat_xyzw)


@pytest.mark.parametrize("offset_s", [0.11, -0.02, 7.5])
def test_the_motion_of_a_real_trolley_observes_it(trolley, offset_s):
    seconds = (trolley.t_ns - EPOCH_NS) / S
    own_s = np.arange(seconds[0] + 10, seconds[-1] - 10, 0.05)
    rng = np.random.default_rng(2)
    xyz_m = np.column_stack([np.interp(own_s, seconds, axis_m) for axis_m in trolley.position_m.T])
    estimate = trajectory(own_s - offset_s, xyz_m + rng.normal(0, 0.05, xyz_m.shape) * [1, 1, 0])
    found = estimate_time_offset(trolley, moved(estimate, Rotation.from_euler("z", 1.0), (1, 2, 0)))
    assert found.offset_s == pytest.approx(offset_s, abs=0.01)
    assert found.interval[0] <= offset_s + 0.005
    assert found.interval[1] >= offset_s - 0.005
