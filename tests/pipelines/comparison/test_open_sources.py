from __future__ import annotations

import pytest

from quadlog.errors import RecordingNotFound, UsageError
from quadlog.pipelines.comparison.problems import CompareOptions
from quadlog.pipelines.comparison.sources import open_sources
from quadlog.pipelines.executor.progress import Silent


def test_each_kind_by_what_it_is_called(planned_run, write_map, tmp_path):
    path = str(write_map(["..", ".."]))
    options = CompareOptions(episodes=3)
    sources, losses = open_sources([str(planned_run), "forest:0.1", "forest:0.1"], options, tmp_path, Silent())
    assert [each.name for each in sources] == [str(planned_run), "forest:0.1"]
    assert [each.count for each in sources] == [1, 3]
    assert [each.is_static for each in sources] == [False, False]
    assert losses == []
    ((source,), _) = open_sources([path], CompareOptions(start_cell=(0, 0), goal_cell=(1, 1)), tmp_path, Silent())
    assert source.is_static
    assert source.row_zero_on_top


@pytest.mark.parametrize(
    ("arguments", "options", "says"),
    [
        (["a.map"], {"start_cell": (0, 0)}, "go together"),
        (["forest:0.1"], {"goal_cell": (0, 0)}, "go together"),
        (["forest:0.1"], {"start_cell": (0, 0), "goal_cell": (1, 1)}, "are for MovingAI .map and ROS map_server .yaml"),
        (["forest:0.1"], {"scen": "a.scen"}, "--scen FILE.scen is for MovingAI .map files"),
        (["a.map", "a.yaml"], {"scen": "a.scen"}, "--scen FILE.scen is for MovingAI .map files"),
        (["a.map"], {"scen": "a.scen", "start_cell": (0, 0), "goal_cell": (1, 1)}, "of its own"),
    ],
)
def test_queries_that_no_source_takes_are_usage(tmp_path, arguments, options, says):
    with pytest.raises(UsageError, match=says):
        open_sources(arguments, CompareOptions(**options), tmp_path, Silent())


@pytest.mark.parametrize("name", ["nothing", "frest:0.2", "walk.bag"])
def test_what_is_nothing_is_looked_for_as_a_recording(tmp_path, name):
    with pytest.raises(RecordingNotFound, match="no such file"):
        open_sources([str(tmp_path / name)], CompareOptions(), tmp_path, Silent())


def test_an_empty_folder_has_no_recording(tmp_path):
    with pytest.raises(RecordingNotFound, match="no recording in this folder"):
        open_sources([str(tmp_path)], CompareOptions(), tmp_path, Silent())
