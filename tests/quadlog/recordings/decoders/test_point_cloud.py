"""Clouds of PointCloud2 and Livox messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import DecodeError
from quadlog.lidar.point_times import find_reading, usual_step_ns
from quadlog.messages import PointCloud
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.point_cloud import DATATYPES, PointCloud2Decoder, decode_livox
from quadlog.recordings.decoding import kinds_of
from tests.lab.decoded import decoded
from tests.lab.messages import KINDS, XYZ, Ros, channel_of, serialised, zeroed

T_NS = 1_700_000_000_123_456_789


def read(ros: Any, message: Any, said: list[str] | None = None, kind: str = "") -> PointCloud:
    """By a decoder that has seen no other; what it warns of is appended to `said`."""
    payload = serialised(kind or ros.kind, message)
    channel = Channel("/points", "", ros.encoding, "", b"")
    return PointCloud2Decoder(channel, ([] if said is None else said).append)(payload)


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
def test_any_layout_is_read_like_a_structured_array(both_ros, layout, encoding):
    ros = getattr(both_ros, encoding)
    random = np.random.default_rng(layout["seed"])
    points = np.zeros(layout["count"], layout["dtype"])
    for name in points.dtype.names or ():
        points[name] = random.integers(0, 100, points[name].shape)
    rows = {"rows": layout["rows"], "padding": layout["padding"]}
    message = ros.cloud(T_NS, points, **rows, is_bigendian=layout["big"])
    cloud = read(ros, message, kind="big" if layout["big_cdr"] and encoding == "cdr" else "")

    assert cloud.stamp_ns == T_NS
    assert cloud.frame_id == "lidar"
    assert cloud.xyz_m.dtype == np.float32
    assert cloud.xyz_m.T.flags.c_contiguous  # each coordinate side by side
    np.testing.assert_array_equal(cloud.xyz_m, np.column_stack([points[axis].astype(np.float32) for axis in "xyz"]))
    if layout["count"]:
        assert cloud.ring is not None
        np.testing.assert_array_equal(cloud.ring, points["ring"].astype(np.uint16))


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("row_step", [0, 14, 3 * 14, 3 * 3 * 14 + 1])
def test_rows_lie_as_the_length_of_the_data_says(ros: Any, row_step: int, padding: int) -> None:
    points = np.zeros(9, [*XYZ.descr, ("ring", "<u2")])
    points["x"], points["ring"] = np.arange(9), np.arange(9)
    message, said = ros.cloud(T_NS, points, rows=3, padding=padding), []
    right, message.row_step = message.row_step, row_step
    if padding and row_step == 3 * 14:
        return  # sound by itself
    cloud = read(ros, message, said)
    assert (cloud.xyz_m[:, 0].tolist(), cloud.ring.tolist()) == (list(range(9)), list(range(9)))
    assert ["row_step" in each for each in said] == [True] * (row_step != right)


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("flag", [False, True])
def test_the_byte_order_is_that_of_sound_coordinates(ros: Any, order: str, flag: bool, kind: str) -> None:
    """Whatever the flag says; NaN and zeros, which have no order, and a few absurd ones do not decide."""
    points = np.zeros(400, [*((axis, order + kind) for axis in "xyz"), ("ring", order + "u2")])
    xyz = np.random.default_rng(1).uniform(-20, 20, (400, 3))
    xyz[:90], xyz[90:140], xyz[140:190] = np.nan, 0.0, 1e30
    for axis, values in zip("xyz", xyz.T, strict=True):
        points[axis] = values
    points["ring"], said = 3, []
    cloud = read(ros, ros.cloud(T_NS, points, is_bigendian=flag), said)
    if kind == "f4" or flag == (order == ">"):
        np.testing.assert_array_equal(cloud.xyz_m, xyz.astype(np.float32))
    assert cloud.ring.tolist() == [3] * 400
    assert ["is_bigendian" in each for each in said] == [True] * (flag != (order == ">"))


def test_of_two_fields_of_one_name_the_first_counts(ros: Any) -> None:
    message = ros.cloud(T_NS, np.array([(1, 2, 3, 9)], [*XYZ.descr, ("other", "<f4")]))
    message.fields[3].name = "x"
    assert read(ros, message).xyz_m.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"width": 0xFFFFFFFF, "height": 0xFFFFFFFF}, "do not fit"),  # before anything is allocated
        ({"data": np.zeros(47, np.uint8)}, "need 48 bytes, data has 47"),
        ({"row_step": 0, "data": np.zeros(49, np.uint8)}, "row_step 0"),  # rows would overlap
        ({"row_step": 0, "data": np.zeros(46, np.uint8)}, "row_step 0"),
        ({"fields": [("x", 0), ("y", 4), ("z", 10)]}, "field z lies outside"),
        ({"fields": [("x", 0), ("range", 4)]}, "without y, z; its fields: x, range"),
    ],
)
def test_points_that_do_not_fit_their_data_are_refused(ros: Any, changed: dict[str, Any], why: str) -> None:
    if "fields" in changed:
        fields = [{"name": name, "offset": offset, "datatype": 7, "count": 1} for name, offset in changed["fields"]]
        changed = {"fields": [ros.make("sensor_msgs/msg/PointField", **each) for each in fields]}
    with pytest.raises(DecodeError, match=why):
        read(ros, ros.cloud(T_NS, np.zeros(4, XYZ), rows=2, **changed))


AFTER_S = np.arange(250) * 0.0004
"""Of the points of a scan after its first one; a scan comes every 0.1 s."""
Given = Callable[[np.ndarray, int], np.ndarray]


def after(scale: float, begin: float = 0.0) -> Given:
    return lambda after_s, stamp_ns: begin + after_s * scale


def since(epoch_ns: int, scale: float) -> Given:
    return lambda after_s, stamp_ns: (stamp_ns - epoch_ns) * 1e-9 * scale + after_s * scale


def once(stray: float) -> Given:
    return lambda after_s, stamp_ns: np.where(np.arange(len(after_s)) == 7, stray, after_s)


NO_BITS: Given = lambda after_s, stamp_ns: np.full(len(after_s), stamp_ns * 1e-9)  # noqa: E731
FLAGS: Given = lambda after_s, stamp_ns: np.arange(len(after_s)) % 2  # noqa: E731


def counter(begin_ns: int) -> Given:
    """Nanoseconds in 32 bits, of which the last of five scans has begin_ns in its middle."""
    return lambda after_s, stamp_ns: (begin_ns + np.rint(after_s * 1e9) + stamp_ns % 10**9 - 573_456_789) % 2**32


GOOD = ("t", "<u4", after(1e9))


class Timed(NamedTuple):
    """Fields of points, when the first one was measured after the stamp, None: unknown, and the only warning."""

    fields: tuple[tuple[str, str, Given], ...]
    first_s: float | None = 0.0
    warning: str = ""
    scans: int = 5
    apart_ns: int = 300
    """What a 1970-based double can tell."""


OWN_START = "counts neither from the stamp nor from 1970"
TIMES = {
    "seconds": Timed((("time", "<f4", after(1)),)),
    "milliseconds": Timed((("time", "<f4", after(1e3)),)),
    "milliseconds in 16 bits": Timed((("time", "<u2", after(1e3)),), apart_ns=500_000),
    "microseconds": Timed((("timestamp", "<u4", after(1e6)),)),
    "nanoseconds": Timed((("t", "<u4", after(1e9)),)),
    "nanoseconds, by its name": Timed((("time_offset_ns", "<f8", after(1e9)),)),
    "shares of a scan": Timed((("time", "<f4", after(10)),)),
    "stamped at the end": Timed((("time", "<f4", after(1, -0.1)),), -0.1),
    "stamped at the end, microseconds": Timed((("time", "<i4", after(1e6, -1e5)),), -0.1),
    "a part of a turn": Timed((("time", "<f4", after(1e6 / 5, 6e4)),), 0.06),
    "seconds of 1970": Timed((("timestamp", "<f8", since(0, 1)),)),
    "milliseconds of 1970": Timed((("timestamp", "<f8", since(0, 1e3)),)),
    "nanoseconds of 1970": Timed((("timestamp", "<f8", since(0, 1e9)),)),
    "since its start": Timed((("time", "<f8", since(T_NS - 10**12, 1e3)),), 0.0, OWN_START),
    "since its start, in an overflowing counter": Timed((("time", "<u4", counter(0)),), 0.0, OWN_START),
    "since its start, past half of a counter": Timed((("time", "<u4", counter(2**31)),), 0.0, OWN_START),
    "a single scan": Timed((("time", "<f4", after(1e6)),), scans=1),
    "one stray": Timed((("time", "<f4", once(1e30)),), apart_ns=1_100_000),
    "one missing": Timed((("time", "<f4", once(np.nan)),)),
    "behind a constant": Timed((("timestamp", "<f8", after(0, 7)), GOOD)),
    "behind one that is too coarse": Timed((("timestamp", "<f4", NO_BITS), GOOD)),
    "behind one without a unit": Timed((("timestamp", "<f8", after(3e7)), GOOD)),
    "behind one that fits less well": Timed((("timestamp", "<f8", after(1e8)), GOOD)),
    "behind one of another clock": Timed((("time", "<f8", since(T_NS - 10**12, 1)), GOOD)),
    "of many names, the first of two": Timed((("time", "<f4", after(1)), ("t", "<u4", after(1e9)))),
    "without a unit": Timed((("time", "<f4", after(30)),), None, "scans are not deskewed: time of points spans"),
    "too long in its unit": Timed(
        (("t", "<u4", after(5e9)),), None, "t of points spans 4.88e+08, in no unit the 0.1 s"
    ),
    "a flag": Timed((("time_is_valid", "<u1", FLAGS),), None, "in no unit"),
    "too coarse": Timed((("timestamp", "<f4", NO_BITS),), None, "is a float32, too coarse"),
    "never set": Timed((("time", "<f4", after(0)),), None),
    "no numbers": Timed((("time", "<f8", after(np.nan)),), None),
}


@pytest.mark.parametrize("case", TIMES.values(), ids=TIMES)
def test_point_times(ros: Any, case: Timed) -> None:
    clouds = []
    for stamp_ns in range(T_NS, T_NS + case.scans * 10**8, 10**8):
        points = np.ones(len(AFTER_S), [*XYZ.descr, *(each[:2] for each in case.fields)])
        for name, _, given_as in case.fields:
            values = given_as(AFTER_S, stamp_ns)
            points[name] = values if points[name].dtype.kind == "f" else np.rint(values)
        clouds.append(read(ros, ros.cloud(stamp_ns, points)))
    reading = find_reading(clouds, np.array([each.stamp_ns for each in clouds]))
    times = reading.timed(clouds[-1]).times
    warnings = reading.warnings(case.scans)
    assert [case.warning in each for each in warnings] == ([True] if case.warning else [])
    if case.first_s is None:
        assert times is None
        return
    assert times is not None
    lasts_s = AFTER_S / 5 if case.first_s > 0 else AFTER_S
    apart_ns = np.abs(times.offset_ns - (case.first_s + lasts_s) * 1e9)
    # A stray point gets any time of the scan.
    assert (np.delete(apart_ns, 7) <= case.apart_ns).all()
    assert (np.abs(times.offset_ns - case.first_s * 1e9) <= 101_000_000).all()
    ends_ns = [times.offset_ns.min(), times.offset_ns.max()]
    np.testing.assert_allclose([times.first_ns, times.last_ns], ends_ns, atol=case.apart_ns)


@pytest.mark.parametrize(
    ("steps_ms", "usual_ms"),
    [
        ([100, 100, 100], 100), ([], 100), ([100, 200, 100, 100, 300, 100], 100), ([100] * 9 + [60_000] * 2, 100),
        ([1, 99, 1, 99, 1], 99), ([0, 50, 0, 50], 50),
    ],
)  # fmt: skip
def test_the_usual_time_between_scans(steps_ms: list[int], usual_ms: int) -> None:
    """With scans that are missing, a pause, or those of two lidars in turns."""
    assert usual_step_ns(np.cumsum([T_NS, *(each * 10**6 for each in steps_ms)])) == usual_ms * 10**6


LIVOX = "livox_ros_driver2"


def custom_message(kind: str, count: int, timebase_ns: int = T_NS, frame: str = "livox") -> Any:
    points = [
        zeroed(kind, f"{LIVOX}/msg/CustomPoint", offset_time=1000 * i, x=i + 0.25, y=-i, z=2.0 * i, line=i % 4)
        for i in range(count)
    ]
    header = {"header__frame_id": frame, "header__stamp": Ros(kind).stamp(T_NS)}
    return zeroed(kind, f"{LIVOX}/msg/CustomMsg", **header, timebase=timebase_ns, point_num=count, points=points)


@pytest.mark.parametrize("kind", ["ros1", "little"])
@pytest.mark.parametrize(
    ("package", "as_bundled", "schema", "is_read"),
    [
        (LIVOX, True, True, True), ("livox_interfaces", True, False, True), ("any_lidar", True, True, True),
        ("any_lidar", True, False, False), ("any_other", False, True, False),
    ],
)  # fmt: skip
def test_livox_messages_of_any_package(kind: str, package: str, as_bundled: bool, schema: bool, is_read: bool) -> None:
    """Where the recording's definition is the same; Livox's own packages need none."""
    channel = channel_of(kind, f"{LIVOX}/msg/CustomMsg", embedded=schema)
    text = channel.schema.replace(LIVOX.encode(), package.encode())
    text = text if as_bundled else text.replace(b"uint8 lidar_id", b"uint8 device")
    channel = replace(channel, type_name=f"{package}/msg/CustomMsg", schema=text)
    assert kinds_of(channel) == (PointCloud,) * is_read
    if is_read:
        (cloud,) = decoded(channel, serialised(kind, custom_message(kind, 4)))
        assert len(cloud.xyz_m) == 4


@given(count=st.integers(0, 5), frame=st.text("abc", max_size=9))
@pytest.mark.parametrize("kind", KINDS)
def test_livox_points_lines_and_offsets(kind: str, count: int, frame: str) -> None:
    """The length of the frame's name decides where CDR aligns the timebase, from which offsets count."""
    channel, said, far_ns = channel_of(kind, f"{LIVOX}/msg/CustomMsg"), list[str](), T_NS + 2 * 10**9
    decode_livox(channel, said.append, serialised(kind, custom_message(kind, count, far_ns, frame)))
    cloud = decode_livox(channel, said.append, serialised(kind, custom_message(kind, count, T_NS + 500, frame)))
    says = f"{channel.topic}: timebase is more than a second off header.stamp; times of points count from the stamp"
    assert said == [says]
    i = np.arange(count)
    np.testing.assert_array_equal(cloud.xyz_m, np.column_stack([i + 0.25, -i, 2 * i]).astype(np.float32))
    assert (cloud.stamp_ns, cloud.frame_id) == (T_NS, frame)
    if count:
        np.testing.assert_array_equal(cloud.ring, i % 4)
        np.testing.assert_array_equal(cloud.time_fields["offset_time"], 1000 * i + 500)


@pytest.mark.parametrize("kind", ["ros1", "little"])
def test_cut_or_longer_payloads_are_refused(kind: str) -> None:
    payload = serialised(kind, custom_message(kind, 4))
    for damaged in (payload[:-1], payload[:40], b"", payload + bytes(19)):
        with pytest.raises(DecodeError):
            decoded(channel_of(kind, f"{LIVOX}/msg/CustomMsg"), damaged)
