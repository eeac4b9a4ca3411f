"""Stage `ingest`: open the recording, detect the roles of its topics, and read it in one pass."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, TypedDict

import numpy as np

from quadlog.config.schema import Config, Mount
from quadlog.errors import AmbiguousTopic, EmptyWindow, NothingReadable, QuadlogError
from quadlog.geometry import transform_from_rpy
from quadlog.messages import Float, PointCloud
from quadlog.pipelines.executor.progress import Progress, StageClock
from quadlog.pipelines.stages.context import ReplayContext, needed_lidar
from quadlog.pipelines.stages.positions.uwb import locates_by_uwb, with_carried_anchors
from quadlog.pipelines.stages.scans import LidarTracker, Scanner, ScanSettings, Spill, end_of_sweep_ns
from quadlog.pipelines.stages.stage import POSITION, Stage, stages_for
from quadlog.pipelines.stages.tilt import Tilt, imu_in_base
from quadlog.recordings.gathering import One
from quadlog.recordings.recording import Recording, open_configured
from quadlog.recordings.roles import Roles, detect_roles
from quadlog.recordings.streams import Gatherer, Streams
from quadlog.recordings.tf_tree import TransformTree
from quadlog.results.run.record import InputRecord, describe_file, describe_input_aside
from quadlog.results.run.run_folder import RunFolder
from quadlog.storage.byte_ranges import LocalBytes
from quadlog.storage.shared_digest import SharedDigest

if TYPE_CHECKING:
    from quadlog.pipelines.request import ReplayRequest


def lidar_in_base(recording: Recording, topic: str | None, tree: TransformTree, base_frame: str = "") -> Float | None:
    """(4, 4) transform_lidar_to_base through static tf, None where the frames do not connect."""
    base = tree.base_frame(base_frame)
    if topic is None or base is None:
        return None
    clouds = [each for each in recording.sample(topic, 1) if isinstance(each, PointCloud)]
    return tree.static_transform(clouds[0].frame_id, base) if clouds else None


MOST_WAITING = 8
"""Most clouds that wait for orientations; the oldest is then classified with the tilt known so far."""


def read_all(
    recording: Recording,
    wanted: Gatherer,
    lidar: str,
    window: tuple[int | None, int | None],
    takers: Mapping[str, Callable[[int, PointCloud], None]],
    tilt: Tilt,
    clock: StageClock,
    progress: Progress,
) -> tuple[int, int] | None:
    """Read the small topics and all clouds; a cloud waits until the body's tilt is known up to its last point.

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

        for gathered in recording.gathered([*wanted.moving, lidar], tilt.topics(wanted.moving_tf), *window):
            if gathered.topic != lidar:
                wanted.take(gathered, recording.stamp)
                tilt.take(gathered)
                continue
            if not isinstance(gathered, One) or not isinstance(gathered.message, PointCloud):
                continue
            lap("ingest")
            t_ns = gathered.t_ns
            start_ns = t_ns if start_ns is None else start_ns
            latest_ns = max(latest_ns, t_ns)
            waiting.append((t_ns, gathered.message))
            while len(waiting) > MOST_WAITING or (waiting and tilt.reaches(end_of_sweep_ns(*waiting[0]))):
                take_first()
            progress.advance((t_ns - start_ns) * 1e-9)
        lap("ingest")
        while waiting:
            take_first()
    return None if start_ns is None else (start_ns, latest_ns)


Clouds = Literal["filter", "map"] | None


class OpenLog(NamedTuple):
    """An open recording, which topic plays which role, and whether there are ranges and anchors to locate by."""

    recording: Recording
    roles: Roles
    by_uwb: bool


@contextmanager
def open_log(request: ReplayRequest, clock: StageClock, progress: Progress) -> Iterator[OpenLog]:
    """Open the recording and detect the roles of its topics; nothing is compiled and no folder made before."""
    progress.begin("ingest", None)
    with clock.stage("ingest"):
        recording = open_configured(request.recording, request.config, request.options.msg_path, request.options.stamp)
    with recording:
        with clock.stage("ingest"):
            roles = detect_roles(recording, request.config.topics)
            by_uwb = locates_by_uwb(recording, roles, request.config)
        yield OpenLog(recording, roles, by_uwb)


def reachable_stages(roles: Roles, until: str) -> tuple[Stage, ...]:
    """The stages up to `until` that the log allows; without a lidar those before `filter`.

    Raises MissingInput for a stage that was asked for by its name, and AmbiguousTopic.
    """
    stages = stages_for(until)
    if until == "report" and roles.topic("lidar") is None:
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
            run = RunFolder.claim(request.run, replace=request.existing is not Existing.REFUSE)
        try:
            walk = _read(request, log, describe, run, clouds, before_clouds, tracked, stack, clock, progress)
            for role, what in (("reference", "no reference is used"), ("joints", "no joints are read")):
                if choices := walk.roles.choices(role):
                    walk.warn(f"{what}: {choices}")
            for topic, why in log.recording.joints.refused.items() if "joints" not in walk.roles.found else ():
                walk.warn(f"{topic}: its joints are not used: it {why}")
            walk.say_what_is_new()
            try:
                yield walk
            except QuadlogError:
                walk.say_what_is_new()
                raise
        except QuadlogError:
            run.discard_if_empty()
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
    run: RunFolder,
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
        window = _window(recording, _played(roles), options.start_s, options.duration_s)
        wanted = Gatherer(**topics)
        wanted.take_static(recording)
        mount = _mount(recording, roles, wanted.tree, config)
    clouds_read = _CloudsRead(None, None, None)
    if clouds is not None or tracked:
        progress.begin("start-up", None)
        if clouds is not None:
            before_clouds()
        with clock.stage("ingest"):
            tilt = Tilt(recording, wanted.tree, config, topics["imu"], topics["odometry"])
            spill = None if clouds is None else stack.enter_context(Spill(run.path))
        clouds_read = _read_clouds(request, log, wanted, window, mount, tilt, clouds, spill, tracked, clock, progress)
    else:
        with clock.stage("ingest"):
            for gathered in recording.gathered(wanted.moving, (), *window) if wanted.moving else ():
                wanted.take(gathered, recording.stamp)
    with clock.stage("ingest"):
        streams = wanted.streams()
        if streams.imu is not None:
            streams = replace(streams, imu=imu_in_base(streams.imu, streams.tf, config.topics.base_frame))
        first_ns, last_ns = _seen(recording, roles, streams, window, clouds_read.span_ns)
        described = describe()
    effective = with_carried_anchors(config, streams.anchor_places)
    return ReplayContext(
        config=effective,
        seed=options.seed,
        run=run,
        input=described,
        recording=recording,
        roles=roles,
        streams=streams,
        clock=clock,
        progress=progress,
        transform_lidar_to_base=mount,
        start_ns=window[0],
        end_ns=window[1],
        first_ns=first_ns,
        last_ns=last_ns,
        scanner=clouds_read.scanner,
        tracker=clouds_read.tracker,
        anchors_from_messages=effective is not config,
    )


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
    mount: Float,
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
            scanner = Scanner(settings, request.options.seed, mount, tilt, spill, expected)
            takers["filter"] = scanner.take
        if tracked:
            tracker = LidarTracker(config, mount, tilt)
            takers["position"] = tracker.take
    progress.begin("ingest", expected)
    span_ns = read_all(log.recording, wanted, lidar, window, takers, tilt, clock, progress)
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


def _topics_to_read(recording: Recording, roles: Roles, config: Config, by_uwb: bool) -> _SmallTopics:
    """The small topics by role, as `gather` takes them. Raises AmbiguousTopic for a role that is needed."""
    position = config.topics.position
    chosen = position if position in {channel.topic for channel in recording.channels} else None
    # Odometry may be the position (auto) or the heading (UWB).
    needs_odometry = position in ("auto", "uwb", "odometry")
    # Otherwise the IMU is only used to level scans and to turn the body of legs.
    upright = _unless_ambiguous(roles, "imu") if config.lidar.level or "joints" in roles.found else None
    return {
        "uwb": roles.topics("uwb") if by_uwb else (),
        "odometry": chosen or (roles.topic("odometry") if needs_odometry else None),
        "imu": roles.topic("imu") if by_uwb and position in ("auto", "uwb") else upright,
        "joints": _unless_ambiguous(roles, "joints"),
        "reference": _unless_ambiguous(roles, "reference"),
        "target": roles.topic("target"),
        "tf": roles.topics("tf"),
    }


def _unless_ambiguous(roles: Roles, role: str) -> str | None:
    """The topic of an optional role; None if there is a choice."""
    try:
        return roles.topic(role)
    except AmbiguousTopic:
        return None


def _played(roles: Roles) -> list[str]:
    """Topics with a role, without static transforms, whose stamps may be of any time."""
    topics = [topic for role in roles.found.values() for topic in role.topics]
    return [topic for topic in topics if topic.rsplit("/", 1)[-1] != "tf_static"]


def _window(
    recording: Recording, topics: list[str], start_s: float | None, duration_s: float | None
) -> tuple[int | None, int | None]:
    """--start and --duration as instants on the chosen clock."""
    if start_s is None and duration_s is None:
        return None, None
    begin_ns = _first_ns(recording, topics)
    start_ns = begin_ns + round((start_s or 0.0) * 1e9)
    return start_ns, None if duration_s is None else start_ns + round(duration_s * 1e9)


def _nothing_used(recording: Recording) -> NothingReadable:
    unknown = "".join(f"; {topic} {why}" for topic, why in recording.joints.refused.items())
    return NothingReadable(recording.path, f"no message of a type that quadlog uses; see  quadlog info{unknown}")


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
    """First and last instant of the small topics and of the clouds that were read, clouds_ns.

    Raises EmptyWindow when --start and --duration leave nothing, NothingReadable when there never was anything.
    """
    series = [streams.ranges, streams.odometry, streams.imu, streams.reference, streams.target]
    filled = [each.t_ns for each in series if each is not None and len(each)]
    spans_ns = [(int(t_ns[0]), int(t_ns[-1])) for t_ns in filled] + ([] if clouds_ns is None else [clouds_ns])
    if spans_ns:
        return min(first for first, _ in spans_ns), max(last for _, last in spans_ns)
    lidar = _unless_ambiguous(roles, "lidar")
    clouds = recording.messages([lidar], *window) if lidar else iter(())
    first = next((each.t_ns for each in clouds if isinstance(each.message, PointCloud)), None)
    if first is not None:
        return first, first
    begin_ns = _first_ns(recording, _played(roles))
    if window != (None, None):
        raise EmptyWindow(recording.path, recording.span_ns)
    return begin_ns, begin_ns


def _mount(recording: Recording, roles: Roles, tree: TransformTree, config: Config) -> Float:
    """(4, 4) transform_lidar_to_base: from the configuration, or from static tf where it has none."""
    mount = config.lidar.mount
    lidar = _unless_ambiguous(roles, "lidar")
    if mount == Mount() and (from_tf := lidar_in_base(recording, lidar, tree, config.topics.base_frame)) is not None:
        return from_tf
    angles = np.radians([mount.roll_deg, mount.pitch_deg, mount.yaw_deg])
    return transform_from_rpy(np.array([mount.x_m, mount.y_m, mount.z_m]), *(float(angle) for angle in angles))
