"""What is in a recording, read whole or by its index."""

from __future__ import annotations

import math
import os
import re
import struct
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import IndexType

from quadlog.errors import QuadlogError
from quadlog.recordings.containers.bounded_reader import Damaged
from quadlog.recordings.containers.container import Budget, Channel, LogTimes
from quadlog.recordings.recording import Recording, open_recording
from quadlog.recordings.survey import Pulse, indexed_pulses, survey
from quadlog.storage.byte_ranges import LocalBytes

MS = 10**6
T0 = 1_700_000_000_000 * MS


def test_counts_rates_gaps_and_clock_offset(log: Any) -> None:
    """100 messages at 10 Hz, a pause of a second, 100 at 20 Hz; the header lags log time by 30 ms."""
    t_ns = T0
    for i in range(200):
        t_ns += 1000 * MS if i == 100 else (100 if i < 100 else 50) * MS
        log.add("/odom", t_ns, log.ros.odometry(t_ns - 30 * MS, 0.0))
    (topic,) = survey(Recording(log.container)).topics
    assert topic.messages == 200
    assert topic.hz_max == pytest.approx(20)
    assert topic.hz_min == pytest.approx(10 / 1.9)  # ten intervals: nine of 0.1 s and the pause
    assert topic.gaps == 1
    assert topic.longest_gap_s == pytest.approx(1.0)
    assert topic.clock_offset_s == pytest.approx(-0.03)


@pytest.mark.parametrize(("count", "hz"), [(0, None), (1, None), (2, 2.0), (5, 2.0)])
def test_few_messages(log: Any, count: int, hz: float | None) -> None:
    channel = Channel("/chatter", "std_msgs/msg/String", "cdr", "ros2msg", b"string data")
    log.container.known["/chatter", channel.type_name] = channel
    for i in range(count):
        log.container.add(channel, T0 + i * 500 * MS, b"")
    (topic,) = survey(Recording(log.container)).topics
    assert (topic.messages, topic.hz_min, topic.hz_max, topic.clock_offset_s) == (count, hz, hz, None)


def test_offset_of_types_that_quadlog_does_not_decode(log: Any) -> None:
    """Only the header at the payload's front is read, by the embedded definition or the standard one."""
    kind = log.ros.type("geometry_msgs/msg/PointStamped")
    message = kind(log.ros.header(T0 - 7 * MS), log.ros.type("geometry_msgs/msg/Point")(0.0, 0.0, 0.0))
    log.add("/embedded", T0, message)
    bare = Channel("/bare", "geometry_msgs/msg/PointStamped", "cdr", "", b"")
    log.container.add(bare, T0, log.ros.serialise(message))
    text = b"module m { module msg { struct Other { float a; }; @x struct A { std_msgs::msg::Header header; }; }; };"
    log.container.add(Channel("/idl", "m/msg/A", "cdr", "ros2idl", text), T0, log.ros.serialise(message)[:40])
    offsets = {each.name: each.clock_offset_s for each in survey(Recording(log.container)).topics}
    assert offsets == {name: pytest.approx(-0.007) for name in ("/embedded", "/bare", "/idl")}


def test_links_and_losses(log: Any) -> None:
    for i in range(4):
        log.add("/uwb/n_0/n_2", T0 + i, log.ros.range(T0 + i, 1.0 + i))
    raw = log.container.raw[0]
    log.container.raw[0] = type(raw)(raw.channel, raw.log_time_ns, b"")
    recording = Recording(log.container)
    seen = survey(recording)
    (link,) = seen.links["/uwb/n_0/n_2"]
    assert (link.tag, link.anchor, link.messages, link.range_min_m, link.range_max_m) == (0, 2, 3, 2.0, 4.0)
    assert [(loss.cause, loss.count) for loss in recording.losses] == [("decode", 1)]
    assert seen.messages == 4


def test_reach_of_links_without_a_number(log: Any) -> None:
    for i, range_m in enumerate([math.nan, 3.0, -1.0, -math.inf]):
        log.add("/uwb/n_0/n_2", T0 + i, log.ros.range(T0 + i, range_m))
        log.add("/uwb/n_0/n_3", T0 + i, log.ros.range(T0 + i, math.nan))
    links = survey(Recording(log.container)).links
    (some,), (none,) = links["/uwb/n_0/n_2"], links["/uwb/n_0/n_3"]
    assert (some.messages, some.range_min_m, some.range_max_m) == (4, -1.0, 3.0)
    assert (none.messages, none.range_min_m, none.range_max_m) == (4, None, None)


def test_how_far_stamps_of_ranges_go_back(log: Any) -> None:
    for i, ms in enumerate([0, 100, 200, 50, 150, 140]):
        log.add("/uwb/n_0/n_2", T0 + i, log.ros.range(T0 + ms * MS, 1.0))
        log.add("/uwb/n_0/n_3", T0 + i, log.ros.range(T0 + i * MS, 1.0))
    back, sound = survey(Recording(log.container)).topics
    assert (back.clock_back_ns, back.clock_back_to_ns) == (150 * MS, T0 + 50 * MS)
    assert (sound.clock_back_ns, sound.clock_back_to_ns) == (0, 0)


def seen_of(path: Path, budget: Budget | None) -> tuple[list[Any], list[str]]:
    """What every message's log time tells, and the warnings: read whole, or from the index beside an excerpt."""
    with open_recording(path) as recording:
        part = recording if budget is None else recording.excerpt(budget) or recording
        pulses = None if budget is None else indexed_pulses(recording.container)
        seen = survey(part, pulses)
        topics = [replace(each, clock_offset_s=None, clock_jump_s=None, clock_back_ns=0) for each in seen.topics]
        topics = [replace(each, clock_back_to_ns=0) for each in topics]
        # Stamps are in payloads, of which an excerpt has some.
        warnings = [each for each in recording.warnings if "have the stamp 0" not in each]
        return [sorted(topics, key=str), seen.messages, seen.start_ns, seen.end_ns], warnings


MESSAGES = st.lists(
    st.tuples(st.sampled_from(["/a", "/b", "/c"]), st.integers(0, 9), st.integers(0, 200)), min_size=1, max_size=60
)


@pytest.mark.parametrize("form", ["mcap", "mcap-loose", "bag", "bag-lz4", "db3", "db3-unindexed", "split"])
@given(steps=MESSAGES, start_s=st.sampled_from([0, 100, 1_700_000_000]))
def test_survey_by_index_equals_survey_of_all_messages(
    recordings: Any, form: str, steps: list[tuple[str, int, int]], start_s: int
) -> None:
    """Late messages, equal times, clocks that go back, and chunks that overlap."""
    messages, t_ms = [], start_s * 1000
    for topic, forward, length in steps:
        t_ms = max(0, t_ms + (forward - 2) * 400)
        messages.append((topic, t_ms * MS, bytes(length)))
    with TemporaryDirectory() as name:
        path = recordings.build(form, Path(name) / "walk", messages)
        whole = seen_of(path, None)
        assert seen_of(path, Budget(2, 100, 5)) == whole
    times_ns = [t_ns for _, t_ns, _ in messages]
    if form.startswith("db3"):
        goes_back = any(late > each + 1000 * MS for i, each in enumerate(times_ns) for late in times_ns[:i])
        assert any("goes back" in line for line in whole[1]) == goes_back


@pytest.mark.parametrize("form", ["mcap", "bag"])
def test_no_more_is_read_than_the_index_and_the_excerpt(
    recordings: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    noise = Random(1)
    messages = [(topic, t_ns, noise.randbytes(6000)) for topic, t_ns, _ in recordings.some(400)]
    path = recordings.build(form, tmp_path / "walk", messages)
    size, read_bytes, read = path.stat().st_size, 0, LocalBytes.read

    def count(file: LocalBytes, offset: int, length: int) -> bytes:
        nonlocal read_bytes
        data = read(file, offset, length)
        read_bytes += len(data)
        return data

    monkeypatch.setattr(LocalBytes, "read", count)
    with open_recording(path) as recording:
        pulses = indexed_pulses(recording.container)
        index_bytes = read_bytes
        part = recording.excerpt(Budget(8, size // 10, 100))
        assert part is not None
        seen = survey(part, pulses)
    assert index_bytes < size / 5
    assert 0 < seen.messages_read <= 60
    assert read_bytes - index_bytes <= size / 8
    assert seen.messages == 400


def test_an_excerpt_is_spread_and_holds_every_topic_the_index_knows(recordings: Any, tmp_path: Path) -> None:
    messages = recordings.some(400)
    messages[77] = ("/rare", *messages[77][1:])
    with open_recording(recordings.mcap(tmp_path / "walk.mcap", messages)) as recording:
        assert recording.excerpt(Budget(400, 1 << 20, 400)) is None
        part = recording.excerpt(Budget(8, 1 << 20, 100))
        assert part is not None
        read = recordings.read(part.container)
    assert {topic for topic, _, _ in read} == {"/a", "/b", "/rare"}
    times_ns = [t_ns for _, t_ns, _ in read]
    assert (times_ns[0], times_ns[-1]) == (messages[0][1], messages[-1][1])
    assert max(late - early for early, late in pairwise(times_ns)) < (times_ns[-1] - times_ns[0]) / 6


def test_an_index_that_contradicts_the_file_is_damaged(recordings: Any, tmp_path: Path) -> None:
    path = recordings.mcap(tmp_path / "walk.mcap", recordings.some(80), index_types=IndexType.ALL & ~IndexType.MESSAGE)
    with open_recording(path) as recording, pytest.raises(Damaged, match="list 0 of 80 messages"):
        indexed_pulses(recording.container)


@pytest.mark.parametrize("form", ["mcap", "bag"])
def test_an_index_that_names_a_channel_twice_in_a_chunk_is_damaged(recordings: Any, tmp_path: Path, form: str) -> None:
    path = recordings.build(form, tmp_path / "walk", recordings.some(80))
    number_behind = re.compile(rb"(op=\x04.{16}conn=|\x07.\x00{7})[\x00-\x02]\x00", re.DOTALL)
    path.write_bytes(number_behind.sub(lambda found: found[1] + b"\1\0", path.read_bytes()))
    with open_recording(path) as recording, pytest.raises(Damaged, match="twice"):
        indexed_pulses(recording.container)


@pytest.mark.parametrize("form", ["mcap", "bag"])
def test_messages_at_time_zero_are_counted_by_the_index(recordings: Any, tmp_path: Path, form: str) -> None:
    messages = [
        (topic, 0 if i in (100, 300) else t_ns, data) for i, (topic, t_ns, data) in enumerate(recordings.some(400))
    ]
    path = recordings.build(form, tmp_path / "walk", messages)
    whole = seen_of(path, None)
    assert any("2 messages logged at time 0" in line for line in whole[1])
    assert seen_of(path, Budget(1, 100, 5)) == whole


@pytest.mark.parametrize("form", ["mcap", "bag"])
def test_wrong_chunk_times_are_found_by_message_indexes(recordings: Any, tmp_path: Path, form: str) -> None:
    messages = recordings.some(400)
    if form == "mcap":
        path = recordings.mcap(tmp_path / "walk.mcap", messages, enable_crcs=False)
        data = bytearray(path.read_bytes())
        with path.open("rb") as file:
            chunk = make_reader(file).get_summary().chunk_indexes[30]  # type: ignore[union-attr]
        ends = data.rindex(struct.pack("<QQ", chunk.message_start_time, chunk.message_end_time)) + 8
        struct.pack_into("<Q", data, ends, chunk.message_end_time - 1)
    else:
        path = recordings.bag(tmp_path / "walk.bag", messages)
        data = bytearray(path.read_bytes())
        ends = [found.end() for found in re.finditer(b"end_time=", data)][30]
        seconds, _ = struct.unpack_from("<II", data, ends)
        struct.pack_into("<II", data, ends, seconds - 1, 0)
    path.write_bytes(data)
    whole = seen_of(path, None)
    assert any("wrong times for 1 chunk" in line for line in whole[1])
    assert seen_of(path, Budget(1, 100, 5)) == whole


def test_clouds_are_checked_without_their_points(log: Any) -> None:
    """Their stamps count, and those that cannot be decoded are a loss, as if they had been decoded."""
    for i in range(3):
        log.add("/points", T0 + i, log.ros.cloud(T0 + i - 5 * MS, np.ones((4, 3))))
    raw = log.container.raw[2]
    log.container.raw[2] = type(raw)(raw.channel, raw.log_time_ns, bytes(raw.payload)[:-20])
    recording = Recording(log.container)
    decoded = [messages for _, messages in recording.everything()]
    assert [[len(each.xyz_m) for each in messages] for messages in decoded] == [[0], [0], []]
    assert survey(recording).topics[0].clock_offset_s == pytest.approx(-0.005)
    assert [(loss.cause, loss.count) for loss in recording.losses] == [("decode", 1)]


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
def test_real_recordings_by_their_index() -> None:
    """Those that are sound and have a whole index: the same as reading everything."""
    folder = Path(os.environ["QUADLOG_DATASETS"])
    paths = [path for path in sorted(folder.rglob("*")) if path.suffix in (".mcap", ".bag", ".db3")]
    by_index = 0
    for path in paths:
        try:
            indexed = seen_of(path, Budget(2, 1, 8))
        except (Damaged, QuadlogError):
            continue
        assert indexed == seen_of(path, None), path
        by_index += 1
    assert by_index > 50


CHANNEL = Channel("/a", "std_msgs/msg/String", "cdr", "ros2msg", b"string data")


def told(pulse: Pulse) -> tuple[Any, ...]:
    return pulse.messages, pulse.first_ns, pulse.last_ns, pulse.longest_ns, pulse.rates_hz(), pulse.gaps()


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=80), st.integers(1, 30))
def test_batches_make_no_difference_and_rates_are_those_of_all_runs(steps: list[int], size: int) -> None:
    t_ns = np.cumsum(np.array(steps, np.int64))
    batched, whole = Pulse(), Pulse()
    whole.take(t_ns)
    for begin in range(0, len(t_ns), size):
        batched.take(t_ns[begin : begin + size])
    assert told(batched) == told(whole)
    runs_ns = [b - a for a, b in zip(t_ns.tolist(), t_ns[10:].tolist(), strict=False) if b > a]
    if runs_ns:
        assert whole.rates_hz() == pytest.approx((1e10 / max(runs_ns), 1e10 / min(runs_ns)))


def test_chunks_that_overlap_are_put_in_order() -> None:
    """Far more times than are kept: of 80 chunks, each reaches into the next."""
    t_ns = np.cumsum(np.random.default_rng(1).integers(1, 10**6, 800_000))
    late = np.arange(len(t_ns)) // 10_000 + (np.arange(len(t_ns)) % 7 == 0)

    def log_times() -> Iterator[LogTimes]:
        for chunk in range(late.max() + 1):
            yield LogTimes(int(t_ns[late == chunk].min()), CHANNEL, t_ns[late == chunk])

    whole = Pulse()
    whole.take(t_ns)
    container: Any = SimpleNamespace(channels=(CHANNEL,), log_times=log_times)
    assert told(indexed_pulses(container)[CHANNEL]) == told(whole)


def test_chunks_that_all_overlap_are_refused_before_they_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("quadlog.recordings.survey._MOST_TIMES", 1 << 20)
    batch = np.arange(1 << 18)
    endless: Any = SimpleNamespace(
        channels=(CHANNEL,), log_times=lambda: (LogTimes(0, CHANNEL, batch) for _ in range(40))
    )
    with pytest.raises(Damaged, match="overlap too much"):
        indexed_pulses(endless)
