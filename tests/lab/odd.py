"""What makes a good log odd: each function changes the messages of a Log in place, or the file that was written.

`good` drives round a room with odometry, a scanner and its mount; every row of tests/cases/test_odd_logs.py takes that
log and one or two of these changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from tests.lab.messages import At, yawed
from tests.lab.recordings import flip
from tests.lab.strangers import ROS, Log, Room, add_scans, instants_s, ns

Change = Callable[[Log, Room], None]
SECONDS = 8.0
MOUNT = (0.1, 0.0, 0.0)
"""x_m, y_m, yaw_rad of the scanner in base."""
ANCHORS_M = {0: (-4.5, -3.0, 1.2), 1: (2.0, -3.0, 1.2), 2: (2.0, 3.0, 1.2), 3: (-4.5, 3.0, 1.2)}
TAG_HEIGHT_M = 0.6
ANCHORS_TOML = "".join(
    f"[[uwb.anchors]]\nid = {anchor}\nx_m = {x_m}\ny_m = {y_m}\nz_m = {z_m}\n"
    for anchor, (x_m, y_m, z_m) in ANCHORS_M.items()
)


def good(log: Log, room: Room) -> None:
    """Odometry at 20 Hz, a scanner at 10 Hz whose place is in tf_static."""
    log.tf(ns(0.0), "base_link", "laser", MOUNT, 0.2, "/tf_static")
    for t_s in instants_s(SECONDS, 20):
        log.odometry(ns(t_s), room.at(t_s))
    add_scans(log, room, SECONDS, 180, MOUNT)


def with_ranges(log: Log, room: Room) -> None:
    """The same, and UWB ranges of one tag above base to four anchors at 10 Hz, a topic for each anchor."""
    good(log, room)
    rng = np.random.default_rng(3)
    for t_s in instants_s(SECONDS, 10):
        x_m, y_m, _ = room.at(t_s)
        for anchor, anchor_m in ANCHORS_M.items():
            range_m = float(np.linalg.norm(np.subtract((x_m, y_m, TAG_HEIGHT_M), anchor_m))) + rng.normal(0, 0.03)
            log.range(ns(t_s) + 2_000_000 * anchor, f"/uwb/tag_0/anchor_{anchor}", range_m)


def _of(log: Log, topics: tuple[str, ...]) -> Iterator[tuple[int, Any]]:
    """Row and content of the messages of some topics; of all without a topic, /tf_static apart."""
    for row, (_, topic, content) in enumerate(log.messages):
        if topic in topics or not (topics or topic == "/tf_static"):
            yield row, content


def _headers(content: Any) -> Iterator[Any]:
    for stamped in getattr(content, "transforms", [content]):
        yield stamped.header


def stamped(offset_s: float, *topics: str) -> Change:
    """Header stamps of another clock: so much later than they should be."""

    def change(log: Log, room: Room) -> None:
        for row, content in _of(log, topics):
            moved = deepcopy(content)
            for header in _headers(moved):
                t_ns = header.stamp.sec * 10**9 + header.stamp.nanosec + round(offset_s * 1e9)
                header.stamp.sec, header.stamp.nanosec = divmod(t_ns, 10**9)
            log.messages[row] = (*log.messages[row][:2], moved)

    return change


def unstamped(*topics: str) -> Change:
    """Headers that the driver leaves empty."""

    def change(log: Log, room: Room) -> None:
        for _, content in _of(log, topics):
            for header in _headers(content):
                header.stamp.sec = header.stamp.nanosec = 0

    return change


def renamed(topic: str, name: str) -> Change:
    def change(log: Log, room: Room) -> None:
        log.messages = [(t_ns, name if each == topic else each, content) for t_ns, each, content in log.messages]

    return change


def repeated(after_ns: int, *topics: str) -> Change:
    """Each message is recorded a second time, with its own stamp so much later."""

    def change(log: Log, room: Room) -> None:
        again = Log()
        again.messages = [(t_ns + after_ns, topic, content) for t_ns, topic, content in log.messages if topic in topics]
        stamped(after_ns * 1e-9)(again, room)
        log.messages += again.messages

    return change


def of_sensor(frame: str, mount: At, *, known: bool = True) -> Change:
    """Odometry whose poses are those of a sensor; known: tf_static has its mount, by way of a frame between."""

    def change(log: Log, room: Room) -> None:
        for row, content in _of(log, ("/odom",)):
            t_s = (log.messages[row][0] - ns(0.0)) * 1e-9
            (x_m, y_m, yaw_rad), (ahead_m, left_m, turned_rad) = room.at(t_s), mount
            cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
            at = content.pose.pose
            at.position.x, at.position.y = x_m + cos * ahead_m - sin * left_m, y_m + sin * ahead_m + cos * left_m
            at.orientation = ROS.vector(*yawed(yaw_rad + turned_rad), name="Quaternion")
            content.child_frame_id = frame
        if known:
            log.tf(ns(0.0), "base_link", "plate", (mount[0], 0.0, 0.0), 0.1, "/tf_static")
            log.tf(ns(0.0), "plate", frame, (0.0, mount[1], mount[2]), 0.1, "/tf_static")

    return change


def by_tf(prefix: str = "") -> Change:
    """The odometry as tf instead, on the topic of a robot's namespace."""

    def change(log: Log, room: Room) -> None:
        log.messages = [row for row in log.messages if row[1] != "/odom"]
        renamed("/tf_static", f"{prefix}/tf_static")(log, room)
        for t_s in instants_s(SECONDS, 20):
            log.tf(ns(t_s), "odom", "base_link", room.at(t_s), topic=f"{prefix}/tf")

    return change


def other_robot(topic: str) -> Change:
    """A second body's transforms between frames of the same names, in turns with the first one's."""

    def change(log: Log, room: Room) -> None:
        for t_s in instants_s(SECONDS, 20):
            log.tf(ns(t_s) + 7_000_000, "odom", "base_link", (5.0 + 0.1 * t_s, 3.0, 1.0), topic=topic)

    return change


def paused(gap_s: float) -> Change:
    """The recorder stood still in the middle of the log for so long; clocks went on, the robot did not."""

    def change(log: Log, room: Room) -> None:
        later = Log()
        later.messages = [row for row in log.messages if row[0] >= ns(SECONDS / 2)]
        log.messages = [row for row in log.messages if row[0] < ns(SECONDS / 2)]
        stamped(gap_s)(later, room)
        log.messages += [(t_ns + round(gap_s * 1e9), *rest) for t_ns, *rest in later.messages]

    return change


def in_bursts(every_s: float, *topics: str) -> Change:
    """A relay that hands on what it has only so often: log times come in bursts, stamps do not."""

    def change(log: Log, room: Room) -> None:
        step_ns = round(every_s * 1e9)
        for row, _ in _of(log, topics):
            t_ns, topic, content = log.messages[row]
            log.messages[row] = (ns(0.0) + -(-(t_ns - ns(0.0)) // step_ns) * step_ns, topic, content)

    return change


def latched(topic: str, before_s: float) -> Change:
    """A pose of long ago that is sent again when recording begins."""

    def change(log: Log, room: Room) -> None:
        log.pose(ns(0.0), room.at(0.0), topic)
        t_ns, name, content = log.messages.pop()
        one = Log()
        one.messages = [(t_ns, name, content)]
        stamped(-before_s)(one, room)
        log.messages += one.messages

    return change


def limited(low_m: float, high_m: float, wrong_m: float, share: float) -> Change:
    """Ranges with limits of their own, and so many of them outside of these."""

    def change(log: Log, room: Room) -> None:
        rng = np.random.default_rng(4)
        for _, content in _of(log, tuple(f"/uwb/tag_0/anchor_{anchor}" for anchor in ANCHORS_M)):
            content.min_range, content.max_range = low_m, high_m
            content.range = wrong_m if rng.random() < share else content.range

    return change


def in_unit(per_m: float) -> Change:
    """Ranges in centimetres or millimetres."""

    def change(log: Log, room: Room) -> None:
        for _, content in _of(log, tuple(f"/uwb/tag_0/anchor_{anchor}" for anchor in ANCHORS_M)):
            content.range *= per_m

    return change


def only(*topics: str) -> Change:
    def change(log: Log, room: Room) -> None:
        log.messages = [row for row in log.messages if row[1] in topics]

    return change


def beside(topic: str) -> Change:
    """A topic that no one uses."""

    def change(log: Log, room: Room) -> None:
        for t_s in instants_s(SECONDS, 1):
            log.put(topic, ns(t_s), "std_msgs/msg/String", data="hello")

    return change


def cut(path: Path) -> None:
    """The recorder was killed: the last third is not there."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def flipped(path: Path) -> None:
    """One byte of the middle is another one."""
    flip(path, path.stat().st_size // 2)
