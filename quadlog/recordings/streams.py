"""The small topics of a recording, read in one pass as series, and the stamps of its clouds."""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import quat_from_euler, turned, yaw_from_quat
from quadlog.messages import (
    NO_ID,
    NS_PER_S,
    UNPLACED,
    Batch,
    Float,
    Imu,
    ImuSeries,
    Int,
    JointSeries,
    JointStates,
    Message,
    Odometry,
    Pose,
    PoseSeries,
    RangeSeries,
    Timed,
    Transforms,
    Twist,
    TwistSeries,
    UwbRanges,
)
from quadlog.recordings.clocks.bursts import spread
from quadlog.recordings.clocks.clock import Mask, Sender, clock_losses, goes_back, kept_rows, left_out
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.decoders.anchor_places import AnchorPlace, places_of
from quadlog.recordings.reading import Pass
from quadlog.recordings.recording import Recording
from quadlog.recordings.tf_tree import WORLD_FRAMES, TransformTree, is_named, is_static

MOST_OF_A_JOINT = 1e5
"""Larger angles, rates, torques and forces are no measurements."""


@dataclass(frozen=True, slots=True)
class Streams:
    """What `gather` found; None for a role without topic or without a single message.

    range_gap_db: (N,) receiver minus first-path power beside ranges, NaN where a message has none.
    odometry_linear_mps, odometry_angular_radps: (N, 3) beside odometry.
    anchor_places: anchor id -> where the range messages say that it is. estimates: pose topic -> its poses.
    losses: of topics whose clock was set back. clouds_ns: (C,) stamps of the clouds in the order in which they came;
    clouds_of: (C,) by the number of their topic; repeated_clouds: (C,) those that a clock that was set stamps wrongly.
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
    clouds_of: Int
    repeated_clouds: Mask
    joints: JointSeries | None = None
    commands: TwistSeries | None = None
    estimates: Mapping[str, PoseSeries] = field(default_factory=dict)


class Wanted(NamedTuple):
    """Topics by role."""

    uwb: Sequence[str] = ()
    odometry: str | None = None
    imu: str | None = None
    reference: str | None = None
    target: str | None = None
    tf: Sequence[str] = ()
    joints: str | None = None
    command: str | None = None
    estimates: Sequence[str] = ()
    lidar: Sequence[str] = ()

    def topics(self, *, static: bool) -> list[str]:
        """Those of static transforms, which hold before any window too, or all others, each once."""
        single = (self.odometry, self.imu, self.joints, self.reference, self.target, self.command)
        topics = dict.fromkeys([*self.uwb, *filter(None, single), *self.estimates, *self.lidar, *self.tf])
        return [topic for topic in topics if (topic in self.tf and is_static(topic)) == static]

    def kinds(self) -> dict[type[Message], set[str | None]]:
        """The topics of each kind of rows."""
        poses = {self.odometry, self.reference, self.target, self.command, *self.estimates}
        kinds: dict[type[Message], set[str | None]] = {Pose: poses, Odometry: poses, Imu: {self.imu}}
        return kinds | {
            Twist: {self.command},
            JointStates: {self.joints},
            UwbRanges: {*self.uwb},
            Transforms: {*self.tf},
        }


def gather(
    recording: Recording,
    start_ns: int | None = None,
    end_ns: int | None = None,
    watch: Callable[[str], object] = lambda _: None,
    **topics: Any,
) -> Streams:
    """Read topics by role, those of Wanted, once (static transforms apart: they count from before start_ns too).

    watch: called with the topic of all that is read.
    Messages that have overtaken one another are sorted. Where a clock was set
    back, what it stamps a second time is dropped, which is a loss, because two
    walks would interleave. Times increase strictly except those of ranges: a
    message with the stamp of another is dropped and counted in warnings.
    Raises ClocksDiffer.
    """
    logged = _Logged(Wanted(**topics))
    logged.read(recording, static=True)
    logged.read(recording, start_ns, end_ns, watch)
    return logged.streams(spread_bursts=recording.stamp == "auto")


def look_at_frames(recording: Recording, tf: Sequence[str]) -> TransformTree:
    """The frames that all static transforms and an excerpt of the others show, on log times."""
    logged = _Logged(Wanted(tf=tf))
    logged.read(recording, static=True)
    if not all(map(is_static, tf)):
        logged.read(recording.glimpse())
    return logged.streams().tf


class _Track(NamedTuple):
    """Rows (N,) of a kind, of a topic or of a transform, as logged; log times (N,), and the frames of the last row."""

    topic: str
    rows: NDArray[np.void]
    log_ns: Int
    frame_id: str = ""
    child_frame_id: str = ""

    @classmethod
    def of(cls, batches: Sequence[Batch]) -> _Track:
        """The rows of all batches; of ranges without the places of anchors, which some messages may have alone."""
        ranges = batches[0].kind is UwbRanges
        rows = np.concatenate([each.rows[list(UNPLACED.names or ())] if ranges else each.rows for each in batches])
        log_ns = np.concatenate([each.log_ns for each in batches])
        if (np.diff(rows["order"]) < 0).any():
            by_order = np.argsort(rows["order"], kind="stable")
            rows, log_ns = rows[by_order], log_ns[by_order]
        last = max(batches, key=lambda each: int(each.rows["order"][-1]))
        return cls(last.topic, rows, log_ns, last.frame_id, last.child_frame_id)

    @property
    def t_ns(self) -> Int:
        """Their times (N,), a view."""
        times: Int = self.rows["t_ns"]
        return times

    def columns(self, *names: str) -> list[Any]:
        """Copies of their times and of columns, with which the rows can go."""
        return [self.rows[name].copy() for name in ("t_ns", *names)]

    def parts(self, kind: type[Message]) -> list[NDArray[np.intp]]:
        """The rows of each sender: of ranges of each link, since tags of a topic may be late by different amounts."""
        if kind is not UwbRanges or not goes_back(self.t_ns):
            return [np.arange(len(self.rows))]
        order = np.lexsort((self.rows["anchor"], self.rows["tag"]))
        link = np.column_stack([self.rows["tag"], self.rows["anchor"]])[order]
        return np.split(order, np.flatnonzero((link[1:] != link[:-1]).any(axis=1)) + 1)


_Key = tuple[type[Message], str, str]
_THINGS: dict[type[Message], str] = {UwbRanges: "ranges", Transforms: "transforms"}


class _Logged:
    """What was read of the wanted topics, and the series that it makes."""

    def __init__(self, wanted: Wanted) -> None:
        self._wanted, self._kinds = wanted, wanted.kinds()
        self._static: dict[_Key, list[Batch]] = defaultdict(list)
        self._batches: dict[_Key, list[Batch]] = defaultdict(list)
        self._clouds = array("q")  # number of the topic, log time and time of each
        self._unmeasured = Counter[str]()
        self._warnings: list[str] = []

    def read(
        self,
        recording: Recording,
        start_ns: int | None = None,
        end_ns: int | None = None,
        watch: Callable[[str], object] = lambda _: None,
        *,
        static: bool = False,
    ) -> None:
        """Keep what the wanted topics hold in a window: static transforms, or all else."""
        topics, reading = self._wanted.topics(static=static), Pass(recording, start_ns, end_ns)
        for each in recording.read(topics, reading) if topics else ():
            watch(each.topic)
            if isinstance(each, Timed):
                if each.topic in self._wanted.lidar:
                    self._clouds.extend((self._wanted.lidar.index(each.topic), reading.log_ns, each.t_ns))
            elif each.unmeasured:
                self._unmeasured[each.unmeasured] += len(each.rows)
            elif each.topic in self._kinds[each.kind]:
                names = (each.frame_id, each.child_frame_id) if each.kind is Transforms else (each.topic, "")
                (self._static if static else self._batches)[each.kind, *names].append(each)

    def streams(self, *, spread_bursts: bool = False) -> Streams:
        """All series. spread_bursts: joints that come in bursts get the times at which they were sent."""
        wanted, warnings = self._wanted, self._warnings
        places = places_of(each.rows for key, some in self._batches.items() if key[0] is UwbRanges for each in some)
        tracks = {key: _Track.of(self._batches.pop(key)) for key in [*self._batches]}
        if spread_bursts:
            self._spread_joints(tracks)
        clouds = np.array(self._clouds, np.int64).reshape(-1, 3).T
        losses, repeated_clouds = self._put_right(tracks, clouds)
        ranges, gap_db = self._ranges(tracks)
        poses = {topic: _poses(tracks, topic) for topic in self._kinds[Pose]}
        odometry, twist = poses[wanted.odometry], tracks.get((Odometry, str(wanted.odometry), ""))
        velocities = [None, None] if odometry is None else [np.zeros((len(odometry), 3))] * 2
        if twist is not None:
            _, *velocities = twist.columns("linear_mps", "angular_radps")
        return Streams(
            ranges=ranges,
            range_gap_db=gap_db,
            odometry=odometry,
            odometry_linear_mps=velocities[0],
            odometry_angular_radps=velocities[1],
            imu=self._imu(tracks),
            reference=poses[wanted.reference],
            target=poses[wanted.target],
            tf=self._tree(tracks),
            warnings=warnings,
            losses=losses,
            anchor_places=places,
            clouds_ns=clouds[2],
            clouds_of=clouds[0],
            repeated_clouds=repeated_clouds,
            joints=self._joints(tracks),
            commands=_commands(tracks, wanted.command),
            estimates={topic: series for topic in wanted.estimates if (series := poses[topic]) is not None},
        )

    def _put_right(self, tracks: dict[_Key, _Track], clouds: Int) -> tuple[list[Loss], Mask]:
        """Bring tracks in the order of time, without what a clock that was set stamps wrongly; which clouds these are.

        Equal stamps, of which the first is kept, are counted in warnings. clouds: (3, C) as in _clouds.
        """
        parts = [(key, rows) for key, track in tracks.items() for rows in track.parts(key[0])]
        senders = [
            Sender(tracks[key].topic, _THINGS.get(key[0], "messages"), tracks[key].log_ns[rows], tracks[key].t_ns[rows])
            for key, rows in parts
        ]
        scanners = [clouds[0] == number for number in range(len(self._wanted.lidar))]
        for topic, mine in zip(self._wanted.lidar, scanners, strict=True):
            senders.append(Sender(topic, "clouds", *clouds[1:, mine]))
        masks, repeated = left_out(senders), np.zeros(clouds.shape[1], np.bool_)
        for mine, mask in zip(scanners, masks[len(parts) :], strict=True):
            repeated[mine] = mask
        whole = {key: np.zeros(len(track.rows), np.bool_) for key, track in tracks.items()}
        for (key, rows), mask in zip(parts, masks[: len(parts)], strict=True):
            whole[key][rows] = mask
        for key, track in tracks.items():
            repeats = key[0] is UwbRanges  # ranges of one instant are several
            if not whole[key].any() and (np.diff(track.t_ns) >= (not repeats)).all():
                continue
            kept = kept_rows(track.t_ns, whole[key], equal=repeats)
            equal = len(track.rows) - len(kept) - int(whole[key].sum())
            if equal and key[0] is not Transforms:
                some = f"{track.topic}: {equal} of {len(track.rows)} messages"
                self._warnings.append(f"{some} have the stamp of another; they are dropped")
            tracks[key] = track._replace(rows=track.rows[kept])
        return clock_losses(senders, masks), repeated

    def _tree(self, tracks: Mapping[_Key, _Track]) -> TransformTree:
        tree = TransformTree()
        static = {key: _Track.of(batches) for key, batches in self._static.items()}
        for key, track in [*static.items(), *tracks.items()]:
            if key[0] is Transforms:
                pose = np.column_stack([track.rows["position_m"], track.rows["quat_xyzw"]])
                tree.add(track.topic, *key[1:], track.t_ns.copy(), pose, static=key in static)
        return tree

    def _ranges(self, tracks: Mapping[_Key, _Track]) -> tuple[RangeSeries | None, Float | None]:
        """Ranges of all topics by time, without those that have no ids."""
        found = []
        for track in (tracks[key] for key in tracks if key[0] is UwbRanges):
            known = (track.rows["tag"] != NO_ID) & (track.rows["anchor"] != NO_ID)
            if count := int((~known).sum()):
                some = f"{track.topic}: {count} ranges without ids"
                self._warnings.append(f"{some} are left out; name their ends in [[uwb.range_topics]]")
            found.append(track.rows[known])
        total = sum(map(len, found)) + self._unmeasured.total()
        for why, count in sorted(self._unmeasured.items()):
            self._warnings.append(f"{count} of {total} ranges were not measured and are left out: {why}")
        if not any(map(len, found)):
            return None, None
        names = ("order", "t_ns", "tag", "anchor", "range_m", "first_path_gap_db")
        order, *columns = (np.concatenate([rows[name] for rows in found]) for name in names)
        by_time = np.lexsort((order, columns[0])) if len(found) > 1 else slice(None)
        *series, gap_db = (column[by_time] for column in columns)
        return RangeSeries(*series), gap_db

    def _spread_joints(self, tracks: Mapping[_Key, _Track]) -> None:
        """Joints that come in bursts, and the IMU beside them, get the times at which they were sent."""
        topic = self._wanted.joints
        joints, imu = tracks.get((JointStates, str(topic), "")), tracks.get((Imu, str(self._wanted.imu), ""))
        if joints is None:
            return
        logged_ns = joints.t_ns.copy()
        t_ns, how = spread(logged_ns, joints.rows["tick"].astype(np.float64))
        if not how:
            return
        self._warnings.append(f"{topic}: joints come in bursts ({how}; as they are stamped:  --stamp header")
        joints.t_ns[:] = t_ns
        if imu is not None:
            same = np.array_equal(imu.t_ns, logged_ns)
            imu.t_ns[:] = t_ns if same else spread(imu.t_ns.copy(), np.full(len(imu.rows), np.nan))[0]

    def _imu(self, tracks: Mapping[_Key, _Track]) -> ImuSeries | None:
        track = tracks.get((Imu, str(self._wanted.imu), ""))
        if track is None:
            return None
        t_ns, rates, quat_xyzw = track.columns("angular_radps", "quat_xyzw")
        finite = np.isfinite(quat_xyzw)
        if finite.any() and not finite.all():
            self._warnings.append(f"{track.topic}: not every message has an orientation; none is used")
        return ImuSeries(t_ns, rates, quat_xyzw if finite.all() else None, track.frame_id)

    def _joints(self, tracks: Mapping[_Key, _Track]) -> JointSeries | None:
        track = tracks.get((JointStates, str(self._wanted.joints), ""))
        if track is None:
            return None
        t_ns, *parts = track.columns("position_rad", "velocity_radps", "torque_nm", "foot_force_n")
        for what, part in zip(("angles", "speeds", "torques", "foot forces"), parts, strict=True):
            unfit = ~(np.abs(part) <= MOST_OF_A_JOINT)
            # A message that gives none of them has NaN everywhere.
            if unfit.any() and not np.isnan(part).all():
                some = f"{track.topic}: {unfit.sum()} of {unfit.size} {what}"
                self._warnings.append(f"{some} are no finite numbers; left out")
            part[unfit] = np.nan
            # Drivers that measure none write zeros.
            if what in ("torques", "foot forces") and not np.nan_to_num(part).any():
                part[:] = np.nan
        return JointSeries(t_ns, *parts)


MOVED_OVER_S = 0.2
"""Speeds that a pose does not come with are its differences over so long."""


def _commands(tracks: Mapping[_Key, _Track], topic: str | None) -> TwistSeries | None:
    """Velocities in the body: as they are wanted or were measured; without any the differences of poses."""
    kinds = ((kind, str(topic), "") for kind in (Twist, Odometry, Pose))
    track = next((tracks[key] for key in kinds if key in tracks), None)
    if track is None:
        return None
    t_ns, rows, names = track.t_ns.copy(), track.rows, track.rows.dtype.names or ()
    placed = "position_m" in names and not np.isnan(rows["position_m"]).any()
    if "linear_mps" in names and (rows["linear_mps"].any() or not placed):
        return TwistSeries(t_ns, np.column_stack([rows["linear_mps"][:, :2], rows["angular_radps"][:, 2]]))
    yaw_rad = np.unwrap(yaw_from_quat(rows["quat_xyzw"]))
    ends_ns = [np.clip(t_ns + sign * MOVED_OVER_S / 2 * NS_PER_S, t_ns[0], t_ns[-1]) for sign in (-1, 1)]
    poses = (*rows["position_m"].T[:2], yaw_rad)
    before, after = (np.column_stack([np.interp(at_ns, t_ns, each) for each in poses]) for at_ns in ends_ns)
    moved = (after - before) / np.maximum(ends_ns[1] - ends_ns[0], 1)[:, None] * NS_PER_S
    return TwistSeries(t_ns, np.column_stack([turned(-yaw_rad, moved[:, :2]), moved[:, 2]]))


VELOCITY_FRAME = "velocity_start"


def _integrated(t_ns: Int, linear_mps: Float, angular_radps: Float, frame: str) -> PoseSeries:
    """Poses (N,) from the origin on, turned about z alone, by velocities along a body's axes, or along a world's."""
    step_s, in_world = np.diff(t_ns)[:, None] * 1e-9, is_named(frame, WORLD_FRAMES)
    mean_mps, mean_radps = ((each[1:] + each[:-1]) / 2 for each in (linear_mps, angular_radps))
    yaw_rad = np.append(0.0, np.cumsum(mean_radps[:, 2:] * step_s))
    steps_m = turned((yaw_rad[1:] + yaw_rad[:-1]) / 2 * (not in_world), mean_mps * step_s)
    position_m = np.concatenate([np.zeros((1, 3)), np.cumsum(steps_m, axis=0)])
    return PoseSeries(t_ns, position_m, quat_from_euler(yaw_rad), VELOCITY_FRAME, "" if in_world else frame)


def _poses(tracks: Mapping[_Key, _Track], topic: str | None) -> PoseSeries | None:
    track = tracks.get((Odometry, str(topic), "")) or tracks.get((Pose, str(topic), ""))
    if track is None:
        return None
    t_ns, position_m, quat_xyzw = track.columns("position_m", "quat_xyzw")
    if np.isnan(position_m).all():
        return _integrated(t_ns, track.rows["linear_mps"], track.rows["angular_radps"], track.child_frame_id)
    return PoseSeries(t_ns, position_m, quat_xyzw, track.frame_id, track.child_frame_id)
