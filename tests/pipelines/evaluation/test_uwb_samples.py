from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from quadlog.errors import NotARun
from quadlog.metrics.summary import summarise
from quadlog.pipelines.evaluation.reference import error_samples, residual_samples, robot_tag_of, saved_error_samples
from quadlog.results.run.tables import TABLES, write_table

N = 60


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Two tags on the robot, of which the one with the larger id counts."""
    tags = [{"id": 7, "role": "robot"}, {"id": 3, "role": "none", "x_m": 0.1}]
    (tmp_path / "run.json").write_text(json.dumps({"quadlog_version": "0.1.0", "config": {"uwb": {"tags": tags}}}))
    tag, t_ns = np.repeat([3, 7], N), np.tile(np.arange(N), 2)
    others = dict.fromkeys(("x_m", "y_m", "z_m", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2"), 0.0)
    residual_m = np.where(tag == 7, 0.2, 9.0)
    residual_m[-1] = np.nan
    fixes = others | {"t_ns": t_ns, "tag": tag, "residual_rms_m": residual_m, "n_ranges": 3, "outlier": False}
    write_table(tmp_path / "fixes.parquet", TABLES["fixes"], fixes)
    source = np.tile(["fixes", "track"], N).astype(object)
    errors = {"t_ns": t_ns, "tag": tag, "source": source, "bound_m": 1.0, "error_y_m": 0.0}
    error_x_m = np.where((tag == 7) & (source == "fixes"), 0.5, 9.0)
    write_table(tmp_path / "uwb_errors.parquet", TABLES["uwb_errors"], errors | {"error_x_m": error_x_m})
    return tmp_path


def test_only_the_robots_own_tag_counts(run):
    assert robot_tag_of(run)[1] == 7
    residual = summarise(residual_samples(run)["uwb_residual_m"])
    assert (residual.value, residual.n) == (pytest.approx(0.2), 3 * (N - 1))
    errors = {name: summarise(each) for name, each in saved_error_samples(run).items()}
    assert {name: (each.value, each.n) for name, each in errors.items()} == {
        "uwb_rmse_m": (pytest.approx(0.5), N // 2),
        "uwb_bias_m": (pytest.approx(0.5), N // 2),
        "uwb_nees": (pytest.approx(81 * -2 * np.log(0.05)), N // 2),
        "uwb_coverage_95": (0.0, N // 2),
    }


def test_a_bias_is_what_averaging_leaves():
    error_m = np.random.default_rng(0).normal([0.3, -0.4], 1, (500, 2))
    error_m[3] = np.nan
    found = summarise(error_samples(np.arange(500), error_m)["uwb_bias_m"])
    assert found.value == pytest.approx(np.hypot(*np.nanmean(error_m, axis=0)))
    assert found.n == 499


def test_nothing_known_has_no_samples():
    for samples in (
        error_samples(np.arange(2), np.full((2, 2), np.nan)),
        error_samples(np.arange(0), np.empty((0, 2))),
    ):
        assert [summarise(each) for each in samples.values()] == [None, None]


def test_a_config_that_is_none_is_damage(run):
    (run / "run.json").write_text(json.dumps({"quadlog_version": "0.1.0", "config": {"uwb": {"tags": 5}}}))
    with pytest.raises(NotARun, match=r"run\.json: is damaged: config:"):
        robot_tag_of(run)
