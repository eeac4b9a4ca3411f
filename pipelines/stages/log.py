"""A recording that is open for a replay: the roles of its topics, its window, and what its small topics hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from quadlog.config.controllers import COMMAND
from quadlog.config.schema import Config, Mount
from quadlog.errors import MAX_LISTED, MissingInput, NothingToReplay, QuadlogError, set_flag
from quadlog.lidar.levelling import UpSeries
from quadlog.lidar.point_times import AS_THEY_COME, TimeReading, find_reading
from quadlog.messages import PointCloud
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.request import ReplayOptions
from quadlog.pipelines.stages import mount as mounts
from quadlog.pipelines.stages.all_stages import READING
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.stages.outlook import Outlook, locates_by_uwb
from quadlog.pipelines.stages.positions.uwb import with_carried_anchors
from quadlog.pipelines.stages.scanners import Scanners, Sweep
from quadlog.pipelines.store import only
from quadlog.recordings.recording import open_recording
from quadlog.recordings.streams import Streams, gather
from quadlog.recordings.topics.roles import detect_roles, position_topics
from quadlog.results import STAGES
from quadlog.results.record import InputRecord, describe_input_aside

if TYPE_CHECKING:
    from quadlog.pipelines.stages.scans import LidarTracker
    from quadlog.positioning.leg_odometry import LegTrack


@dataclass(frozen=True)
class Log(Outlook):
    """What a replay knows of its recording before it reads it; path: as it was given."""

    path: Path
    options: ReplayOptions
    by_command: bool = False

    def last_stage(self) -> str:
        """The last stage that was asked for, or of those that need no lidar where it was not by its name.

        by_command: commands drive the simulated robot, which needs no map. Raises MissingInput and AmbiguousTopic.
        """
        until, may_walk = self.options.until, self.by_command and self.options.until in ("control", "report")
        if may_walk and self.roles.topic("command") is None:
            raise MissingInput("control", self.roles.why_none("command"), "choose another  --controller")
        if (until == "report" or may_walk) and "lidar" not in self.roles.found:
            return "control" if may_walk else "position"
        if STAGES.index(until) >= STAGES.index("filter") and self.roles.topic("lidar") is None:
            raise MissingInput("filter", self.roles.why_none("lidar"), "stop before it with  --until position")
        return until

    @cached_property
    def window(self) -> tuple[int | None, int | None]:
        """--start and --duration as instants on the chosen clock, None where it is open."""
        start_s, duration_s = self.options.start_s, self.options.duration_s
        if start_s is None and duration_s is None:
            return None, None
        start_ns = self._first_ns() + round((start_s or 0.0) * 1e9)
        return start_ns, None if duration_s is None else start_ns + round(duration_s * 1e9)

    def _first_ns(self) -> int:
        first = next(iter(self.recording.messages(self.roles.played)), None)
        if first is not None:
            return first.t_ns
        heard = [topic for topic in self.roles.played if topic not in self.unheard]
        raw = next(iter(self.recording.container.messages(heard)), None) if heard else None
        if raw is None:
            raise NothingToReplay(self.recording.path, self.why_nothing())
        return raw.log_time_ns  # of messages that hold nothing, as of tags that hear no anchor

    def span_ns(self, streams: Streams) -> tuple[int, int]:
        """First and last instant of what was read; of a reference, or commands, where there is nothing else.

        Raises QuadlogError when --start and --duration leave nothing, NothingToReplay when there never was anything.
        """
        series = [streams.ranges, streams.odometry, streams.imu, streams.joints, streams.target]
        times_ns = [each.t_ns for each in (*series, *streams.estimates.values()) if each is not None]
        tf_ns = np.array(streams.tf.span_ns() or (), np.int64)
        t_ns = np.concatenate([*times_ns, streams.clouds_ns[~streams.repeated_clouds], tf_ns])
        for each in (streams.reference, streams.commands):
            if not len(t_ns) and each is not None:
                t_ns = each.t_ns
        if len(t_ns):
            return int(t_ns.min()), int(t_ns.max())
        begin_ns = self._first_ns()
        if self.window != (None, None):
            span_ns = self.recording.span_ns
            length = f"; the recording lasts {(span_ns[1] - span_ns[0]) * 1e-9:.1f} s" if span_ns else ""
            raise QuadlogError(f"{self.recording.path}: no message within --start and --duration{length}")
        return begin_ns, begin_ns


@contextmanager
def open_log(path: Path, config: Config, options: ReplayOptions) -> Iterator[Log]:
    """Open a recording and detect the roles of its topics; only its index and a few messages are read."""
    by_command, config = config.simulation.controller == COMMAND, only(config, READING)
    with open_recording(path, config, msg_path=options.msg_path, stamp=options.stamp) as recording:
        roles = detect_roles(recording, config.topics)
        if config.lidar.mount != Mount():
            roles.frames.bodies.clear()  # base is what the mount is given in, not what odometry is of
        yield Log(recording, roles, config, locates_by_uwb(recording, roles, config), path, options, by_command)


@dataclass(frozen=True)
class LogData:
    """What the small topics of a log hold, and the stamps of its clouds, which are streamed apart.

    config: of the stage that uses it. mount: of the lidar; mover: of clouds whose frame moves in base. up: which way is
    up in base, None where it is unknown. first_ns, last_ns: first and last instant. legs, tracker: the body's track by
    its joints and by its clouds, None where there is none. scanners: of several, whose clouds are those of one in base.
    """

    log: Log
    config: Config
    input: InputRecord
    streams: Streams
    mount: mounts.LidarMount
    mover: mounts.CloudMover | None
    up: UpSeries | None
    first_ns: int
    last_ns: int
    legs: LegTrack | None = None
    tracker: LidarTracker | None = None
    point_times: TimeReading = AS_THEY_COME
    scanners: Scanners | None = None

    @property
    def anchors_carried(self) -> bool:
        """Whether the anchors are those that the messages place."""
        return with_carried_anchors(self.log.config, self.streams.anchor_places) is not self.log.config

    def clouds(self) -> Iterator[tuple[int, PointCloud]]:
        """The clouds and their stamps, without those that a clock that was set stamps wrongly."""
        logged = self.log.recording.messages(self.log.lidars, *self.log.window)
        if self.scanners is not None:
            yield from ((t_ns, self.scanners.as_one(t_ns, sweeps)) for t_ns, sweeps in self.scanners.turns(logged))
            return
        repeated = iter(self.streams.repeated_clouds.tolist())
        for t_ns, _, cloud in logged:
            if isinstance(cloud, PointCloud) and not next(repeated, False):
                yield t_ns, self.point_times.timed(cloud) if self.mover is None else self.mover.moved(t_ns, cloud)

    def turns(self) -> Iterator[tuple[int, list[Sweep]]]:
        """The same, each scanner's by itself and as it was taken."""
        if self.scanners is None:
            yield from ((t_ns, [Sweep(0, t_ns, cloud)]) for t_ns, cloud in self.clouds())
        else:
            yield from self.scanners.turns(self.log.recording.messages(self.log.lidars, *self.log.window))


def read_log(log: Log, progress: Progress) -> LogData:
    """The first reading of a log: the small topics, and the stamps of its clouds.

    Raises AmbiguousTopic for a role that is needed, QuadlogError for an empty window, NothingToReplay and ClocksDiffer.
    """
    recording, roles, config = log.recording, log.roles, log.config
    described = describe_input_aside(log.path)
    topics = log.topics_to_read()
    counts = [channel.count for topic in log.lidars for channel in recording.channels_of(topic)]
    progress.begin("ingest", None if None in counts or log.window != (None, None) else sum(filter(None, counts)))

    def watch(topic: str) -> None:
        if topic in log.lidars:
            progress.advance()

    streams = gather(recording, *log.window, watch, **topics)
    frames = roles.frames
    found = [mounts.find_mount(recording, roles, config, topic, topics["odometry"]) for topic in log.lidars]
    mount = found[0] if found else mounts.find_mount(recording, roles, config, None, None)
    streams = mounts.poses_in_base(streams, frames.base or "", mount, topics)
    streams.warnings.extend(_sender_warnings(log, streams))
    imu = streams.imu
    if imu is not None and (wrong := mounts.orientation_warning(recording, str(topics["imu"]), imu)) is not None:
        streams.warnings.append(wrong)
        imu = replace(imu, quat_xyzw=None)
    gap_ns = round(config.lidar.pose_gap_s * 1e9)
    movers = [None if each.moving is None else mounts.CloudMover(each, streams, gap_ns) for each in found]
    streams.warnings.extend(_of_mounts(log, found, movers, streams))
    scanners = Scanners.of(log, found, movers, streams) if len(found) > 1 else None
    if scanners is not None:
        streams, mount = scanners.one(streams), mounts.LidarMount(np.eye(4))
    mover = movers[0] if len(movers) == 1 else None
    first_ns, last_ns = log.span_ns(streams)
    data = LogData(
        log=log,
        config=config,
        input=described.result(),
        streams=replace(streams, imu=None if imu is None else mounts.imu_in_base(imu, frames)),
        mount=mount,
        mover=mover,
        up=mounts.up_of_base(streams, frames, roles.base_in_map, imu) if config.lidar.level else None,
        first_ns=first_ns,
        last_ns=last_ns,
        point_times=AS_THEY_COME if scanners is None else scanners.times,
        scanners=scanners,
    )
    if mover is not None or scanners is not None:
        return data
    point_times = find_reading((cloud for _, cloud in data.clouds()), streams.clouds_ns)
    mount = mounts.with_tilt(mount, islice(data.clouds(), mounts.LOOKED_AT), data.up)
    return replace(data, mount=mount, point_times=point_times)


@dataclass(frozen=True, slots=True)
class Facts:
    """What a replay needs of the small topics at its end. tags: those that ranged.

    anchors: id -> x, y, z of those that the messages place where none are configured.
    """

    input: InputRecord
    first_ns: int
    last_ns: int
    tags: Sequence[int]
    anchors: Mapping[int, Sequence[float]]

    @classmethod
    def load(cls, _: Path, state: Any) -> Self:
        """As stage `ingest` has left them."""
        anchors = {int(anchor): place_m for anchor, place_m in state["anchors"].items()}
        return cls(**state | {"input": InputRecord(**state["input"]), "anchors": anchors})


def ingest(_: Path, journal: Journal, __: Config, read: Callable[[], LogData]) -> dict[str, Any]:
    """The first reading of a log."""
    with journal.clock.stage("ingest"):
        data = read()
    tell_recording(data, journal)
    ranges, places = data.streams.ranges, data.streams.anchor_places if data.anchors_carried else {}
    return {
        "input": data.input.model_dump(exclude_none=True),
        "first_ns": int(data.first_ns),
        "last_ns": int(data.last_ns),
        "tags": [] if ranges is None else np.unique(ranges.tag).tolist(),
        "anchors": {anchor: list(map(float, place.position_m)) for anchor, place in places.items()},
    }


def tell_recording(data: LogData, journal: Journal) -> None:
    """Losses and warnings of the recording so far; and roles whose choice is left to the user."""
    roles, recording = data.log.roles, data.log.recording
    journal.lose([*recording.losses, *data.streams.losses])
    journal.warn(*recording.warnings, *data.streams.warnings)
    for role, what in (("reference", "no reference is used"), ("joints", "no joints are read")):
        if choices := roles.choices(role):
            journal.warn(f"{what}: {choices}")
    base = None if roles.frames.configured else roles.frames.base
    others = [] if base is None else roles.frames.other_robots(base)
    flags = [set_flag("topics.tf", each) for each in roles.transforms[1:]]
    if flags := [*flags, *(set_flag("topics.base_frame", [frame]) for frame in others)]:
        taken, some = roles.topics("tf")[0] if len(roles.transforms) > 1 else base, "  or  ".join(flags[:MAX_LISTED])
        journal.warn(f"tf moves {len(flags) + 1} robots: the one of {taken} is taken; choose another with  {some}")
    for topic, why in roles.unused_truths.items():
        journal.warn(f"no reference is used: {topic} {why}")
    for topic, why in recording.joints.refused.items() if "joints" not in roles.found else ():
        journal.warn(f"{topic}: its joints are not used: it {why}")


def _sender_warnings(log: Log, streams: Streams) -> list[str]:
    """Leaves the poses of one of two nodes that send a transform above base in turns; returns the warnings."""
    others = [*position_topics(log.recording), *(["lidar"] if log.lidars else [])]
    flags = "  or  ".join(set_flag("topics.position", [each]) for each in others[:MAX_LISTED]) or "none"
    chain = streams.tf.chain(log.roles.frames.base or "")
    found = [(edge, edge.keep_one_sender(streams.odometry)) for edge in chain if not edge.is_still]
    return [
        f"{edge.topic}: two nodes send {edge.parent} to {edge.child} in turns, {one[2]:.2f} m apart: {one[0]} poses of "
        f"one are taken, {one[1]} are left out; other positions:  {flags}"
        for edge, one in found
        if one is not None
    ]


def _of_mounts(
    log: Log, found: Sequence[mounts.LidarMount], movers: Sequence[mounts.CloudMover | None], streams: Streams
) -> list[str]:
    """What a user should know of the mounts, now that all transforms are read."""
    frames, imu = log.roles.frames, streams.imu
    fixed = [mount.from_tf for mount in found if mount.from_tf is not None]
    if imu is not None and frames.base is not None and mounts.imu_mount(imu.frame_id, frames) is not None:
        fixed.append((imu.frame_id, frames.base))
    moved = [text for mover in movers if mover is not None for text in mover.warnings()]
    return [*mounts.moved_mounts(fixed, streams.tf), *moved]
