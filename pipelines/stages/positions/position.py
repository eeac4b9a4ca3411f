"""Stage `position`: where the robot and the target were, and where they looked, from the best source there is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from quadlog import geometry
from quadlog.config.schema import Config
from quadlog.errors import MissingInput, set_flag
from quadlog.geometry import quat_from_euler, roll_pitch_from_quat, seconds_since, wrap_angle, yaw_from_quat
from quadlog.lidar.levelling import tilt_at, tilt_of, up_in_base
from quadlog.messages import Float, Int, Odometry, PoseSeries
from quadlog.metrics.alignment import find_frame_offset
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.stages.log import LogData
from quadlog.pipelines.stages.outlook import AUTO_ORDER, SEE_INFO, wants_lidar_track, wants_uwb
from quadlog.pipelines.stages.positions.heading import find_heading
from quadlog.pipelines.stages.positions.implausible import tell_implausible
from quadlog.pipelines.stages.positions.legs import LEGS_FRAME, STEP_S, rows_apart, tell_legs, track_legs, write_joints
from quadlog.pipelines.stages.positions.uwb import UwbPositions, locate_tags, with_carried_anchors, write_uwb
from quadlog.pipelines.stages.positions.uwb_tags import lever_of
from quadlog.pipelines.stages.tracks import RobotTrack, TargetTrack
from quadlog.positioning.unlocated import MOST_UNLOCATED, located_rows, segment_of, unlocated_ns
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.decoding import kinds_of
from quadlog.recordings.streams import VELOCITY_FRAME, Streams
from quadlog.recordings.topics.roles import position_topics
from quadlog.recordings.topics.topic_names import names_estimator, names_truth
from quadlog.results.tables import TABLES, write_table
from quadlog.storage.formats.tum import read_tum, write_tum_poses

STOOD_M = 0.1
"""A robot that never was farther from its start stood still: there is no way ahead of it to plan."""
LEAST_TURN_RAD = 1.0
"""A walk that turns by more, or from yaw 0, while its poses' yaw is the same to the last bit, has no orientation."""
LIDAR_FRAME = "lidar_start"
"""The name of map when positions are from the lidar: base, upright, where the first scan was taken."""


def locate(folder: Path, journal: Journal, config: Config, data: LogData) -> dict[str, str]:
    """Writes poses, target and trajectory.tum, with UWB fixes, ranges and stds too. Returns the names of frames.

    Raises MissingInput where the chosen source is not in the recording.
    """
    journal.progress.begin("position", None)
    with journal.clock.stage("position"):
        tracker = None
        if wants_lidar_track(data.log, config):
            from quadlog.pipelines.stages.scans import LidarTracker  # loads the compiler

            tracker = LidarTracker(data, config)
        config = with_carried_anchors(config, data.streams.anchor_places)
        data = replace(data, config=config, tracker=tracker)
        data = replace(data, legs=track_legs(data))
        uwb = locate_tags(data, journal)
        robot = _robot(data, journal, uwb)
        _tell_instead_of_uwb(data, journal, robot)
        target = _target(data, journal, uwb, robot)
        _tell_unlocated(data, journal, robot)
        used = {*journal.topics.get("position", ()), *data.log.roles.topics(robot.source)}
        tell_implausible(data, journal, robot, [one for one in position_topics(data.log.recording) if one not in used])
        others = {"uwb": lambda: _from_lidar(data, journal), "lidar": lambda: _from_uwb(data, journal, uwb)}
        other = others.get(robot.source, lambda: None)()  # for a comparison of UWB and lidar
        reference = settled_reference(data, journal, robot)
        data = replace(data, streams=replace(data.streams, reference=reference))
        if uwb is not None:
            write_uwb(folder, data, uwb)
        robot.write(folder)
        if target is not None:
            target.write(folder)
        if reference is not None:
            write_tum_poses(folder / "reference.tum", reference.t_ns, reference.position_m, reference.quat_xyzw)
        if other is not None:
            write_table(folder / "other_poses.parquet", TABLES["other_poses"], other.columns())
        write_joints(folder, data, journal)
    journal.lose(data.log.recording.losses)
    words = "nothing is followed" if target is None else f"target from {target.source}"
    journal.note(f"robot position from {robot.source}, {words}", first=True)
    return {"frame": robot.frame_id, "reference_frame": "" if reference is None else reference.frame_id}


def _tell_unlocated(data: LogData, journal: Journal, robot: RobotTrack) -> None:
    """Count the time without positions, which is a loss where it is much of the log."""
    spanned_ns, lost_ns = data.last_ns - data.first_ns, 0
    tried = data.tracker is not None or data.legs is not None
    if robot.source != "fixed":
        lost_ns = unlocated_ns(robot.t_ns, data.first_ns, data.last_ns)
    elif tried and data.config.topics.position == "auto":
        lost_ns = spanned_ns
    if robot.source == "lidar" and data.tracker is not None:
        # Scans that are lost for less than a second leave no gap, but positions there are between measured ones.
        lost_ns = max(lost_ns, round(data.tracker.lost_share() * spanned_ns))
    if lost_ns:
        journal.count("unlocated_ms", lost_ns // 1_000_000)
        series = [data.streams.ranges, data.streams.odometry, data.streams.imu, data.streams.joints]
        heard = [each.t_ns for each in (*series, robot, *data.streams.estimates.values()) if each is not None]
        heard_ns = np.sort(np.concatenate([*heard, data.streams.clouds_ns]))
        journal.count("paused_ms", unlocated_ns(heard_ns, data.first_ns, data.last_ns) // 1_000_000)
    if lost_ns > MOST_UNLOCATED * spanned_ns:
        why = "" if robot.source == "uwb" else failures(data).get(robot.source, "")  # ranges may be missing then
        detail = f"{lost_ns / spanned_ns:.0%} of {spanned_ns * 1e-9:.1f} s have no measured position"
        journal.lose([Loss("positions", f"{detail}: {why}" if why else detail)])


def _robot(data: LogData, journal: Journal, uwb: UwbPositions | None) -> RobotTrack:
    """The track of the configured source, or of the first of AUTO_ORDER that there is."""
    wanted = data.config.topics.position
    ends_ns = np.unique(np.array([data.first_ns, data.last_ns], dtype=np.int64))
    sources: dict[str, Callable[[], RobotTrack | None]] = {
        "uwb": lambda: _from_uwb(data, journal, uwb),
        "tf": lambda: _from_tf(data, journal),
        "odometry": lambda: _from_odometry(data, journal),
        "pose": lambda: _from_lone_pose(data, journal),
        "legs": lambda: _from_legs(data, journal),
        "lidar": lambda: _from_lidar(data, journal),
        "gnss": lambda: _from_lone_pose(data, journal, "gnss"),
        "twist": lambda: _from_lone_pose(data, journal, "twist"),
        "fixed": lambda: RobotTrack(ends_ns, np.zeros((len(ends_ns), 2)), np.zeros(len(ends_ns)), "fixed"),
    }
    if wanted == "auto":
        track = next(found for name in AUTO_ORDER if (found := sources[name]()) is not None)
        if track.source == "fixed":
            log, used = data.log, journal.topics.get("position", ())
            others = log.ways_out(data.streams.tf, used, failures(data)) or SEE_INFO
            journal.warn(f"no position was found: the robot is taken to stand at the origin all the time; {others}")
        return track
    if wanted in sources:
        chosen = sources[wanted]()
    elif data.log.recording.channels_of(wanted):
        journal.use("position", wanted)
        channels, mapped = data.log.recording.channels_of(wanted), data.log.recording.mapped
        kinds = {kind for channel in channels for kind in kinds_of(channel, mapped)}
        chosen = _from_poses(data.streams.odometry, "odometry" if Odometry in kinds else "pose", journal)
    else:
        warnings = list[str]()
        chosen = _from_poses(read_tum(Path(wanted), warnings), "file", journal)
        journal.warn(*warnings)
    if chosen is None:
        raise data.log.without(wanted, data.streams.tf, failures(data))
    return chosen


def _tell_instead_of_uwb(data: LogData, journal: Journal, robot: RobotTrack) -> None:
    """Where there are ranges and anchors, and the position is from something else that nobody chose."""
    wanted = data.config.topics.position == "auto" and wants_uwb(data.config) and "uwb" in data.log.roles.found
    if wanted and robot.source not in ("uwb", "fixed"):
        why, flag = data.log.why_not("uwb", failures(data)), set_flag("topics.position", [robot.source])
        journal.warn(
            f"UWB gives no position ({why}): the robot's position is from {robot.source} instead; if that is meant, "
            f"{flag}"
        )


def _from_uwb(data: LogData, journal: Journal, uwb: UwbPositions | None) -> RobotTrack | None:
    if uwb is None or uwb.robot is None or len(uwb.robot.track) == 0:
        return None
    if uwb.body is None:
        track = uwb.robot.track
        x_m, y_m = lever_of(data.config, uwb.robot.tag)
    else:
        track = uwb.body.track
        x_m, y_m = uwb.body.middle_m.tolist()
    tags = [uwb.robot] if uwb.body is None else uwb.body.tags
    yaw_rad, yaw_std_rad = find_heading(data, journal, track, x_m, None if uwb.body is None else uwb.body.yaw)
    return RobotTrack(
        track.t_ns,
        geometry.tag_to_base(track.position_m, yaw_rad, x_m, y_m),
        yaw_rad,
        "uwb",
        covariance_m2=geometry.base_covariance(track.covariance_m2, yaw_rad, yaw_std_rad, x_m, y_m),
        yaw_std_rad=yaw_std_rad,
        # base is on the ground, below the tags by the heights that were given for them.
        z_m=track.z_m - np.mean([tag.height_m for tag in tags]) if all(tag.height_solved for tag in tags) else None,
        tilt_rad=_tilt(data.streams, track.t_ns),
    )


def _tilt(streams: Streams, t_ns: Int) -> Float | None:
    """Roll and pitch (N, 2) of base at t_ns (N,) by the IMU, or else by odometry that is not planar; None without."""
    imu, odometry = streams.imu, streams.odometry
    if imu is not None and imu.quat_xyzw is not None:
        return tilt_at(t_ns, up_in_base(imu.t_ns, imu.quat_xyzw))
    if odometry is not None and odometry.quat_xyzw[:, :2].any():
        return tilt_at(t_ns, up_in_base(odometry.t_ns, odometry.quat_xyzw))
    return None


def _from_tf(data: LogData, journal: Journal) -> RobotTrack | None:
    topics, tree = data.config.topics, data.streams.tf
    base = data.log.roles.frames.base
    frame = None if base is None else tree.fixed_frame(base, topics.map_frame)
    series = None if base is None or frame is None else tree.pose_series(base, frame)
    if series is not None:
        journal.use("tf")
        if frame != topics.map_frame:
            journal.note(f"no frame {topics.map_frame} moves {base} in tf: {frame}, in which it moves, is the map")
    return _from_poses(series, "tf", journal)


def _from_odometry(data: LogData, journal: Journal) -> RobotTrack | None:
    data.log.roles.topic("odometry")  # raises AmbiguousTopic where a choice of one is needed
    if data.streams.odometry is not None:
        journal.use("odometry")
    return _from_poses(data.streams.odometry, "odometry", journal)


def _from_lone_pose(data: LogData, journal: Journal, source: str = "pose") -> RobotTrack | None:
    topics = data.log.roles.topics(source)
    if len(topics) != 1:
        return None
    journal.use(source)
    return _from_poses(data.streams.estimates.get(topics[0]), source, journal)


def _from_legs(data: LogData, journal: Journal) -> RobotTrack | None:
    track = data.legs
    if track is None:
        return None
    journal.use("joints")
    if data.streams.imu is not None:
        journal.use("imu")
    tell_legs(data, journal, track)
    rows = rows_apart(track, STEP_S)
    rows = rows[located_rows(track.t_ns, track.standing)[rows]]
    if len(rows) == 0:
        return None
    yaw_rad = track.rpy_rad[rows, 2] - track.rpy_rad[0, 2]
    cos, sin = np.cos(track.rpy_rad[0, 2]), np.sin(track.rpy_rad[0, 2])
    xy_m = track.position_m[rows, :2] @ np.array([[cos, -sin], [sin, cos]])
    # Height drifts by several times more than the plane: no height rather than a wrong one.
    tilt_rad = track.rpy_rad[rows, :2]
    return RobotTrack(track.t_ns[rows], xy_m, wrap_angle(yaw_rad), "legs", LEGS_FRAME, tilt_rad=tilt_rad)


def _from_lidar(data: LogData, journal: Journal) -> RobotTrack | None:
    track = None if data.tracker is None else data.tracker.track().measured()
    if data.tracker is None or track is None or len(track.t_ns) == 0:
        return None
    journal.use("lidar")
    journal.warn(*data.tracker.warnings())
    turned = track.rotation
    yaw_rad = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    tilt_rad = tilt_of(turned[:, 2])
    x_y_m, z_m = track.position_m[:, :2], track.position_m[:, 2]
    return RobotTrack(track.t_ns, x_y_m, yaw_rad, "lidar", LIDAR_FRAME, z_m=z_m, tilt_rad=tilt_rad)


def _from_poses(poses: PoseSeries | None, source: str, journal: Journal) -> RobotTrack | None:
    if poses is None:
        return None
    if poses.frame_id == VELOCITY_FRAME:
        flag = set_flag("topics.position", ["fixed"])
        journal.warn(
            f"positions are integrated velocities: their error grows all the time; if the robot stood:  {flag}"
        )
    poses = _oriented(poses, "poses have", journal)
    yaw_rad, tilt_rad = yaw_from_quat(poses.quat_xyzw), roll_pitch_from_quat(poses.quat_xyzw)
    xy_m, z_m = poses.position_m[:, :2], poses.position_m[:, 2]
    return RobotTrack(poses.t_ns, xy_m, yaw_rad, source, poses.frame_id, z_m=z_m, tilt_rad=tilt_rad)


def _oriented(poses: PoseSeries, which: str, journal: Journal) -> PoseSeries:
    """The poses; where they have no orientation, with the yaw of their course and a warning."""
    yaw_rad = yaw_from_quat(poses.quat_xyzw)
    if len(poses) == 0 or np.ptp(yaw_rad) > 0:
        return poses
    course_rad = _course(poses.t_ns, poses.position_m[:, :2])
    # No orientation is read as yaw 0, which a straight walk another way shows as well as a turn does.
    ways_rad = course_rad if yaw_rad[0] else np.append(0.0, course_rad)
    if np.ptp(np.unwrap(ways_rad)) <= LEAST_TURN_RAD:
        return poses
    journal.warn(f"the {which} no orientation: the heading is the direction of travel")
    roll_rad, pitch_rad = roll_pitch_from_quat(poses.quat_xyzw).T
    return replace(poses, quat_xyzw=quat_from_euler(wrap_angle(course_rad), pitch_rad, roll_rad))


def _course(t_ns: Int, xy_m: Float) -> Float:
    """(N,) direction of travel over the second around t_ns, held while the robot stands; zeros if it always does."""
    t_s = seconds_since(t_ns, t_ns[0])
    x_m, y_m = (np.interp(t_s + 0.5, t_s, axis_m) - np.interp(t_s - 0.5, t_s, axis_m) for axis_m in xy_m.T)
    moving = np.hypot(x_m, y_m) >= STOOD_M
    held = np.maximum.accumulate(np.where(moving, np.arange(len(t_ns)), int(np.argmax(moving))))
    return np.arctan2(y_m, x_m)[held] * moving.any()


def _target(data: LogData, journal: Journal, uwb: UwbPositions | None, robot: RobotTrack) -> TargetTrack | None:
    """What is followed: the person's tag, a pose topic, a fixed point, or the robot itself so much later."""
    topics = data.config.topics
    person = None if uwb is None else uwb.person
    if topics.target == "fixed":
        point = np.array([[topics.target_x_m, topics.target_y_m]])
        return TargetTrack(robot.t_ns, np.repeat(point, len(robot.t_ns), axis=0), "fixed")
    # UWB's frame is that of the anchors; a robot placed by its own odometry is in another one, unless a user says so.
    own_frame = (
        robot.source in ("odometry", "legs", "lidar", "twist")
        or (robot.source in ("pose", "gnss") and topics.position == "auto")
        or (robot.source == "tf" and robot.frame_id != topics.map_frame)
    )
    in_one_frame = topics.target == "uwb" or not own_frame
    if topics.target in ("auto", "uwb") and in_one_frame and person is not None and len(person.track):
        return TargetTrack(person.track.t_ns, person.track.position_m, "uwb")
    if topics.target == "uwb":
        raise MissingInput("position", "topics.target = 'uwb', but no second tag was located", "see  quadlog info")
    if topics.target in ("auto", "ahead"):
        if np.hypot(*(robot.xy_m - robot.xy_m[0]).T).max() < STOOD_M:
            if robot.source != "fixed":
                journal.note("the robot stood still: there is no way ahead of it")
            return None
        # Where the robot itself is so much later; at the end of the recording, or before a gap, where it stops.
        parts = segment_of(robot.t_ns, robot.t_ns, data.config.lidar.pose_gap_s)
        last_ns = robot.t_ns[np.searchsorted(parts, parts, side="right") - 1]
        later_ns = np.minimum(robot.t_ns + round(topics.ahead_s * 1e9), last_ns)
        return TargetTrack(robot.t_ns, robot.poses_at(later_ns, np.inf)[:, :2], "ahead")
    if data.streams.target is None:
        raise MissingInput("position", f"topics.target = {topics.target!r} gives no poses", "see  quadlog info")
    series = data.streams.target
    journal.use("target")
    return TargetTrack(series.t_ns, series.position_m[:, :2], topics.target)


def robot_track(data: LogData, journal: Journal) -> RobotTrack:
    """The robot's track from the configured source other than UWB. Raises MissingInput."""
    return _robot(replace(data, legs=track_legs(data)), journal, None)


SAME_M = 1e-3
"""A track whose distance from another one is less in most of its poses is that very track."""
LONGEST_GAP_S = 1.0


def settled_reference(data: LogData, journal: Journal, robot: RobotTrack) -> PoseSeries | None:
    """The reference unless the robot's track was made of it; says how far other estimates are from the track."""
    if (reference := data.streams.reference) is not None:
        journal.use("reference")
        (topic,) = data.log.roles.topics("reference")
        if not names_truth(topic) and _is_source(robot, topic, reference):
            journal.warn(
                f"no error is given: {topic}, the chosen reference, is what the robot's {robot.source} is made of"
            )
            reference = None
    for topic, poses in data.streams.estimates.items():
        if robot.source == "fixed" or topic in data.log.roles.topics(robot.source):
            continue
        if _is_source(robot, topic, poses):
            journal.note(f"{topic} is not compared: the robot's {robot.source} is made of it")
        elif (
            apart := find_frame_offset(poses.position_m[:, :2], robot.poses_at(poses.t_ns, LONGEST_GAP_S)[:, :2])
        ) is not None:
            aligned = poses.frame_id != robot.frame_id
            apart_m = apart.after_m if aligned else apart.before_m
            how = " once aligned" if aligned else ""
            journal.note(f"differs from {topic} by {apart_m:.2f} m rms{how} (another estimate, not a reference)")
    return reference and _oriented(reference, "reference has", journal)


def _is_source(robot: RobotTrack, topic: str, poses: PoseSeries) -> bool:
    """Whether poses in the track's own frame are by an estimator that tf gets this frame from, or the track itself."""
    if poses.frame_id != robot.frame_id:
        return False
    if robot.source == "tf" and names_estimator(topic):
        return True
    apart_m = np.hypot(*(robot.poses_at(poses.t_ns, LONGEST_GAP_S)[:, :2] - poses.position_m[:, :2]).T)
    known = np.isfinite(apart_m)
    return bool(known.any() and np.median(apart_m[known]) < SAME_M)


def failures(data: LogData) -> dict[str, str]:
    """Why the sources that were tried give no position, or not all of the time."""
    found = {"uwb": "no position could be solved from the ranges"} if data.streams.ranges else {}
    found |= {} if data.legs is None else {"legs": "no foot stands"}
    return found | ({} if data.tracker is None else {"lidar": data.tracker.why_lost()})
