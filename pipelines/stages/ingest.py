"""Stage `ingest`: open the recording, find out which topic plays which role, and read it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

import numpy as np

from quadlog.config import Config, Mount
from quadlog.errors import AmbiguousTopic, EmptyWindow, NothingReadable, QuadlogError
from quadlog.geometry import transform_from_rpy
from quadlog.messages import Float, PointCloud
from quadlog.pipelines.opening import imu_in_base, lidar_in_base, open_configured
from quadlog.pipelines.progress import Progress, StageClock
from quadlog.pipelines.stages.one_pass import read_all, read_small
from quadlog.pipelines.stages.scans import Scanner, ScanSettings
from quadlog.pipelines.stages.spill import Spill
from quadlog.pipelines.stages.tilt import Tilt
from quadlog.pipelines.stages.uwb import wants_uwb
from quadlog.pipelines.stages.walk import Walk, needed_lidar
from quadlog.recordings.recording import Recording
from quadlog.recordings.roles import Roles, detect_roles
from quadlog.recordings.streams import Gatherer, Streams
from quadlog.recordings.tf_tree import TransformTree
from quadlog.results.record import InputRecord, describe_file, describe_input_aside
from quadlog.results.run_folder import RunFolder
from quadlog.stages import stages_until
from quadlog.storage.byte_source import LocalBytes
from quadlog.storage.shared_digest import SharedDigest

if TYPE_CHECKING:
    from quadlog.pipelines.replay import ReplayRequest

Clouds = Literal["filter", "map"] | None


@contextmanager
def open_walk(
    request: ReplayRequest,
    clock: StageClock,
    progress: Progress,
    described: InputRecord | None = None,
    clouds: Clouds = None,
    before_clouds: Callable[[], None] = lambda: None,
) -> Iterator[Walk]:
    """The recording opened and read, in one pass; its run folder is taken before, and given back if that fails.

    described: the input, where it is known already. clouds: whether they are classified, and kept for maps, too.
    before_clouds: called before the first of them is read, where they are.
    """
    from quadlog.pipelines.replay import Existing

    progress.begin("ingest", None)
    with clock.stage("ingest"):
        recording = open_configured(request.recording, request.config, request.options.msg_path, request.options.stamp)
    with recording, ExitStack() as stack:
        with clock.stage("ingest"):
            describe = _describing(request.recording, recording) if described is None else lambda: described
            roles = detect_roles(recording, request.config.topics)
            if "filter" in stages_until(request.options.until):
                needed_lidar(roles)
            run = RunFolder.claim(request.run, replace=request.existing is not Existing.REFUSE)
        try:
            walk = _read(request, recording, describe, roles, run, clouds, before_clouds, stack, clock, progress)
            _tell_ambiguities(walk)
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
    """What describes the input once it is read: by the bytes that are read anyway where the container shares them."""
    file = getattr(recording.container, "file", None)
    if not isinstance(file, LocalBytes):
        return describe_input_aside(path).result
    digest = SharedDigest(file)
    return lambda: describe_file(path, digest.finish())


def _read(
    request: ReplayRequest,
    recording: Recording,
    describe: Callable[[], InputRecord],
    roles: Roles,
    run: RunFolder,
    clouds: Clouds,
    before_clouds: Callable[[], None],
    stack: ExitStack,
    clock: StageClock,
    progress: Progress,
) -> Walk:
    """The walk with all that is read of the recording; the stack gives back what is kept of its clouds."""
    config, options = request.config, request.options
    with clock.stage("ingest"):
        topics = _topics_to_read(recording, roles, config)
        window = _window(recording, _played(roles), options.start_s, options.duration_s)
        wanted = Gatherer(**topics)
        wanted.take_static(recording)
        mount = _mount(recording, roles, wanted.tree, config)
    scanner: Scanner | None = None
    first_cloud_ns: int | None = None
    if clouds is None:
        with clock.stage("ingest"):
            read_small(recording, wanted, window)
    else:
        lidar = needed_lidar(roles)
        progress.begin("start-up", None)
        before_clouds()
        with clock.stage("ingest"):
            tilt = Tilt(recording, wanted.tree, config, topics["imu"], topics["odometry"])
            settings = ScanSettings.of_config(config, maps=clouds == "map")
            scanner = Scanner(settings, options.seed, mount, tilt, stack.enter_context(Spill(run.path)))
            progress.begin("ingest", _expected(recording, lidar, window))
        first_cloud_ns = read_all(recording, wanted, lidar, window, scanner, tilt, clock, progress)
    with clock.stage("ingest"):
        streams = wanted.streams()
        if streams.imu is not None:
            streams = replace(streams, imu=imu_in_base(streams.imu, streams.tf, config.topics.base_frame))
        first_ns, last_ns = _seen(recording, roles, streams, window, first_cloud_ns)
        described = describe()
    return Walk(
        config=config,
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
        scanner=scanner,
    )


def _expected(recording: Recording, topic: str, window: tuple[int | None, int | None]) -> int | None:
    """How many messages the index promises on a topic; None for part of a recording, or without an index."""
    counts = [channel.count for channel in recording.channels if channel.topic == topic]
    known = [count for count in counts if count is not None]
    return sum(known) if len(known) == len(counts) and window == (None, None) else None


class _SmallTopics(TypedDict):
    uwb: tuple[str, ...]
    odometry: str | None
    imu: str | None
    reference: str | None
    target: str | None
    tf: tuple[str, ...]


def _topics_to_read(recording: Recording, roles: Roles, config: Config) -> _SmallTopics:
    """The small topics by role, as `gather` takes them. An ambiguity is raised where the role is needed."""
    position = config.topics.position
    chosen = position if position in {channel.topic for channel in recording.channels} else None
    locates = wants_uwb(config)
    # Under auto an odometry may have to be the position, and beside UWB it is the heading.
    needs_odometry = position in ("auto", "uwb", "odometry")
    # Elsewhere an IMU only tells scans how the body was tilted.
    upright = _unless_ambiguous(roles, "imu") if config.lidar.level else None
    return {
        "uwb": roles.topics("uwb") if locates else (),
        "odometry": chosen or (roles.topic("odometry") if needs_odometry else None),
        "imu": roles.topic("imu") if locates and position in ("auto", "uwb") else upright,
        "reference": _unless_ambiguous(roles, "reference"),
        "target": roles.topic("target"),
        "tf": roles.topics("tf"),
    }


def _tell_ambiguities(walk: Walk) -> None:
    """A replay can do without a reference, but not without saying that there was a choice."""
    if choices := walk.roles.choices("reference"):
        walk.warn(f"no reference is used: {choices}")


def _unless_ambiguous(roles: Roles, role: str) -> str | None:
    """The topic of a role that a replay can do without."""
    try:
        return roles.topic(role)
    except AmbiguousTopic:
        return None


def _played(roles: Roles) -> list[str]:
    """Every topic with a role, static transforms apart, which may be stamped at any time: only their clocks count."""
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


def _first_ns(recording: Recording, topics: list[str]) -> int:
    first = next(iter(recording.messages(topics)), None)
    if first is None:
        raise NothingReadable(recording.path, "no message of a type that quadlog uses; see  quadlog info")
    return first.t_ns


def _seen(
    recording: Recording, roles: Roles, streams: Streams, window: tuple[int | None, int | None], cloud_ns: int | None
) -> tuple[int, int]:
    """First and last instant of the small topics, or the first cloud's, cloud_ns, where there are none.

    Raises EmptyWindow when --start and --duration leave nothing, NothingReadable when there never was anything.
    """
    series = [streams.ranges, streams.odometry, streams.imu, streams.reference, streams.target]
    filled = [each.t_ns for each in series if each is not None and len(each)]
    if filled:
        return min(int(t_ns[0]) for t_ns in filled), max(int(t_ns[-1]) for t_ns in filled)
    if cloud_ns is not None:
        return cloud_ns, cloud_ns
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
