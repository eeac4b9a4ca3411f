"""Heading of the robot: yaw of an IMU or odometry turned onto the course of the track, or the course itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quadlog.geometry import wrap_angle, yaw_from_quat
from quadlog.messages import Float, ImuSeries
from quadlog.pipelines.stages.journal import Journal
from quadlog.positioning.batch.motion import Track
from quadlog.positioning.heading import (
    IMU_DRIFT,
    ODOMETRY_DRIFT,
    UNKNOWN_YAW_STD_RAD,
    AlignedHeading,
    TagsYaw,
    YawSensor,
    align_yaw,
    course_heading,
    filter_lag_s,
    gyro_sensor,
)
from quadlog.recordings.streams import Streams

if TYPE_CHECKING:
    from quadlog.pipelines.stages.log import LogData

COURSE_ONLY = "heading is the direction of travel"
UNCERTAIN_HEADING_RAD = np.radians(5.0)
DISAGREEMENT_STD, DISAGREEMENT_SHARE = 3.0, 0.1
ASKEW_SHARE = 0.1
SILENT_S = 1.0
SIDEWAYS_STD_RAD = np.radians(10.0)
"""By how much carriers move beside the direction in which they look, which the std of a course does not hold."""


def find_heading(
    data: LogData, journal: Journal, track: Track, tag_ahead_m: float, by_tags: TagsYaw | None = None
) -> tuple[Float, Float]:
    """Yaw (T,) of base at the track's instants, and its std (T,): a sensor's turned onto the course, or the course.

    by_tags, of several tags on the robot, takes the place of the course unless it is known worse than that.
    """
    causal = not data.config.uwb.smooth
    # The first course lies in the future of a causal track.
    course, course_std = course_heading(track, 0.0, filter_lag_s(track)) if causal else course_heading(track)
    sideways = np.hypot(np.median(course_std), SIDEWAYS_STD_RAD)
    if by_tags is not None and not causal and np.median(by_tags.std_rad) > sideways:
        tags_deg = _median_deg(by_tags.std_rad)
        journal.note(
            f"the lever arms of the tags show the heading to {tags_deg:.1f} degrees only, and are not used for it"
        )
        by_tags = None
    own = (course, course_std) if by_tags is None else (by_tags.yaw_rad, by_tags.std_rad)
    sensors = _orientations(data.streams, journal)
    aligned = {role: align_yaw(track, sensor, tag_ahead_m, by_tags, causal=causal) for role, sensor in sensors.items()}
    usable = {role: each for role, each in aligned.items() if each.is_known.any()}
    if causal and usable:
        return _first_known(journal, usable, own, "the course" if by_tags is None else "the tags")
    if "imu" in usable and usable["imu"].upside_down:
        journal.note("imu: its yaw rate fits the course with the sign turned; it seems to be mounted upside down")
    best = min(usable, key=lambda role: np.median(usable[role].yaw_std_rad), default=None)
    if best is not None and np.median(usable[best].yaw_std_rad) <= np.median(own[1]):
        journal.use(best)
        _tell_choice(journal, best, usable)
        _tell_aligned(journal, best, usable[best], by_tags)
        return usable[best].yaw_rad, usable[best].yaw_std_rad
    best_deg = 0.0 if best is None else _median_deg(usable[best].yaw_std_rad)
    if by_tags is None:
        why = f"the yaw of {best} fits the course to {best_deg:.0f} degrees only" if best else _why_course(aligned)
        _tell_course(journal, why, course_std)
        return own
    others = f", better than {best} ({best_deg:.1f} degrees)" if best else ""
    journal.note(
        f"heading from the lever arms of the tags, known to {_median_deg(by_tags.std_rad):.1f} degrees{others}",
        first=True,
    )
    _warn_if_uncertain(journal, float(np.median(by_tags.std_rad)))
    return own


def _median_deg(std_rad: Float) -> float:
    return float(np.degrees(np.median(std_rad)))


def _first_known(
    journal: Journal, usable: Mapping[str, AlignedHeading], own: tuple[Float, Float], onto: str
) -> tuple[Float, Float]:
    """Heading that the robot could have had at each instant: of the first sensor, in a fixed order, that is aligned.

    Before any is, its own: that of the tags, or the course. The best sensor is known from the whole log only, and is
    not used here.
    """
    yaw_rad, std_rad = own
    for role, each in reversed(list(usable.items())):
        journal.use(role)
        yaw_rad = np.where(each.is_known, each.yaw_rad, yaw_rad)
        std_rad = np.where(each.is_known, each.yaw_std_rad, std_rad)
    end_rad = float(std_rad[-1])
    journal.note(
        f"heading from {next(iter(usable))}, aligned to {onto} up to each instant; std at the end "
        f"{np.degrees(end_rad):.1f} degrees, an error of {10 * end_rad:.2f} m at a distance of 10 m",
        first=True,
    )
    _warn_if_uncertain(journal, end_rad)
    return yaw_rad, std_rad


def _orientations(streams: Streams, journal: Journal) -> dict[str, YawSensor]:
    """Every yaw of the recording by its role: an IMU's orientation first, the integral of its rate last."""
    imu, odometry = streams.imu, streams.odometry
    sensors: dict[str, YawSensor] = {}
    rate_only = _rate_only(imu, journal)
    if imu is not None and imu.quat_xyzw is not None:
        sensors["imu"] = YawSensor(imu.t_ns, yaw_from_quat(imu.quat_xyzw), IMU_DRIFT)
    if odometry is not None:
        sensors["odometry"] = YawSensor(odometry.t_ns, yaw_from_quat(odometry.quat_xyzw), ODOMETRY_DRIFT)
    if rate_only is not None:
        sensors["imu"] = gyro_sensor(rate_only.t_ns, rate_only.angular_radps[:, 2])
    return sensors


def _rate_only(imu: ImuSeries | None, journal: Journal) -> ImuSeries | None:
    """The IMU's messages with a yaw rate, where it gives no orientation; gaps, in which turns are lost, are noted."""
    if imu is None or imu.quat_xyzw is not None:
        return None
    known = np.isfinite(imu.angular_radps[:, 2])
    if not known.all():
        journal.warn(f"imu: {np.sum(~known)} of {len(imu)} messages without a number as yaw rate are left out")
        imu = replace(imu, t_ns=imu.t_ns[known], angular_radps=imu.angular_radps[known])
    gap_s = float(np.diff(imu.t_ns).max(initial=0)) * 1e-9
    if gap_s > SILENT_S:
        journal.warn(f"imu: silent for {gap_s:.1f} s; turns in that time are missing from its yaw")
    return imu if len(imu) else None


def _why_course(aligned: Mapping[str, AlignedHeading]) -> str:
    if not aligned:
        return "no IMU and no odometry"
    names = " and ".join(aligned)
    if any(each.fit is not None for each in aligned.values()):
        return f"the yaw of {names} does not match the direction of travel"
    return f"the robot never moved for long enough while {names} gave yaw"


def _tell_course(journal: Journal, why: str, std_rad: Float) -> None:
    std = float(np.median(std_rad))
    if std < 0.99 * UNKNOWN_YAW_STD_RAD:
        known = f"known to {np.degrees(std):.1f} degrees, and wrong when the robot walks sideways or backwards"
    else:
        known = "the robot hardly moves, so it is unknown"
    journal.warn(f"{why}: {COURSE_ONLY}; {known}")


def _tell_choice(journal: Journal, best: str, usable: Mapping[str, AlignedHeading]) -> None:
    """Why this sensor and no other; and a warning where they contradict each other."""
    own = usable[best]
    for role, other in usable.items():
        if role == best:
            continue
        own_deg, other_deg = (np.degrees(np.median(each.yaw_std_rad)) for each in (own, other))
        journal.note(f"heading from {best} (std {own_deg:.1f} degrees), not from {role} ({other_deg:.1f} degrees)")
        apart = np.abs(wrap_angle(own.yaw_rad - other.yaw_rad))
        contrary = apart > DISAGREEMENT_STD * np.hypot(own.yaw_std_rad, other.yaw_std_rad)
        if np.mean(contrary) > DISAGREEMENT_SHARE:
            journal.warn(
                f"{best} and {role} contradict each other in {np.mean(contrary):.0%} of the time: their headings are "
                f"up to {np.degrees(apart.max()):.0f} degrees apart; that of {best} is used"
            )


def _tell_aligned(journal: Journal, role: str, heading: AlignedHeading, by_tags: TagsYaw | None) -> None:
    fit, std, drift = heading.fit, float(np.median(heading.yaw_std_rad)), ""
    assert fit is not None
    if by_tags is not None:
        journal.note(
            f"heading from {role}, turned by {np.degrees(fit.offset_rad):.1f} degrees onto the yaw of the tags: known "
            f"to {np.degrees(std):.1f} degrees, the tags' own to {_median_deg(by_tags.std_rad):.1f} degrees",
            first=True,
        )
        _warn_if_uncertain(journal, std)
        return
    if abs(fit.drift_radps) > 2 * np.sqrt(fit.covariance[1, 1]) > 0:
        drift = f", its drift of {np.degrees(fit.drift_radps) * 60:.1f} degrees a minute taken out"
    journal.note(
        f"heading from {role}, turned by {np.degrees(fit.offset_rad):.1f} +- {np.degrees(std):.1f} degrees{drift}, "
        f"an error of {10 * std:.2f} m at a distance of 10 m",
        first=True,
    )
    _warn_if_uncertain(journal, std)
    if fit.askew_share > ASKEW_SHARE:
        journal.warn(
            f"in {fit.askew_share:.0%} of its motion the robot walks more than 60 degrees off its heading, "
            f"sideways or backwards; if it does so most of the time, the heading from {role} is aligned wrongly"
        )


def _warn_if_uncertain(journal: Journal, std_rad: float) -> None:
    if std_rad > UNCERTAIN_HEADING_RAD:
        off_m = 10 * std_rad
        journal.warn(
            f"heading std is {np.degrees(std_rad):.1f} degrees, an error of {off_m:.2f} m at a distance of 10 m"
        )
