"""Stage `position`: where the robot and the target were, and where they looked, from the best source there is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quadlog.errors import MissingInput
from quadlog.geometry import base_covariance, tag_to_base, wrap_angle, yaw_from_quat
from quadlog.messages import Float, ImuSeries, Int, PoseSeries
from quadlog.pipelines.stages.context import ReplayContext, RobotTrack, TargetTrack
from quadlog.pipelines.stages.tag_errors import lever_of
from quadlog.pipelines.stages.uwb import UwbPositions, locate_tags, write_uwb
from quadlog.positioning.heading.heading import (
    IMU_DRIFT,
    ODOMETRY_DRIFT,
    AlignedHeading,
    CausalHeading,
    align_gyro,
    align_gyro_causally,
    align_yaw,
    align_yaw_causally,
    course_heading,
    course_heading_std,
    filter_lag_s,
)
from quadlog.positioning.heading.yaw_offset import UNKNOWN_YAW_STD_RAD, SensorDrift
from quadlog.positioning.track.tracker import Track
from quadlog.results.run.tables import TABLES, write_table
from quadlog.storage.formats.tum import read_tum, write_tum

COURSE_ONLY = "heading is the course walked; 1 degree is 17 cm at 10 m"
UNCERTAIN_HEADING_RAD = np.radians(5.0)
DISAGREEMENT_STD, DISAGREEMENT_SHARE = 3.0, 0.1
ASKEW_SHARE = 0.1
SILENT_S = 1.0


@dataclass(frozen=True, slots=True)
class _YawSensor:
    """An orientation over time: yaw_rad (M,) at t_ns (M,), from the topic of a role."""

    role: str
    t_ns: Int
    yaw_rad: Float
    drift: SensorDrift


def find_heading(walk: ReplayContext, track: Track, tag_ahead_m: float) -> tuple[Float, Float]:
    """Yaw (T,) of base at the track's instants, and its std (T,): a sensor's turned onto the course, or the course."""
    if not walk.config.uwb.smooth:
        return _causal_heading(walk, track, tag_ahead_m)
    aligned = {sensor.role: _align(track, sensor, tag_ahead_m) for sensor in _orientations(walk)}
    rate_only = _rate_only(walk)
    if rate_only is not None:
        gyro = align_gyro(track, rate_only.t_ns, rate_only.angular_radps[:, 2], tag_ahead_m)
        aligned["imu"] = gyro.heading
        if gyro.upside_down and gyro.heading.told:
            walk.note("imu: its yaw rate fits the course with the sign turned; it seems to be mounted upside down")
    told = {role: each for role, each in aligned.items() if each.told}
    course, course_std = course_heading(track), course_heading_std(track)
    if not told:
        _tell_course(walk, _why_course(aligned), course_std)
        return course, course_std
    best = min(told, key=lambda role: np.median(told[role].yaw_std_rad))
    if np.median(told[best].yaw_std_rad) > np.median(course_std):
        std_deg = np.degrees(np.median(told[best].yaw_std_rad))
        _tell_course(walk, f"the yaw of {best} fits the course to {std_deg:.0f} degrees only", course_std)
        return course, course_std
    walk.use(best)
    _tell_choice(walk, best, told)
    _tell_aligned(walk, best, told[best])
    return told[best].yaw_rad, told[best].yaw_std_rad


def _causal_heading(walk: ReplayContext, track: Track, tag_ahead_m: float) -> tuple[Float, Float]:
    """Heading that the robot could have had at each instant: of the first sensor, in a fixed order, that is aligned.

    Before any is aligned it is the course. The best sensor is known from the whole log only, and is not used here.
    """
    aligned: dict[str, CausalHeading] = {}
    for sensor in _orientations(walk):
        aligned[sensor.role] = align_yaw_causally(track, sensor.t_ns, sensor.yaw_rad, tag_ahead_m, drift=sensor.drift)
    rate_only = _rate_only(walk)
    if rate_only is not None:
        rate_radps = rate_only.angular_radps[:, 2]
        aligned["imu"] = align_gyro_causally(track, rate_only.t_ns, rate_radps, tag_ahead_m)
    # The first course lies in the future of a causal track.
    yaw_rad = course_heading(track, before_motion_rad=0.0)
    std_rad = course_heading_std(track, before_motion_rad=0.0, lag_s=filter_lag_s(track))
    used = [role for role, heading in aligned.items() if heading.told.any()]
    if not used:
        _tell_course(walk, _why_course(aligned), std_rad)
        return yaw_rad, std_rad
    for role in reversed(used):
        walk.use(role)
        told = aligned[role].told
        yaw_rad = np.where(told, aligned[role].yaw_rad, yaw_rad)
        std_rad = np.where(told, aligned[role].yaw_std_rad, std_rad)
    end_rad = float(std_rad[-1])
    walk.note(
        f"heading from {used[0]}, turned at each instant by what the course had told until then; at the end known to "
        f"{np.degrees(end_rad):.1f} degrees: an obstacle 10 m away is off by {10 * end_rad:.2f} m"
    )
    _warn_if_uncertain(walk, end_rad)
    return yaw_rad, std_rad


def _orientations(walk: ReplayContext) -> list[_YawSensor]:
    """Every orientation of the recording, the IMU's first."""
    imu, odometry = walk.streams.imu, walk.streams.odometry
    sensors: list[_YawSensor] = []
    if imu is not None and imu.quat_xyzw is not None and not frozen(imu):
        sensors.append(_YawSensor("imu", imu.t_ns, yaw_from_quat(imu.quat_xyzw), IMU_DRIFT))
    if odometry is not None:
        sensors.append(_YawSensor("odometry", odometry.t_ns, yaw_from_quat(odometry.quat_xyzw), ODOMETRY_DRIFT))
    return sensors


def _rate_only(walk: ReplayContext) -> ImuSeries | None:
    """The IMU where it gives yaw rates, but no orientation; gaps, in which turns are lost, are told."""
    imu = walk.streams.imu
    if imu is None or (imu.quat_xyzw is not None and not frozen(imu)):
        return None
    if imu.quat_xyzw is not None:
        walk.warn("imu: its orientation is the same in every message and is not used; its yaw rate is")
    gap_s = float(np.diff(imu.t_ns).max(initial=0)) * 1e-9
    if gap_s > SILENT_S:
        walk.warn(f"imu: silent for {gap_s:.1f} s; what the robot turned meanwhile is not in its yaw rate")
    return imu


def frozen(imu: ImuSeries) -> bool:
    """Drivers without an orientation may send the same one all the time."""
    return imu.quat_xyzw is not None and len(imu) > 1 and not np.ptp(imu.quat_xyzw, axis=0).any()


def _align(track: Track, sensor: _YawSensor, tag_ahead_m: float) -> AlignedHeading:
    return align_yaw(track, sensor.t_ns, sensor.yaw_rad, tag_ahead_m, drift=sensor.drift)


def _why_course(aligned: Mapping[str, AlignedHeading | CausalHeading]) -> str:
    if not aligned:
        return "no IMU and no odometry"
    names = " and ".join(aligned)
    if any(isinstance(each, AlignedHeading) and each.moving_s > 0 for each in aligned.values()):
        return f"the course has nothing in common with the yaw of {names}"
    return f"the robot never moved for long enough while {names} gave yaw"


def _tell_course(walk: ReplayContext, why: str, std_rad: Float) -> None:
    std = float(np.median(std_rad))
    if std < 0.99 * UNKNOWN_YAW_STD_RAD:
        known = f"known to {np.degrees(std):.1f} degrees, and wrong where it walks sideways or backwards"
    else:
        known = "the robot hardly moves, so nothing is known of it"
    walk.warn(f"{why}: {COURSE_ONLY}; {known}")


def _tell_choice(walk: ReplayContext, best: str, told: Mapping[str, AlignedHeading]) -> None:
    """Why this sensor and no other; and a warning where they contradict each other."""
    own = told[best]
    for role, other in told.items():
        if role == best:
            continue
        own_deg, other_deg = (np.degrees(np.median(each.yaw_std_rad)) for each in (own, other))
        walk.note(f"heading is better told by {best} ({own_deg:.1f} degrees) than by {role} ({other_deg:.1f} degrees)")
        apart = np.abs(wrap_angle(own.yaw_rad - other.yaw_rad))
        contrary = apart > DISAGREEMENT_STD * np.hypot(own.yaw_std_rad, other.yaw_std_rad)
        if np.mean(contrary) > DISAGREEMENT_SHARE:
            walk.warn(
                f"{best} and {role} contradict each other in {np.mean(contrary):.0%} of the time: their headings are "
                f"up to {np.degrees(apart.max()):.0f} degrees apart; that of {best} is used"
            )


def _tell_aligned(walk: ReplayContext, role: str, heading: AlignedHeading) -> None:
    std = float(np.median(heading.yaw_std_rad))
    drift = ""
    if abs(heading.drift_radps) > 2 * heading.drift_std_radps > 0:
        drift = f", its drift of {np.degrees(heading.drift_radps) * 60:.1f} degrees a minute taken out"
    walk.note(
        f"heading from {role}, turned by {np.degrees(heading.offset_rad):.1f} +- {np.degrees(std):.1f} degrees{drift}: "
        f"an obstacle 10 m away is off by {10 * std:.2f} m"
    )
    _warn_if_uncertain(walk, std)
    if heading.askew_share > ASKEW_SHARE:
        walk.warn(
            f"in {heading.askew_share:.0%} of its motion the robot walks more than 60 degrees off its heading, "
            f"sideways or backwards; were such steps the most, the heading from {role} is turned wrongly"
        )


def _warn_if_uncertain(walk: ReplayContext, std_rad: float) -> None:
    if std_rad > UNCERTAIN_HEADING_RAD:
        walk.warn(f"heading is known to {np.degrees(std_rad):.1f} degrees only; 1 degree is 17 cm at 10 m")


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
