"""The joints of the logged body: its track by its legs, with warnings, and joints.parquet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quadlog.config.schema import Config
from quadlog.metrics.walking import MOST_UNEVEN, stride_hz, uneven_share
from quadlog.pipelines.stages.journal import Journal
from quadlog.positioning.leg_odometry import LegGeometry, leg_track
from quadlog.positioning.odometry import BodyMotion, motion_between
from quadlog.recordings.formatting import several
from quadlog.results.tables import CONTACTS, FOOT_FORCES, JOINT_COLUMNS, TABLES, TableWriter

if TYPE_CHECKING:
    from quadlog.control.locomotion.robot import Robot
    from quadlog.pipelines.stages.log import LogData
    from quadlog.positioning.leg_odometry import LegTrack

LEGS_FRAME = "legs_start"
"""The name of map when positions are from legs: base, upright, where the first joints were read."""
STEP_S = 0.01
"""Poses are written no more often; joints are read at up to 1 kHz."""
VELOCITY_STEP_S = 0.04
MOST_SLIPPING = 0.65
"""Share of the time: .1 in simulated walks, up to .6 of a real Go2, whose feet give way; .7 to .8 with wrong joints."""
FEWEST_ROWS = 25
"""Joint states in a stride; with fewer a foot's landing is a large part of its stance."""


def track_legs(data: LogData) -> LegTrack | None:
    """The track of the body by its joints, None where no angle is known. Raises UnknownName and UnusableRobot."""
    joints = data.streams.joints
    if joints is None or not np.isfinite(joints.position_rad).any():
        return None
    robot = robot_of(data.config)
    legs = LegGeometry(robot.hips_m, robot.lengths_m, robot.foot_radius_m)
    return leg_track(joints, legs, data.streams.imu)


def robot_of(config: Config) -> Robot:
    """The robot of [robot] model. Raises UnknownName, and what loading a user's file raises."""
    from quadlog.control.locomotion.robot import ROBOTS

    if config.robot.model in ROBOTS:
        return ROBOTS[config.robot.model]
    from quadlog.pipelines.simulation.walk import robot_model
    from quadlog.simulation.robot.height_field import flat

    return robot_model(config, flat()).robot


def tell_legs(data: LogData, journal: Journal, track: LegTrack) -> None:
    """Which robot was assumed, and a warning for everything that leaves the drift without a bound."""
    from quadlog.positioning.leg_odometry import HOLD_S, MAX_GAP_S, AttitudeSource, ContactSource

    robot = data.config.robot
    if "model" not in robot.model_fields_set:
        journal.warn(
            f"legs: no robot is configured; leg lengths of {robot.model!r} are assumed, and distances scale "
            "with them; set robot.model"
        )
    else:
        journal.note(f"legs: lengths and hips are those of {robot.model!r}")
    if track.attitude is AttitudeSource.GYRO:
        journal.warn("legs: no IMU gives an orientation; yaw is summed up from its rates, bias included")
    if track.attitude is AttitudeSource.FEET:
        journal.warn("legs: there is no IMU; yaw comes from the feet alone, and the ground is taken to be level")
    if ContactSource.HEIGHT in track.contact_sources:
        journal.warn("legs: no foot forces and no torques; the lowest feet are taken to stand, which needs even ground")
    if track.unheld_s > HOLD_S:
        journal.warn(f"legs: no foot stands for up to {track.unheld_s:.1f} s; motion in that time is lost")
    step_s = np.diff(track.t_ns) * 1e-9
    usual_s, gaps = float(np.median(step_s)) if len(step_s) else 0.0, np.flatnonzero(step_s > MAX_GAP_S)
    if usual_s > MAX_GAP_S:
        journal.warn(
            f"legs: joints come every {usual_s:.1f} s, too seldom to measure motion; the robot is taken to stand"
        )
    elif len(gaps):
        silent_s, before_mps = step_s[gaps], np.hypot(*track.velocity_mps[np.maximum(gaps - 1, 0), :2].T)
        missing_m = before_mps @ np.where(silent_s > HOLD_S, silent_s, 0.0)
        journal.warn(
            f"legs: joints are silent for up to {silent_s.max():.1f} s, {several(len(gaps), 'silence')} above "
            f"{MAX_GAP_S:g} s, {silent_s.sum():.1f} s in all, {silent_s.sum() / step_s.sum():.0%} of the log; the last "
            f"speed is taken up to {HOLD_S:g} s, in longer ones some {missing_m:.2f} m of the way are missing"
        )
    rows = len(track) / max(step_s.sum() * stride_hz(track.t_ns, track.contact), 1e-9)
    if 0 < rows < FEWEST_ROWS and usual_s <= MAX_GAP_S:
        journal.warn(
            f"legs: joints come {rows:.0f} times a stride, at {len(step_s) / step_s.sum():.0f} Hz: too seldom to see "
            "exactly when a foot stands; record them at a higher rate"
        )
    if track.slipping_share > MOST_SLIPPING:
        journal.warn(
            f"legs: feet that carry move against the ground in {track.slipping_share:.0%} of the time: they slip, or "
            "robot.model, robot.joints or robot.feet is wrong"
        )
    assert data.streams.joints is not None
    unknown = float(np.isnan(data.streams.joints.position_rad).any(axis=1).mean())
    if unknown:
        journal.warn(f"legs: {unknown:.1%} of the joint states lack angles; those legs are left out there")


def legs_motion(track: LegTrack, *, causal: bool) -> BodyMotion | None:
    """The body's velocity and yaw by the legs, between instants VELOCITY_STEP_S apart; None of a shorter track."""
    rows = rows_apart(track, VELOCITY_STEP_S)
    usable = np.ones(max(len(rows) - 1, 0), dtype=bool)
    position_m, yaw_rad = track.position_m[rows, :2], track.rpy_rad[rows, 2]
    return motion_between(track.t_ns[rows], position_m, yaw_rad, usable, "legs", causal=causal)


def rows_apart(track: LegTrack, step_s: float) -> np.ndarray:
    """Rows of the track no closer than about step_s, the first and the last among them."""
    if len(track) < 2:
        return np.arange(len(track))
    _, rows = np.unique((track.t_ns - track.t_ns[0]) // round(step_s * 1e9), return_index=True)
    return np.unique(np.append(rows, len(track) - 1))


BATCH_ROWS = 16384


def write_joints(folder: Path, data: LogData, journal: Journal) -> None:
    """Writes joints.parquet where the log has joints."""
    joints = data.streams.joints
    if joints is None:
        return
    journal.use("joints")
    journal.count("joint_states", len(joints))
    if (share := uneven_share(joints.t_ns)) > MOST_UNEVEN:
        journal.warn(
            f"joints come unevenly or are silent in {share:.0%} of the time: no stride frequency, no duty factor"
        )
    series = joints.position_rad, joints.velocity_radps, joints.torque_nm, joints.foot_force_n
    with TableWriter(folder / "joints.parquet", TABLES["joints"]) as table:
        for begin in range(0, len(joints), BATCH_ROWS):
            rows = slice(begin, begin + BATCH_ROWS)
            contacts = {} if data.legs is None else dict(zip(CONTACTS, data.legs.contact[rows].T, strict=True))
            columns: dict[str, object] = {"t_ns": joints.t_ns[rows], **contacts}
            for names, values in zip((*JOINT_COLUMNS, FOOT_FORCES), series, strict=True):
                columns |= zip(names, values[rows].T, strict=True)
            table.append(columns)
