"""UWB in a replay: which tag is whose, its fixes and track, and what became of every range."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from quadlog.config import Config
from quadlog.geometry import yaw_from_quat
from quadlog.messages import RangeSeries
from quadlog.pipelines.stages.survey import tell_survey
from quadlog.pipelines.stages.uwb_tables import write_uwb_tables
from quadlog.pipelines.stages.uwb_words import tell_located
from quadlog.pipelines.stages.walk import Walk
from quadlog.pipelines.tag_roles import roles_of
from quadlog.positioning.body_motion import BodyMotion
from quadlog.positioning.locate import Anchors, Located, LocateSettings, TagInfo, TagResult, locate
from quadlog.results.schemas import TABLES
from quadlog.results.tables import TableWriter


@dataclass(frozen=True, slots=True)
class UwbPositions:
    """All tags located, and which of them are the robot's and the person's."""

    located: Located
    robot: TagResult | None
    person: TagResult | None


def locate_tags(walk: Walk) -> UwbPositions | None:
    """Every tag in the recording located on its own; None when UWB is not used, which is said."""
    config, ranges = walk.config, walk.streams.ranges
    if not config.uwb.anchors:
        for topic in walk.roles.found["uwb"].topics if "uwb" in walk.roles.found else ():
            walk.warn(f"{topic}: ranges are not used, no [[uwb.anchors]] are configured; quadlog init writes a form")
        return None
    if not wants_uwb(config):
        return None
    if ranges is None:
        walk.warn("anchors are configured, but the recording has no UWB ranges")
        return None
    tags = tags_of(config, ranges)
    robot = roles_of(config, list(tags)).get("robot", -1)
    if robot in tags and config.uwb.odometry:
        tags[robot] = replace(tags[robot], body_motion=_body_motion(walk))
    anchors, settings = anchors_of(config), settings_of(config)
    located = locate(ranges, anchors, list(tags.values()), settings)
    tell_located(walk, located)
    tell_survey(walk, located, anchors, settings)
    by_id = {result.tag: result for result in located.tags}
    roles = roles_of(config, list(tags))
    walk.use("uwb")
    return UwbPositions(located, by_id.get(roles.get("robot", -1)), by_id.get(roles.get("person", -1)))


def _body_motion(walk: Walk) -> BodyMotion | None:
    """What the odometry says of the robot's own motion; None without one that gives velocities."""
    odometry, streams = walk.streams.odometry, walk.streams
    if odometry is None or streams.odometry_linear_mps is None or streams.odometry_angular_radps is None:
        return None
    if not streams.odometry_linear_mps.any():
        return None
    return BodyMotion(
        odometry.t_ns,
        streams.odometry_linear_mps[:, :2],
        yaw_from_quat(odometry.quat_xyzw),
        streams.odometry_angular_radps[:, 2],
    )


def wants_uwb(config: Config) -> bool:
    """Whether the robot or the target may be located by UWB."""
    return bool(config.uwb.anchors) and not {"auto", "uwb"}.isdisjoint({config.topics.position, config.topics.target})


def anchors_of(config: Config) -> Anchors:
    """The configured anchors as arrays."""
    anchors = config.uwb.anchors
    return Anchors(
        np.array([anchor.id for anchor in anchors], dtype=np.int64),
        np.array([[anchor.x_m, anchor.y_m, anchor.z_m] for anchor in anchors]),
        np.array([anchor.bias_m for anchor in anchors]),
    )


def tags_of(config: Config, ranges: RangeSeries) -> dict[int, TagInfo]:
    """The tags to locate, by id, with their heights: those seen, and of a configured table only those on it."""
    seen = [int(tag) for tag in np.unique(ranges.tag)]
    table = {tag.id: tag for tag in config.uwb.tags}
    wanted = [tag for tag in seen if tag in table] if table else seen
    person = roles_of(config, wanted).get("person")
    heights = {tag: config.uwb.person_height_m if tag == person else config.uwb.tag_height_m for tag in wanted}
    heights |= {tag: row.height_m for tag, row in table.items() if row.height_m is not None and tag in heights}
    return {tag: TagInfo(tag, heights[tag]) for tag in wanted}


def settings_of(config: Config) -> LocateSettings:
    """The section `uwb` as the algorithms take it."""
    uwb = config.uwb
    return LocateSettings(
        range_std_m=uwb.range_std_m,
        min_range_m=uwb.min_range_m,
        max_range_m=uwb.max_range_m,
        epoch_s=uwb.epoch_s,
        outlier_m=uwb.outlier_m,
        acceleration_std_mps2=uwb.acceleration_std_mps2,
        method=uwb.method,
        height=uwb.height,
        mirror=uwb.mirror,
        calibrate=uwb.calibrate,
        smooth=uwb.smooth,
    )


def write_uwb(walk: Walk, uwb: UwbPositions) -> None:
    """fixes.parquet and ranges.parquet, tag after tag; and what tells how good they are."""
    with ExitStack() as stack:
        fixes = stack.enter_context(TableWriter(walk.run.path / "fixes.parquet", TABLES["fixes"]))
        ranges = stack.enter_context(TableWriter(walk.run.path / "ranges.parquet", TABLES["ranges"]))
        for result in uwb.located.tags:
            fixes.append(_fix_columns(result))
            rows = result.ranges
            columns = {"t_ns": rows.t_ns, "anchor": rows.anchor, "range_m": rows.range_m}
            ranges.append(columns | {"tag": result.tag, "predicted_m": rows.predicted_m, "weight": rows.weight})
    write_uwb_tables(walk, uwb)


def _fix_columns(result: TagResult) -> dict[str, object]:
    solved, fixes = result.fixes.solved, result.fixes
    covariance = fixes.covariance_m2[solved]
    return {
        "t_ns": result.fix_t_ns[solved],
        "tag": result.tag,
        "x_m": fixes.position_m[solved, 0],
        "y_m": fixes.position_m[solved, 1],
        "z_m": fixes.z_m[solved],
        "cov_xx_m2": covariance[:, 0, 0],
        "cov_xy_m2": covariance[:, 0, 1],
        "cov_yy_m2": covariance[:, 1, 1],
        "n_ranges": fixes.n_ranges[solved],
        "residual_rms_m": fixes.residual_rms_m[solved],
        "outlier": fixes.outlier[solved],
    }
