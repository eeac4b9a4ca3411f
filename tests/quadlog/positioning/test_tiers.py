"""Radios on moving robots, one topic for each pair (uwb_tiers): every pair is read and named."""

from __future__ import annotations

import os
import sqlite3
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from quadlog.recordings.recording import open_recording
from quadlog.recordings.streams import gather
from quadlog.recordings.survey import survey

PAIR, EIGHT = "rosbag2_2022_09_07-17_25_41", "shortbag"


def folder(name: str) -> Path:
    if "QUADLOG_DATASETS" not in os.environ:
        pytest.skip("QUADLOG_DATASETS is not set")
    path = Path(os.environ["QUADLOG_DATASETS"]) / "uwb_tiers" / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path


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


@pytest.mark.parametrize("name", [PAIR, EIGHT], ids=["pair", "eight"])
def test_limits_of_zero_drop_no_range(name):
    """min_range and max_range are both zero in every message: a strict check would drop all of them."""
    stored = stored_ranges(name)
    with open_recording(folder(name)) as recording:
        topics = [channel.topic for channel in recording.channels if channel.topic.startswith("/uwb/tof/")]
        ranges = gather(recording, uwb=topics).ranges
        assert recording.losses == []
    every = [message for messages in stored.values() for message in messages]
    assert {(message.min_range, message.max_range, message.header.frame_id) for message in every} == {(0.0, 0.0, "")}
    assert len(ranges) == len(every)
    for topic, messages in stored.items():
        tag, anchor = (int(part[2:]) for part in topic.split("/")[3:5])
        mine = (ranges.tag == tag) & (ranges.anchor == anchor)
        np.testing.assert_allclose(
            np.sort(ranges.range_m[mine]), np.sort([message.range for message in messages]), rtol=1e-6
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
