from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.testing import assert_array_equal

from quadlog.config.file import load_config
from quadlog.errors import MissingInput
from quadlog.pipelines.comparison.run_planners import ask_everything
from quadlog.pipelines.comparison.sources import recording_source, run_source
from quadlog.pipelines.executor.progress import Silent
from quadlog.planning.rules import Rules


@pytest.fixture
def cut(fixtures: Path, tmp_path: Path) -> Callable[..., Path]:
    def copy(seconds: float, keep: Callable[[str], bool]) -> Path:
        """The beginning of the committed recording, of the topics to keep."""
        path = tmp_path / "cut.mcap"
        with (fixtures / "follow.mcap").open("rb") as source, path.open("wb") as target:
            writer, channels = Writer(target), {}
            writer.start()
            reader = make_reader(source)
            end_ns = reader.get_summary().statistics.message_start_time + int(seconds * 1e9)
            for schema, channel, message in reader.iter_messages():
                if message.log_time >= end_ns:
                    break
                if not keep(channel.topic):
                    continue
                if channel.id not in channels:
                    known = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, known)
                place = channels[channel.id]
                writer.add_message(place, message.log_time, message.data, message.publish_time, message.sequence)
            writer.finish()
        return path

    return copy


def test_a_recording_asks_what_its_run_asks(cut, planned_run, fixtures, tmp_path):
    config = load_config(fixtures / "follow.toml", environ={})
    path = cut(1.0, lambda topic: True)
    source, loss = recording_source(path, "cut.mcap", config, tmp_path / "run", 0, Silent())
    assert (source.name, loss) == ("cut.mcap", "")
    columns = ask_everything(source, ["astar"], Rules(), Silent()).columns
    of_run = ask_everything(run_source(planned_run, "run"), ["astar"], Rules(), Silent()).columns
    count = len(columns["t_ns"])  # the last scan was logged after the cut
    assert count == len(of_run["t_ns"]) - 1
    for name in ("t_ns", "expanded", "start_col", "start_row", "goal_col", "goal_row"):
        assert_array_equal(columns[name], of_run[name][:count], name)


def test_a_recording_without_a_lidar_is_named_and_no_flag_of_replay_proposed(cut, tmp_path):
    path = cut(0.5, lambda topic: topic != "/lidar/points")
    with pytest.raises(
        MissingInput, match=r"cut\.mcap: no topic is fit to be the lidar; planners are compared on maps"
    ):
        recording_source(path, "cut.mcap", load_config(None, environ={}), tmp_path / "run", 0, Silent())


def test_a_recording_without_a_target_says_how_to_choose_one(cut, tmp_path):
    path = cut(0.3, lambda topic: topic in ("/lidar/points", "/tf_static"))
    with pytest.raises(MissingInput, match=r"cut\.mcap shows no target; choose one with  --set topics\.target=ahead"):
        recording_source(path, "cut.mcap", load_config(None, environ={}), tmp_path / "run", 0, Silent())
