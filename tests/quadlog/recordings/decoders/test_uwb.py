"""UWB ranges of every driver's messages, and whose ends a topic's ranges have."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.range_ends import ends_of_topic
from quadlog.recordings.decoders.ranges import own_ranges
from quadlog.recordings.decoders.ros_messages import BUNDLED
from tests.lab.decoded import decoded

T_NS = 1_700_000_000_000_000_005


class Linktrack:
    """Bundled definitions under any package, with the header of the ROS 2 port where asked."""

    def __init__(self, encoding, frame, *parts, package="nlink_parser", with_header=False):
        self.encoding, self.package, self.frame = encoding, package, f"{package}/msg/Linktrack{frame}"
        self.store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
        types = {}
        for i, name in enumerate((frame, *parts)):
            text = (BUNDLED / "nlink_parser" / "msg" / f"Linktrack{name}.msg").read_text()
            text = "std_msgs/Header header\n" + text if with_header and i == 0 else text
            types.update(get_types_from_msg(text, f"{package}/msg/Linktrack{name}"))
        self.store.register(types)

    def part(self, name, *values):
        return self.store.types[f"{self.package}/msg/Linktrack{name}"](*values)

    def header(self):
        stamp = self.store.types["builtin_interfaces/msg/Time"](T_NS // 10**9, T_NS % 10**9)
        parts = (1, stamp, "uwb") if self.encoding == "ros1" else (stamp, "uwb")
        return self.store.types["std_msgs/msg/Header"](*parts)

    def decoded(self, *values, schema=True):
        message, ros1 = self.store.types[self.frame](*values), self.encoding == "ros1"
        serialize = self.store.serialize_ros1 if ros1 else self.store.serialize_cdr
        text = self.store.generate_msgdef(self.frame, ros_version=1 if ros1 else 2)[0].encode() if schema else b""
        kind = ("ros1msg" if ros1 else "ros2msg") if schema else ""
        return decoded(Channel("/uwb", self.frame, self.encoding, kind, text), bytes(serialize(message, self.frame)))


def zeros(count):
    return np.zeros(count, np.float32)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize("with_header", [False, True])
@pytest.mark.parametrize("schema", [False, True])
@pytest.mark.parametrize("package", ["nlink_parser", "nlink_parser_ros2_interfaces"])
def test_tagframe0_leaves_absent_anchors_out(encoding, with_header, schema, package):
    """Only zero is absent: whatever else is no distance is counted where ranges are screened."""
    linktrack = Linktrack(encoding, "Tagframe0", package=package, with_header=with_header)
    distances = np.array([1.5, 0, -2.5, np.nan, np.inf, 0, 0, 8.25], np.float32)
    body = (2, 4, 10, 20, 4.2, zeros(3), zeros(3), zeros(3), distances, zeros(3), zeros(4), zeros(3), zeros(3))
    (ranges,) = linktrack.decoded(*([linktrack.header()] if with_header else []), *body, schema=schema)
    assert (ranges.tag, ranges.anchor.tolist()) == (4, [0, 2, 3, 4, 7])
    np.testing.assert_array_equal(ranges.range_m, [1.5, -2.5, np.nan, np.inf, 8.25])
    assert ranges.stamp_ns == (T_NS if with_header else None)
    assert ranges.first_path_gap_db is None


def as_rows(messages):
    return [(each.tag, each.anchor.tolist(), each.range_m.tolist()) for each in messages]


def test_anchors_hold_the_ranges_of_every_tag():
    frame = Linktrack("ros1", "Anchorframe0", "Tag")
    tags = [frame.part("Tag", 2, i, zeros(3), np.array([0, i, 0, 0, 0, 0, 0, 2 * i], np.float32)) for i in (3, 5)]
    assert as_rows(frame.decoded(1, 0, 1, 2, 5.0, tags)) == [(3, [1, 7], [3.0, 6.0]), (5, [1, 7], [5.0, 10.0])]
    frame = Linktrack("ros1", "Nodeframe3", "Node2")
    nodes = [frame.part("Node2", 2, 7, 3.5, -80.0, -79.0), frame.part("Node2", 2, 8, 0.0, -80.0, -79.0)]
    assert as_rows(frame.decoded(1, 2, 1, 2, 5.0, nodes)) == [(7, [2], [3.5])]
    frame = Linktrack("ros1", "Nodeframe4", "Node4Tag", "Node4Anchor")
    anchors = [frame.part("Node4Anchor", 0, 1.0), frame.part("Node4Anchor", 6, 2.0)]
    assert as_rows(frame.decoded(3, 0, 1, 2, 5.0, [frame.part("Node4Tag", 3, 4.0, anchors)])) == [(3, [0, 6], [1, 2])]


@pytest.mark.parametrize(("name", "node"), [("Nodeframe3", "Node2"), ("Nodeframe5", "Node5")])
def test_nodeframes_of_a_tag_list_anchors_with_signal_strength(name, node):
    frame = Linktrack("cdr", name, node)
    rows = [(1, 1, 3.5, -85.0, -77.0), (2, 9, 1.0, -80.0, -79.0), (1, 2, 4.5, -80.0, -79.0)]
    found = frame.decoded(2, 6, 1, 2, 5.0, [frame.part(node, *row) for row in rows], schema=False)
    assert as_rows(found) == [(6, [1, 2], [3.5, 4.5])]
    assert found[0].first_path_gap_db.tolist() == [8.0, 1.0]


def bundled(ros, name):
    if name not in ros.store.types:
        package, _, last = name.split("/")
        ros.store.register(get_types_from_msg((BUNDLED / package / "msg" / f"{last}.msg").read_text(), name))
    return ros.type(name)


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize("range_m", [3.25, -math.inf, math.nan, 0.0, -1.0, math.inf])
@pytest.mark.parametrize("kind", ["sensor_msgs/msg/Range", "gtec_msgs/msg/Ranging", "uwb_driver/msg/UwbRange"])
def test_single_ranges(ros, kind, embedded, range_m):
    """What is no distance is passed on to be counted; infinity in a Range says that nothing was measured."""
    ends, stamp_ns = (None, [-1]), T_NS
    if kind.endswith("Ranging"):  # millimetres
        range_m = round(1000 * np.nan_to_num(range_m, posinf=0, neginf=-7)) / 1000
        message = bundled(ros, kind)(11, 2, round(1000 * range_m), 7, -80.0, 0.01)
        ends, stamp_ns = (2, [11]), None
    elif kind.endswith("UwbRange"):  # the requester is the tag
        numbers = (1, 200, 100, 0, 1, 0, 0, 5, range_m, 1.0, 1.0, 0.1, 0.1, 0.1, 0.0, 0.0, 1, 0, 0, 0, 0, 0, 0)
        point = ros.type("geometry_msgs/msg/Point")(0.0, 0.0, 0.0)
        message = bundled(ros, kind)(ros.header(T_NS), *numbers, *[point] * 4)
        ends = (200, [100])
    else:
        message = ros.range(T_NS, range_m)
    channel = ros.channel("/uwb/n_3", kind)
    if not embedded:
        channel = Channel(channel.topic, kind, ros.encoding, "", b"")
    (ranges,) = decoded(channel, ros.serialise(message))
    measured = not math.isinf(range_m) or not kind.endswith("/Range")
    assert bool(ranges.unmeasured) != measured
    assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist()) == (stamp_ns, ends[0], ends[1] * measured)
    np.testing.assert_array_equal(ranges.range_m, [range_m] * measured)


@pytest.mark.parametrize(
    ("range_m", "limits_m", "measured"),
    [
        *((60.0, (0.1, 50.0), False), (0.4, (0.5, 100.0), False), (50.0, (0.1, 50.0), True), (0.1, (0.1, 50.0), True)),
        *((60.0, (0.0, 0.0), True), (60.0, (-1.0, -1.0), True), (60.0, (50.0, 0.1), True), (60.0, (-1.0, 50.0), True)),
        *((math.nan, (0.1, 50.0), True), (60.0, (0.1, math.nan), True), (60.0, (0.0, math.inf), True)),
    ],
)
def test_limits_of_a_range_count_where_it_has_some(ros, range_m, limits_m, measured):
    kind = "sensor_msgs/msg/Range"
    message = ros.type(kind)(ros.header(T_NS), 0, 0.0, *limits_m, range_m)
    (ranges,) = decoded(ros.channel("/uwb/n_3", kind), ros.serialise(message))
    assert (len(ranges.range_m), len(ranges.anchor), "min_range" in ranges.unmeasured) == (
        measured,
        measured,
        not measured,
    )


@pytest.mark.parametrize("status", [0, 1, 2, 3, 4, 5, 6, 7, 9, 11, 32, 34, 64, 98])
def test_a_ranging_that_failed_measured_nothing(ros, status):
    """0: success; 1: no answer; 3: not tried; even ones with 2, 4 or 32: no leading edge, too long; others: remarks."""
    kind = "uwb_driver/msg/UwbRange"
    point = ros.type("geometry_msgs/msg/Point")(1.0, 2.0, 3.0)
    numbers = (1, 200, 100, 0, 1, status, 0, 5, 3.5, 1.0, 1.0, 0.1, 0.1, 0.1, 0.0, 0.0, 1, 0, 0, 0, 0, 0, 0)
    message = bundled(ros, kind)(ros.header(T_NS), *numbers, *[point] * 4)
    (ranges,) = decoded(ros.channel("/uwb", kind), ros.serialise(message))
    failed = status in (1, 3) or (status % 2 == 0 and any(status & bit for bit in (2, 4, 32)))
    assert (len(ranges.range_m) == 0, "range_status" in ranges.unmeasured) == (failed, failed)
    assert (ranges.anchor_position_m is None) == failed


@pytest.mark.parametrize(
    ("error", "measured"), [(0.004, True), (0.0, True), (-1.0, False), (math.nan, False), (math.inf, False)]
)
def test_a_range_without_a_standard_deviation_was_not_measured(ros, error, measured):
    message = bundled(ros, "gtec_msgs/msg/Ranging")(11, 2, 3000, 7, -80.0, error)
    (ranges,) = decoded(ros.channel("/uwb", message.__msgtype__), ros.serialise(message))
    assert (ranges.range_m.tolist(), "errorEstimation" in ranges.unmeasured) == ([3.0] * measured, not measured)


OWN = {  # fields of a message -> the text of its definition, and its values
    "one": ("std_msgs/Header header\nuint16 peer\nint32 distance_mm\n", lambda ros: (ros.header(T_NS), 7, 2500)),
    "nodes": (
        "string note\nuint8 id\nNode[] nodes\n",
        lambda ros: ("", 4, [ros.type("own/msg/Node")(*each) for each in ((7, 2.5), (9, 3.5))]),
    ),
    "lists": (
        "uint8 id\nuint8[] ids\nfloat32[2] range\nbuiltin_interfaces/Time stamp\n",
        lambda ros: (4, np.array([7, 9], np.uint8), np.array([2.5, 3.5], np.float32), ros.stamp(T_NS)),
    ),
    "short": (
        "uint8 id\nuint8[1] ids\nfloat32[2] range\n",
        lambda ros: (4, np.array([7], np.uint8), np.array([2.5, 3.5], np.float32)),
    ),
}


@pytest.mark.parametrize(
    ("name", "keys", "expected"),
    [
        ("one", {"field": "distance_mm", "unit": "mm", "tag": 3, "anchor": "peer"}, (T_NS, 3, [7], [2.5])),
        ("one", {"field": "distance_mm", "unit": "cm", "tag": "peer", "anchor": 9}, (T_NS, 7, [9], [25.0])),
        ("one", {"field": "distance_mm"}, (T_NS, None, [-1], [2500.0])),
        ("nodes", {"field": "nodes[].dis", "tag": "id", "anchor": "nodes[].id"}, (None, 4, [7, 9], [2.5, 3.5])),
        ("nodes", {"field": "nodes[].dis", "tag": 1}, (None, 1, [0, 1], [2.5, 3.5])),
        ("lists", {"field": "range[]", "tag": "id", "anchor": "ids[]"}, (T_NS, 4, [7, 9], [2.5, 3.5])),
        ("lists", {"field": "range", "tag": "id"}, r"has no number range \(id, ids\[\], range\[\], stamp\)"),
        ("lists", {"field": "stamp", "tag": "id"}, "has no number stamp "),
        ("nodes", {"field": "note"}, "has no number note "),
        ("nodes", {"field": "nodes[].far"}, r"has no number nodes\[\]\.far \(nodes\[\]\."),
        ("short", {"field": "range[]", "anchor": "ids[]"}, "anchor and range differ in length"),
    ],
)
def test_ranges_of_any_message_by_their_fields(ros, name, keys, expected):
    text, values = OWN[name]
    if f"own/msg/{name.title()}" not in ros.store.fielddefs:
        ros.store.register(get_types_from_msg("uint8 id\nfloat32 dis\n", "own/msg/Node"))
        ros.store.register(get_types_from_msg(text, f"own/msg/{name.title()}"))
    message = ros.type(f"own/msg/{name.title()}")(*values(ros))
    given = ros.channel("/own", message.__msgtype__), ros.serialise(message)
    mapped = {"/own": own_ranges(**keys)}
    if isinstance(expected, str):
        with pytest.raises(DecodeError, match=expected):
            decoded(*given, mapped=mapped)
    else:
        (ranges,) = decoded(*given, mapped=mapped)
        assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist(), ranges.range_m.tolist()) == expected


@pytest.mark.parametrize("bits", [32, 40])
@pytest.mark.parametrize("six", [True, False])
def test_ranges_from_the_times_of_two_way_ranging(ros, bits, six):
    """Six times on two counters that run at different rates and begin again, or their four intervals."""
    tick_s, away_m, a_begins, b_begins = 1.565e-11, 12.345, 2**bits - 10**7, 2**bits - 3 * 10**7
    flight_s, fast_a, fast_b = away_m / 299_792_458.0, 1 + 2e-5, 1 - 1e-5
    at_s = np.cumsum([0, flight_s, 3e-4, flight_s, 5e-4, flight_s])  # poll, response, final: sent and received
    counted = [
        (begin + round(t_s * fast / tick_s)) % 2**bits
        for t_s, begin, fast in zip(
            at_s,
            [a_begins, b_begins, b_begins, a_begins, a_begins, b_begins],
            [fast_a, fast_b, fast_b, fast_a, fast_a, fast_b],
            strict=True,
        )
    ]
    names = ["poll_tx", "poll_rx", "resp_tx", "resp_rx", "final_tx", "final_rx"]
    values, kind = counted, f"uint{32 if bits == 32 else 64}"
    if not six:
        names, kind = ["round_a", "reply_a", "round_b", "reply_b"], "float64"
        values = [
            (at_s[b] - at_s[a]) * fast / tick_s
            for a, b, fast in ((0, 3, fast_a), (3, 4, fast_a), (2, 5, fast_b), (1, 2, fast_b))
        ]
    name = f"own/msg/Times{bits}{six}"
    if name not in ros.store.fielddefs:
        ros.store.register(get_types_from_msg("".join(f"{kind} {each}\n" for each in names), name))
    mapped = {"/own": own_ranges(times=names, tick_s=tick_s, tag=1, anchor=2)}
    (ranges,) = decoded(ros.channel("/own", name), ros.serialise(ros.type(name)(*values)), mapped=mapped)
    np.testing.assert_allclose(ranges.range_m, away_m, atol=0.01)


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
        *((each, None) for each in ("/uwb/tag_2/range", "/sonar_2", "/range", "/a1/b2/c3", "/uwb/n_" + "9" * 20)),
    ],
)
def test_names(topic, ends):
    assert ends_of_topic(topic) == ends


@pytest.mark.parametrize(
    ("topic", "mapped", "anchors", "ends"),
    [
        ("/n_7/n_5", {}, [7], (5, 7)),
        ("/n_7/n_5", {}, [5, 7], (7, 5)),
        ("/n_7/n_5", {"/n_7/n_5": (1, 2)}, [7], (1, 2)),
        ("/uwb/anchor_0/tag_2", {}, [2], (2, 0)),
        ("/uwb/anchor_0/anchor_2", {}, [0], (2, 0)),
    ],
)
def test_the_configuration_then_words_then_known_anchors_decide(topic, mapped, anchors, ends):
    assert ends_of_topic(topic, mapped, anchors) == ends
