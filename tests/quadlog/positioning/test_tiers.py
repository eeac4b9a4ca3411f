"""Radios on moving robots, one topic for each pair (uwb_tiers): every pair read and named, and what its ranges hold."""

from __future__ import annotations

import os
import sqlite3
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from quadlog.messages import Float, PoseSeries, RangeSeries
from quadlog.recordings.recording import open_recording
from quadlog.recordings.streams import gather
from quadlog.recordings.survey import survey

PAIR, EIGHT = "rosbag2_2022_09_07-17_25_41", "shortbag"
ROBOTS = {
    PAIR: {2: "turtlebot01_cap", 3: "turtlebot03_cap"},
    EIGHT: {3: "turtlebot3_cap", 4: "turtlebot4_cap", 5: "turtlebot5_cap", 7: "turtlebot1_cap"},
}
"""Which radio is on which robot that motion capture saw: the pairing whose distances the ranges follow. Radios 1, 2,
6 and 8 stood elsewhere."""


@dataclass(frozen=True)
class Site:
    ranges: RangeSeries
    robots: dict[int, PoseSeries]

    def links(self) -> list[tuple[int, int]]:
        """Tag and anchor of every link both of whose ends motion capture saw."""
        named = sorted({*zip(self.ranges.tag.tolist(), self.ranges.anchor.tolist(), strict=True)})
        return [link for link in named if set(link) <= set(self.robots)]

    def measured_and_true_m(self, tag: int, anchor: int) -> tuple[Float, Float]:
        mine = (self.ranges.tag == tag) & (self.ranges.anchor == anchor)
        t_ns = self.ranges.t_ns[mine]
        here_m, there_m = (positions_at(self.robots[end], t_ns) for end in (tag, anchor))
        return self.ranges.range_m[mine], np.linalg.norm(here_m - there_m, axis=1)


def positions_at(poses: PoseSeries, t_ns: np.ndarray) -> Float:
    since_ns, known_ns = t_ns - poses.t_ns[0], poses.t_ns - poses.t_ns[0]
    return np.stack([np.interp(since_ns, known_ns, poses.position_m[:, axis]) for axis in range(3)], axis=1)


def folder(name: str) -> Path:
    if "QUADLOG_DATASETS" not in os.environ:
        pytest.skip("QUADLOG_DATASETS is not set")
    path = Path(os.environ["QUADLOG_DATASETS"]) / "uwb_tiers" / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path


@pytest.fixture(scope="module", params=[PAIR, EIGHT], ids=["pair", "eight"])
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def site(name) -> Site:
    with open_recording(folder(name)) as recording:
        topics = [channel.topic for channel in recording.channels if channel.topic.startswith("/uwb/tof/")]
        ranges = gather(recording, uwb=topics).ranges
        poses = {
            radio: gather(recording, reference=f"/vrpn_client_node/{robot}/pose").reference
            for radio, robot in ROBOTS[name].items()
        }
        assert recording.losses == []
    assert ranges is not None
    return Site(ranges, poses)


def stored_ranges(name: str) -> dict[str, list[object]]:
    """The range messages of each topic, read with sqlite3 and rosbags: the oracle."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    stored: dict[str, list[object]] = {}
    (path,) = folder(name).glob("*.db3")
    with sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True) as database:
        rows = database.execute(
            "SELECT t.name, t.type, m.data FROM messages m JOIN topics t ON t.id = m.topic_id "
            "WHERE t.type = 'sensor_msgs/msg/Range' ORDER BY m.timestamp"
        )
        for topic, type_name, data in rows:
            stored.setdefault(topic, []).append(store.deserialize_cdr(data, type_name))
    return stored


def test_limits_of_zero_drop_no_range(name, site):
    """min_range and max_range are both zero in every message: a strict check would drop all of them."""
    stored = stored_ranges(name)
    every = [message for messages in stored.values() for message in messages]
    assert {(message.min_range, message.max_range, message.header.frame_id) for message in every} == {(0.0, 0.0, "")}
    assert len(site.ranges) == len(every)
    for topic, messages in stored.items():
        tag, anchor = (int(part[2:]) for part in topic.split("/")[3:5])
        mine = (site.ranges.tag == tag) & (site.ranges.anchor == anchor)
        np.testing.assert_allclose(
            np.sort(site.ranges.range_m[mine]), np.sort([message.range for message in messages]), rtol=1e-6
        )


def test_every_pair_is_read_and_named_once():
    """Eight radios: 28 pairs. /uwb/tof/n_7/n_5/distance is the one that is named in the other order."""
    with open_recording(folder(EIGHT)) as recording:
        links = survey(recording).links
    pairs = [(link.tag, link.anchor) for each in links.values() for link in each]
    assert all(len(each) == 1 for each in links.values())
    assert sorted(map(sorted, pairs)) == [list(pair) for pair in combinations(range(1, 9), 2)]
    assert [pair for pair in pairs if pair[0] > pair[1]] == [(7, 5)]
    (other_way,) = links["/uwb/tof/n_7/n_5/distance"]
    assert (other_way.tag, other_way.anchor, other_way.messages) == (7, 5, 125)


def test_the_pair_of_robots_is_named():
    with open_recording(folder(PAIR)) as recording:
        links = survey(recording).links
    ((topic, (link,)),) = links.items()
    assert (topic, link.tag, link.anchor, link.messages) == ("/uwb/tof/n_2/n_3/distance", 2, 3, 3357)


def test_known_anchors_turn_every_pair_with_one_unknown_end_the_right_way():
    """Whichever end is named first: with all but radio 7 known, 7 is the tag of its seven links."""
    anchors = (1, 2, 3, 4, 5, 6, 8)
    with open_recording(folder(EIGHT), anchor_ids=anchors) as recording:
        links = survey(recording).links
    ends = [(link.tag, link.anchor) for each in links.values() for link in each]
    assert sorted(anchor for tag, anchor in ends if tag == 7) == list(anchors)


def test_ranges_exceed_the_distance_by_a_constant(site):
    """0.23 to 0.40 m, to 0.05 m, for every link between robots, moving or not; what is left of it is noise.

    The median, because some links are late for seconds at a time. Both ends
    move, so no anchor is known, and motion capture stands in for it.
    """
    links = site.links()
    assert len(links) in (1, 6)
    for link in links:
        measured_m, true_m = site.measured_and_true_m(*link)
        bias_m = float(np.median(measured_m - true_m))
        assert 0.23 - 0.05 <= bias_m <= 0.40 + 0.05, link
        assert np.median(np.abs(measured_m - true_m - bias_m)) < 0.10, link


def test_the_bias_does_not_grow_with_the_distance(name, site):
    """Links whose length changes by a metre: near and far halves agree, so a constant is the right model."""
    for link in {PAIR: [(2, 3)], EIGHT: [(3, 4), (4, 7), (3, 7)]}[name]:
        measured_m, true_m = site.measured_and_true_m(*link)
        far = true_m > np.median(true_m)
        assert np.ptp(true_m) > 0.7
        near_m, far_m = (float(np.median((measured_m - true_m)[half])) for half in (~far, far))
        assert near_m == pytest.approx(far_m, abs=0.10)
