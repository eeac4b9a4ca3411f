"""What the survey of a recording is given: tags, ranges, expected heights, and how well the odometry is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from quadlog.config.schema import Config
from quadlog.errors import InvalidConfigValue, MissingInput, TooLarge
from quadlog.messages import Float, Int, RangeSeries
from quadlog.pipelines.journal import Journal
from quadlog.pipelines.stages.positions.tag_errors import roles_of
from quadlog.pipelines.stages.tracks import RobotTrack
from quadlog.positioning.lidar_odometry import ScanMatch
from quadlog.positioning.self_survey.batch import HeightPrior, OdometryPrior
from quadlog.positioning.self_survey.problem import MeasuredRanges, OdometryPoses

if TYPE_CHECKING:
    from quadlog.pipelines.log import LogData

ABOVE_TAG_M, ABOVE_TAG_STD_M = 1.0, 0.8
"""Anchors whose height nobody gives are expected this much above the tag: on a walk over a level floor, an anchor as
far below the tag fits as well."""
MOST_LISTED = 20
HEIGHT_STD_M = 0.05
"""How well heights that are given are known."""
MOST_ANCHORS, MOST_LINKS = 256, 1024
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
PRIORS = {
    "odometry": OdometryPrior(0.03, 0.05, 0.01, (0.02, 0.02)),
    "legs": OdometryPrior(0.05, 0.05, 0.01, (0.03, 0.02)),
    "lidar": OdometryPrior(0.003, 0.003, 0.001, (0.01, 0.005), first_pose_std=(0.02, 0.003)),
    "tf": OdometryPrior(0.01, 0.01, 0.003, (0.01, 0.01)),
}
LEAST_PRIOR = OdometryPrior(0.002, 0.001, 0.0003, (0.003, 0.002))
"""Of a pose topic or file that the configuration names, such as motion capture."""


def odometry_poses(data: LogData, track: RobotTrack) -> OdometryPoses:
    """The robot's track; poses of the lidar are doubtful where a scan does not determine all of the motion."""
    doubtful: np.ndarray | None = None
    if track.source == "lidar" and data.tracker is not None:
        doubtful = data.tracker.track().measured().match != ScanMatch.MATCHED
    return OdometryPoses(track.t_ns, track.xy_m, track.yaw_rad, doubtful)


def odometry_prior(data: LogData, track: RobotTrack) -> OdometryPrior:
    """How well the source of the track is known; a topic that is named may be odometry all the same."""
    types = {channel.type_name for channel in data.log.recording.channels if channel.topic == track.source}
    return PRIORS.get("odometry" if ODOMETRY_TYPE in types else track.source, LEAST_PRIOR)


def robot_tags(config: Config, journal: Journal, ranges: RangeSeries) -> tuple[int, ...]:
    """The tags that sit on the robot. Raises MissingInput."""
    seen = [int(tag) for tag in np.unique(ranges.tag)]
    table = config.uwb.tags
    tags = tuple(each.id for each in table if each.role == "robot" and each.id in seen)
    if not table:
        tags = (roles_of(config, seen)["robot"],)
    if not tags:
        some = f"{listed(seen[:MOST_LISTED])}{', …' if len(seen) > MOST_LISTED else ''}"
        raise MissingInput("survey", "no tag of role robot in [[uwb.tags]] has ranges", f"the tags are {some}")
    nameless = len(set(seen) - {each.id for each in table} - set(tags))
    if nameless:
        taken = "" if table else f"tag {tags[0]} is taken to be the robot's, "
        journal.warn(f"{taken}{nameless} other tags are not used; name the robot's in [[uwb.tags]]")
    return tags


def tag_heights(config: Config, tags: Iterable[int]) -> Float:
    """(T,) heights of tags above the floor, as configured."""
    own = {tag.id: tag.height_m for tag in config.uwb.tags if tag.height_m is not None}
    return np.array([own.get(tag, config.uwb.tag_height_m) for tag in tags])


def usable_ranges(
    config: Config, journal: Journal, ranges: RangeSeries, tags: tuple[int, ...]
) -> tuple[MeasuredRanges, Int]:
    """The ranges of the robot's tags within the configured limits, and the ids (A,) of the anchors. Raises TooLarge."""
    uwb = config.uwb
    own = np.isin(ranges.tag, tags)
    with np.errstate(invalid="ignore"):
        usable = own & (ranges.range_m >= uwb.min_range_m) & (ranges.range_m <= uwb.max_range_m)
    bad = int((own & ~usable).sum())
    if bad:
        journal.warn(f"{bad} ranges that are NaN, infinite or outside uwb.min_range_m to uwb.max_range_m are left out")
    if not usable.any():
        raise MissingInput("survey", f"no usable range of tag {listed(tags)}", "see  quadlog info")
    anchor_ids, anchor = np.unique(ranges.anchor[usable], return_inverse=True)
    if len(anchor_ids) > MOST_ANCHORS:
        raise TooLarge("survey: anchors", len(anchor_ids), MOST_ANCHORS)
    if len(tags) * len(anchor_ids) > MOST_LINKS:
        raise TooLarge("survey: links between the robot's tags and anchors", len(tags) * len(anchor_ids), MOST_LINKS)
    tag = np.argsort(tags)[np.searchsorted(np.sort(tags), ranges.tag[usable])]
    anchor = np.asarray(anchor, dtype=np.int64)
    return MeasuredRanges(ranges.t_ns[usable], tag, anchor, ranges.range_m[usable]), anchor_ids


def height_prior(
    config: Config, anchor_ids: Int, tags: tuple[int, ...], given: Mapping[int | None, float]
) -> HeightPrior:
    """Expected heights: as given, else as configured, else above the tag. Raises InvalidConfigValue for unknown ids."""
    ids = anchor_ids.tolist()
    unknown = [each for each in given if each is not None and each not in ids]
    if unknown:
        raise InvalidConfigValue(str(unknown[0]), f"no such anchor; there are {listed(ids)}", "--anchor-height")
    heights = {each.id: each.z_m for each in config.uwb.anchors} | {
        key: value for key, value in given.items() if key is not None
    }
    usual_m = float(np.mean(tag_heights(config, tags))) + ABOVE_TAG_M
    everywhere = given.get(None)
    mean_m = np.array([heights.get(each, usual_m if everywhere is None else everywhere) for each in ids])
    std_m = np.array([HEIGHT_STD_M if each in heights or everywhere is not None else ABOVE_TAG_STD_M for each in ids])
    return HeightPrior(mean_m, std_m)


def listed(ids: Iterable[int]) -> str:
    """Ids for a message."""
    return ", ".join(map(str, ids))
