"""The small topics of a recording, gathered in one pass into columns, and the stamps of its clouds."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import (
    Float,
    Imu,
    ImuSeries,
    Int,
    JointSeries,
    JointStates,
    Odometry,
    PointCloud,
    Pose,
    PoseSeries,
    RangeSeries,
    Transforms,
    UwbRanges,
)
from quadlog.recordings.bursts import spread
from quadlog.recordings.clock import clock_losses, kept_rows, repeated_rows
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.decoders.anchor_places import AnchorPlace, AnchorPlaces
from quadlog.recordings.decoders.columns import Columns
from quadlog.recordings.decoders.pose import is_static
from quadlog.recordings.gathering import Gathered, Many
from quadlog.recordings.recording import Recording
from quadlog.recordings.tf_tree import TransformTree


@dataclass(frozen=True, slots=True)
class Streams:
    """What `gather` found; None for a role without topic or without a single message.

    range_gap_db: (N,) receiver minus first-path power beside ranges, NaN where a message has none.
    odometry_linear_mps, odometry_angular_radps: (N, 3) beside odometry.
    anchor_places: anchor id -> where the range messages say that it is. estimates: pose topic -> its poses.
    losses: of topics whose clock was set back. clouds_ns: (C,) stamps of the clouds in the order in which they came;
    repeated_clouds: (C,) those that a clock that was set back stamps a second time.
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
    losses: list[Loss]
    anchor_places: dict[int, AnchorPlace]
    clouds_ns: Int
    repeated_clouds: NDArray[np.bool_]
    joints: JointSeries | None = None
    estimates: Mapping[str, PoseSeries] = field(default_factory=dict)


def gather(
    recording: Recording,
    start_ns: int | None = None,
    end_ns: int | None = None,
    watch: Callable[[str], object] = lambda _: None,
    **topics: Any,
) -> Streams:
    """Read topics by role, as Gatherer takes them, once (static transforms apart: they count from before start_ns too).

    watch: called with the topic of all that is read.
    Messages that have overtaken one another are sorted. Where a clock was set
    back, what it stamps a second time is dropped, which is a loss, because two
    walks would interleave. Times increase strictly except those of ranges: a
    message with the stamp of another is dropped and counted in warnings.
    Raises ClocksDiffer.
    """
    wanted = Gatherer(**topics)
    wanted.take_all(wanted.static, recording)
    wanted.take_all(wanted.moving, recording, start_ns, end_ns, watch)
    return wanted.streams()


def look_at_frames(recording: Recording, tf: Sequence[str]) -> TransformTree:
    """The frames that all static transforms and an excerpt of the others show, on log times."""
    wanted = Gatherer(tf=tf)
    wanted.take_all(wanted.static, recording)
    if wanted.moving:
        wanted.take_all(wanted.moving, recording.glimpse())
    return wanted.tree


_NO_QUATERNION = [nan] * 4
_NO_TWIST = [0.0] * 6
_JOINT_VALUES = 41
MOST_OF_A_JOINT = 1e5
"""Larger angles, rates, torques and forces are no measurements."""


@dataclass
class _Columns:
    """Rows of numbers: a time and `width` values each, and which of them came first. The last frames count.

    code: of the array that holds the values, "d" or "f".
    """

    width: int
    code: str = "d"
    order: array[int] = field(default_factory=lambda: array("q"))
    t_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(init=False)
    frame_id: str = ""
    child_frame_id: str = ""
    _frames_of: int = -1

    def __post_init__(self) -> None:
        self.values = array(self.code)

    def add(self, order: int, t_ns: int, values: Iterable[float]) -> None:
        """One row."""
        self.order.append(order)
        self.t_ns.append(t_ns)
        self.values.extend(values)

    def extend(self, order: Int, t_ns: Int, values: Float) -> None:
        """Rows (N,), (N,) and (N, width)."""
        self.order.frombytes(order.tobytes())
        self.t_ns.frombytes(t_ns.tobytes())
        self.values.frombytes(np.ascontiguousarray(values, self.code).tobytes())

    def name(self, order: int, frame_id: str, child_frame_id: str = "") -> None:
        """The frames of a row."""
        if order > self._frames_of:
            self._frames_of, self.frame_id, self.child_frame_id = order, frame_id, child_frame_id

    def arrays(self) -> tuple[Int, Float]:
        """Times (N,) and values (N, width) in the order in which they came."""
        order, t_ns = np.array(self.order, np.int64), np.array(self.t_ns, np.int64)
        values = np.array(self.values, self.code).reshape(-1, self.width)
        if (np.diff(order) < 0).any():
            rows = np.argsort(order, kind="stable")
            t_ns, values = t_ns[rows], values[rows]
        return t_ns, values

    def set_times(self, t_ns: Int) -> None:
        """Other times (N,), in the order in which rows came."""
        rank = np.argsort(np.argsort(np.array(self.order), kind="stable"))
        self.t_ns = array("q", t_ns[rank].tobytes())

    def increasing(self, topic: str, warnings: list[str], losses: list[Loss]) -> tuple[Int, Float]:
        """Both columns by time, which increases strictly; what is left out is added to warnings and losses."""
        t_ns, values = self.arrays()
        kept = kept_rows(t_ns)
        lost = clock_losses(topic, "messages", [t_ns])
        losses += lost
        if equal := len(t_ns) - len(kept) - sum(each.count or 0 for each in lost):
            warnings.append(f"{topic}: {equal} of {len(t_ns)} messages have the stamp of another; they are dropped")
        return t_ns[kept], values[kept]


class Gatherer:
    """Files messages, and columns of them, under every role that their topics have.

    moving: the topics to read, static transforms apart; moving_tf: those of transforms among them.
    """

    def __init__(
        self,
        uwb: Sequence[str] = (),
        odometry: str | None = None,
        imu: str | None = None,
        reference: str | None = None,
        target: str | None = None,
        tf: Sequence[str] = (),
        joints: str | None = None,
        estimates: Sequence[str] = (),
        lidar: str | None = None,
    ) -> None:
        single = (odometry, imu, joints, reference, target, lidar)
        topics = dict.fromkeys([*uwb, *(topic for topic in single if topic), *estimates, *tf])
        self.static = [topic for topic in tf if is_static(topic)]
        self.moving = [topic for topic in topics if topic not in self.static]
        self.moving_tf = [topic for topic in tf if topic not in self.static]
        self.tree = TransformTree()
        self._uwb, self._imu_topic, self._joints_topic = set(uwb), imu, joints
        self._estimates = {f"estimate {topic}": topic for topic in estimates}
        self._pose_topics = {"odometry": odometry, "reference": reference, "target": target, **self._estimates}
        self._ranges = _Columns(5)  # tag, anchor, range, gap, and the topic by its number in _range_topics
        self._range_topics: dict[str, int] = {}
        self._nameless: dict[str, int] = {}
        self._unmeasured: dict[str, int] = {}  # why -> how many ranges
        self._poses = {role: _Columns(13) for role in self._pose_topics}
        self._columns_of_topic: dict[str, list[_Columns]] = {}
        for role, topic in self._pose_topics.items():
            self._columns_of_topic.setdefault(topic or "", []).append(self._poses[role])
        self._imu = _Columns(7)
        self._joints = _Columns(_JOINT_VALUES, "f")
        self._stamp = ""
        self._places = AnchorPlaces()
        self._lidar, self._clouds_ns = lidar, array("q")
        self._warnings: list[str] = []
        self._losses: list[Loss] = []

    def take_all(
        self,
        topics: Sequence[str],
        recording: Recording,
        start_ns: int | None = None,
        end_ns: int | None = None,
        watch: Callable[[str], object] = lambda _: None,
    ) -> None:
        """File all that topics hold in a window; see gather."""
        for gathered in recording.gathered(topics, start_ns, end_ns) if topics else ():
            self.take(gathered, recording.stamp)
            watch(gathered.topic)

    def take(self, gathered: Gathered, stamp: str) -> None:
        """File what was read."""
        self._stamp = stamp
        if isinstance(gathered, Many):
            self._take_columns(*gathered)
            return
        order, t_ns, topic, content = gathered
        if isinstance(content, Imu):
            if topic != self._imu_topic:
                return
            self._imu.name(order, content.frame_id)
            quaternion = _NO_QUATERNION if content.quat_xyzw is None else content.quat_xyzw.tolist()
            self._imu.add(order, t_ns, [*content.angular_radps.tolist(), *quaternion])
        elif isinstance(content, (Pose, Odometry)):
            for column in self._columns_of_topic.get(topic, ()):
                _take_pose(order, t_ns, content, column)
        elif isinstance(content, JointStates):
            if topic == self._joints_topic:
                fields = (content.position_rad, content.velocity_radps, content.torque_nm, content.foot_force_n)
                self._joints.add(order, t_ns, [*np.concatenate(fields).tolist(), content.tick])
        elif isinstance(content, PointCloud):
            if topic == self._lidar:
                self._clouds_ns.append(t_ns)
        elif isinstance(content, UwbRanges):
            if topic in self._uwb:
                self._take_ranges(order, t_ns, topic, content)
        elif isinstance(content, Transforms):
            for pose in content.transforms:
                own_ns = t_ns if stamp == "log" or not pose.stamp_ns else pose.stamp_ns
                self.tree.add(own_ns, pose, static=content.static, order=order, topic=topic)

    def _take_columns(self, order: Int, t_ns: Int, topic: str, columns: Columns) -> None:
        last = int(order[-1])
        if columns.kind is Imu:
            if topic == self._imu_topic:
                self._imu.name(last, columns.frame_id)
                self._imu.extend(order, t_ns, columns.values)
        elif columns.kind is JointStates:
            if topic == self._joints_topic:
                self._joints.extend(order, t_ns, columns.values)
        elif columns.kind is UwbRanges:
            if topic in self._uwb:
                self._take_range_columns(order, t_ns, topic, columns.values)
        elif topic in self._columns_of_topic:
            twist = np.zeros((len(order), 13 - columns.values.shape[1]))
            values = np.concatenate([columns.values, twist], axis=1)
            for column in self._columns_of_topic[topic]:
                column.name(last, columns.frame_id, columns.child_frame_id)
                column.extend(order, t_ns, values)
        elif columns.kind is Pose:
            self.tree.add_moving(topic, columns.frame_id, columns.child_frame_id, order, t_ns, columns.values)

    def _take_range_columns(self, order: Int, t_ns: Int, topic: str, values: Float) -> None:
        row, anchor = np.nonzero(values[:, 1:])
        number = self._range_topics.setdefault(topic, len(self._range_topics))
        measured = [values[row, 0], anchor, values[row, 1 + anchor], np.full(len(row), nan), np.full(len(row), number)]
        self._ranges.extend(order[row], t_ns[row], np.column_stack(measured))

    def _take_ranges(self, order: int, t_ns: int, topic: str, message: UwbRanges) -> None:
        self._places.take(message)
        if message.unmeasured:
            self._unmeasured[message.unmeasured] = self._unmeasured.get(message.unmeasured, 0) + 1
        if message.tag is None:
            self._nameless[topic] = self._nameless.get(topic, 0) + len(message.range_m)
            return
        anchors, given = message.anchor.tolist(), message.first_path_gap_db
        gaps = [nan] * len(anchors) if given is None else given.tolist()
        number = self._range_topics.setdefault(topic, len(self._range_topics))
        for anchor, range_m, gap in zip(anchors, message.range_m.tolist(), gaps, strict=True):
            self._ranges.add(order, t_ns, (message.tag, anchor, range_m, gap, number))

    def streams(self) -> Streams:
        """Everything taken so far, as series."""
        for topic, count in sorted(self._nameless.items()):
            self._warnings.append(
                f"{topic}: {count} ranges without ids are left out; name their ends in [[uwb.range_topics]]"
            )
        odometry, twist = self._pose_series("odometry")
        reference, _ = self._pose_series("reference")
        target, _ = self._pose_series("target")
        estimates = {topic: self._pose_series(role)[0] for role, topic in self._estimates.items()}
        ranges, gap_db = self._range_series()
        if self._stamp == "auto":
            self._spread_joints()
        imu, joints = self._imu_series(), self._joint_series()
        for topic in self.moving_tf:
            self._losses += clock_losses(topic, "transforms", self.tree.stamps(topic))
        clouds_ns = np.array(self._clouds_ns, np.int64)
        self._losses += clock_losses(str(self._lidar), "clouds", [clouds_ns])
        return Streams(
            ranges=ranges,
            range_gap_db=gap_db,
            odometry=odometry,
            odometry_linear_mps=None if odometry is None else twist[:, :3],
            odometry_angular_radps=None if odometry is None else twist[:, 3:],
            imu=imu,
            reference=reference,
            target=target,
            tf=self.tree,
            warnings=self._warnings,
            losses=self._losses,
            anchor_places=self._places.found(),
            clouds_ns=clouds_ns,
            repeated_clouds=repeated_rows(clouds_ns),
            joints=joints,
            estimates={topic: series for topic, series in estimates.items() if series is not None},
        )

    def _range_series(self) -> tuple[RangeSeries | None, Float | None]:
        t_ns, values = self._ranges.arrays()
        total = len(t_ns) + sum(self._unmeasured.values())
        for why, count in sorted(self._unmeasured.items()):
            self._warnings.append(f"{count} of {total} ranges were not measured and are left out: {why}")
        if len(t_ns) == 0:
            return None, None
        t_ns, values = self._on_one_clock(t_ns, values)
        order = np.argsort(t_ns, kind="stable")
        t_ns, values = t_ns[order], values[order]
        tag, anchor = values[:, 0].astype(np.int64), values[:, 1].astype(np.int64)
        return RangeSeries(t_ns, tag, anchor, values[:, 2].copy()), values[:, 3].copy()

    def _on_one_clock(self, t_ns: Int, values: Float) -> tuple[Int, Float]:
        """Both columns without what a clock that was set back stamps a second time.

        Link by link: tags that share a topic may be late by different amounts.
        """
        topic = values[:, 4].astype(np.int64)
        order = np.lexsort((values[:, 1], values[:, 0], topic))
        link = np.column_stack([topic, values[:, :2]])[order]
        links = np.split(order, np.flatnonzero((link[1:] != link[:-1]).any(axis=1)) + 1)
        repeated = np.zeros(len(t_ns), dtype=bool)
        for rows in links:
            repeated[rows] = repeated_rows(t_ns[rows])
        for name, index in self._range_topics.items():
            mine = [t_ns[rows] for rows in links if topic[rows[0]] == index]
            self._losses += clock_losses(name, "ranges", mine)
        return t_ns[~repeated], values[~repeated]

    def _pose_series(self, role: str) -> tuple[PoseSeries | None, Float]:
        column = self._poses[role]
        t_ns, values = column.increasing(str(self._pose_topics[role]), self._warnings, self._losses)
        if len(t_ns) == 0:
            return None, values[:, 7:]
        series = PoseSeries(t_ns, values[:, :3].copy(), values[:, 3:7].copy(), column.frame_id, column.child_frame_id)
        return series, values[:, 7:].copy()

    def _spread_joints(self) -> None:
        """Joints that come in bursts, and the IMU beside them, get the times at which they were sent."""
        logged_ns, values = self._joints.arrays()
        t_ns, how = spread(logged_ns, values[:, -1].astype(np.float64))
        if how:
            self._warnings.append(
                f"{self._joints_topic}: joints come in bursts ({how}; as they are stamped:  --stamp header"
            )
            self._joints.set_times(t_ns)
            imu_ns, _ = self._imu.arrays()
            same = np.array_equal(imu_ns, logged_ns)
            self._imu.set_times(t_ns if same else spread(imu_ns, np.full(len(imu_ns), nan))[0])

    def _imu_series(self) -> ImuSeries | None:
        t_ns, values = self._imu.increasing(str(self._imu_topic), self._warnings, self._losses)
        if len(t_ns) == 0:
            return None
        quaternions = values[:, 3:].copy()
        oriented = bool(np.isfinite(quaternions).all())
        if not oriented and np.isfinite(quaternions).any():
            self._warnings.append(f"{self._imu_topic}: not every message has an orientation; none is used")
        return ImuSeries(t_ns, values[:, :3].copy(), quaternions if oriented else None, self._imu.frame_id)

    def _joint_series(self) -> JointSeries | None:
        topic = str(self._joints_topic)
        t_ns, values = self._joints.increasing(topic, self._warnings, self._losses)
        if len(t_ns) == 0:
            return None
        parts = {"angles": values[:, :12], "speeds": values[:, 12:24], "torques": values[:, 24:36]}
        parts["foot forces"] = values[:, 36:40]
        for what, part in parts.items():
            unfit = ~(np.abs(part) <= MOST_OF_A_JOINT)
            # A message that gives none of them has NaN everywhere.
            if unfit.any() and not np.isnan(part).all():
                self._warnings.append(f"{topic}: {unfit.sum()} of {unfit.size} {what} are no finite numbers; left out")
            part[unfit] = np.nan
        for what in ("torques", "foot forces"):
            # Drivers that measure none write zeros.
            if not np.nan_to_num(parts[what]).any():
                parts[what][:] = np.nan
        return JointSeries(t_ns, *parts.values())


def _take_pose(order: int, t_ns: int, message: Pose | Odometry, column: _Columns) -> None:
    twist = _NO_TWIST
    if isinstance(message, Odometry):
        twist = [*message.linear_mps.tolist(), *message.angular_radps.tolist()]
    column.name(order, message.frame_id, message.child_frame_id)
    column.add(order, t_ns, [*message.position_m.tolist(), *message.quat_xyzw.tolist(), *twist])
