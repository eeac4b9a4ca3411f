from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import SeekingReader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from quadlog.errors import NotARun
from quadlog.results import read_table
from quadlog.results.foxglove.derived_mcap import write_derived
from quadlog.results.foxglove.messages import paths
from quadlog.results.plots.scans import CLASS_COLOR
from quadlog.results.run.maps import CloudSample, write_cloud_samples
from quadlog.results.run.record import LossRecord, RunRecord

START_NS = 1_700_000_000_123_456_789
KINDS = {1: "u1", 7: "<f4"}  # foxglove's NumericType, by number


def read(path: Path, topic: str) -> list[tuple[int, Any]]:
    with path.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [(message.log_time, each) for _, _, message, each in reader.iter_decoded_messages(topics=[topic])]


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


@settings(max_examples=15, deadline=None)
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
