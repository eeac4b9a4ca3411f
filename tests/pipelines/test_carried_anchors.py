"""Logs whose range messages say where the anchors are, from file to positions, info and init; written by rosbags."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.messages import UwbRanges
from quadlog.pipelines.executor.progress import Kept
from quadlog.pipelines.info import describe_recording, propose_config
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.recordings.decoders.anchor_places import MOST_ANCHORS, AnchorPlaces
from quadlog.recordings.decoders.ros_messages import BUNDLED

KIND = "uwb_driver/msg/UwbRange"
START_NS = 1_700_000_000 * 10**9
SQUARE_M = np.array([(0.5, -0.5, 1.2), (8.0, 0.0, 1.25), (8.0, 7.0, 1.2), (0.0, 7.0, 1.3)])
IDS = (100, 101, 102, 103)
Places = Callable[[int, int], Any]


def carried(anchor: int, message: int) -> Any:
    """The true place with a jitter of a centimetre, as a self-survey has it."""
    return SQUARE_M[anchor] + 0.01 * np.random.default_rng(message).standard_normal(3)


def tag_m(at_s: np.ndarray) -> np.ndarray:
    phase = 2 * np.pi * at_s / 20
    return np.column_stack([4 + 2.5 * np.sin(phase), 3.5 + 1.8 * np.sin(2 * phase), np.full(len(at_s), 0.6)])


def write(path: Path, places: Places = carried, seconds: float = 6.0) -> Path:
    """Single ranges in turns, 80 Hz, to a bag or an MCAP file by its suffix."""
    ros1 = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    text = (BUNDLED / "uwb_driver" / "msg" / "UwbRange.msg").read_text()
    store.register(get_types_from_msg(text, KIND))
    definition, digest = store.generate_msgdef(KIND, ros_version=1 if ros1 else 2)
    t_ns = START_NS + np.arange(int(seconds * 80), dtype=np.int64) * 12_500_000
    true_m = tag_m((t_ns - START_NS) * 1e-9)
    noise_m = 0.03 * np.random.default_rng(0).standard_normal(len(t_ns))
    payloads = []
    for i, (each_ns, position_m) in enumerate(zip(t_ns.tolist(), true_m, strict=True)):
        anchor = i % 4
        range_m = float(np.linalg.norm(position_m - SQUARE_M[anchor]) + noise_m[i])
        message = make(store, ros1, i, each_ns, IDS[anchor], range_m, places(anchor, i))
        serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
        payloads.append((each_ns, bytes(serialize(message, KIND))))
    if ros1:
        with BagWriter(path) as bag:
            connection = bag.add_connection("/uwb", KIND, msgdef=definition, md5sum=digest)
            for each_ns, payload in payloads:
                bag.write(connection, each_ns, payload)
        return path
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        channel = writer.register_channel("/uwb", "cdr", writer.register_schema(KIND, "ros2msg", definition.encode()))
        for each_ns, payload in payloads:
            writer.add_message(channel, each_ns, payload, each_ns)
        writer.finish()
    return path


def make(store: Any, ros1: bool, i: int, t_ns: int, anchor: int, range_m: float, place: Any) -> Any:
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)
    header = types["std_msgs/msg/Header"](*((i, stamp, "uwb") if ros1 else (stamp, "uwb")))
    point = types["geometry_msgs/msg/Point"]
    numbers = (i % 65536, 7, anchor, 0, 1, 0, 0, 5, range_m, 1.0, 1.0, 0.1, 0.1, 0.1, 0.0, 0.0, 1, 0, 0, 0, 0, 0, 0)
    nowhere = point(0.0, 0.0, 0.0)
    return types[KIND](header, *numbers, nowhere, point(*(float(each) for each in place)), nowhere, nowhere)


def run(path: Path, config: Config | None = None, name: str = "run", **options: Any) -> tuple[Any, list[str]]:
    kept = Kept()
    request = ReplayRequest(path, path.parent / name, config or Config(), ReplayOptions(until="position"), plots=False)
    return replay(replace(request, **options), kept), kept.lines


def poses_of(folder: Path) -> dict[str, np.ndarray]:
    return {key: column.to_numpy() for key, column in pq.read_table(folder / "poses.parquet").to_pandas().items()}


def rmse_m(folder: Path) -> float:
    poses = poses_of(folder)
    error_m = np.column_stack([poses["x_m"], poses["y_m"]]) - tag_m((poses["t_ns"] - START_NS) * 1e-9)[:, :2]
    return float(np.sqrt(np.mean(np.sum(error_m**2, axis=1))))


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_the_robot_is_located_by_the_anchors_of_the_messages(tmp_path, suffix):
    outcome, lines = run(write(tmp_path / f"walk{suffix}"))
    assert outcome.exit_code == 0
    assert set(poses_of(outcome.run)["source"]) == {"uwb"}
    assert rmse_m(outcome.run) < 0.1
    assert any("positions of 4 anchors from the messages" in line for line in lines)
    assert not any(line.startswith("warning: /uwb") or "contradict" in line for line in lines)


def test_it_is_the_run_that_the_same_anchors_in_the_configuration_give(tmp_path):
    """And the configuration that lies beside the run gives it again."""
    path = write(tmp_path / "walk.bag")
    outcome, _ = run(path)
    again, lines = run(path, load_config(outcome.run / "config.toml", environ={}), "again")
    for name in ("fixes", "poses", "ranges", "links"):
        assert (outcome.run / f"{name}.parquet").read_bytes() == (again.run / f"{name}.parquet").read_bytes()
    assert not any("anchors" in line for line in lines if line.startswith("warning"))
    assert json.loads((outcome.run / "run.json").read_text())["anchors_from_messages"]
    assert not json.loads((again.run / "run.json").read_text())["anchors_from_messages"]


def test_resuming_knows_the_finished_run(tmp_path):
    path = write(tmp_path / "walk.bag", seconds=4)
    run(path)
    _, lines = run(path, existing=Existing.RESUME)
    assert any("already done" in line for line in lines)
    other = Config.model_validate({"uwb": {"anchors": configured(SQUARE_M)}})
    _, lines = run(path, other, existing=Existing.RESUME)
    assert not any("already done" in line for line in lines)


def configured(position_m: np.ndarray) -> list[dict[str, float]]:
    return [{"id": i, "x_m": x, "y_m": y, "z_m": z} for i, (x, y, z) in zip(IDS, position_m.tolist(), strict=True)]


@pytest.mark.parametrize("nowhere", [(0.0, 0.0, 0.0), (np.nan, 1.0, 1.0), (np.inf, 0.0, 0.0), (1e30, 0.0, 0.0)])
def test_zero_and_nan_are_no_positions(tmp_path, nowhere):
    """Of all anchors, or of two of four: a fix needs three."""
    for name, known in (("none", 0), ("two", 2)):
        path = write(
            tmp_path / f"{name}.mcap", lambda anchor, i, n=known: carried(anchor, i) if anchor < n else nowhere, 4
        )
        outcome, lines = run(path, name=f"run-{name}")
        assert outcome.exit_code == 0
        assert set(poses_of(outcome.run)["source"]) == {"fixed"}
        words = [line for line in lines if "ranges are not used" in line]
        assert len(words) == 1
        assert ("place 2 of the 3 that a fix needs" in words[0]) == (known == 2)
        assert len(describe_recording(path, Config())["anchors"]) == known


def test_an_anchor_without_a_position_is_left_out_and_told(tmp_path):
    path = write(tmp_path / "walk.mcap", lambda anchor, i: carried(anchor, i) if anchor else (0, 0, 0))
    outcome, lines = run(path)
    assert set(poses_of(outcome.run)["source"]) == {"uwb"}
    assert any("anchors seen" in line and "100 (" in line for line in lines)


def test_an_anchor_that_moves_is_told_once(tmp_path):
    path = write(tmp_path / "walk.mcap", lambda anchor, i: carried(anchor, i) + (anchor == 2) * i / 200 * np.ones(3))
    for lines in (run(path)[1], [f"warning: {each}" for each in describe_recording(path, Config())["warnings"]]):
        told = [line for line in lines if "contradict" in line]
        assert len(told) == 1
        assert "anchor 102 by " in told[0]
        assert "101" not in told[0]


def test_one_wild_position_is_not_believed(tmp_path):
    path = write(tmp_path / "walk.mcap", lambda anchor, i: (500.0, 0, 0) if i == 2 else carried(anchor, i), 4)
    outcome, lines = run(path)
    assert rmse_m(outcome.run) < 0.15
    assert not any("contradict" in line for line in lines)


def test_the_configuration_wins_with_one_warning(tmp_path):
    path = write(tmp_path / "walk.bag", lambda anchor, i: carried(anchor, i) + np.array([3.0, 0, 0]))
    config = Config.model_validate({"uwb": {"anchors": configured(SQUARE_M)}})
    outcome, lines = run(path, config)
    assert rmse_m(outcome.run) < 0.1
    for each in (lines, [f"warning: {each}" for each in describe_recording(path, config)["warnings"]]):
        told = [line for line in each if "[[uwb.anchors]], which are used" in line]
        assert len(told) == 1
        assert "4 of 4 anchors" in told[0]
        assert "by 3.0" in told[0]


def test_info_shows_them_and_the_health_of_the_links(tmp_path, capsys):
    from quadlog.cli.main import run as run_cli

    path = write(tmp_path / "walk.bag")
    info = describe_recording(path, Config())
    assert [row["id"] for row in info["anchors"]] == list(IDS)
    np.testing.assert_allclose([[row[f"{axis}_m"] for axis in "xyz"] for row in info["anchors"]], SQUARE_M, atol=0.01)
    assert all(row["moved_m"] < 0.05 for row in info["anchors"])
    assert [(row["tag"], row["anchor"]) for row in info["uwb"]] == [(7, anchor) for anchor in IDS]
    assert run_cli(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^ +102 +120 +(8|7.99\d|8.00\d) ", out, re.MULTILINE), out
    assert run_cli(["info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["anchors"] == info["anchors"]


def test_init_writes_them_as_a_configuration_that_works(tmp_path):
    path = write(tmp_path / "walk.bag", lambda anchor, i: carried(anchor, i) if anchor < 3 else (0, 0, 0))
    text = propose_config(path).text
    anchors = tomllib.loads(text)["uwb"]["anchors"]
    assert [each["id"] for each in anchors] == [100, 101, 102]
    np.testing.assert_allclose([[each[f"{axis}_m"] for axis in "xyz"] for each in anchors], SQUARE_M[:3], atol=0.01)
    assert "# id = 103" in text
    (tmp_path / "quadlog.toml").write_text(text)
    outcome, _ = run(path, load_config(tmp_path / "quadlog.toml", environ={}))
    assert set(poses_of(outcome.run)["source"]) == {"uwb"}


def test_memory_is_bounded():
    """Neither the ids of a damaged log nor its length are collected without end; the median stays."""
    places = AnchorPlaces()
    rng = np.random.default_rng(0)
    for i in range(20_000):
        places.take(UwbRanges(0, 0, np.array([i % 2]), np.ones(1), None, 5 + rng.normal(0, 0.01, (1, 3))))
    for i in range(2, 3 * MOST_ANCHORS):
        places.take(UwbRanges(0, 0, np.array([i]), np.ones(1), None, np.ones((1, 3))))
    found = places.found()
    assert len(found) == MOST_ANCHORS
    assert found[0].n == 10_000
    np.testing.assert_allclose(found[0].position_m, 5, atol=0.002)
