"""The small topics of a recording, gathered in one pass into columns; the clouds are left to be streamed."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import nan

import numpy as np

from quadlog.messages import (
    Float,
    Imu,
    ImuSeries,
    Int,
    Message,
    Odometry,
    Pose,
    PoseSeries,
    RangeSeries,
    Transforms,
    UwbRanges,
)
from quadlog.recordings.increasing import increasing_rows
from quadlog.recordings.recording import Recording
from quadlog.recordings.repeated_stamps import backward_steps, repeated_rows
from quadlog.recordings.tf_tree import TransformTree
from quadlog.recordings.words import stamps_go_back


@dataclass(frozen=True, slots=True)
class Streams:
    """What `gather` found; None for a role without topic or without a single message.

    range_gap_db: (N,) receiver minus first-path power beside ranges, NaN where a message has none.
    odometry_linear_mps, odometry_angular_radps: (N, 3) beside odometry.
    """

    ranges: RangeSeries | None
    range_gap_db: Float | None
    odometry: PoseSeries | None
    odometry_linear_mps: Float | None
    odometry_angular_radps: Float | None
    imu: ImuSeries | None
    reference: PoseSeries | None
    target: PoseSeries | None
    tf: TransformTree
    warnings: list[str]


def gather(
    recording: Recording,
    *,
    uwb: Sequence[str] = (),
    odometry: str | None = None,
    imu: str | None = None,
    reference: str | None = None,
    target: str | None = None,
    tf: Sequence[str] = (),
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Streams:
    """Read the named topics once (static transforms apart: they count from before start_ns too).

    Times of each series increase strictly: a message whose stamp does not is
    dropped and counted in warnings. Ranges are sorted instead, as far as their
    messages may have overtaken one another; where a link's stamps go back
    farther, what it stamps a second time is dropped and counted, because two
    walks would interleave. Raises ClocksDiffer.
    """
    sinks = _Sinks(uwb, odometry, imu, reference, target)
    static = [topic for topic in tf if topic.rsplit("/", 1)[-1] == "tf_static"]
    for timed in recording.messages(static) if static else ():
        sinks.take(timed.t_ns, timed.topic, timed.message, recording.stamp)
    moving = [*uwb, *(topic for topic in (odometry, imu, reference, target) if topic), *tf]
    moving = [topic for topic in dict.fromkeys(moving) if topic not in static]
    for timed in recording.messages(moving, start_ns, end_ns) if moving else ():
        sinks.take(timed.t_ns, timed.topic, timed.message, recording.stamp)
    return sinks.streams()


_NO_QUATERNION = [nan] * 4
_NO_TWIST = [0.0] * 6


@dataclass
class _Columns:
    """Rows of numbers as they come: a time and `width` values each."""

    width: int
    t_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    frame_id: str = ""
    child_frame_id: str = ""

    def arrays(self) -> tuple[Int, Float]:
        return np.array(self.t_ns, np.int64), np.array(self.values, np.float64).reshape(-1, self.width)

    def increasing(self, topic: str, warnings: list[str]) -> tuple[Int, Float]:
        """Both columns without as few rows as it takes for the times to increase strictly."""
        t_ns, values = self.arrays()
        kept = increasing_rows(t_ns)
        dropped = len(t_ns) - len(kept)
        if dropped:
            warnings.append(f"{topic}: {dropped} of {len(t_ns)} stamps do not increase; those messages are dropped")
        return t_ns[kept], values[kept]


class _Sinks:
    """Where each topic's messages go."""

    def __init__(
        self, uwb: Sequence[str], odometry: str | None, imu: str | None, reference: str | None, target: str | None
    ) -> None:
        self.uwb, self.imu_topic = set(uwb), imu
        self.pose_topics = {"odometry": odometry, "reference": reference, "target": target}
        self.ranges = _Columns(4)
        self.range_topic: array[int] = array("q")  # beside ranges, into range_topics
        self.range_topics: dict[str, int] = {}
        self.nameless: dict[str, int] = {}
        self.poses = {role: _Columns(13) for role in self.pose_topics}
        self.columns_of_topic: dict[str, list[_Columns]] = {}
        for role, topic in self.pose_topics.items():
            self.columns_of_topic.setdefault(topic or "", []).append(self.poses[role])
        self.imu = _Columns(7)
        self.tree = TransformTree()
        self.warnings: list[str] = []

    def take(self, t_ns: int, topic: str, message: Message, stamp: str) -> None:
        """File one message under every role its topic has."""
        if isinstance(message, Imu):
            self.imu.t_ns.append(t_ns)
            self.imu.frame_id = message.frame_id
            self.imu.values.extend(message.angular_radps.tolist())
            self.imu.values.extend(_NO_QUATERNION if message.quat_xyzw is None else message.quat_xyzw.tolist())
        elif isinstance(message, (Pose, Odometry)):
            for column in self.columns_of_topic.get(topic, ()):
                _take_pose(t_ns, message, column)
        elif isinstance(message, UwbRanges):
            if topic in self.uwb:
                self._take_ranges(t_ns, topic, message)
        elif isinstance(message, Transforms):
            for pose in message.transforms:
                own_ns = t_ns if stamp == "log" or not pose.stamp_ns else pose.stamp_ns
                self.tree.add(own_ns, pose, static=message.static)

    def _take_ranges(self, t_ns: int, topic: str, message: UwbRanges) -> None:
        if message.tag is None:
            self.nameless[topic] = self.nameless.get(topic, 0) + len(message.range_m)
            return
        anchors, given = message.anchor.tolist(), message.first_path_gap_db
        gaps = [nan] * len(anchors) if given is None else given.tolist()
        for anchor, range_m, gap in zip(anchors, message.range_m.tolist(), gaps, strict=True):
            self.ranges.t_ns.append(t_ns)
            self.ranges.values.extend((message.tag, anchor, range_m, gap))
            self.range_topic.append(self.range_topics.setdefault(topic, len(self.range_topics)))

    def streams(self) -> Streams:
        """Everything taken so far, as series."""
        for topic, count in sorted(self.nameless.items()):
            self.warnings.append(
                f"{topic}: {count} ranges without ids are left out; name their ends in [[uwb.range_topics]]"
            )
        odometry, twist = self._pose_series("odometry")
        reference, _ = self._pose_series("reference")
        target, _ = self._pose_series("target")
        ranges, gap_db = self._range_series()
        return Streams(
            ranges=ranges,
            range_gap_db=gap_db,
            odometry=odometry,
            odometry_linear_mps=None if odometry is None else twist[:, :3],
            odometry_angular_radps=None if odometry is None else twist[:, 3:],
            imu=self._imu_series(),
            reference=reference,
            target=target,
            tf=self.tree,
            warnings=self.warnings,
        )

    def _range_series(self) -> tuple[RangeSeries | None, Float | None]:
        t_ns, values = self.ranges.arrays()
        if len(t_ns) == 0:
            return None, None
        t_ns, values = self._on_one_clock(t_ns, values)
        order = np.argsort(t_ns, kind="stable")
        t_ns, values = t_ns[order], values[order]
        tag, anchor = values[:, 0].astype(np.int64), values[:, 1].astype(np.int64)
        return RangeSeries(t_ns, tag, anchor, values[:, 2].copy()), values[:, 3].copy()

    def _on_one_clock(self, t_ns: Int, values: Float) -> tuple[Int, Float]:
        """Both columns without what a clock that was set back stamps a second time; each such topic is told.

        Link by link: tags that share a topic may be late by different amounts.
        """
        topic = np.array(self.range_topic, np.int64)
        order = np.lexsort((values[:, 1], values[:, 0], topic))
        link = np.column_stack([topic, values[:, :2]])[order]
        repeated, back_ns = np.zeros(len(t_ns), dtype=bool), np.zeros(len(t_ns), dtype=np.int64)
        for rows in np.split(order, np.flatnonzero((link[1:] != link[:-1]).any(axis=1)) + 1):
            steps = backward_steps(t_ns[rows])
            if len(steps):
                repeated[rows] = repeated_rows(t_ns[rows])
                back_ns[rows[steps]] = t_ns[rows[steps - 1]] - t_ns[rows[steps]]
        for name, index in self.range_topics.items():
            mine = topic == index
            worst = int(np.argmax(np.where(mine, back_ns, 0)))
            if back_ns[worst]:
                self.warnings.append(
                    f"{stamps_go_back(name, int(back_ns[worst]), int(t_ns[worst]))}; {repeated[mine].sum()} ranges "
                    "whose stamps repeat or run ahead of others are dropped; take log times with  --stamp log"
                )
        return t_ns[~repeated], values[~repeated]

    def _pose_series(self, role: str) -> tuple[PoseSeries | None, Float]:
        column = self.poses[role]
        t_ns, values = column.increasing(str(self.pose_topics[role]), self.warnings)
        if len(t_ns) == 0:
            return None, values[:, 7:]
        series = PoseSeries(t_ns, values[:, :3].copy(), values[:, 3:7].copy(), column.frame_id, column.child_frame_id)
        return series, values[:, 7:].copy()

    def _imu_series(self) -> ImuSeries | None:
        t_ns, values = self.imu.increasing(str(self.imu_topic), self.warnings)
        if len(t_ns) == 0:
            return None
        quaternions = values[:, 3:].copy()
        oriented = bool(np.isfinite(quaternions).all())
        if not oriented and np.isfinite(quaternions).any():
            self.warnings.append(f"{self.imu_topic}: not every message has an orientation; none is used")
        return ImuSeries(t_ns, values[:, :3].copy(), quaternions if oriented else None, self.imu.frame_id)


def _take_pose(t_ns: int, message: Pose | Odometry, column: _Columns) -> None:
    column.t_ns.append(t_ns)
    column.values.extend(message.position_m.tolist())
    column.values.extend(message.quat_xyzw.tolist())
    if isinstance(message, Odometry):
        column.values.extend(message.linear_mps.tolist())
        column.values.extend(message.angular_radps.tolist())
    else:
        column.values.extend(_NO_TWIST)
    column.frame_id, column.child_frame_id = message.frame_id, message.child_frame_id
