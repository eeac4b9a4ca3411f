from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import ExitCode, NotARun, QuadlogError
from quadlog.metrics.catalogue import CATALOGUE, parse_condition
from quadlog.metrics.summary import value_of
from quadlog.pipelines.evaluation.metrics import explain_runs, measure_runs
from quadlog.pipelines.evaluation.reference import OnTime, Reference, compare_with_reference
from quadlog.pipelines.evaluation.samples import SAMPLED, read_samples
from quadlog.pipelines.request import ReplayOutcome
from quadlog.results.record import read_metrics
from quadlog.results.tables import read_table
from tests.lab.runs import unfinish

READ = ("run.json", "config.toml", "metrics.json", "reference.tum", "trajectory.tum")


@pytest.fixture(scope="session")
def lean_run(short_run: ReplayOutcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `quadlog metrics` reads of the short run; not to be changed."""
    lean = tmp_path_factory.mktemp("lean") / "follow"
    lean.mkdir()
    for path in short_run.run.iterdir():
        if path.name in READ or path.suffix == ".parquet":
            shutil.copy(path, lean / path.name)
    return lean


@pytest.fixture
def run(lean_run: Path, tmp_path: Path) -> Path:
    """The same, of the test's own."""
    return shutil.copytree(lean_run, tmp_path / "follow")


def measure(run: Path, *conditions: str, detail: bool = True):
    return measure_runs([run], None, [parse_condition(each) for each in conditions], detail)


def test_what_the_tables_give_again_is_what_the_replay_said(lean_run):
    saved = read_metrics(lean_run)
    outcome = measure(lean_run)
    assert (outcome.problems, outcome.exit_code) == ([], ExitCode.DONE)
    found = outcome.runs[0].metrics
    assert list(found) == [name for name in CATALOGUE if name in saved]
    again, _ = read_samples(lean_run, saved)
    assert {name for name, each in found.items() if each.detail} == set(again)
    assert set(again) == SAMPLED & set(saved) >= {"eta_m", "ate_rmse_m", "uwb_residual_m", "expanded_total"}
    for name, samples in again.items():
        assert (value_of(samples), len(samples.values)) == (saved[name]["value"], saved[name]["n"]), name
    for name, each in found.items():
        assert (each.value, each.n, each.unit) == tuple(saved[name][key] for key in ("value", "n", "unit")), name
        assert each.unit == CATALOGUE[name].unit


def test_a_run_that_cannot_be_read_does_not_hide_the_others(run):
    broken = shutil.copytree(run, run.with_name("broken"))
    unfinish(broken)
    outcome = measure_runs([run.parent], None, [parse_condition("eta_m>100")])
    assert [each.label for each in outcome.runs] == ["follow"]
    assert outcome.problems == [f"{broken}: is an unfinished run (finished: false in run.json)"]
    assert outcome.failing == [f"{broken}: eta_m > 100: unknown, the run cannot be read"]
    assert outcome.exit_code is ExitCode.CHECK_FAILED
    assert measure_runs([run.parent], None, []).exit_code is ExitCode.WITH_LOSS
    (run / "run.json").write_text("{")
    with pytest.raises(NotARun, match="not one of 2 runs can be read"):
        measure_runs([run.parent], None, [])


def test_runs_of_different_settings_are_not_averaged(run):
    other = shutil.copytree(run, run.with_name("other"))
    record = json.loads((other / "run.json").read_text())
    record["config"]["uwb"]["anchors"][0]["x_m"] += 1.0
    record["seed"] = record["options"]["seed"] = 7
    (other / "run.json").write_text(json.dumps(record))
    assert not measure_runs([run.parent], None, []).differing, "a place of an anchor and a seed are no settings"
    record["config"]["planner"]["name"] = "astar"
    (other / "run.json").write_text(json.dumps(record))
    outcome = measure_runs([run.parent], None, [])
    assert [line.partition(":")[0] for line in outcome.differing] == ["planner.name"]


def test_a_metric_is_explained_by_its_worst_instant(lean_run):
    """That of the table, and against another reference that of its comparison."""

    def worst(name, reference=None):
        runs = measure_runs([lean_run], reference, []).runs
        return explain_runs(name, runs, reference).splitlines()[8].split()

    for name, table, column, pick in (
        ("eta_m", "control", "error_m", np.nanargmax),
        ("clearance_min_m", "clearances", "clearance_m", np.nanargmin),
    ):
        values = read_table(lean_run, table)
        at = int(pick(values[column]))
        assert worst(name)[0] == str(values["t_ns"][at])
        assert float(worst(name)[2]) == pytest.approx(values[column][at], rel=1e-5)
    reference = Reference.read(lean_run / "reference.tum", OnTime(align=True))
    worst_m = compare_with_reference(lean_run, reference).samples["ate_rmse_m"].values.max()
    assert float(worst("ate_rmse_m", reference)[2]) == pytest.approx(worst_m, rel=1e-5)
    runs = measure_runs([lean_run], None, []).runs
    assert "a run saves no samples of it" in explain_runs("cost_of_transport", runs, None)


@given(
    name=st.sampled_from(
        ["run.json", "metrics.json", "control.parquet", "plans.parquet", "fixes.parquet", "reference.tum"]
    ),
    content=st.none()
    | st.binary(max_size=60)
    | st.floats(0, 1)
    | st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["eta_m", "config", "value", "n", "uwb"]), inner)
        ),
        max_leaves=6,
    ).map(lambda value: json.dumps(value).encode()),
)
def test_whatever_a_folder_holds_is_one_line_or_an_answer(lean_run, tmp_path_factory, name, content):
    run = shutil.copytree(lean_run, tmp_path_factory.mktemp("odd") / "run")
    path = run / name
    if content is None:
        path.unlink()
    elif isinstance(content, float):
        path.write_bytes(path.read_bytes()[: int(content * path.stat().st_size)])
    else:
        path.write_bytes(content)
    try:
        outcome = measure(run, "eta_m>100")
    except QuadlogError as error:
        said = str(error)
    else:
        said = "".join(outcome.problems)
        assert outcome.problems or outcome.exit_code in (ExitCode.DONE, ExitCode.CHECK_FAILED)
    assert "\n" not in said
    shutil.rmtree(run)
