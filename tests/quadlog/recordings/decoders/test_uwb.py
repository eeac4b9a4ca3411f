"""UWB ranges of every driver's messages, and whose ends a topic's ranges have."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.messages import UwbRanges
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.ros_messages import BUNDLED
from quadlog.recordings.decoders.uwb import ends_of_topic
from quadlog.recordings.decoding import decoder_for

FOLDER = BUNDLED / "nlink_parser" / "msg"
T_NS = 1_700_000_000_000_000_005


def store_with(names: list[str], package: str, *, header: bool, encoding: str) -> Any:
    """A rosbags store of bundled definitions under any package, optionally with the header of the ROS 2 port."""
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    types: dict = {}
    for i, name in enumerate(names):
        text = (FOLDER / f"{name}.msg").read_text()
        text = "std_msgs/Header header\n" + text if header and i == 0 else text
        types.update(get_types_from_msg(text, f"{package}/msg/{name}"))
    store.register(types)
    return store


def decode(store: Any, message: Any, encoding: str, *, schema: bool) -> tuple[UwbRanges, ...]:
    name = message.__msgtype__
    ros1 = encoding == "ros1"
    payload = store.serialize_ros1(message, name) if ros1 else store.serialize_cdr(message, name)
    text = store.generate_msgdef(name, ros_version=1 if ros1 else 2)[0].encode() if schema else b""
    channel = Channel("/uwb", name, encoding, ("ros1msg" if ros1 else "ros2msg") if schema else "", text)
    decoder = decoder_for(channel)
    assert decoder is not None
    return decoder(payload)  # type: ignore[return-value]


def header(store: Any, encoding: str) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](T_NS // 10**9, T_NS % 10**9)
    parts = (1, stamp, "uwb") if encoding == "ros1" else (stamp, "uwb")
    return store.types["std_msgs/msg/Header"](*parts)


def zeros(count: int) -> np.ndarray:
    return np.zeros(count, np.float32)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize("with_header", [False, True])
@pytest.mark.parametrize("schema", [False, True])
@pytest.mark.parametrize("package", ["nlink_parser", "nlink_parser_ros2_interfaces"])
def test_tagframe0_leaves_absent_anchors_out(encoding: str, with_header: bool, schema: bool, package: str) -> None:
    """Only zero is absent: whatever else is no distance is counted where ranges are screened."""
    store = store_with(["LinktrackTagframe0"], package, header=with_header, encoding=encoding)
    distances = np.array([1.5, 0, -2.5, np.nan, np.inf, 0, 0, 8.25], np.float32)
    body = (2, 4, 10, 20, 4.2, zeros(3), zeros(3), zeros(3), distances, zeros(3), zeros(4), zeros(3), zeros(3))
    parts = (header(store, encoding), *body) if with_header else body
    message = store.types[f"{package}/msg/LinktrackTagframe0"](*parts)
    (ranges,) = decode(store, message, encoding, schema=schema)
    assert ranges.tag == 4
    assert ranges.anchor.tolist() == [0, 2, 3, 4, 7]
    np.testing.assert_array_equal(ranges.range_m, [1.5, -2.5, np.nan, np.inf, 8.25])
    assert ranges.stamp_ns == (T_NS if with_header else None)
    assert ranges.first_path_gap_db is None


def test_anchorframe0_holds_the_ranges_of_every_tag() -> None:
    store = store_with(["LinktrackAnchorframe0", "LinktrackTag"], "nlink_parser", header=False, encoding="ros1")
    tag = store.types["nlink_parser/msg/LinktrackTag"]
    tags = [tag(2, i, zeros(3), np.array([0, i, 0, 0, 0, 0, 0, 2 * i], np.float32)) for i in (3, 5)]
    message = store.types["nlink_parser/msg/LinktrackAnchorframe0"](1, 0, 1, 2, 5.0, tags)
    decoded = decode(store, message, "ros1", schema=True)
    assert [(each.tag, each.anchor.tolist(), each.range_m.tolist()) for each in decoded] == [
        (3, [1, 7], [3.0, 6.0]),
        (5, [1, 7], [5.0, 10.0]),
    ]


@pytest.mark.parametrize(("name", "node_name"), [("Nodeframe3", "Node2"), ("Nodeframe5", "Node5")])
def test_nodeframes_of_a_tag_list_anchors_with_signal_strength(name: str, node_name: str) -> None:
    names = [f"Linktrack{name}", f"Linktrack{node_name}"]
    store = store_with(names, "nlink_parser", header=False, encoding="cdr")
    node = store.types[f"nlink_parser/msg/Linktrack{node_name}"]
    nodes = [node(1, 1, 3.5, -85.0, -77.0), node(2, 9, 1.0, -80.0, -79.0), node(1, 2, 4.5, -80.0, -79.0)]
    message = store.types[f"nlink_parser/msg/Linktrack{name}"](2, 6, 1, 2, 5.0, nodes)
    (ranges,) = decode(store, message, "cdr", schema=False)
    assert ranges.tag == 6
    assert ranges.anchor.tolist() == [1, 2]
    assert ranges.range_m.tolist() == [3.5, 4.5]
    assert ranges.first_path_gap_db is not None
    assert ranges.first_path_gap_db.tolist() == [8.0, 1.0]


def test_nodeframe_of_an_anchor_lists_tags() -> None:
    store = store_with(["LinktrackNodeframe3", "LinktrackNode2"], "nlink_parser", header=False, encoding="ros1")
    node = store.types["nlink_parser/msg/LinktrackNode2"]
    nodes = [node(2, 7, 3.5, -80.0, -79.0), node(2, 8, 0.0, -80.0, -79.0)]
    message = store.types["nlink_parser/msg/LinktrackNodeframe3"](1, 2, 1, 2, 5.0, nodes)
    decoded = decode(store, message, "ros1", schema=True)
    assert [(each.tag, each.anchor.tolist(), each.range_m.tolist()) for each in decoded] == [
        (7, [2], [3.5]),
        (8, [], []),
    ]


def test_nodeframe4_holds_each_tag_with_its_anchors() -> None:
    names = ["LinktrackNodeframe4", "LinktrackNode4Tag", "LinktrackNode4Anchor"]
    store = store_with(names, "nlink_parser", header=False, encoding="ros1")
    anchor = store.types["nlink_parser/msg/LinktrackNode4Anchor"]
    tags = [store.types["nlink_parser/msg/LinktrackNode4Tag"](3, 4.0, [anchor(0, 1.0), anchor(6, 2.0)])]
    message = store.types["nlink_parser/msg/LinktrackNodeframe4"](3, 0, 1, 2, 5.0, tags)
    (ranges,) = decode(store, message, "ros1", schema=True)
    assert (ranges.tag, ranges.anchor.tolist(), ranges.range_m.tolist()) == (3, [0, 6], [1.0, 2.0])


def test_every_bundled_definition_parses() -> None:
    for path in sorted(BUNDLED.rglob("*.msg")):
        package = Path(path).parents[1].name
        assert get_types_from_msg(path.read_text(), f"{package}/msg/{path.stem}")


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize("range_m", [3.25, -math.inf, math.nan, 0.0, -1.0, math.inf])
def test_a_range_with_zero_limits_is_kept(ros: Any, embedded: bool, range_m: float) -> None:
    """What is no distance is passed on to be counted; infinity alone says that nothing was measured."""
    message = ros.type("sensor_msgs/msg/Range")(ros.header(T_NS, ""), 0, 0.0, 0.0, 0.0, range_m)
    channel = ros.channel("/uwb/n_3", "sensor_msgs/msg/Range")
    if not embedded:
        channel = Channel(channel.topic, channel.type_name, channel.message_encoding, "", b"")
    (ranges,) = decoder_for(channel)(ros.serialise(message))  # type: ignore[misc]
    measured = range_m != math.inf
    assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist()) == (T_NS, None, [-1] * measured)
    np.testing.assert_array_equal(ranges.range_m, [range_m] * measured)


def test_ranges_with_a_variance_are_recognised_without_definition() -> None:
    store = get_typestore(Stores.LATEST)
    stamp = store.types["builtin_interfaces/msg/Time"](1, 2)
    header = store.types["std_msgs/msg/Header"](stamp, "")
    message: Any = store.types["sensor_msgs/msg/Range"](header, 0, 0.0, 0.0, 0.0, 3.25, 0.5)
    decoder = decoder_for(Channel("/r", "sensor_msgs/msg/Range", "cdr", "", b""))
    assert decoder is not None
    (ranges,) = decoder(bytes(store.serialize_cdr(message, "sensor_msgs/msg/Range")))
    assert ranges.range_m.tolist() == [3.25]  # type: ignore[union-attr]


def bundled(ros: Any, name: str) -> Any:
    if name not in ros.store.types:
        package, _, last = name.split("/")
        ros.store.register(get_types_from_msg((BUNDLED / package / "msg" / f"{last}.msg").read_text(), name))
    return ros.type(name)


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize(("millimetres", "range_m"), [(3456, 3.456), (0, 0.0), (-7, -0.007)])
def test_gtec_millimetres_become_metres(ros: Any, embedded: bool, millimetres: int, range_m: float) -> None:
    """Failures, 0 or less, are passed on to be counted."""
    message = bundled(ros, "gtec_msgs/msg/Ranging")(11, 2, millimetres, 7, -80.0, 0.01)
    channel = ros.channel("/gtec", "gtec_msgs/msg/Ranging")
    if not embedded:
        channel = Channel(channel.topic, channel.type_name, channel.message_encoding, "", b"")
    (ranges,) = decoder_for(channel)(ros.serialise(message))  # type: ignore[misc]
    assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist(), ranges.range_m.tolist()) == (None, 2, [11], [range_m])


@pytest.mark.parametrize("range_m", [7.5, 0.0, -2.0, math.nan, math.inf])
def test_uwb_driver_requester_is_the_tag(ros: Any, range_m: float) -> None:
    kind = bundled(ros, "uwb_driver/msg/UwbRange")
    point = ros.type("geometry_msgs/msg/Point")(0.0, 0.0, 0.0)
    numbers = (1, 200, 100, 0, 1, 0, 0, 5, range_m, 1.0, 1.0, 0.1, 0.1, 0.1, 0.0, 0.0, 1, 0, 0, 0, 0, 0, 0)
    message = kind(ros.header(T_NS), *numbers, point, point, point, point)
    channel = Channel("/uwb", "uwb_driver/msg/UwbRange", ros.encoding, "", b"")
    (ranges,) = decoder_for(channel)(ros.serialise(message))  # type: ignore[misc]
    assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist()) == (T_NS, 200, [100])
    np.testing.assert_array_equal(ranges.range_m, [range_m])


@pytest.mark.parametrize(
    ("topic", "ends"),
    [
        ("/uwb/tof/n_3/n_7/distance", (3, 7)),
        ("/uwb/anchor_4/range", (0, 4)),
        ("/uwb/anchor_0/tag_2", (2, 0)),
        ("/uwb/tag_0/anchor_2", (0, 2)),
        ("/uwb/Anchor0/Tag2/range", (2, 0)),
        ("/uwb/anchors/0/n_2", (2, 0)),
        ("/uwb/anchor_id_0_tag_id_2", (2, 0)),
        ("/uwb/anchor_3/n_7", (7, 3)),
        ("/uwb/n_3/tag_7", (7, 3)),
        ("/uwb_anchor/n_3/n_7", (3, 7)),
        ("/uwb/tag_2/range", None),
        ("/sonar_2", None),
        ("/range", None),
        ("/a1/b2/c3", None),
        ("/uwb/n_99999999999999999999", None),
    ],
)
def test_names(topic: str, ends: tuple[int, int] | None) -> None:
    assert ends_of_topic(topic) == ends


@pytest.mark.parametrize(
    ("topic", "mapped", "anchors", "ends"),
    [
        ("/n_7/n_5", {}, [7], (5, 7)),
        ("/n_7/n_5", {}, [5, 7], (7, 5)),
        ("/n_7/n_5", {"/n_7/n_5": (1, 2)}, [7], (1, 2)),
        ("/uwb/anchor_0/tag_2", {}, [0, 1, 2], (2, 0)),
        ("/uwb/anchor_0/tag_2", {}, [2], (2, 0)),
        ("/uwb/tag_0/anchor_2", {}, [0], (0, 2)),
        ("/uwb/anchor_0/anchor_2", {}, [0], (2, 0)),
    ],
)
def test_the_configuration_then_words_then_known_anchors_decide(
    topic: str, mapped: dict[str, tuple[int, int]], anchors: list[int], ends: tuple[int, int]
) -> None:
    assert ends_of_topic(topic, mapped, anchors) == ends
