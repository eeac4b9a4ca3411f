"""The example plug-ins, installed as their pyproject.toml says, where their answers are known."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.ndimage import label

import quadlog
from quadlog.cli.main import run
from quadlog.planning.registry import make_planner
from quadlog.planning.rules import Rules
from quadlog.results.record import PluginRecord
from tests.conftest import forget_plugins

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "plugins"
FIXTURES = ROOT / "fixtures"
PROJECT = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
TYPE = "beacon_msgs/msg/Distances"
DEFINITION = "std_msgs/Header header\nuint8 tag\nuint16[] beacons\nfloat32[] distances\n"
UWB_TOPIC = "/nlink_linktrack_tagframe0"


@pytest.fixture
def example(plugin_site, install) -> None:
    """The example distribution, at its own version."""
    shutil.copytree(EXAMPLE / "quadlog_examples", plugin_site / "quadlog_examples")
    install(PROJECT["name"], PROJECT["version"], PROJECT["entry-points"])


@pytest.fixture(scope="module")
def beacons(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The committed recording with every LinkTrack frame as a Distances message instead."""
    path = tmp_path_factory.mktemp("recording") / "follow.mcap"
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(DEFINITION, TYPE))
    text, _ = store.generate_msgdef(TYPE, ros_version=2)
    with (FIXTURES / "follow.mcap").open("rb") as source, path.open("wb") as target:
        writer = Writer(target)
        writer.start()
        ids: dict[str, int] = {}
        for schema, channel, message, decoded in make_reader(
            source, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            uwb = channel.topic == UWB_TOPIC
            if channel.topic not in ids:
                kind = (TYPE, "ros2msg", text.encode()) if uwb else (schema.name, schema.encoding, schema.data)
                topic = "/beacons" if uwb else channel.topic
                ids[channel.topic] = writer.register_channel(topic, "cdr", writer.register_schema(*kind))
            data = _as_distances(store, decoded) if uwb else message.data
            writer.add_message(ids[channel.topic], message.log_time, data, message.publish_time, message.sequence)
        writer.finish()
    return path


def _as_distances(store, frame) -> bytes:
    """The ranges of a LinkTrack frame; its eighth anchor, which it has no range to, did not answer."""
    header, stamp = frame.header, frame.header.stamp
    kinds = store.types
    distances = np.array(frame.dis_arr, np.float32)
    message = kinds[TYPE](
        kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](stamp.sec, stamp.nanosec), header.frame_id),
        frame.id,
        np.arange(len(distances), dtype=np.uint16),
        np.where(distances > 0, distances, np.float32(-1)),
    )
    return bytes(store.serialize_cdr(message, TYPE))


def replayed(recording: Path, output: Path, *words: str) -> quadlog.Run:
    command = ["replay", str(recording), "-c", str(FIXTURES / "follow.toml"), "-o", str(output)]
    assert run([*command, "--duration", "2", "--no-plots", *words]) == 0
    return quadlog.load_run(output / "follow")


def test_the_decoder_gives_the_run_that_quadlogs_own_decoder_gives(example, beacons, tmp_path):
    words = ("--until", "position", "--planner", "greedy")  # which does not come to planning
    ours = replayed(FIXTURES / "follow.mcap", tmp_path / "own", *words)
    theirs = replayed(beacons, tmp_path / "theirs", *words)
    for name in ("fixes", "ranges", "poses", "target"):
        assert len(ours.table(name)) > 0
        assert (ours.path / f"{name}.parquet").read_bytes() == (theirs.path / f"{name}.parquet").read_bytes(), name
    decoder = {"group": "quadlog.decoders", "name": TYPE, "distribution": "quadlog-examples", "version": "1.0"}
    assert (ours.record.plugins, theirs.record.plugins) == ([], [PluginRecord(**decoder)])


@pytest.mark.parametrize("installed", [True, False])
def test_info_knows_what_the_decoder_gives(request, beacons, capsys, installed):
    if installed:
        request.getfixturevalue("example")
    assert run(["info", str(beacons), "--json"]) == 0
    topics = {each["name"]: each for each in json.loads(capsys.readouterr().out)["topics"]}
    assert (topics["/beacons"]["role"], topics["/beacons"]["type"]) == ("uwb" if installed else None, TYPE)


def test_a_replay_plans_by_the_planner_and_another_version_of_it_is_another_run(
    example, install, plugin_site, tmp_path
):
    words = ("--planner", "greedy", "--until", "plan")
    done = replayed(FIXTURES / "follow.mcap", tmp_path, *words)
    assert set(done.table("plans")["planner"]) == {"greedy"}
    assert done.metric("success_rate") == 1
    assert [each.name for each in done.record.plugins] == ["greedy"]
    written = (done.path / "run.json").stat().st_mtime_ns
    replayed(FIXTURES / "follow.mcap", tmp_path, *words, "--resume")
    assert (done.path / "run.json").stat().st_mtime_ns == written
    shutil.rmtree(plugin_site / "quadlog_examples-1.0.dist-info")
    install(PROJECT["name"], "1.1", PROJECT["entry-points"])
    again = replayed(FIXTURES / "follow.mcap", tmp_path, *words, "--resume")
    assert again.record.plugins[0].version == "1.1"


def test_the_comparison_asks_the_planner(example, capsys):
    command = ["compare-planners", "forest:0.1", "--episodes", "1", "--format", "json"]
    assert run([*command, "--planner", "greedy"]) == 0
    captured = capsys.readouterr()
    astar, greedy = json.loads(captured.out)
    assert (astar["planner"], greedy["planner"]) == ("astar", "greedy")
    assert greedy["success_rate"] == astar["success_rate"]
    assert greedy["suboptimality_mean"] > 0
    assert "Planner greedy is of quadlog-examples 1.0." in captured.err


@given(seed=st.integers(0, 2**32), density=st.floats(0, 0.6), corner_cutting=st.booleans())
def test_the_planner_finds_a_way_exactly_where_there_is_one(example, seed, density, corner_cutting):
    """With corners cut, scipy's labels of eight neighbours tell where; without, four neighbours do."""
    rng = np.random.default_rng(seed)
    free = rng.random((8, 9)) >= density
    parts, _ = label(free, np.ones((3, 3)) if corner_cutting else None)
    start, goal = (tuple(rng.integers((9, 8)).tolist()) for _ in range(2))
    same = parts[start[1], start[0]] == parts[goal[1], goal[0]] > 0
    plan = make_planner("greedy", Rules(corner_cutting=corner_cutting)).plan(~free, start, goal)
    assert plan.found == same
    if same:
        optimum = make_planner("astar", Rules(corner_cutting=corner_cutting)).plan(~free, start, goal)
        assert plan.cost >= optimum.cost


BROKEN_WHEN_ASKED = """
from quadlog.planning.planners.astar import AStar
class Broken(AStar):
    name = "broken"
    def plan(self, *_):
        raise ValueError("lost")
"""
REPLAY = ["replay", str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml"), "--duration", "1", "--no-plots"]


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("import nothing_there\n", "cannot be loaded: ModuleNotFoundError: No module named 'nothing_there'"),
        (BROKEN_WHEN_ASKED, "could not plan: ValueError: lost"),
    ],
)
@pytest.mark.parametrize(
    "command", [[*REPLAY, "--until", "plan", "-o"], ["compare-planners", "forest:0.1", "--episodes", "1"]]
)
def test_a_broken_planner_is_one_line(install, capsys, tmp_path, command, source, reason):
    entry_points = {"quadlog.planners": {"broken": "quadlog_broken:Broken"}}
    install("quadlog-broken", "0.2", entry_points, {"quadlog_broken": source})
    output = [str(tmp_path)] if command[-1] == "-o" else []
    assert run([*command, *output, "--planner", "broken"]) == 1
    *_, last = capsys.readouterr().err.splitlines()
    assert last == f"quadlog: planner broken of quadlog-broken 0.2: {reason}"


def test_the_controller_walks_a_course_beside_ours(example, tmp_path, capsys):
    """Without a fall and on its way, turning; run.json names it, and `metrics` has both in one table."""
    course = tmp_path / "bend.csv"
    course.write_text("0,0\n0.7,0\n1.1,0.3\n")
    for name in ("virtual_model", "pmw"):
        assert run(["simulate", str(course), "--controller", name, "--no-plots", "-o", str(tmp_path)]) == 0
    runs = [tmp_path / f"bend-{name}" / "seed-000" for name in ("virtual_model", "pmw")]
    theirs, ours = (quadlog.load_run(each) for each in runs)
    assert (theirs.metric("fallen"), ours.metric("fallen")) == (0, 0)
    assert theirs.metric("completion_time_s") == pytest.approx(ours.metric("completion_time_s"), abs=0.5)
    assert theirs.metric("pitch_rms_rad") < 0.12
    assert [each.name for each in theirs.record.plugins] == ["virtual_model"]
    assert ours.record.plugins == []
    capsys.readouterr()
    assert run(["metrics", *map(str, runs)]) == 0
    assert "Metrics of bend-virtual_model/seed-000, bend-pmw/seed-000" in capsys.readouterr().out.replace("\n", " ")


def test_runs_of_plugins_are_read_where_these_are_not_installed(example, plugin_site, tmp_path, capsys):
    course = tmp_path / "step.csv"
    course.write_text("0,0\n0.2,0\n")
    words = ["--controller", "virtual_model", "--set", "planner.name=greedy", "--no-plots", "-o", str(tmp_path)]
    assert run(["simulate", str(course), *words]) == 0
    shutil.rmtree(plugin_site / "quadlog_examples-1.0.dist-info")
    forget_plugins()
    walked = str(tmp_path / "step-virtual_model" / "seed-000")
    assert [run([command, walked]) for command in ("metrics", "report")] == [0, 0]
    assert run(["simulate", str(course), *words[2:], "--force"]) == 1, "nor is it walked again"


BROKEN_CONTROLLER = """
class Broken:
    def __init__(self, robot, gait): pass
    def step(self, t_s, state, wanted): return [t_s] * 11
"""


def test_a_broken_controller_is_one_line_and_leaves_no_run(install, capsys, tmp_path):
    points = {"quadlog.controllers": {"broken": "quadlog_broken:Broken"}}
    install("quadlog-broken", "0.2", points, {"quadlog_broken": BROKEN_CONTROLLER})
    words = ["simulate", "line", "-o", str(tmp_path / "runs"), "--controller"]
    assert run([*words, "broken"]) == 1
    *_, last = capsys.readouterr().err.splitlines()
    reason = "its torques are float64 (11,), not numbers (12,)"
    assert last == f"quadlog: controller broken of quadlog-broken 0.2: {reason}"
    assert run([*words, "brokn"]) == 2
    assert "'broken'" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def _shell_lines() -> Iterator[list[str]]:
    for block in (EXAMPLE / "README.md").read_text().split("```sh\n")[1:]:
        for line in block.split("```")[0].splitlines():
            words = line.split("  #")[0].split()
            if words and words[0] == "quadlog":
                yield words[1:]


def test_every_command_of_its_readme_runs(example, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    told = list(_shell_lines())
    assert len(told) == 5
    for words in told:
        shortened = [str(tmp_path / word) if word.startswith("runs") else word for word in words]
        if words[0] == "replay":
            shortened += ["--duration", "1.5", "--until", "plan", "--no-plots"]
        if words[0] == "simulate":
            course = tmp_path / "line.csv"
            course.write_text("0,0\n0.3,0\n")
            shortened = ["simulate", str(course), *shortened[2:], "--no-plots"]
        assert run(shortened) == 0
