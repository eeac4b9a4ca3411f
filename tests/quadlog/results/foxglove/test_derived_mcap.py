from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import SeekingReader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from quadlog.errors import NotARun
from quadlog.results import load_maps, read_table
from quadlog.results.foxglove.derived_mcap import write_derived
from quadlog.results.foxglove.messages import paths
from quadlog.results.plots.scans import CLASS_COLOR
from quadlog.results.run.maps import CloudSample, write_cloud_samples
from quadlog.results.run.record import LossRecord, RunRecord
from quadlog.results.run.tables import TABLES, write_table

START_NS = 1_700_000_000_123_456_789


def read(path: Path, topic: str) -> list[tuple[int, Any]]:
    """(log time, decoded message) of a topic."""
    with path.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(message.log_time, each) for _, _, message, each in reader.iter_decoded_messages(topics=[topic])]


TOPICS = {
    "/quadlog/tf": ("foxglove.FrameTransform", 40),
    "/quadlog/pose": ("foxglove.PoseInFrame", 40),
    "/quadlog/target": ("foxglove.PoseInFrame", 40),
    "/quadlog/uwb/anchors": ("foxglove.SceneUpdate", 1),
    "/quadlog/uwb/fix/0": ("foxglove.PoseInFrame", 40),
    "/quadlog/uwb/fix/1": ("foxglove.PoseInFrame", 39),
    "/quadlog/map": ("foxglove.Grid", 40),
    "/quadlog/scan": ("foxglove.PointCloud", 2),
    "/quadlog/cells": ("foxglove.Vector2", 40),
    "/quadlog/path": ("foxglove.SceneUpdate", 40),
    "/quadlog/path_smooth": ("foxglove.SceneUpdate", 40),
    "/quadlog/resim/tf": ("foxglove.FrameTransform", 200),
    "/quadlog/resim/pose": ("foxglove.PoseInFrame", 200),
    "/quadlog/resim/error": ("foxglove.Vector3", 200),
    "/quadlog/resim/path": ("foxglove.SceneUpdate", 40),
    "/quadlog/resim/path_smooth": ("foxglove.SceneUpdate", 40),
    "/quadlog/log": ("foxglove.Log", 4),
}


def test_topics_schemas_and_counts(tiny_run: Path) -> None:
    with (tiny_run / "derived.mcap").open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    found = {
        channel.topic: (summary.schemas[channel.schema_id].name, counts[channel.id])
        for channel in summary.channels.values()
    }
    assert found == TOPICS
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert summary.statistics.message_start_time == START_NS


def test_times_are_the_tables_and_in_order(tiny_run: Path, derived: Any) -> None:
    poses = read_table(tiny_run, "poses")
    assert [t for t, _ in derived["/quadlog/pose"]] == poses["t_ns"].tolist()
    control = read_table(tiny_run, "control")
    assert [t for t, _ in derived["/quadlog/resim/error"]] == control["t_ns"].tolist()
    with (tiny_run / "derived.mcap").open("rb") as file:
        stored = [message.log_time for *_, message in SeekingReader(file).iter_messages(log_time_order=False)]
        file.seek(0)
        numbers = [message.sequence for *_, message in SeekingReader(file).iter_messages(topics=["/quadlog/pose"])]
    assert stored == sorted(stored)
    assert numbers == list(range(40))


def test_poses_and_transforms_say_what_the_tables_say(tiny_run: Path, derived: Any) -> None:
    poses = read_table(tiny_run, "poses")
    for i, (t_ns, message) in enumerate(derived["/quadlog/pose"]):
        assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == t_ns
        assert message.frame_id == "map"
        assert (message.pose.position.x, message.pose.position.y) == (poses["x_m"][i], poses["y_m"][i])
        quat = message.pose.orientation
        assert 2 * np.arctan2(quat.z, quat.w) == pytest.approx(poses["yaw_rad"][i])
    last = derived["/quadlog/tf"][-1][1]
    assert (last.parent_frame_id, last.child_frame_id) == ("map", "base")
    assert (last.translation.x, last.translation.y) == (poses["x_m"][-1], poses["y_m"][-1])
    resim = derived["/quadlog/resim/tf"][0][1]
    assert (resim.parent_frame_id, resim.child_frame_id) == ("map", "base_resim")
    assert derived["/quadlog/uwb/fix/0"][0][1].pose.position.z == 0.6
    assert derived["/quadlog/resim/pose"][0][1].pose.position.z == 0.0  # a kinematic robot has no height


def test_grids_are_the_maps(tiny_run: Path, derived: Any) -> None:
    for (t_ns, grid), (map_t_ns, origin_m, occupied) in zip(derived["/quadlog/map"], load_maps(tiny_run), strict=True):
        assert t_ns == map_t_ns
        assert (grid.pose.position.x, grid.pose.position.y) == tuple(origin_m)
        assert (grid.column_count, grid.row_stride, grid.cell_stride, grid.cell_size.x) == (50, 50, 1, 0.1)
        assert [(field.name, field.offset, field.type) for field in grid.fields] == [("occupied", 0, 1)]
        np.testing.assert_array_equal(np.frombuffer(grid.data, np.uint8).reshape(60, 50), occupied)


def test_numbers_and_what_was_said(tiny_run: Path, derived: Any) -> None:
    plans, control = read_table(tiny_run, "plans"), read_table(tiny_run, "control")
    cells = [(each.x, each.y) for _, each in derived["/quadlog/cells"]]
    assert cells == list(zip(plans["expanded"], plans["generated"], strict=True))
    errors = [(each.x, each.y, each.z) for _, each in derived["/quadlog/resim/error"]]
    expected = np.column_stack([control[name] for name in ("error_m", "cross_track_m", "time_error_m")])
    np.testing.assert_array_equal(errors, expected)
    assert {t for t, _ in derived["/quadlog/log"]} == {START_NS}
    assert [(line.level, line.name, line.message) for _, line in derived["/quadlog/log"]] == [
        (4, "loss", "one chunk is damaged, from 1.0 s to 1.5 s (/points)"),
        (3, "warning", "no heading source: yaw is the course"),
        (2, "metric", "eta_m = 0.123 m (n = 200)"),
        (2, "metric", "fallen = 0 (n = 1)"),
    ]


def test_the_bytes_do_not_depend_on_the_process(tiny_run: Path) -> None:
    written = (tiny_run / "derived.mcap").read_bytes()
    script = (
        "import foxglove; foxglove.Channel('/other', message_encoding='json')\n"
        f"from pathlib import Path\nfrom quadlog.results.foxglove.derived_mcap import write_derived\n"
        f"write_derived(Path({str(tiny_run)!r}))"
    )
    subprocess.run([sys.executable, "-c", script], check=True, env={**os.environ, "PYTHONHASHSEED": "7"})
    assert (tiny_run / "derived.mcap").read_bytes() == written


def test_a_run_of_nothing_but_positions(tiny_run: Path, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tiny_run / "poses.parquet").rename(tmp_path / "run" / "poses.parquet")
    write_derived(tmp_path / "run")
    with (tmp_path / "run" / "derived.mcap").open("rb") as file:
        topics = {channel.topic for _, channel, _ in SeekingReader(file).iter_messages()}
    assert topics == {"/quadlog/tf", "/quadlog/pose"}


def test_a_walk_along_a_course_is_its_own_frame_and_its_tilt_is_scipys(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    control = {name: np.zeros(50) for name in TABLES["control"].names}
    control |= {name: rng.uniform(-1, 1, 50) for name in ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")}
    control |= {"t_ns": np.arange(50), "fallen": np.zeros(50, bool)}
    for name in ("z_m", "roll_rad", "pitch_rad"):
        control[name][7] = np.nan  # as without a body
    write_table(tmp_path / "control.parquet", TABLES["control"], control)
    (tmp_path / "metrics.json").write_text(
        json.dumps({name: {"value": 2.0, "n": 1, "unit": ""} for name in ("fallen", "realtime_factor")})
    )
    path = write_derived(tmp_path)
    frames, poses = ([each for _, each in read(path, f"/quadlog/{topic}")] for topic in ("tf", "resim/pose"))
    lines = [each.message for _, each in read(path, "/quadlog/log")]
    assert lines == ["fallen = 2 (n = 1)"]  # how fast it was is no result
    angles = np.nan_to_num(np.column_stack([control["yaw_rad"], control["pitch_rad"], control["roll_rad"]]))
    truth = Rotation.from_euler("ZYX", angles)
    for quats, places in (
        ([frame.rotation for frame in frames], [frame.translation for frame in frames]),
        ([pose.pose.orientation for pose in poses], [pose.pose.position for pose in poses]),
    ):
        found = Rotation.from_quat([[quat.x, quat.y, quat.z, quat.w] for quat in quats])
        assert (truth.inv() * found).magnitude().max() < 1e-7
        expected = np.nan_to_num(np.column_stack([control[name] for name in ("x_m", "y_m", "z_m")]))
        np.testing.assert_array_equal([[place.x, place.y, place.z] for place in places], expected)
    assert {(frame.parent_frame_id, frame.child_frame_id) for frame in frames} == {("map", "base")}
    assert not read(path, "/quadlog/resim/tf")


@pytest.mark.parametrize("t_ns", [-1, (1 << 32) * 10**9])
def test_a_time_that_foxglove_cannot_show_is_refused(tmp_path: Path, t_ns: int) -> None:
    pose = dict.fromkeys(("x_m", "y_m", "yaw_rad", "z_m", "roll_rad", "pitch_rad"), 0.0) | {
        "t_ns": [t_ns],
        "source": "uwb",
    }
    write_table(tmp_path / "poses.parquet", TABLES["poses"], pose)
    with pytest.raises(NotARun, match="before 1970 or after 2106"):
        write_derived(tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["poses.parquet"]


def test_a_damaged_table_stops_it_whole(write_run: Callable[[Path], Path], tmp_path: Path) -> None:
    run = write_run(tmp_path / "run")
    (run / "derived.mcap").unlink()
    (run / "plans.parquet").write_bytes(b"PAR1")
    with pytest.raises(NotARun, match=r"plans\.parquet"):
        write_derived(run)
    assert not (run / "derived.mcap").exists()
    assert not [name for name in [each.name for each in run.iterdir()] if name.startswith(".")]


KINDS = {1: "u1", 7: "<f4"}  # foxglove's NumericType, by number


def points_in_map(cloud: Any) -> tuple[np.ndarray, np.ndarray]:
    """What the message says, by its own description: places (N, 3) in its frame, and all fields."""
    about = {
        "names": [field.name for field in cloud.fields],
        "formats": [KINDS[field.type] for field in cloud.fields],
        "offsets": [field.offset for field in cloud.fields],
        "itemsize": cloud.point_stride,
    }
    points = np.frombuffer(cloud.data, np.dtype(about))
    at, turn = cloud.pose.position, cloud.pose.orientation
    xyz_m = np.column_stack([points[name] for name in "xyz"]).astype(np.float64)
    turned_m = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply(xyz_m)
    return turned_m + np.array([at.x, at.y, at.z]), points


def test_paths_are_lines_of_the_points_there_are(tiny_run: Path, derived: Any) -> None:
    for prefix, topic in (("", "/quadlog"), ("resim_", "/quadlog/resim")):
        paths = read_table(tiny_run, f"{prefix}paths")
        for k, (t_ns, update) in enumerate(derived[f"{topic}/path"]):
            rows = slice(10 * k, 10 * k + 10)
            assert paths["t_ns"][rows].tolist() == [t_ns] * 10
            (entity,) = update.entities
            (line,) = entity.lines
            assert (entity.frame_id, entity.id, line.type) == ("map", "path", 0)  # 0: one line through all points
            assert [point.x for point in line.points] == paths["x_m"][rows].tolist()
            assert [point.y for point in line.points] == paths["y_m"][rows].tolist()
            assert len(derived[f"{topic}/path_smooth"][k][1].entities[0].lines[0].points) == 8


def test_without_a_path_there_is_no_line() -> None:
    nothing = {name: np.zeros(0) for name in ("x_m", "y_m", "smooth_x_m", "smooth_y_m")}
    assert list(paths({"t_ns": np.zeros(0, np.int64), **nothing}, "", "#000000")) == []


def test_anchors_stand_where_the_links_say(tiny_run: Path, derived: Any) -> None:
    links = read_table(tiny_run, "links")
    ((t_ns, update),) = derived["/quadlog/uwb/anchors"]
    assert t_ns == START_NS
    assert [entity.texts[0].text for entity in update.entities] == ["anchor 0", "anchor 1", "anchor 2"]
    for k, entity in enumerate(update.entities):
        at = entity.spheres[0].pose.position
        assert (at.x, at.y, at.z) == tuple(links[name][k] for name in ("x_m", "y_m", "z_m"))


@given(
    xy_m=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
    yaw_rad=st.floats(-10, 10),
    n=st.integers(0, 30),
    seed=st.integers(0, 99),
)
def test_any_scan_is_put_into_map_with_its_classes(
    tmp_path_factory: pytest.TempPathFactory, xy_m: Any, yaw_rad: float, n: int, seed: int
) -> None:
    rng, run = np.random.default_rng(seed), tmp_path_factory.mktemp("run")
    xyz_m, label = rng.normal(0, 9, (n, 3)).astype(np.float32), rng.integers(0, 4, n).astype(np.uint8)
    classes = ["invalid", "ground", "obstacle", "unheard of"]
    early, late = (CloudSample(START_NS + t, xyz_m, label, *xy_m, yaw_rad) for t in (0, 5))
    lost = CloudSample(START_NS + 1, xyz_m, label, np.nan, np.nan, np.nan)
    write_cloud_samples(run, [early, lost, late], classes)
    clouds = read(write_derived(run), "/quadlog/scan")
    assert [t for t, _ in clouds] == [START_NS, START_NS + 5]  # none without a place
    cloud = clouds[0][1]
    assert cloud.frame_id == "map"
    places_m, points = points_in_map(cloud)
    turn = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad), 0], [np.sin(yaw_rad), np.cos(yaw_rad), 0], [0, 0, 1]])
    np.testing.assert_allclose(places_m, xyz_m.astype(np.float64) @ turn.T + [*xy_m, 0], atol=1e-9)
    np.testing.assert_array_equal(points["label"], label)
    for name, rgb in zip(classes, ("#d9d9d9", CLASS_COLOR["ground"], CLASS_COLOR["obstacle"], "#1a1a1a"), strict=True):
        for point in points[label == classes.index(name)]:
            assert bytes(point[k] for k in ("red", "green", "blue")).hex() == rgb.lower().removeprefix("#")
            assert point["alpha"] == 255


def test_the_configured_lidar_is_a_frame_of_its_own(tiny_run: Path, tiny_record: RunRecord, tmp_path: Path) -> None:
    mount = {"x_m": 0.2, "y_m": -0.1, "z_m": 0.45, "roll_deg": 10.0, "pitch_deg": -20.0, "yaw_deg": 90.0}
    record = replace(tiny_record, config={"lidar": {"mount": mount}})
    ((t_ns, frame),) = read(write_derived(tiny_run, tmp_path / "a.mcap", record), "/quadlog/tf_static")
    assert (t_ns, frame.parent_frame_id, frame.child_frame_id) == (START_NS, "base", "lidar")
    assert (frame.translation.x, frame.translation.y, frame.translation.z) == (0.2, -0.1, 0.45)
    turn = Rotation.from_quat([frame.rotation.x, frame.rotation.y, frame.rotation.z, frame.rotation.w])
    assert (turn.inv() * Rotation.from_euler("ZYX", [90, -20, 10], degrees=True)).magnitude() < 1e-9

    nothing = replace(tiny_record, config={"lidar": {"mount": dict.fromkeys(mount, 0.0)}})
    assert not read(write_derived(tiny_run, tmp_path / "b.mcap", nothing), "/quadlog/tf_static")
    for bad in ({"lidar": 1}, {"lidar": {"mount": {"x_m": "here"}}}, {"lidar": {"mount": {"yaw_deg": None}}}):
        with pytest.raises(NotARun, match=r"config\.lidar\.mount"):
            write_derived(tiny_run, tmp_path / "c.mcap", replace(tiny_record, config=bad))


def test_words_of_any_kind_are_said(tiny_run: Path, tiny_record: RunRecord, tmp_path: Path) -> None:
    words = ["Γειά \U0001f415 \x00\n</script>", "half a pair: \ud800"]
    record = replace(tiny_record, losses=[LossRecord("crc", words[0])], warnings=[words[1]])
    lines = read(write_derived(tiny_run, tmp_path / "a.mcap", record), "/quadlog/log")
    assert [line.message for _, line in lines[:2]] == [words[0], "half a pair: ?"]
