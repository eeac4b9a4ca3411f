from __future__ import annotations

import shutil

import numpy as np
import pytest

from quadlog.pipelines.evaluation.metrics import explain_runs, measure_runs
from quadlog.pipelines.evaluation.reference import OnTime, Reference, compare_with_reference
from quadlog.results.tables import read_table


def explain(run, name, reference=None):
    return explain_runs(name, measure_runs([run], reference, []).runs, reference)


def test_the_worst_instant_is_the_tables(short_run):
    control = read_table(short_run.run, "control", ["t_ns", "error_m"])
    worst = int(np.argmax(control["error_m"]))
    line = explain(short_run.run, "eta_m").splitlines()[8].split()
    assert line[0] == str(control["t_ns"][worst])
    assert float(line[1]) == pytest.approx((control["t_ns"][worst] - 1767225600_000000000) / 1e9, abs=0.5)
    assert float(line[2]) == pytest.approx(control["error_m"][worst], rel=1e-5)


def test_metrics_without_samples_and_without_a_value_say_so(short_run):
    assert "a run saves no samples of it" in explain(short_run.run, "cost_of_transport")
    assert "has no such metric" in explain(short_run.run, "forward_m")
    assert "never above zero" in explain(short_run.run, "success_rate")


def test_the_nearest_obstacle_is_the_worst_and_no_row_is_made_up_for_runs_without_them(short_run, tmp_path):
    near = read_table(short_run.run, "clearances")
    nearest = int(np.nanargmin(near["clearance_m"]))
    line = next(row for row in explain(short_run.run, "clearance_min_m").splitlines() if "176" in row[:8]).split()
    assert line[0] == str(near["t_ns"][nearest])
    assert float(line[2]) == pytest.approx(near["clearance_m"][nearest], rel=1e-5)
    older = shutil.copytree(short_run.run, tmp_path / "follow")
    (older / "clearances.parquet").unlink()
    measured = measure_runs([older], None, [])
    assert measured.problems == []  # it was made before these were saved
    assert "a run saves no samples of it" in explain_runs("clearance_min_m", measured.runs, None)


def test_the_worst_is_that_against_the_reference_given(short_run):
    reference = Reference.read(short_run.run / "reference.tum", OnTime(align=True))
    worst_m = compare_with_reference(short_run.run, reference).samples["ate_rmse_m"].values.max()
    line = explain(short_run.run, "ate_rmse_m", reference).splitlines()[8].split()
    assert float(line[2]) == pytest.approx(worst_m, rel=1e-5)
    assert line != explain(short_run.run, "ate_rmse_m").splitlines()[8].split()


def test_damage_is_said_in_the_place_of_instants(short_run, tmp_path):
    runs = measure_runs([short_run.run], None, []).runs
    runs[0] = type(runs[0])(tmp_path, "gone", runs[0].metrics)
    assert "worst instants unknown" in explain_runs("eta_m", runs, None)
