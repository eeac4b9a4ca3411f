from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

from quadlog.config.file import load_config
from quadlog.errors import MissingInput
from quadlog.pipelines.comparison.compare import ask_everything
from quadlog.pipelines.comparison.sources import recording_source, run_source
from quadlog.pipelines.executor.progress import Silent
from quadlog.planning.rules import Rules


@pytest.fixture
def recorded(cut: Callable[..., Path], fixtures: Path, tmp_path: Path, without_pictures: None) -> Callable[..., Path]:
    """The beginning of the committed recording, of the topics to keep."""
    return lambda seconds, keep: cut(
        fixtures / "follow.mcap", tmp_path / "cut.mcap", seconds, lambda _, topic: keep(topic)
    )


def test_a_recording_asks_what_its_run_asks(recorded, planned_run, fixtures, tmp_path):
    config = load_config(fixtures / "follow.toml", environ={})
    path = recorded(1.0, lambda topic: True)
    source, loss = recording_source(path, "cut.mcap", config, tmp_path / "run", 0, Silent())
    assert (source.name, loss) == ("cut.mcap", "")
    columns = ask_everything(source, ["astar"], Rules(), Silent()).columns
    of_run = ask_everything(run_source(planned_run, "run"), ["astar"], Rules(), Silent()).columns
    count = len(columns["t_ns"])  # the last scan was logged after the cut
    assert count == len(of_run["t_ns"]) - 1
    for name in ("t_ns", "expanded", "start_col", "start_row", "goal_col", "goal_row"):
        assert_array_equal(columns[name], of_run[name][:count], name)


def test_a_recording_without_a_lidar_is_named_and_no_flag_of_replay_proposed(recorded, tmp_path):
    path = recorded(0.5, lambda topic: topic != "/lidar/points")
    with pytest.raises(
        MissingInput, match=r"cut\.mcap: no topic is fit to be the lidar; planners are compared on maps"
    ):
        recording_source(path, "cut.mcap", load_config(None, environ={}), tmp_path / "run", 0, Silent())


def test_a_recording_without_a_target_says_how_to_choose_one(recorded, tmp_path):
    path = recorded(0.3, lambda topic: topic in ("/lidar/points", "/tf_static"))
    with pytest.raises(MissingInput, match=r"cut\.mcap shows no target; choose one with  --set topics\.target=ahead"):
        recording_source(
            path, "cut.mcap", load_config(None, ["topics.position=fixed"], {}), tmp_path / "run", 0, Silent()
        )
