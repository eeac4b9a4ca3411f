"""UWB ranges of every driver's messages, and whose ends a topic's ranges have."""

from __future__ import annotations

import math

import numpy as np
import pytest

from quadlog.config.schema import Config
from quadlog.errors import DecodeError
from quadlog.recordings.decoders.ranges import own_ranges
from quadlog.recordings.recording import Recording
from tests.lab.decoded import decoded
from tests.lab.messages import channel_of, serialised, zeroed

T_NS = 1_700_000_000_000_000_005


def linktrack(kind, name, *, package="nlink_parser", embedded=True, **values):
    message = zeroed(kind, f"{package}/msg/Linktrack{name}", **values)
    return decoded(channel_of(kind, message.__msgtype__, embedded=embedded), serialised(kind, message))


@pytest.mark.parametrize("kind", ["ros1", "little"])
@pytest.mark.parametrize("embedded", [False, True])
@pytest.mark.parametrize("package", ["nlink_parser", "link_parser", "ros2_port"])
def test_tagframe0_leaves_absent_anchors_out(kind, package, embedded):
    """Only zero is absent: whatever else is no distance is counted where ranges are screened."""
    values = {"id": 4, "dis_arr": [1.5, 0, -2.5, np.nan, np.inf, 0, 0, 8.25]}
    if package == "ros2_port":
        values |= {"header__stamp__sec": 5, "header__stamp__nanosec": 7}
    (ranges,) = linktrack(kind, "Tagframe0", package=package, embedded=embedded, **values)
    assert (ranges.tag, ranges.anchor.tolist()) == (4, [0, 2, 3, 4, 7])
    np.testing.assert_array_equal(ranges.range_m, [1.5, -2.5, np.nan, np.inf, 8.25])
    assert ranges.stamp_ns == (5_000_000_007 if package == "ros2_port" else None)
    assert ranges.first_path_gap_db is None


NODES = [
    {"role": 1, "id": 1, "dis": 3.5, "fp_rssi": -85.0, "rx_rssi": -77.0},
    {"role": 2, "id": 9, "dis": 1.0},
    {"role": 1, "id": 2, "dis": 4.5, "fp_rssi": -80.0, "rx_rssi": -79.0},
    {"role": 1, "id": 3},
]


def made(part, fields):
    return zeroed("little", f"nlink_parser/msg/Linktrack{part}", **fields)


def anchors_of(tag):
    return [made("Node4Anchor", {"id": 10 * tag + j, "dis": float(tag + j)}) for j in range(tag)]


@pytest.mark.parametrize(
    ("frame", "part", "fields", "rows"),
    [
        (
            "Anchorframe0",
            "Tag",
            [{"id": i, "dis_arr": [0, i, 0, 0, 0, 0, 0, 2 * i]} for i in (3, 5)],
            [(3, [1, 7], [3.0, 6.0]), (5, [1, 7], [5.0, 10.0])],
        ),
        ("Nodeframe3", "Node2", NODES, [(6, [1, 2], [3.5, 4.5])]),
        ("Nodeframe5", "Node5", NODES, [(6, [1, 2], [3.5, 4.5])]),
        ("Nodeframe3", "Node2", [{"role": 2, "id": 7, "dis": 3.5}, {"role": 2, "id": 8}], [(7, [6], [3.5])]),
        (
            "Nodeframe4",
            "Node4Tag",
            [{"id": tag, "anchors": anchors_of(tag)} for tag in (3, 0, 2)],
            [(3, [30, 31, 32], [3.0, 4.0, 5.0]), (2, [20, 21], [2.0, 3.0])],
        ),
    ],
)
def test_frames_list_ranges_of_tags_and_anchors(frame, part, fields, rows):
    """A tag's frame lists its anchors with their signal strengths, an anchor's the tags that it hears."""
    of_tag, nodes = fields is NODES, [made(part, each) for each in fields]
    ends = {"role": 2 if of_tag else 1, "id": 6} if part in ("Node2", "Node5") else {}
    found = linktrack("little", frame, **{"tags" if part == "Node4Tag" else "nodes": nodes}, embedded=False, **ends)
    assert [(each.tag, each.anchor.tolist(), each.range_m.tolist()) for each in found] == rows
    if of_tag:
        assert found[0].first_path_gap_db.tolist() == [8.0, 1.0]


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize("range_m", [3.25, -math.inf, math.nan, 0.0, -1.0, math.inf])
@pytest.mark.parametrize("kind", ["ros1", "little"])
@pytest.mark.parametrize(
    ("name", "ends", "fields"),
    [
        ("sensor_msgs/msg/Range", (None, [-1]), {}),
        ("gtec_msgs/msg/Ranging", (2, [11]), {"anchorId": 11, "tagId": 2}),  # millimetres
        ("uwb_driver/msg/UwbRange", (200, [100]), {"requester_id": 200, "responder_id": 100}),
    ],
)
def test_single_ranges(name, ends, fields, kind, range_m, embedded):
    """What is no distance is passed on to be counted; infinity in a Range says that nothing was measured."""
    values = {"range": range_m}
    if name.endswith("Ranging"):
        range_m = round(1000 * np.nan_to_num(range_m, posinf=0, neginf=-7)) / 1000
        values = {"range": round(1000 * range_m)}
    elif name.endswith("UwbRange"):
        values = {"distance": range_m}
    message = zeroed(kind, name, **fields, **values)
    if timed := hasattr(message, "header"):
        message.header.stamp.sec, message.header.stamp.nanosec = 5, 7
    (ranges,) = decoded(channel_of(kind, name, embedded=embedded), serialised(kind, message))
    measured = not math.isinf(range_m) or not name.endswith("/Range")
    assert bool(ranges.unmeasured) != measured
    stamp_ns = 5_000_000_007 if timed else None
    assert (ranges.stamp_ns, ranges.tag, ranges.anchor.tolist()) == (stamp_ns, ends[0], ends[1] * measured)
    np.testing.assert_array_equal(ranges.range_m, [range_m] * measured)


LIMITS = [
    *((60.0, (0.1, 50.0), False), (0.4, (0.5, 100.0), False), (50.0, (0.1, 50.0), True), (0.1, (0.1, 50.0), True)),
    *((60.0, (0.0, 0.0), True), (60.0, (-1.0, -1.0), True), (60.0, (50.0, 0.1), True), (60.0, (-1.0, 50.0), True)),
    *((math.nan, (0.1, 50.0), True), (60.0, (0.1, math.nan), True), (60.0, (0.0, math.inf), True)),
]
# 1: no answer; 3: not tried; even ones with 2, 4 or 32: no leading edge, too long; others: remarks.
STATUSES = dict.fromkeys((0, 5, 7, 8, 9, 11, 64), True) | dict.fromkeys((1, 2, 3, 4, 6, 32, 34, 98), False)
DEVIATIONS = {0.004: True, 0.0: True, -1.0: False, math.nan: False, math.inf: False}


@pytest.mark.parametrize(
    ("name", "why", "fields", "measured"),
    [
        *(
            (
                "sensor_msgs/msg/Range",
                "min_range",
                {"range": range_m, "min_range": low_m, "max_range": high_m},
                measured,
            )
            for range_m, (low_m, high_m), measured in LIMITS
        ),
        *(("uwb_driver/msg/UwbRange", "range_status", {"range_status": i}, each) for i, each in STATUSES.items()),
        *(("gtec_msgs/msg/Ranging", "errorEstimation", {"errorEstimation": e}, each) for e, each in DEVIATIONS.items()),
    ],
)
def test_what_a_message_says_was_not_measured_is_no_range(name, why, fields, measured):
    """Outside of its limits where it has some, by its status, or without a standard deviation."""
    message = zeroed("little", name, **fields)
    (ranges,) = decoded(channel_of("little", name), serialised("little", message))
    found = len(ranges.range_m), len(ranges.anchor), why in ranges.unmeasured
    assert found == (measured, measured, not measured)
    assert (ranges.anchor_position_m is not None) == (measured and name.startswith("uwb_driver"))


NODE = "uint8 id\nfloat32 dis\n"
OWN = {
    "One": "std_msgs/Header header\nuint16 peer\nint32 distance_mm\n",
    "Nodes": "string note\nuint8 id\nNode[] nodes\n",
    "Lists": "uint8 id\nuint8[] ids\nfloat32[2] range\nbuiltin_interfaces/Time stamp\n",
    "Short": "uint8 id\nuint8[1] ids\nfloat32[2] range\n",
}


def own_values(ros, name):
    return {
        "One": lambda: {"header": ros.header(T_NS), "peer": 7, "distance_mm": 2500},
        "Nodes": lambda: {
            "id": 4,
            "nodes": [ros.make("own/msg/Node", id=i, dis=dis) for i, dis in ((7, 2.5), (9, 3.5))],
        },
        "Lists": lambda: {"id": 4, "ids": np.uint8([7, 9]), "range": [2.5, 3.5], "stamp": ros.stamp(T_NS)},
        "Short": lambda: {"id": 4, "ids": [7], "range": [2.5, 3.5]},
    }[name]()


@pytest.mark.parametrize(
    ("name", "keys", "expected"),
    [
        ("One", {"field": "distance_mm", "unit": "mm", "tag": 3, "anchor": "peer"}, (T_NS, 3, [7], [2.5])),
        ("One", {"field": "distance_mm", "unit": "cm", "tag": "peer", "anchor": 9}, (T_NS, 7, [9], [25.0])),
        ("One", {"field": "distance_mm"}, (T_NS, None, [-1], [2500.0])),
        ("Nodes", {"field": "nodes[].dis", "tag": "id", "anchor": "nodes[].id"}, (None, 4, [7, 9], [2.5, 3.5])),
        ("Nodes", {"field": "nodes[].dis", "tag": 1}, (None, 1, [0, 1], [2.5, 3.5])),
        ("Lists", {"field": "range[]", "tag": "id", "anchor": "ids[]"}, (T_NS, 4, [7, 9], [2.5, 3.5])),
        ("Lists", {"field": "range", "tag": "id"}, r"has no number range \(id, ids\[\], range\[\], stamp\)"),
        ("Lists", {"field": "stamp", "tag": "id"}, "has no number stamp "),
        ("Nodes", {"field": "note"}, "has no number note "),
        ("Nodes", {"field": "nodes[].far"}, r"has no number nodes\[\]\.far \(nodes\[\]\."),
        ("Short", {"field": "range[]", "anchor": "ids[]"}, "anchor and range differ in length"),
    ],
)
def test_ranges_of_any_message_by_their_fields(ros, name, keys, expected):
    ros.register(Node=NODE, **OWN)
    message = ros.make(f"own/msg/{name}", **own_values(ros, name))
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
    name = f"Times{bits}{six}"
    ros.register(**{name: "".join(f"{kind} {each}\n" for each in names)})
    mapped = {"/own": own_ranges(times=names, tick_s=tick_s, tag=1, anchor=2)}
    message = ros.make(f"own/msg/{name}", **dict(zip(names, values, strict=True)))
    (ranges,) = decoded(ros.channel("/own", message.__msgtype__), ros.serialise(message), mapped=mapped)
    np.testing.assert_allclose(ranges.range_m, away_m, atol=0.01)


ENDS = {
    "/uwb/tof/n_3/n_7/distance": (3, 7),
    "/uwb/anchor_4/range": (0, 4),
    "/uwb/anchor_0/tag_2": (2, 0),
    "/uwb/tag_0/anchor_2": (0, 2),
    "/uwb/Anchor0/Tag2/range": (2, 0),
    "/uwb/anchors/0/n_2": (2, 0),
    "/uwb/anchor_id_0_tag_id_2": (2, 0),
    "/uwb/anchor_3/n_7": (7, 3),
    "/uwb/n_3/tag_7": (7, 3),
    "/uwb_anchor/n_3/n_7": (3, 7),
} | dict.fromkeys(("/uwb/tag_2/range", "/sonar_2", "/range", "/a1/b2/c3", "/uwb/n_" + "9" * 20))


@pytest.mark.parametrize(
    ("topic", "ends", "mapped", "anchors"),
    [
        *((topic, ends, {}, []) for topic, ends in ENDS.items()),
        ("/n_7/n_5", (5, 7), {}, [7]),
        ("/n_7/n_5", (7, 5), {}, [5, 7]),
        ("/n_7/n_5", (1, 2), {"/n_7/n_5": (1, 2)}, [7]),
        ("/uwb/anchor_0/tag_2", (2, 0), {}, [2]),
        ("/uwb/anchor_0/anchor_2", (2, 0), {}, [0]),
    ],
)
def test_the_configuration_then_words_then_known_anchors_decide(log, topic, ends, mapped, anchors):
    log.add(topic, T_NS, log.ros.range(T_NS, 2.5))
    rows = [{"topic": each, "tag": tag, "anchor": anchor} for each, (tag, anchor) in mapped.items()]
    places = [{"id": each, "x_m": 0, "y_m": 0, "z_m": 0} for each in anchors]
    config = Config.model_validate({"uwb": {"range_topics": rows, "anchors": places}})
    (timed,) = Recording(log.container, config).messages([topic])
    assert (timed.message.tag, *timed.message.anchor.tolist()) == (ends or (None, -1))
