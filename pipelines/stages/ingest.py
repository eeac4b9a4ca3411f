"""Stage `ingest`: open the recording, detect the roles of its topics, and read it in one pass."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TypedDict

from quadlog.config.schema import Config
from quadlog.errors import AmbiguousTopic, EmptyWindow, NothingToReplay, QuadlogError
from quadlog.messages import PointCloud
from quadlog.pipelines.executor.progress import Progress, StageClock
from quadlog.pipelines.stages.context import ReplayContext, needed_lidar
from quadlog.pipelines.stages.mount import CloudMover, LidarMount, find_mount, imu_in_base, imu_mount, moved_mounts
from quadlog.pipelines.stages.positions.uwb import locates_by_uwb, with_carried_anchors
from quadlog.pipelines.stages.scans import LidarTracker, Scanner, ScanSettings, Spill, end_of_sweep_ns
from quadlog.pipelines.stages.stage import POSITION, Stage, stages_for
from quadlog.pipelines.stages.tilt import Tilt, contradicts_gravity
from quadlog.recordings.gathering import One
from quadlog.recordings.recording import Recording, open_configured
from quadlog.recordings.roles import Roles, detect_roles
from quadlog.recordings.streams import Gatherer, Streams
from quadlog.recordings.tf_tree import TransformTree
from quadlog.results.places import claim, discard_if_empty
from quadlog.results.record import InputRecord, RunRecord, describe_file, describe_input_aside
from quadlog.results.run import Run
from quadlog.storage.byte_ranges import LocalBytes
from quadlog.storage.shared_digest import SharedDigest
from quadlog.version import __version__

if TYPE_CHECKING:
    from quadlog.pipelines.request import ReplayRequest


MOST_WAITING = 8
"""Most clouds that wait for orientations and poses; the oldest is then classified by what is known so far."""


def read_all(
    recording: Recording,
    wanted: Gatherer,
    lidar: str,
    window: tuple[int | None, int | None],
    takers: Mapping[str, Callable[[int, PointCloud], None]],
    awaited: Sequence[Tilt | CloudMover],
    clock: StageClock,
    progress: Progress,
) -> tuple[int, int] | None:
    """Read the small topics and all clouds; a cloud waits until what is awaited is known up to its last point.

    takers: what each cloud is given to, by the stage whose time it takes. Returns the instants of the first and the
    latest cloud, None where there was none.
    """
    start_ns: int | None = None
    latest_ns = 0
    waiting: deque[tuple[int, PointCloud]] = deque()
    with clock.laps("ingest", *takers) as lap:

        def take_first() -> None:
            each = waiting.popleft()
            for name, take in takers.items():
                take(*each)
                lap(name)

        prompt = [topic for each in awaited for topic in each.topics(wanted.moving_tf)]
        for gathered in recording.gathered([*wanted.moving, lidar], prompt, *window):
            if gathered.topic != lidar:
                wanted.take(gathered, recording.stamp)
                for each in awaited:
                    each.take(gathered)
                continue
            if not isinstance(gathered, One) or not isinstance(gathered.message, PointCloud):
                continue
            lap("ingest")
            t_ns = gathered.t_ns
            start_ns = t_ns if start_ns is None else start_ns
            wanted.note_cloud(lidar, t_ns)
            latest_ns = max(latest_ns, t_ns)
            waiting.append((t_ns, gathered.message))
            while len(waiting) > MOST_WAITING or (waiting and _known(awaited, end_of_sweep_ns(*waiting[0]))):
                take_first()
            progress.advance((t_ns - start_ns) * 1e-9)
        lap("ingest")
        while waiting:
            take_first()
    return None if start_ns is None else (start_ns, latest_ns)


def _known(awaited: Sequence[Tilt | CloudMover], t_ns: int) -> bool:
    return all(each.reaches(t_ns) for each in awaited)


Clouds = Literal["filter", "map"] | None


class OpenLog(NamedTuple):
    """An open recording, which topic plays which role, and whether there are ranges and anchors to locate by."""

    recording: Recording
    roles: Roles
    by_uwb: bool


@contextmanager
def open_log(request: ReplayRequest, clock: StageClock, progress: Progress) -> Iterator[OpenLog]:
    """Open the recording and detect the roles of its topics; nothing is compiled and no folder made before."""
    progress.begin("open", None)
    with clock.stage("ingest"):
        recording = open_configured(request.recording, request.config, request.options.msg_path, request.options.stamp)
    with recording:
        with clock.stage("ingest"):
            roles = detect_roles(recording, request.config.topics)
            by_uwb = locates_by_uwb(recording, roles, request.config)
        yield OpenLog(recording, roles, by_uwb)


def reachable_stages(roles: Roles, until: str) -> tuple[Stage, ...]:
    """The stages up to `until` that the log allows; without a lidar, or with a choice of them, those before `filter`.

    Raises MissingInput and AmbiguousTopic for a stage that was asked for by its name.
    """
    stages = stages_for(until)
    if until == "report" and "lidar" not in roles.found:
        return tuple(stage for stage in stages if stage is POSITION)
    if any("filter" in stage.names for stage in stages):
        needed_lidar(roles)
    return stages


@contextmanager
def open_walk(
    log: OpenLog,
    request: ReplayRequest,
    clock: StageClock,
    progress: Progress,
    described: InputRecord | None = None,
    clouds: Clouds = None,
    before_clouds: Callable[[], None] = lambda: None,
    tracked: bool = False,
) -> Iterator[ReplayContext]:
    """Read the recording in one pass; its run folder is claimed before, and released if that fails.

    described: the input, if known already. clouds: whether clouds are classified, and kept for maps.
    before_clouds: called before the first cloud is classified. tracked: whether the robot's track is made of clouds.
    """
    from quadlog.pipelines.request import Existing

    with ExitStack() as stack:
        with clock.stage("ingest"):
            describe = _describing(request.recording, log.recording) if described is None else lambda: described
            claim(request.run, replace=request.existing is not Existing.REFUSE)
        try:
            walk = _read(request, log, describe, clouds, before_clouds, tracked, stack, clock, progress)
            for role, what in (("reference", "no reference is used"), ("joints", "no joints are read")):
                if choices := walk.roles.choices(role):
                    walk.warn(f"{what}: {choices}")
            for topic, why in walk.roles.unused_truths.items():
                walk.warn(f"no reference is used: {topic} {why}")
            for topic, why in log.recording.joints.refused.items() if "joints" not in walk.roles.found else ():
                walk.warn(f"{topic}: its joints are not used: it {why}")
            walk.say_what_is_new()
            try:
                yield walk
            except QuadlogError:
                walk.say_what_is_new()
                raise
        except QuadlogError:
            discard_if_empty(request.run)
            raise


def _describing(path: Path, recording: Recording) -> Callable[[], InputRecord]:
    """A function that describes the input once it is read; hashes the bytes while they are read, where possible."""
    file = getattr(recording.container, "file", None)
    if not isinstance(file, LocalBytes):
        return describe_input_aside(path).result
    digest = SharedDigest(file)
    return lambda: describe_file(path, digest.finish())


def _read(
    request: ReplayRequest,
    log: OpenLog,
    describe: Callable[[], InputRecord],
    clouds: Clouds,
    before_clouds: Callable[[], None],
    tracked: bool,
    stack: ExitStack,
    clock: StageClock,
    progress: Progress,
) -> ReplayContext:
    """The replay's state with all that is read; the stack closes the spill."""
    config, options = request.config, request.options
    recording, roles, by_uwb = log
    with clock.stage("ingest"):
        topics = _topics_to_read(recording, roles, config, by_uwb)
        window = _window(recording, roles.played, options.start_s, options.duration_s)
        wanted = Gatherer(**topics)
        wanted.take_static(recording)
        lidar = _unless_ambiguous(roles, "lidar")
        mount = find_mount(recording, roles, config, lidar, wanted.tree, topics["odometry"])
        imu = topics["imu"]
        wrong = None if imu is None else contradicts_gravity(recording, imu)
    clouds_read = _CloudsRead(None, None, None)
    if clouds is not None or tracked:
        progress.begin("start-up", None)
        if clouds is not None:
            before_clouds()
        with clock.stage("ingest"):
            tilt = Tilt(recording, wanted.tree, roles.frames, config, None if wrong else imu, topics["odometry"])
            spill = None if clouds is None else stack.enter_context(Spill(request.run))
        clouds_read = _read_clouds(request, log, wanted, window, mount, tilt, clouds, spill, tracked, clock, progress)
    else:
        with clock.stage("ingest"):
            for gathered in recording.gathered(wanted.moving, (), *window) if wanted.moving else ():
                wanted.take(gathered, recording.stamp)
    with clock.stage("ingest"):
        streams = _with_imu_in_base(wanted.streams(), roles.frames, config.topics.base_frame, wrong)
        streams.warnings.extend(_of_mounts(mount, streams, roles.frames, config.topics.base_frame))
        first_ns, last_ns = _seen(recording, roles, streams, window, clouds_read.span_ns)
        described = describe()
    effective = with_carried_anchors(config, streams.anchor_places)
    record = RunRecord(
        quadlog_version=__version__,
        command=request.command,
        config=effective,
        options=options.to_dict(),
        input=described,
        seed=options.seed,
        recorded_s=(last_ns - first_ns) * 1e-9,
    )
    return ReplayContext(
        config=effective,
        seed=options.seed,
        run=Run(request.run, record),
        input=described,
        recording=recording,
        roles=roles,
        streams=streams,
        clock=clock,
        progress=progress,
        transform_lidar_to_base=mount.transform_lidar_to_base,
        lidar_mount_known=mount.known,
        start_ns=window[0],
        end_ns=window[1],
        first_ns=first_ns,
        last_ns=last_ns,
        scanner=clouds_read.scanner,
        tracker=clouds_read.tracker,
        anchors_from_messages=effective is not config,
    )


def _with_imu_in_base(streams: Streams, frames: TransformTree, base_frame: str, wrong: str | None) -> Streams:
    """The streams with the IMU in base's axes; wrong: why its orientation is not used, or None."""
    if streams.imu is None:
        return streams
    if wrong is not None:
        streams.warnings.append(wrong)
    imu = streams.imu if wrong is None else replace(streams.imu, quat_xyzw=None)
    return replace(streams, imu=imu_in_base(imu, frames, base_frame))


def _of_mounts(mount: LidarMount, streams: Streams, frames: TransformTree, base_frame: str) -> list[str]:
    """What a user should know of the mounts, now that all transforms are read."""
    fixed = [] if mount.from_tf is None else [mount.from_tf]
    base = frames.base_frame(base_frame)
    if streams.imu is not None and base is not None and imu_mount(streams.imu.frame_id, frames, base) is not None:
        fixed.append((streams.imu.frame_id, base))
    return moved_mounts(fixed, streams.tf) + ([] if mount.mover is None else mount.mover.warnings())


class _CloudsRead(NamedTuple):
    """What took the clouds, None where it was not asked for, and the instants of the first and the latest one."""

    scanner: Scanner | None
    tracker: LidarTracker | None
    span_ns: tuple[int, int] | None


def _read_clouds(
    request: ReplayRequest,
    log: OpenLog,
    wanted: Gatherer,
    window: tuple[int | None, int | None],
    mount: LidarMount,
    tilt: Tilt,
    clouds: Clouds,
    spill: Spill | None,
    tracked: bool,
    clock: StageClock,
    progress: Progress,
) -> _CloudsRead:
    """Read the small topics and the clouds, which are classified into the spill, tracked, or both."""
    lidar, config = needed_lidar(log.roles), request.config
    takers: dict[str, Callable[[int, PointCloud], None]] = {}
    scanner, tracker = None, None
    with clock.stage("ingest"):
        expected = _expected(log.recording, lidar, window)
        if spill is not None:
            settings = ScanSettings.of_config(config, maps=clouds == "map")
            fixed = mount.transform_lidar_to_base
            scanner = Scanner(settings, request.options.seed, fixed, tilt, spill, expected)
            takers["filter"] = mount.behind(scanner.take)
        if tracked:
            tracker = LidarTracker(config, mount.transform_lidar_to_base, tilt)
            takers["position"] = mount.behind(tracker.take)
    progress.begin("ingest", expected)
    awaited = (tilt,) if mount.mover is None else (tilt, mount.mover)
    span_ns = read_all(log.recording, wanted, lidar, window, takers, awaited, clock, progress)
    return _CloudsRead(scanner, tracker, span_ns)


def _expected(recording: Recording, topic: str, window: tuple[int | None, int | None]) -> int | None:
    """Number of messages on a topic by the index; None for part of a recording, or without an index."""
    counts = [channel.count for channel in recording.channels if channel.topic == topic]
    known = [count for count in counts if count is not None]
    return sum(known) if len(known) == len(counts) and window == (None, None) else None


class _SmallTopics(TypedDict):
    uwb: tuple[str, ...]
    odometry: str | None
    imu: str | None
    joints: str | None
    reference: str | None
    target: str | None
    tf: tuple[str, ...]
    estimates: tuple[str, ...]


def _topics_to_read(recording: Recording, roles: Roles, config: Config, by_uwb: bool) -> _SmallTopics:
    """The small topics by role, as `gather` takes them. Raises AmbiguousTopic for a role that is needed."""
    position = config.topics.position
    chosen = position if position in {channel.topic for channel in recording.channels} else None
    # Odometry may be the position (auto) or the heading (UWB); tf goes before it, and needs no choice of one.
    needs_odometry = position in ("auto", "uwb", "odometry")
    by_tf = position == "auto" and not by_uwb and "tf" in roles.found
    odometry = _unless_ambiguous(roles, "odometry") if by_tf else roles.topic("odometry") if needs_odometry else None
    # Otherwise the IMU is only used to level scans and to turn the body of legs.
    upright = _unless_ambiguous(roles, "imu") if config.lidar.level or "joints" in roles.found else None
    return {
        "uwb": roles.topics("uwb") if by_uwb else (),
        "odometry": chosen or odometry,
        "imu": roles.topic("imu") if by_uwb and position in ("auto", "uwb") else upright,
        "joints": _unless_ambiguous(roles, "joints"),
        "reference": _unless_ambiguous(roles, "reference"),
        "target": roles.topic("target"),
        "tf": roles.topics("tf"),
        "estimates": roles.topics("pose"),
    }


def _unless_ambiguous(roles: Roles, role: str) -> str | None:
    """The topic of an optional role; None if there is a choice."""
    try:
        return roles.topic(role)
    except AmbiguousTopic:
        return None


def _window(
    recording: Recording, topics: list[str], start_s: float | None, duration_s: float | None
) -> tuple[int | None, int | None]:
    """--start and --duration as instants on the chosen clock."""
    if start_s is None and duration_s is None:
        return None, None
    begin_ns = _first_ns(recording, topics)
    start_ns = begin_ns + round((start_s or 0.0) * 1e9)
    return start_ns, None if duration_s is None else start_ns + round(duration_s * 1e9)


def _nothing_used(recording: Recording) -> NothingToReplay:
    unknown = "".join(f"; {topic} {why}" for topic, why in recording.joints.refused.items())
    return NothingToReplay(recording.path, f"no message of a type that quadlog uses; see  quadlog info{unknown}")


def _first_ns(recording: Recording, topics: list[str]) -> int:
    first = next(iter(recording.messages(topics)), None)
    if first is None:
        raise _nothing_used(recording)
    return first.t_ns


def _seen(
    recording: Recording,
    roles: Roles,
    streams: Streams,
    window: tuple[int | None, int | None],
    clouds_ns: tuple[int, int] | None,
) -> tuple[int, int]:
    """First and last instant of the small topics and of the clouds that were read, clouds_ns, not of a reference alone.

    Raises EmptyWindow when --start and --duration leave nothing, NothingToReplay when there never was anything.
    """
    series = [streams.ranges, streams.odometry, streams.imu, streams.joints, streams.target]
    series += streams.estimates.values()
    filled = [each.t_ns for each in series if each is not None and len(each)]
    spans_ns = [(int(t_ns[0]), int(t_ns[-1])) for t_ns in filled]
    spans_ns += [span_ns for span_ns in (streams.tf.span_ns(), clouds_ns) if span_ns is not None]
    reference = streams.reference
    if not spans_ns and reference is not None and len(reference):
        spans_ns.append((int(reference.t_ns[0]), int(reference.t_ns[-1])))
    if spans_ns:
        return min(first_ns for first_ns, _ in spans_ns), max(last_ns for _, last_ns in spans_ns)
    lidar = _unless_ambiguous(roles, "lidar")
    clouds = recording.messages([lidar], *window) if lidar else iter(())
    first = next((each.t_ns for each in clouds if isinstance(each.message, PointCloud)), None)
    if first is not None:
        return first, first
    begin_ns = _first_ns(recording, roles.played)
    if window != (None, None):
        raise EmptyWindow(recording.path, recording.span_ns)
    return begin_ns, begin_ns
