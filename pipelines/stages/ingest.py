"""Stage `ingest`: open the recording, find out which topic plays which role, read all but the clouds."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from quadlog.config import Config, Mount
from quadlog.errors import AmbiguousTopic, EmptyWindow, NothingReadable, QuadlogError
from quadlog.geometry import transform_from_rpy
from quadlog.messages import Float, PointCloud
from quadlog.pipelines.opening import imu_in_base, lidar_in_base, open_configured
from quadlog.pipelines.progress import Progress, StageClock
from quadlog.pipelines.stages.uwb import wants_uwb
from quadlog.pipelines.stages.walk import Walk, needed_lidar
from quadlog.recordings.recording import Recording
from quadlog.recordings.roles import Roles, detect_roles
from quadlog.recordings.streams import Streams, gather
from quadlog.results.record import InputRecord, describe_input_aside
from quadlog.results.run_folder import RunFolder
from quadlog.stages import stages_until

if TYPE_CHECKING:
    from quadlog.pipelines.replay import ReplayRequest


@contextmanager
def open_walk(
    request: ReplayRequest, clock: StageClock, progress: Progress, described: InputRecord | None = None
) -> Iterator[Walk]:
    """The recording opened and its small topics read; its run folder claimed once that has worked.

    described: the input, where it is known already.
    """
    from quadlog.pipelines.replay import Existing

    config, options = request.config, request.options
    progress.begin("ingest", None)
    with clock.stage("ingest"):
        recording = open_configured(request.recording, config, options.msg_path, options.stamp)
    with recording:
        with clock.stage("ingest"):
            describing = describe_input_aside(request.recording) if described is None else _known(described)
            roles = detect_roles(recording, config.topics)
            if "filter" in stages_until(options.until):
                needed_lidar(roles)
            topics = _topics_to_read(recording, roles, config)
            start_ns, end_ns = _window(recording, _played(roles), options.start_s, options.duration_s)
            streams = gather(recording, **topics, start_ns=start_ns, end_ns=end_ns)
            if streams.imu is not None:
                streams = replace(streams, imu=imu_in_base(streams.imu, streams.tf, config.topics.base_frame))
            first_ns, last_ns = _seen(recording, roles, streams, (start_ns, end_ns))
            read = describing.result()
            run = RunFolder.claim(request.run, replace=request.existing is not Existing.REFUSE)
        walk = Walk(
            config=config,
            seed=options.seed,
            run=run,
            input=read,
            recording=recording,
            roles=roles,
            streams=streams,
            clock=clock,
            progress=progress,
            transform_lidar_to_base=_mount(recording, roles, streams, config),
            start_ns=start_ns,
            end_ns=end_ns,
            first_ns=first_ns,
            last_ns=last_ns,
        )
        _tell_ambiguities(walk)
        walk.say_what_is_new()
        try:
            yield walk
        except QuadlogError:
            walk.say_what_is_new()
            run.discard_if_empty()
            raise


def _known(described: InputRecord) -> Future[InputRecord]:
    known: Future[InputRecord] = Future()
    known.set_result(described)
    return known


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
    recording: Recording, roles: Roles, streams: Streams, window: tuple[int | None, int | None]
) -> tuple[int, int]:
    """First and last instant of the small topics, or the first cloud's where there are none.

    Raises EmptyWindow when --start and --duration leave nothing, NothingReadable when there never was anything.
    """
    series = [streams.ranges, streams.odometry, streams.imu, streams.reference, streams.target]
    filled = [each.t_ns for each in series if each is not None and len(each)]
    if filled:
        return min(int(t_ns[0]) for t_ns in filled), max(int(t_ns[-1]) for t_ns in filled)
    lidar = _unless_ambiguous(roles, "lidar")
    clouds = recording.messages([lidar], *window) if lidar else iter(())
    first = next((each.t_ns for each in clouds if isinstance(each.message, PointCloud)), None)
    if first is not None:
        return first, first
    begin_ns = _first_ns(recording, _played(roles))
    if window != (None, None):
        raise EmptyWindow(recording.path, recording.span_ns)
    return begin_ns, begin_ns


def _mount(recording: Recording, roles: Roles, streams: Streams, config: Config) -> Float:
    """(4, 4) transform_lidar_to_base: from the configuration, or from static tf where it has none."""
    mount = config.lidar.mount
    if mount == Mount() and (from_tf := _mount_in_tf(recording, roles, streams, config)) is not None:
        return from_tf
    angles = np.radians([mount.roll_deg, mount.pitch_deg, mount.yaw_deg])
    return transform_from_rpy(np.array([mount.x_m, mount.y_m, mount.z_m]), *(float(angle) for angle in angles))


def _mount_in_tf(recording: Recording, roles: Roles, streams: Streams, config: Config) -> Float | None:
    return lidar_in_base(recording, _unless_ambiguous(roles, "lidar"), streams.tf, config.topics.base_frame)
