"""Trajectories against a reference: pairs and errors against evo's, clock and frame against known ones."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core import sync
from evo.core.trajectory import PoseTrajectory3D
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from quadlog.geometry import quat_from_euler
from quadlog.messages import PoseSeries
from quadlog.metrics.alignment import find_frame_offset, frame_offset_words, mirror_words
from quadlog.metrics.positioning import associate, positions_at
from quadlog.metrics.reference_offset import compare_trajectories, estimate_time_offset
from quadlog.metrics.summary import metrics_of, value_of
from quadlog.storage.formats.tum import read_tum

S = 1_000_000_000
EPOCH_NS = 1_700_000_000 * S


def as_evo(ours: PoseSeries) -> PoseTrajectory3D:
    stamps_s = np.array([float(f"{t // 10**9}.{t % 10**9:09d}") for t in ours.t_ns.tolist()])  # as in a TUM file
    return PoseTrajectory3D(ours.position_m, np.roll(ours.quat_xyzw, 1, axis=1), stamps_s)


def by_evo(reference: PoseSeries, estimate: PoseSeries, offset_s: float, align: bool = False) -> dict[str, float]:
    pair = sync.associate_trajectories(as_evo(reference), as_evo(estimate), max_diff=0.01, offset_2=offset_s)
    if align:
        pair[1].align(pair[0])
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    rpe = evo_metrics.RPE(evo_metrics.PoseRelation.translation_part, 1, evo_metrics.Unit.frames)
    for each in (ape, rpe):
        each.process_data(pair)
    rmse = evo_metrics.StatisticsType.rmse
    return {"n": pair[0].num_poses, "ate": ape.get_statistic(rmse), "rpe": rpe.get_statistic(rmse)}


@pytest.mark.parametrize(("start_ns", "offset_s"), [(0, 0.0), (17 * 10**17, 0.0), (10**10, -0.37), (10**10, 2.5)])
@pytest.mark.parametrize("counts", [(300, 100), (100, 300), (200, 200)])
def test_pairs_and_errors_are_equal_to_evos(counts, start_ns, offset_s):
    rng = np.random.default_rng(len(counts) + counts[0])
    one_ns, other_ns = (np.sort(rng.choice(3000, n, replace=False)) * 1_000_000 + start_ns for n in counts)
    reference, estimate = (
        PoseSeries(t_ns, rng.normal(size=(len(t_ns), 3)).cumsum(axis=0), Rotation.random(len(t_ns), rng=rng).as_quat())
        for t_ns in (one_ns, other_ns - round(offset_s * 1e9))
    )
    found = metrics_of(compare_trajectories(reference, estimate, 0.01, offset_s).samples)
    ours = {"n": found["ate_rmse_m"].n, "ate": found["ate_rmse_m"].value, "rpe": found["rpe_rmse_m"].value}
    assert ours == pytest.approx(by_evo(reference, estimate, offset_s), abs=1e-9)
    assert ours["n"] == len(associate(one_ns, estimate.t_ns, 0.01, offset_s)[0]) > 50


def test_positions_between_poses():
    known_ns, known_m = np.array([0, 100, 1000]), np.array([[0.0, 0, 0], [1, 2, 3], [9, 9, 9]])
    found = positions_at(np.array([-1, 0, 50, 100, 500, 1000, 1001]), known_ns, known_m, max_gap_ns=200)
    np.testing.assert_allclose(found[[1, 2, 3, 5]], [[0, 0, 0], [0.5, 1, 1.5], [1, 2, 3], [9, 9, 9]])
    assert np.isnan(found[[0, 4, 6]]).all()
    assert np.isnan(positions_at(np.array([3]), known_ns[:0], known_m[:0], 10)).all()


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


def test_the_interval_holds_the_truth_about_as_often_as_it_says_and_no_offset_is_seldom_taken_for_one():
    """Errors of 5 cm correlated over half a second: of 30 walks of 60 s, 28.5 would be expected; also on short ones."""
    held = 0
    for seed in range(30):
        at_s, xyz_m = walk(seed)
        found = estimate_time_offset(trajectory(at_s, xyz_m), noisy(at_s, xyz_m, 0.1, 0.05, 60, seed=seed))
        held += found.interval[0] <= 0.1 <= found.interval[1]
        short = estimate_time_offset(trajectory(at_s, xyz_m), noisy(at_s, xyz_m, 0.0, 0.05, 20, seed=seed))
        assert not short.differs_from(0.0), seed
    assert held >= 25


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
    compared = compare_trajectories(trajectory(AT_S, both[0]), trajectory(AT_S - 0.2, both[1]), 0.03)
    timed = {"reference_time_offset_s", "ate_time_corrected_rmse_m"} & set(compared.samples)
    assert (compared.offset.offset_s is not None) == (not compared.offset.why_not) == bool(timed) == observes
    assert not observes or compared.offset.offset_s == pytest.approx(0.2, abs=0.05)


def test_other_walks_and_few_poses_tell_no_offset():
    at_s, xyz_m = walk(0)
    one, others = trajectory(at_s, xyz_m), [noisy(at_s, xyz_m, 0.1, 0.05, n / 20) for n in (1, 2, 12, 99)]
    others += [trajectory(*walk(seed)) for seed in (20, 21, 22)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for other in others:
            assert estimate_time_offset(one, other).offset_s is None
            assert estimate_time_offset(other, one).offset_s is None


@pytest.mark.parametrize(("offset_s", "heights"), [(0.11, False), (-0.4, True)])
def test_corrected_and_aligned_errors_are_evos_with_the_offset_found(offset_s, heights):
    at_s, xyz_m = walk(5)
    xyz_m = xyz_m + np.outer(0.5 * np.sin(at_s) * heights, [0, 0, 1])
    turn, shift_m = Rotation.from_euler("z", 0.05), (0.2, -0.1, 0.3 if heights else 0)
    reference, estimate = trajectory(at_s, xyz_m), moved(noisy(at_s, xyz_m, offset_s, 0.05, 60), turn, shift_m)
    compared = compare_trajectories(reference, estimate)
    values = {name: value_of(each) for name, each in compared.samples.items()}
    found_s = values["reference_time_offset_s"]
    assert found_s == pytest.approx(offset_s, abs=0.05)
    for name, align in (("ate_time_corrected_rmse_m", False), ("ate_aligned_rmse_m", True)):
        assert values[name] == pytest.approx(by_evo(reference, estimate, found_s, align)["ate"], abs=1e-6), name
    assert f"the reference's clock is not that of the poses: time offset {found_s:+.3f} s" in compared.warnings()[0]


@pytest.mark.parametrize("offset_s", [0.11, -0.02, 7.5])
def test_the_motion_of_a_real_trolley_observes_it(lias_site, offset_s):
    trolley = read_tum(lias_site.folder / "lias_fast_mocap.tum")
    seconds = (trolley.t_ns - EPOCH_NS) / S
    own_s = np.arange(seconds[0] + 10, seconds[-1] - 10, 0.05)
    xyz_m = np.column_stack([np.interp(own_s, seconds, axis_m) for axis_m in trolley.position_m.T])
    xyz_m += np.random.default_rng(2).normal(0, 0.05, xyz_m.shape) * [1, 1, 0]
    estimate = moved(trajectory(own_s - offset_s, xyz_m), Rotation.from_euler("z", 1.0), (1, 2, 0))
    found = estimate_time_offset(trolley, estimate)
    assert found.offset_s == pytest.approx(offset_s, abs=0.01)
    assert found.interval[0] - 0.005 <= offset_s <= found.interval[1] + 0.005


def track(n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 2) with noise, and the truth."""
    phase = np.linspace(0, 4 * np.pi, n)
    truth = np.stack([4 + 3 * np.sin(phase), 3 + 2 * np.cos(phase / 2)], axis=1)
    return truth + np.random.default_rng(0).normal(0, 0.05, (n, 2)), truth


def turned(points: np.ndarray, turn_deg: float) -> np.ndarray:
    return points @ Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()[:2, :2].T


@pytest.mark.parametrize(
    ("turn_deg", "shift_m", "warns"),
    [(0, (0.2, 0), False), (0, (0.3, 0), True), (2, (0, 0), False), (8, (0, 0), True), (180, (7, 2), True)],
)
def test_only_a_frame_that_is_far_and_explains_the_error_is_warned_of(turn_deg, shift_m, warns):
    position_m, truth = track()
    # Turned about the middle of the walk, so that the turn alone does not shift it.
    reference = turned(truth - truth.mean(axis=0), turn_deg) + truth.mean(axis=0) + shift_m
    seen = np.arange(200) % 3 > 0
    found = find_frame_offset(position_m, np.where(seen[:, None], reference, np.nan))
    assert (frame_offset_words(found) is not None) == warns
    whole = find_frame_offset(position_m[seen], reference[seen])
    assert found.after_m == whole.after_m == pytest.approx(0.07, abs=0.01)
    assert find_frame_offset(position_m[:9], reference[:9]) is find_frame_offset(position_m, reference * np.nan) is None


def test_a_mirrored_reference_is_told_from_a_turned_one_and_from_a_bend():
    position_m, truth = track()
    assert "0.07 m mirrored" in mirror_words(position_m, truth[:, ::-1])
    assert mirror_words(position_m, turned(truth, 115.0) + 5) is None
    along_m = np.linspace(0, 50, 200)
    bend_m = 0.5 * np.sin(along_m * np.pi / 50)
    assert mirror_words(np.column_stack([along_m, bend_m]), np.column_stack([along_m, -bend_m])) is None


@pytest.mark.parametrize(("yaw_deg", "says"), [(0, None), (20, None), (180, "180 degrees off"), (-90, "90 degrees off"),
                                               (None, "unrelated to its course")])  # fmt: skip
def test_a_yaw_that_is_not_the_robots_is_said_whatever_the_frames_and_the_drift(yaw_deg, says):
    t_ns, course_rad = np.arange(600) * (S // 10), np.linspace(0, 9, 600)
    steps_m = np.stack([np.cos(course_rad), np.sin(course_rad), 0 * course_rad], axis=1)
    place_m = 0.05 * steps_m.cumsum(axis=0) + np.random.default_rng(3).normal(0, [0.02, 0.02, 0], (600, 3))
    yaw_rad = 0 * course_rad if yaw_deg is None else course_rad + np.radians(yaw_deg)
    drift_rad = 2.0 + t_ns / 240e9
    drifting_m = Rotation.from_rotvec(drift_rad[:, None] * [0, 0, 1]).apply(0.05 * steps_m).cumsum(axis=0)
    estimate = PoseSeries(t_ns, drifting_m, quat_from_euler(course_rad + drift_rad))
    compared = compare_trajectories(PoseSeries(t_ns, place_m, quat_from_euler(yaw_rad)), estimate)
    words = " ".join(compared.in_any_frame)
    assert (words == "") if says is None else (says in words and "rpe_rmse_m" in words)
