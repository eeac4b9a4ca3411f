"""Stage `position`: where the robot and the target were, and where they looked, from the best source there is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from quadlog.errors import MissingInput
from quadlog.geometry import base_covariance, tag_to_base, yaw_from_quat
from quadlog.messages import Float, Int, PoseSeries
from quadlog.pipelines.stages.context import ReplayContext, RobotTrack, TargetTrack
from quadlog.pipelines.stages.positions.heading import find_heading
from quadlog.pipelines.stages.positions.tag_errors import lever_of
from quadlog.pipelines.stages.positions.uwb import UwbPositions, locate_tags, write_uwb
from quadlog.results.run.tables import TABLES, write_table
from quadlog.storage.formats.tum import read_tum, write_tum

AUTO_ORDER = ("uwb", "tf", "odometry", "lidar", "fixed")
LIDAR_FRAME = "lidar_start"
"""The name of map when the lidar tells positions: base, upright, where the first scan was taken."""


def locate_walk(walk: ReplayContext) -> None:
    """Fills walk.robot and walk.target; writes poses, target and trajectory.tum, with UWB fixes, ranges and stds too.

    Raises MissingInput where the chosen source is not in the recording.
    """
    walk.progress.begin("position", None)
    with walk.clock.stage("position"):
        uwb = locate_tags(walk)
        walk.robot = _robot(walk, uwb)
        walk.target = _target(walk, uwb, walk.robot)
        if walk.streams.reference is not None:
            walk.use("reference")
        walk.begin_folder()
        if uwb is not None:
            write_uwb(walk, uwb)
        _write_tracks(walk)
    walk.note(f"robot position from {walk.robot.source}, {_target_words(walk.target)}")


def _robot(walk: ReplayContext, uwb: UwbPositions | None) -> RobotTrack:
    """The track of the configured source, or of the first of AUTO_ORDER that there is."""
    wanted = walk.config.topics.position
    sources: dict[str, Callable[[], RobotTrack | None]] = {
        "uwb": lambda: _from_uwb(walk, uwb),
        "tf": lambda: _from_tf(walk),
        "odometry": lambda: _from_odometry(walk),
        "lidar": lambda: _from_lidar(walk),
        "fixed": lambda: _fixed(walk),
    }
    if wanted == "auto":
        track = next(found for name in AUTO_ORDER if (found := sources[name]()) is not None)
        if track.source == "fixed":
            walk.warn("no pose source in the recording: the robot is taken to stand at the origin all the time")
        return track
    if wanted in sources:
        chosen = sources[wanted]()
    elif wanted in {channel.topic for channel in walk.recording.channels}:
        walk.use("position", wanted)
        chosen = _from_poses(walk.streams.odometry, wanted)
    else:
        chosen = _from_poses(read_tum(Path(wanted)), "file")
    if chosen is None:
        raise MissingInput(
            "position", f"topics.position = {wanted!r}, but {_why_not(walk, wanted)}", "see  quadlog info"
        )
    return chosen


def _why_not(walk: ReplayContext, source: str) -> str:
    if source == "uwb" and not walk.config.uwb.anchors:
        return "no [[uwb.anchors]] are configured"
    return "the recording gives no such poses"


def _from_uwb(walk: ReplayContext, uwb: UwbPositions | None) -> RobotTrack | None:
    if uwb is None or uwb.robot is None or len(uwb.robot.track) == 0:
        return None
    track = uwb.robot.track
    x_m, y_m = lever_of(walk.config, uwb.robot.tag)
    yaw_rad, yaw_std_rad = find_heading(walk, track, x_m)
    return RobotTrack(
        track.t_ns,
        tag_to_base(track.position_m, yaw_rad, x_m, y_m),
        yaw_rad,
        "uwb",
        covariance_m2=base_covariance(track.covariance_m2, yaw_rad, yaw_std_rad, x_m, y_m),
        yaw_std_rad=yaw_std_rad,
    )


def _from_tf(walk: ReplayContext) -> RobotTrack | None:
    topics = walk.config.topics
    base = walk.streams.tf.base_frame(topics.base_frame)
    series = None if base is None else walk.streams.tf.pose_series(base, topics.map_frame)
    if series is not None:
        walk.use("tf")
    return _from_poses(series, "tf")


def _from_odometry(walk: ReplayContext) -> RobotTrack | None:
    if walk.streams.odometry is not None:
        walk.use("odometry")
    return _from_poses(walk.streams.odometry, "odometry")


def _from_lidar(walk: ReplayContext) -> RobotTrack | None:
    track = None if walk.tracker is None else walk.tracker.track()
    if walk.tracker is None or track is None or len(track.t_ns) == 0:
        return None
    walk.use("lidar")
    for text in walk.tracker.warnings():
        walk.warn(text)
    yaw_rad = np.arctan2(track.rotation[:, 1, 0], track.rotation[:, 0, 0])
    return RobotTrack(track.t_ns, track.position_m[:, :2], yaw_rad, "lidar", LIDAR_FRAME)


def _from_poses(poses: PoseSeries | None, source: str) -> RobotTrack | None:
    if poses is None or len(poses) == 0:
        return None
    yaw_rad = yaw_from_quat(poses.quat_xyzw)
    return RobotTrack(poses.t_ns, poses.position_m[:, :2], yaw_rad, source, poses.frame_id)


def _fixed(walk: ReplayContext) -> RobotTrack:
    t_ns = np.unique(np.array([walk.first_ns, walk.last_ns], dtype=np.int64))
    return RobotTrack(t_ns, np.zeros((len(t_ns), 2)), np.zeros(len(t_ns)), "fixed")


def _target(walk: ReplayContext, uwb: UwbPositions | None, robot: RobotTrack) -> TargetTrack | None:
    """What is followed: the person's tag, a pose topic, a fixed point, or the robot itself so much later."""
    topics = walk.config.topics
    person = None if uwb is None else uwb.person
    if topics.target == "fixed":
        point = np.array([[topics.target_x_m, topics.target_y_m]])
        return TargetTrack(robot.t_ns, np.repeat(point, len(robot.t_ns), axis=0), "fixed")
    # UWB's frame is that of the anchors; a robot placed by its own odometry is in another one, unless a user says so.
    in_one_frame = topics.target == "uwb" or robot.source not in ("odometry", "lidar")
    if topics.target in ("auto", "uwb") and in_one_frame and person is not None and len(person.track):
        return TargetTrack(person.track.t_ns, person.track.position_m, "uwb")
    if topics.target == "uwb":
        raise MissingInput("position", "topics.target = 'uwb', but no second tag was located", "see  quadlog info")
    if topics.target in ("auto", "ahead"):
        return None if robot.source == "fixed" else _ahead(robot, topics.ahead_s)
    if walk.streams.target is None:
        raise MissingInput("position", f"topics.target = {topics.target!r} gives no poses", "see  quadlog info")
    series = walk.streams.target
    walk.use("target")
    return TargetTrack(series.t_ns, series.position_m[:, :2], topics.target)


def _ahead(robot: RobotTrack, ahead_s: float) -> TargetTrack:
    """Where the robot itself is ahead_s later; at the end of the recording, where it stops."""
    later_ns = np.minimum(robot.t_ns + round(ahead_s * 1e9), robot.t_ns[-1])
    xy_m = robot.poses_at(later_ns, np.inf)[:, :2]
    return TargetTrack(robot.t_ns, xy_m, "ahead")


def _target_words(target: TargetTrack | None) -> str:
    return "nothing is followed" if target is None else f"target from {target.source}"


def _write_tracks(walk: ReplayContext) -> None:
    folder, robot, target, reference = walk.run.path, walk.robot, walk.target, walk.streams.reference
    assert robot is not None
    x_m, y_m = robot.xy_m.T
    columns = {"t_ns": robot.t_ns, "x_m": x_m, "y_m": y_m, "yaw_rad": robot.yaw_rad, "source": robot.source}
    write_table(folder / "poses.parquet", TABLES["poses"], columns)
    if robot.covariance_m2 is not None and robot.yaw_std_rad is not None:
        _write_uncertainty(folder, robot.t_ns, robot.covariance_m2, robot.yaw_std_rad)
    write_tum(folder / "trajectory.tum", robot.t_ns, x_m, y_m, robot.yaw_rad)
    if target is not None:
        columns = {"t_ns": target.t_ns, "x_m": target.xy_m[:, 0], "y_m": target.xy_m[:, 1], "source": target.source}
        write_table(folder / "target.parquet", TABLES["target"], columns)
    if reference is not None:
        x_m, y_m, _ = reference.position_m.T
        write_tum(folder / "reference.tum", reference.t_ns, x_m, y_m, yaw_from_quat(reference.quat_xyzw))


def _write_uncertainty(folder: Path, t_ns: Int, covariance_m2: Float, yaw_std_rad: Float) -> None:
    """pose_uncertainty.parquet: beside poses.parquet row by row, whose columns are fixed."""
    columns = {"t_ns": t_ns, "yaw_std_rad": yaw_std_rad}
    for name, row, column in (("cov_xx_m2", 0, 0), ("cov_xy_m2", 0, 1), ("cov_yy_m2", 1, 1)):
        columns[name] = covariance_m2[:, row, column]
    write_table(folder / "pose_uncertainty.parquet", TABLES["pose_uncertainty"], columns)


def robot_track(walk: ReplayContext) -> RobotTrack:
    """The robot's track from the configured source other than UWB. Raises MissingInput."""
    return _robot(walk, None)
