from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from quadlog.errors import NotARun
from quadlog.metrics.summary import summarise
from quadlog.pipelines.evaluation.reference import RobotTag, robot_tag_of
from quadlog.pipelines.evaluation.samples import read_samples
from quadlog.results.tables import TABLES, write_table
from quadlog.storage.formats.tum import write_tum

N = 60


def write_record(run: Path, tags: object) -> None:
    made = {"quadlog_version": "0.1.0", "command": [], "options": {}, "input": {"path": "walk.mcap", "size_bytes": 1}}
    made |= {"config": {"uwb": {"tags": tags}}, "seed": 0, "recorded_s": 1.0}
    (run / "run.json").write_text(json.dumps(made))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Two tags on a robot that looks along x, of which the one with the larger id counts; its fixes are 0.5 m off."""
    tags = [{"id": 7, "role": "robot", "y_m": 0.2}, {"id": 3, "role": "none", "x_m": 0.1}]
    write_record(tmp_path, tags)
    tag, t_ns = np.repeat([3, 7], N), np.tile(np.arange(N), 2) * 10_000_000
    residual_m = np.where(tag == 7, 0.2, 9.0)
    residual_m[-1] = np.nan
    fixes = dict.fromkeys(("z_m", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2"), 0.0)
    fixes |= {"x_m": np.where(tag == 7, 1.5, 9.0), "y_m": 2.2, "residual_rms_m": residual_m}
    fixes |= {"t_ns": t_ns, "tag": tag, "n_ranges": 3, "outlier": False}
    write_table(tmp_path / "fixes.parquet", TABLES["fixes"], fixes)
    ends = {"t_ns": t_ns, "tag": tag, "source": np.tile(["fixes", "track"], N).astype(object), "error_y_m": 0.0}
    error_x_m = np.where((tag == 7) & (np.arange(2 * N) % 4 == 1), 0.5, 1.5)
    write_table(tmp_path / "uwb_errors.parquet", TABLES["uwb_errors"], ends | {"error_x_m": error_x_m, "bound_m": 1.0})
    innovations = {"t_ns": t_ns, "tag": tag, "n_ranges": 3, "nis": np.where(tag == 7, 1.25, 9.0)}
    write_table(tmp_path / "innovations.parquet", TABLES["innovations"], innovations)
    first_half_ns = t_ns[: N // 2]
    write_tum(tmp_path / "reference.tum", first_half_ns, *(np.full(N // 2, value) for value in (1.0, 2.0, 0.0)))
    return tmp_path


def test_only_the_robots_own_tag_counts(run):
    assert robot_tag_of(run) == RobotTag(7, (0.0, 0.2))
    wanted = ("uwb_residual_m", "uwb_rmse_m", "uwb_bias_m", "uwb_nis", "uwb_nees", "uwb_coverage_95")
    samples, errors = read_samples(run, wanted)
    assert errors == []
    found = {name: summarise(each) for name, each in samples.items()}
    assert {name: (each.value, each.n) for name, each in found.items()} == {
        "uwb_rmse_m": (pytest.approx(0.5), N // 2),
        "uwb_bias_m": (pytest.approx(0.5), N // 2),
        "uwb_residual_m": (pytest.approx(0.2), 3 * (N - 1)),
        "uwb_nis": (pytest.approx(1.25), N),
        # Errors of half and of one and a half times the reach of their 95 % ellipses, in turn.
        "uwb_nees": (pytest.approx(-2 * np.log(0.05) * (0.25 + 2.25) / 2), N // 2),
        "uwb_coverage_95": (pytest.approx(0.5), N // 2),
    }


def test_a_config_that_is_none_is_damage(run):
    write_record(run, 5)
    with pytest.raises(NotARun, match=r"run\.json: is damaged: config\.uwb\.tags:"):
        robot_tag_of(run)
