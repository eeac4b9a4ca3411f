from __future__ import annotations

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core import sync
from evo.core.trajectory import PoseTrajectory3D
from scipy.spatial.transform import Rotation

from quadlog.messages import PoseSeries
from quadlog.metrics.positioning import (
    associate,
    fix_error_samples,
    positions_at,
    residual_samples,
)
from quadlog.metrics.reference_offset import compare_trajectories
from quadlog.metrics.summary import metrics_of, summarise


def trajectory(rng, t_ns):
    n = len(t_ns)
    return PoseSeries(t_ns, rng.normal(size=(n, 3)).cumsum(axis=0), Rotation.random(n, rng=rng).as_quat())


def as_evo(ours):
    stamps_s = np.array([float(f"{t // 10**9}.{t % 10**9:09d}") for t in ours.t_ns.tolist()])  # as in a TUM file
    return PoseTrajectory3D(ours.position_m, np.roll(ours.quat_xyzw, 1, axis=1), stamps_s)


@pytest.mark.parametrize("start_ns", [0, 1_700_000_000_000_000_000])
@pytest.mark.parametrize("counts", [(300, 100), (100, 300), (200, 200)])
@pytest.mark.parametrize("seed", range(3))
def test_equal_to_evo(seed, counts, start_ns):
    rng = np.random.default_rng(seed)
    times_ns = [np.sort(rng.choice(3000, n, replace=False)) * 1_000_000 + start_ns for n in counts]
    reference, estimate = (trajectory(rng, t_ns) for t_ns in times_ns)
    ours = metrics_of(compare_trajectories(reference, estimate).samples)
    paired = sync.associate_trajectories(as_evo(reference), as_evo(estimate), max_diff=0.01)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data(paired)
    rpe = evo_metrics.RPE(evo_metrics.PoseRelation.translation_part, delta=1, delta_unit=evo_metrics.Unit.frames)
    rpe.process_data(paired)
    assert ours["ate_rmse_m"].n == paired[0].num_poses
    assert ours["ate_rmse_m"].value == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.rmse), abs=1e-9)
    assert ours["rpe_rmse_m"].value == pytest.approx(rpe.get_statistic(evo_metrics.StatisticsType.rmse), abs=1e-9)


@pytest.mark.parametrize("offset_s", [-0.37, 0.004, 2.5])
@pytest.mark.parametrize("counts", [(300, 100), (100, 300), (200, 200)])
def test_an_offset_is_added_as_evo_adds_it(counts, offset_s):
    rng = np.random.default_rng(8)
    one, other = (np.sort(rng.choice(3000, n, replace=False)) * 1_000_000 + 10**10 for n in counts)
    ours = associate(one, other - round(offset_s * 1e9), 0.01, offset_s)
    reference, estimate = trajectory(rng, one), trajectory(rng, other - round(offset_s * 1e9))
    theirs = sync.associate_trajectories(as_evo(reference), as_evo(estimate), max_diff=0.01, offset_2=offset_s)
    assert len(ours[0]) == theirs[0].num_poses > 50
    np.testing.assert_allclose(reference.position_m[ours[0]], theirs[0].positions_xyz)
    np.testing.assert_allclose(estimate.position_m[ours[1]], theirs[1].positions_xyz)


def test_uwb_by_hand():
    t_ns = np.arange(3)
    samples = fix_error_samples(t_ns, np.array([[3.0, 4.0], [3.0, -4.0], [np.nan, 0.0]]))
    metrics = metrics_of(samples | residual_samples(t_ns, np.array([0.1, 0.2, np.nan]), np.array([3, 1, 4])))
    assert (metrics["uwb_rmse_m"].value, metrics["uwb_rmse_m"].n) == (5.0, 2)
    assert (metrics["uwb_bias_m"].value, metrics["uwb_bias_m"].n) == (3.0, 2)
    assert metrics["uwb_residual_m"].value == pytest.approx(np.sqrt((3 * 0.01 + 0.04) / 4))
    assert metrics["uwb_residual_m"].n == 4
    assert metrics_of(residual_samples(t_ns, np.full(3, np.nan), np.zeros(3, dtype=int))) == {}


def test_positions_between_poses():
    known = PoseSeries(
        np.array([0, 100, 1000]), np.array([[0.0, 0, 0], [1, 2, 3], [9, 9, 9]]), np.tile([0.0, 0, 0, 1], (3, 1))
    )
    found = positions_at(np.array([-1, 0, 50, 100, 500, 1000, 1001]), known, max_gap_ns=200)
    np.testing.assert_allclose(found[1:4], [[0, 0, 0], [0.5, 1, 1.5], [1, 2, 3]])
    np.testing.assert_allclose(found[5], [9, 9, 9])
    assert np.isnan(found[[0, 4, 6]]).all()
    nobody = PoseSeries(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 4)))
    assert np.isnan(positions_at(np.array([3]), nobody, 10)).all()


def test_the_interval_of_a_bias_excludes_zero_in_a_twentieth_of_the_logs_that_have_none():
    rng = np.random.default_rng(5)
    lows = []
    for _ in range(400):
        bias = fix_error_samples(np.arange(200), rng.normal(0, [0.1, 0.1], (200, 2)))["uwb_bias_m"]
        lows.append(summarise(bias).interval[0])
    assert 0.02 < np.mean(np.array(lows) > 0) < 0.08
