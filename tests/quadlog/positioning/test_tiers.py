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


@pytest.fixture
def eight() -> Path:
    path = Path(os.environ.get("QUADLOG_DATASETS", "")) / "uwb_tiers" / "shortbag"
    if "QUADLOG_DATASETS" not in os.environ or not path.exists():
        pytest.skip("QUADLOG_DATASETS is not set, or without uwb_tiers")
    return path


def test_limits_of_zero_drop_no_range(eight):
    """min_range and max_range are zero in every message: a strict check would drop all. Oracles: sqlite3, rosbags."""
    store, (path,) = get_typestore(Stores.ROS2_HUMBLE), eight.glob("*.db3")
    with sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True) as database:
        rows = database.execute(
            "SELECT t.name, t.type, m.data FROM messages m JOIN topics t ON t.id = m.topic_id "
            "WHERE t.type = 'sensor_msgs/msg/Range'"
        )
        stored = [(topic, store.deserialize_cdr(data, kind)) for topic, kind, data in rows]
    assert {(message.min_range, message.max_range) for _, message in stored} == {(0.0, 0.0)}
    with open_recording(eight) as recording:
        ranges = gather(recording, uwb=sorted({topic for topic, _ in stored})).ranges
        assert recording.losses == []
    wanted = sorted((*(int(part[2:]) for part in topic.split("/")[3:5]), message.range) for topic, message in stored)
    got = sorted(zip(ranges.tag.tolist(), ranges.anchor.tolist(), ranges.range_m.tolist(), strict=True))
    np.testing.assert_allclose(got, wanted, rtol=1e-6)


def test_every_pair_is_named_once_and_known_anchors_turn_it_the_right_way(eight):
    """Eight radios: 28 pairs, one of them named in the other order. With all but 7 known, 7 is the tag of its links."""
    for anchors in ((), (1, 2, 3, 4, 5, 6, 8)):
        with open_recording(eight, anchor_ids=anchors) as recording:
            links = survey(recording).links
        assert all(len(each) == 1 for each in links.values())
        pairs = [(link.tag, link.anchor) for each in links.values() for link in each]
        assert sorted(map(sorted, pairs)) == [list(pair) for pair in combinations(range(1, 9), 2)]
        if anchors:
            assert sorted(anchor for tag, anchor in pairs if tag == 7) == list(anchors)
        else:
            assert [pair for pair in pairs if pair[0] > pair[1]] == [(7, 5)]
