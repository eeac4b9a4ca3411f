from __future__ import annotations

import shutil

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadlog.config.file import load_config
from quadlog.errors import MissingInput, NotARun, UnreadableConfig
from quadlog.pipelines.comparison.compare import ask_everything
from quadlog.pipelines.comparison.sources import run_source
from quadlog.pipelines.executor.progress import Silent
from quadlog.planning.rules import Rules
from quadlog.results.arrays import load_maps
from quadlog.results.tables import read_table


@pytest.fixture
def own_run(planned_run, tmp_path):
    return shutil.copytree(planned_run, tmp_path / "walk")


def test_its_questions_are_those_of_the_stage_plan(planned_run):
    """The stage's planner, asked again, does and costs the same, in the same cells."""
    columns = ask_everything(run_source(planned_run, "walk"), ["ia_star"], Rules(), Silent()).columns
    plans, cell_m = read_table(planned_run, "plans"), load_maps(planned_run).cell_m
    assert set(plans["planner"]) == set(columns["planner"]) == {"ia_star"}
    assert len(plans["t_ns"]) == 10
    for name in ("t_ns", "found", "expanded", "generated", "cost", "optimal_cost", "from_scratch", "reused_cells"):
        assert_array_equal(columns[name], plans[name], name)
    assert_array_equal(columns["goal_projected"], plans["goal_projected"])
    assert not all(plans["from_scratch"])  # it did build on the plan before
    for end in ("start", "goal"):
        for axis, cell in (("x", "col"), ("y", "row")):
            assert_array_equal(columns[f"{end}_{cell}"], np.floor(plans[f"{end}_{axis}_m"] / cell_m), end)


def test_curvatures_are_of_paths_smoothed_as_the_run_has_it_unless_something_else_is_given(own_run):
    def curvatures(*given):
        source = run_source(own_run, "walk", load_config(None, given, {}).model_dump(exclude_unset=True))
        return ask_everything(source, ["astar"], Rules(), Silent()).columns["curvature_max_1pm"]

    own, other = curvatures(), curvatures("smoothing.merge_m=0")
    assert not np.array_equal(own, other, equal_nan=True)
    text = (own_run / "config.toml").read_text()
    assert "merge_m = 0.6" in text
    (own_run / "config.toml").write_text(text.replace("merge_m = 0.6", "merge_m = 0.0"))
    assert_array_equal(curvatures(), other)
    assert_array_equal(curvatures("smoothing.merge_m=0.6"), own)


@pytest.mark.parametrize(
    ("gone", "error", "says"),
    [
        ("maps.npz", NotARun, "has no maps.npz"),
        ("poses.parquet", NotARun, "has no poses.parquet"),
        ("target.parquet", MissingInput, "walk has no target to plan to; replay with  --set topics.target=ahead"),
        ("config.toml", UnreadableConfig, "No such file"),
    ],
)
def test_a_run_with_a_file_missing_names_it(own_run, gone, error, says):
    (own_run / gone).unlink()
    with pytest.raises(error, match=says):
        run_source(own_run, "walk")


def test_a_run_whose_target_was_never_seen_at_a_map_has_no_question(own_run):
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(own_run / "target.parquet")
    late = pa.array(np.asarray(table["t_ns"]) + 10**13)
    pq.write_table(table.set_column(0, table.schema.field("t_ns"), late), own_run / "target.parquet")
    with pytest.raises(MissingInput, match="no map with robot and target known"):
        ask_everything(run_source(own_run, "walk"), ["astar"], Rules(), Silent())
