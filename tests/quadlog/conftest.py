"""A log in memory, and ROS messages of one generation or the other."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from quadlog.recordings.containers.container import Budget, Channel, Loss, RawMessage
from quadlog.storage.atomic_write import part_prefix
from tests.lab.messages import Ros


class FakeContainer:
    """Messages in memory behind the Container protocol. `add` takes a channel, a log time and a payload.

    The count of a channel is 1, however many messages it has.
    """

    def __init__(self) -> None:
        self.path = Path("fake.mcap")
        self.losses: list[Loss] = []
        self.warnings: list[str] = []
        self.known: dict[tuple[str, str], Channel] = {}
        self.raw: list[RawMessage] = []
        self.asked: list[tuple[int | None, int | None]] = []

    def add(self, channel: Channel, t_ns: int, payload: bytes) -> None:
        channel = self.known.setdefault((channel.topic, channel.type_name), replace(channel, count=1))
        self.raw.append(RawMessage(channel, t_ns, payload))

    @property
    def channels(self) -> tuple[Channel, ...]:
        return tuple(self.known.values())

    @property
    def span_ns(self) -> tuple[int, int] | None:
        times = [each.log_time_ns for each in self.raw]
        return (min(times), max(times)) if times else None

    def excerpt(self, budget: Budget) -> None:
        """It is small."""

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        self.asked.append((start_ns, end_ns))
        for each in sorted(self.raw, key=lambda raw: raw.log_time_ns):
            late = end_ns is not None and each.log_time_ns >= end_ns
            early = start_ns is not None and each.log_time_ns < start_ns
            if not early and not late and (topics is None or each.channel.topic in topics):
                yield each

    def close(self) -> None:
        pass


class Log:
    """A container being filled with ROS 2 messages."""

    def __init__(self, ros: Ros) -> None:
        self.ros, self.container = ros, FakeContainer()

    def add(self, topic: str, t_ns: int, message: Any) -> None:
        channel = self.ros.channel(topic, message.__msgtype__)
        self.container.add(channel, t_ns, self.ros.serialise(message))


@pytest.fixture
def log(both_ros: SimpleNamespace) -> Log:
    return Log(both_ros.cdr)


@pytest.fixture(scope="session", params=["ros1", "cdr"])
def ros(request: pytest.FixtureRequest) -> Ros:
    return Ros("ros1" if request.param == "ros1" else "little")


@pytest.fixture(scope="session")
def both_ros() -> SimpleNamespace:
    return SimpleNamespace(ros1=Ros("ros1"), cdr=Ros())


@pytest.fixture(scope="session")
def left_part() -> str:
    """The name of a file that a process of this host had begun, and that is dead now."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return f"{part_prefix(process.pid)}00000000.part"


@pytest.fixture(scope="session")
def edge_cases() -> Path:
    folder = os.environ.get("QUADLOG_DATASETS")
    if not folder:
        pytest.skip("QUADLOG_DATASETS is not set")
    return Path(folder) / "edge_cases"


@pytest.fixture
def limited() -> Iterator[Callable[[int, int], None]]:
    """Sets a soft limit of this process, for the test."""
    before: dict[int, tuple[int, int]] = {}

    def limit(which: int, most: int) -> None:
        before[which] = resource.getrlimit(which)
        resource.setrlimit(which, (most, before[which][1]))

    yield limit
    for which, limits in before.items():
        resource.setrlimit(which, limits)
