"""What is in a recording, read whole or by its index."""

from __future__ import annotations

import statistics
from dataclasses import replace
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import IndexType

from quadlog.recordings.containers.container import Budget, Channel, Damaged
from quadlog.recordings.recording import Recording, open_recording
from quadlog.recordings.survey import gaps, indexed_times, rates_hz, survey
from quadlog.storage.byte_source import LocalBytes
from tests.lab import recordings

MS = 10**6
T0 = 1_700_000_000_000 * MS


def test_counts_rates_gaps_and_clock_offset(log: Any) -> None:
    """100 messages at 10 Hz, a pause of a second, 100 at 20 Hz; the header lags log time by 30 ms."""
    t_ns = T0
    for i in range(200):
        t_ns += 1000 * MS if i == 100 else (100 if i < 100 else 50) * MS
        log.add("/odom", t_ns, log.ros.odometry(t_ns - 30 * MS))
    (topic,) = survey(Recording(log.container)).topics
    assert topic.messages == 200
    assert topic.hz_max == pytest.approx(20)
    assert topic.hz_min == pytest.approx(10 / 1.9)  # ten intervals: nine of 0.1 s and the pause
    assert topic.gaps == 1
    assert topic.longest_gap_s == pytest.approx(1.0)
    assert topic.clock_offset_s == pytest.approx(-0.03)


def test_offset_of_types_that_quadlog_does_not_decode(log: Any) -> None:
    """Only the header at the payload's front is read, by the embedded definition or the standard one."""
    message = log.ros.make("geometry_msgs/msg/PointStamped", header=log.ros.header(T0 - 7 * MS))
    log.add("/embedded", T0, message)
    bare = Channel("/bare", "geometry_msgs/msg/PointStamped", "cdr", "", b"")
    log.container.add(bare, T0, log.ros.serialise(message))
    text = b"module m { module msg { struct Other { float a; }; @x struct A { std_msgs::msg::Header header; }; }; };"
    log.container.add(Channel("/idl", "m/msg/A", "cdr", "ros2idl", text), T0, log.ros.serialise(message)[:40])
    offsets = {each.name: each.clock_offset_s for each in survey(Recording(log.container)).topics}
    assert offsets == {name: pytest.approx(-0.007) for name in ("/embedded", "/bare", "/idl")}


def seen_of(path: Path, budget: Budget | None) -> tuple[list[Any], list[str]]:
    """What every message's log time tells, and the warnings: read whole, or from the index beside an excerpt."""
    with open_recording(path) as recording:
        part = recording if budget is None else recording.excerpt(budget) or recording
        times = None if budget is None else indexed_times(recording.container)
        seen = survey(part, times)
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
def test_survey_by_index_equals_survey_of_all_messages(form, steps, start_s):
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
def test_no_more_is_read_than_the_index_and_the_excerpt(tmp_path, monkeypatch, form):
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
        times = indexed_times(recording.container)
        index_bytes = read_bytes
        part = recording.excerpt(Budget(8, size // 10, 100))
        assert part is not None
        seen = survey(part, times)
    assert index_bytes < size / 5
    assert 0 < seen.messages_read <= 60
    assert read_bytes - index_bytes <= size / 8
    assert seen.messages == 400


def test_an_index_that_contradicts_the_file_is_damaged(tmp_path: Path) -> None:
    path = recordings.mcap(tmp_path / "walk.mcap", recordings.some(80), index_types=IndexType.ALL & ~IndexType.MESSAGE)
    with open_recording(path) as recording, pytest.raises(Damaged, match="list 0 of 80 messages"):
        indexed_times(recording.container)


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=80))
def test_rates_are_those_of_all_runs_and_gaps_exceed_three_medians(steps: list[int]) -> None:
    t_ns = np.cumsum(np.array(steps, np.int64))
    intervals_ns = [each for each in steps[1:] if each]
    longer = [each for each in intervals_ns if each > 3 * statistics.median(intervals_ns)]
    assert gaps(t_ns) == (len(longer), max(intervals_ns) * 1e-9 if intervals_ns else None)
    runs_ns = [b - a for a, b in zip(t_ns.tolist(), t_ns[10:].tolist(), strict=False) if b > a]
    if runs_ns:
        assert rates_hz(t_ns) == pytest.approx((1e10 / max(runs_ns), 1e10 / min(runs_ns)))
    elif intervals_ns:
        mean_hz = (len(steps) - 1) * 1e9 / sum(intervals_ns)
        assert rates_hz(t_ns) == pytest.approx((mean_hz, mean_hz))
    else:
        assert rates_hz(t_ns) == (None, None)
