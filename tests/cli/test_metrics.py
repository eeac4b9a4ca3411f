from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.run import finish_run, write_result
from quadlog.results.tables import TABLES
from quadlog.storage.formats.tum import write_tum
from tests.lab.runs import begin_run

T_NS = np.arange(200, dtype=np.int64) * 20_000_000


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder of three kinematic walks, whose error grows from one to the next."""
    for number in range(3):
        run = begin_run(tmp_path / "runs" / f"walk-{number}")
        error_m = 0.1 * (number + 1) + 0.01 * np.sin(T_NS / 3e8)
        columns = dict.fromkeys(set(TABLES["control"].names) - {"t_ns", "fallen"}, np.nan)
        columns |= {"t_ns": T_NS, "error_m": error_m, "cross_track_m": -error_m, "fallen": False}
        write_result(run, "control", columns)
        write_tum(run.path / "trajectory.tum", T_NS, np.sqrt(T_NS / 1e9), error_m, 0 * error_m)
        write_result(run, "metrics", {"eta_m": {"value": np.mean(error_m), "n": 200, "unit": "m"}})
        finish_run(run, run.record)
    return tmp_path / "runs"


def test_json_and_csv_are_what_the_contract_says(runs, ok):
    found = json.loads(ok("metrics", runs, "--format", "json"))
    assert found[0] == {"run": str(runs / "walk-0"), "eta_m": pytest.approx(0.1, abs=0.01)}
    assert [set(each) for each in found] == [{"run", "eta_m"}] * 3
    header, *rows = csv.reader(ok("metrics", runs, "--format", "csv").splitlines())
    assert len(rows) == 3
    assert all(float(dict(zip(header, row, strict=True))["p95"]) > 0.1 for row in rows)


def test_one_run_is_value_interval_unit_and_n_in_a_terminal(runs, ok):
    metrics = {name: {"value": -0.0012345, "n": 23520, "unit": "N·m", "low": -0.0012345, "high": 0.012345}
               for name in CATALOGUE}  # fmt: skip
    (runs / "walk-0" / "metrics.json").write_text(json.dumps(metrics))
    lines = ok("metrics", runs / "walk-0").splitlines()
    assert lines[0] == "Metrics of walk-0"
    assert lines[1].split() == ["metric", "value", "95", "%", "unit", "n"]
    assert lines[2].split() == ["ate_rmse_m", "-0.001234", "-0.00123", "to", "0.0123", "N·m", "23520"]
    assert len(lines[2 : lines.index("")]) == len(CATALOGUE)
    assert max(map(len, lines[: lines.index("")])) <= 80


def test_a_condition_that_holds_is_exit_code_4(runs, quadlog):
    assert quadlog("metrics", runs, "--fail-if", "eta_m > 0.5")[::2] == (0, "")
    done = quadlog("metrics", runs, "--fail-if", "eta_m>0.25", "--fail-if", "sigma_m>1", "--format", "json")
    assert (done.code, len(json.loads(done.out))) == (4, 3)
    first, _, third, _ = done.err.splitlines()
    assert first == f"--fail-if {runs}/walk-0: sigma_m > 1: unknown, the run has no sigma_m"
    assert f"--fail-if {runs}/walk-2: eta_m > 0.25 holds: 0.3" in third


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--fail-if", "eta>0.3"], "unknown metric 'eta'; did you mean eta_m?"),
        (["--explain", "ate"], "unknown metric 'ate'; did you mean ate_rmse_m?"),
        (["--fail-if", "eta_m ~ 0.3"], "condition 'eta_m ~ 0.3': write NAME OPERATOR NUMBER"),
        (["--explain", "eta_m", "--format", "json"], "--explain prints text"),
    ],
)
def test_wrong_usage(runs, refused, arguments, words):
    assert words in refused(2, "metrics", runs, *arguments)


def test_a_metric_is_explained_with_the_worst_instants_of_the_runs_if_there_are_any(runs, ok, refused):
    assert "[Tracking] eq. 47" in ok("metrics", "--explain", "sigma_m")
    refused(2, "metrics", "--explain", "eta_m", "--fail-if", "eta_m>1")
    out = ok("metrics", runs / "walk-1", "--explain", "eta_m")
    assert ("walk-1: 0.2" in out, len(out.splitlines())) == (True, 11)


def test_a_reference_gives_ate_and_another_clock_is_refused(runs, tmp_path, quadlog, ok, refused):
    walk, truth = runs / "walk-0", tmp_path / "truth.tum"
    with_truth = ["metrics", walk, "--reference", truth]
    write_tum(truth, T_NS, np.sqrt(T_NS / 1e9), np.zeros(200), np.zeros(200))
    done = quadlog(*with_truth, "--format", "json")
    assert json.loads(done.out)[0]["ate_rmse_m"] == pytest.approx(0.1, abs=0.01)
    assert "200 poses" in done.err
    truth.write_text(truth.read_text().replace(" 0.0 0.0 0.0 0.0 ", " 0.0 0.3 0.0 0.0 "))
    found = json.loads(ok(*with_truth, "--format", "json", "--project-to-plane", "xy"))
    assert found[0]["ate_rmse_m"] == pytest.approx(0.1, abs=0.02)
    write_tum(truth, T_NS + 10**18, np.sqrt(T_NS / 1e9), np.zeros(200), np.zeros(200))
    assert "time offset is unknown" in refused(1, *with_truth)
    ok(*with_truth, "--t-offset", "1e9")
    seconds, pose = zip(*(line.split(" ", 1) for line in truth.read_text().splitlines(keepends=True)), strict=True)
    truth.write_text("".join(2 * f"{t.replace('.', '')} {rest}" for t, rest in zip(seconds, pose, strict=True)))
    told = quadlog(*with_truth, "--t-offset", "1e9").err
    assert told.count("read as ns since 1970") == told.count("200 of 400 lines equal the one before") == 1
