"""Clouds of PointCloud2 and Livox messages."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from quadlog.errors import DecodeError
from quadlog.recordings.decoders.point_cloud import DATATYPES, PointCloud2Decoder, livox_decoder
from quadlog.recordings.decoders.ros_messages import BUNDLED

T_NS = 1_700_000_000_123_456_789
CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def decode_point_cloud2(payload, encoding, topic):
    """One message, by a decoder that has seen none before."""
    return PointCloud2Decoder(topic, encoding)(payload)


def cloud_message(ros: Any, points: np.ndarray, *, rows: int = 1, padding: int = 0, big: bool = False) -> Any:
    """A PointCloud2 of a structured array, with `padding` bytes after each row."""
    field_type = ros.type("sensor_msgs/msg/PointField")
    fields = []
    for name in points.dtype.names:
        dtype, offset = points.dtype.fields[name][:2]
        base, shape = dtype.subdtype or (dtype, ())
        fields.append(field_type(name, offset, CODES[base.str[1:]], int(np.prod(shape, dtype=int))))
    step = points.dtype.itemsize
    columns = len(points) // rows
    table = np.zeros((rows, columns * step + padding), np.uint8)
    table[:, : columns * step] = points.view(np.uint8).reshape(rows, columns * step)
    return ros.type("sensor_msgs/msg/PointCloud2")(
        ros.header(T_NS), rows, columns, fields, big, step, table.shape[1], table.reshape(-1), True
    )


@st.composite
def layouts(draw: st.DrawFn) -> dict[str, Any]:
    """Any order, types, byte order, element counts, gaps between fields, rows and row padding."""
    order = draw(st.sampled_from("<>"))
    coordinates = draw(st.sampled_from(DATATYPES))
    names = draw(st.permutations(["x", "y", "z", "ring", "intensity", "extra"]))
    offsets, formats, at = [], [], draw(st.integers(0, 3))
    for name in names:
        base = coordinates if name in "xyz" else draw(st.sampled_from(DATATYPES))
        if name == "ring":
            base = draw(st.sampled_from(["u1", "u2", "u4", "i4", "f4"]))
        count = draw(st.integers(1, 3)) if name == "extra" else 1
        dtype = np.dtype((order + base, (count,))) if count > 1 else np.dtype(order + base)
        offsets.append(at)
        formats.append(dtype)
        at += dtype.itemsize + draw(st.integers(0, 3))
    rows, columns = draw(st.integers(1, 3)), draw(st.integers(0, 7))
    spec = {"names": list(names), "formats": formats, "offsets": offsets, "itemsize": at + draw(st.integers(0, 3))}
    return {
        "dtype": np.dtype(spec),
        "rows": rows,
        "count": rows * columns,
        "padding": draw(st.integers(0, 5)),
        "big": order == ">",
        "big_cdr": draw(st.booleans()),
        "seed": draw(st.integers(0, 2**32 - 1)),
    }


@given(layout=layouts(), encoding=st.sampled_from(["ros1", "cdr"]))
def test_any_layout_is_read_like_a_structured_array(
    both_ros: SimpleNamespace, layout: dict[str, Any], encoding: str
) -> None:
    ros = getattr(both_ros, encoding)
    random = np.random.default_rng(layout["seed"])
    points = np.zeros(layout["count"], layout["dtype"])
    for name in points.dtype.names or ():
        points[name] = random.integers(0, 100, points[name].shape)
    message = cloud_message(ros, points, rows=layout["rows"], padding=layout["padding"], big=layout["big"])
    payload = ros.serialise(message, big_endian=layout["big_cdr"])

    cloud = decode_point_cloud2(memoryview(payload), encoding, "/points")

    assert cloud.stamp_ns == T_NS
    assert cloud.frame_id == "lidar"
    assert cloud.xyz_m.dtype == np.float32
    assert cloud.xyz_m.T.flags.c_contiguous  # each coordinate side by side
    np.testing.assert_array_equal(cloud.xyz_m, np.column_stack([points[axis].astype(np.float32) for axis in "xyz"]))
    if layout["count"]:
        assert cloud.ring is not None
        np.testing.assert_array_equal(cloud.ring, points["ring"].astype(np.uint16))


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"width": 0xFFFFFFFF, "height": 0xFFFFFFFF}, "do not fit"),  # before anything is allocated
        ({"data": np.zeros(47, np.uint8)}, "need 48 bytes, data has 47"),
        ({"row_step": 0}, "row_step 0"),  # rows would overlap
        ({"fields": [("x", 0), ("y", 4), ("z", 10)]}, "field z lies outside"),
        ({"fields": [("x", 0), ("range", 4)]}, "without y, z; its fields: x, range"),
    ],
)
def test_points_that_do_not_fit_their_data_are_refused(ros: Any, changed: dict[str, Any], why: str) -> None:
    message = cloud_message(ros, np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]), rows=2)
    for name, value in changed.items():
        if name == "fields":
            value = [ros.type("sensor_msgs/msg/PointField")(*each, CODES["f4"], 1) for each in value]
        setattr(message, name, value)
    with pytest.raises(DecodeError, match=why):
        decode_point_cloud2(ros.serialise(message), ros.encoding, "/points")


@pytest.mark.parametrize(
    ("name", "dtype", "values", "expected_ns"),
    [
        ("time", "<f4", [0.0, 0.05], [0, 50_000_000]),  # Velodyne: seconds after the stamp
        ("time", "<f4", [-0.1, 0.0], [-100_000_000, 0]),
        ("t", "<u4", [0, 99_000_000], [0, 99_000_000]),  # Ouster: nanoseconds after the stamp
        ("timestamp", "<f8", [T_NS * 1e-9, T_NS * 1e-9 + 0.1], [0, 100_000_000]),  # RoboSense, Hesai: seconds of 1970
        ("timestamp", "<f8", [float(T_NS), float(T_NS) + 1e8], [0, 100_000_000]),  # Livox: nanoseconds of 1970
        ("time", "<f4", [40.0, 90.0], None),  # no unit makes it plausible
        ("t", "<u4", [1_483_724_884, 1_483_724_884], None),
        ("timestamp", "<f8", [np.nan, np.nan], None),
    ],
)
def test_point_times(ros: Any, name: str, dtype: str, values: list[float], expected_ns: list[int] | None) -> None:
    points = np.zeros(2, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, dtype)])
    points[name] = values
    offset_ns = decode_point_cloud2(ros.serialise(cloud_message(ros, points)), ros.encoding, "/points").offset_ns
    if expected_ns is None:
        assert offset_ns is None
    else:
        assert offset_ns is not None
        np.testing.assert_allclose(offset_ns, expected_ns, atol=300)  # what a 1970-based double can tell


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
@pytest.mark.parametrize(("file", "first_count"), [("vlp16.mcap", 14673), ("helios16p.mcap", 15258)])
def test_real_scans_agree_with_another_reader(both_ros: SimpleNamespace, file: str, first_count: int) -> None:
    from mcap.reader import make_reader

    path = Path(os.environ["QUADLOG_DATASETS"]) / "lidar_16beam" / file
    with path.open("rb") as stream:
        payloads = [message.data for _, _, message in make_reader(stream).iter_messages()]
    for payload in payloads:
        cloud = decode_point_cloud2(payload, "cdr", "/points")
        other = both_ros.cdr.store.deserialize_cdr(payload, "sensor_msgs/msg/PointCloud2")
        at, table = {field.name: field.offset for field in other.fields}, other.data.reshape(-1, other.point_step)
        read = {
            name: table[:, at[name] : at[name] + size] for name, size in (("x", 4), ("y", 4), ("z", 4), ("ring", 2))
        }
        for axis, name in enumerate("xyz"):
            np.testing.assert_array_equal(cloud.xyz_m[:, axis], read[name].copy().view("<f4").ravel())
        np.testing.assert_array_equal(cloud.ring, read["ring"].copy().view("<u2").ravel())
        assert cloud.ring is not None
        assert cloud.ring.max() == 15
    assert len(decode_point_cloud2(payloads[0], "cdr", "/points").xyz_m) == first_count


def custom_message(ros: Any, count: int, timebase_ns: int = T_NS, frame: str = "livox") -> Any:
    """A CustomMsg made and serialised by rosbags from the bundled definition."""
    if "livox_ros_driver/msg/CustomMsg" not in ros.store.types:
        types: dict = {}
        for name in ("CustomMsg", "CustomPoint"):
            text = (BUNDLED / "livox_ros_driver" / "msg" / f"{name}.msg").read_text()
            types.update(get_types_from_msg(text, f"livox_ros_driver/msg/{name}"))
        ros.store.register(types)
    point = ros.type("livox_ros_driver/msg/CustomPoint")
    points = [point(1000 * i, i + 0.25, -i, 2.0 * i, 7, 1, i % 4) for i in range(count)]
    return ros.type("livox_ros_driver/msg/CustomMsg")(
        ros.header(T_NS, frame), timebase_ns, count, 3, np.zeros(3, np.uint8), points
    )


@given(count=st.integers(0, 5), big_endian=st.booleans(), frame=st.text("abc", max_size=9))
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_livox_points_lines_and_offsets(both_ros: Any, encoding: str, count: int, big_endian: bool, frame: str) -> None:
    """The length of the frame's name decides where CDR aligns the timebase, from which offsets count."""
    ros = getattr(both_ros, encoding)
    payload = ros.serialise(custom_message(ros, count, T_NS + 500, frame), big_endian=big_endian)
    cloud = livox_decoder("/livox/lidar", ros.encoding)(payload)
    i = np.arange(count)
    np.testing.assert_array_equal(cloud.xyz_m, np.column_stack([i + 0.25, -i, 2 * i]).astype(np.float32))
    assert (cloud.stamp_ns, cloud.frame_id) == (T_NS, frame)
    if count:
        np.testing.assert_array_equal(cloud.ring, i % 4)
        np.testing.assert_array_equal(cloud.offset_ns, 1000 * i + 500)


def test_cut_or_longer_payloads_are_refused(ros: Any) -> None:
    payload = ros.serialise(custom_message(ros, 4))
    for damaged in (payload[:-1], payload[:40], b"", payload + bytes(19)):
        with pytest.raises(DecodeError):
            livox_decoder("/livox/lidar", ros.encoding)(damaged)
