"""Quality of a recording's ranges for `quadlog info`: links, tags, geometry, and the survey of the anchors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.config.schema import Config
from quadlog.errors import QuadlogError
from quadlog.messages import Float
from quadlog.pipelines.stages.positions.check_anchors import check_located, fault_warnings
from quadlog.pipelines.stages.positions.tag_errors import (
    PositionErrors,
    TagErrors,
    body_tags_of,
    dilution_of,
    errors_of_tags,
    lever_of,
    levers_on_robot,
    roles_of,
)
from quadlog.pipelines.stages.positions.uwb import anchors_of, located_warnings, odometry_motion, settings_of, tags_of
from quadlog.positioning.dilution import CHI2_95, ellipse_95
from quadlog.positioning.links import link_quality, weak_first_path_share
from quadlog.positioning.locate import Located, TagResult, locate
from quadlog.recordings.recording import Recording
from quadlog.recordings.roles import Roles
from quadlog.recordings.streams import Streams, gather

MAP_ROWS, MAP_COLUMNS = 8, 12
"""What fits a terminal."""


def uwb_diagnostics(
    recording: Recording, roles: Roles, config: Config, whole: bool
) -> tuple[dict[str, Any], list[str]]:
    """`uwb`, a row for each tag and anchor, `uwb_tags`, one for each tag, `uwb_body`, the tags that a replay solves
    together, and `dilution`; and why they are empty.

    Anchors are configured. residual_m of a link is an rms, the applied bias taken out; a number that there is not is
    None. whole: whether all of the recording is read; the anchors' places are checked only then, since excerpts of a
    walk tell them too badly.
    """
    empty: dict[str, Any] = {"uwb": [], "uwb_tags": [], "uwb_body": [], "dilution": None}
    reference = roles.found["reference"].topics[0] if "reference" in roles.found else None
    try:
        odometry = roles.found["odometry"].topics[0] if config.uwb.odometry and "odometry" in roles.found else None
        streams = gather(recording, uwb=roles.topics("uwb"), reference=reference, odometry=odometry)
        if streams.ranges is None:
            return empty, ["anchors are configured, but the recording has no UWB ranges"]
        tags = tags_of(config, streams.ranges)
        body = body_tags_of(config, list(tags))
        if len(body) == 1 and config.uwb.odometry:  # as in a replay, so that both have the same residuals
            x_m, y_m = lever_of(config, body[0])
            tags[body[0]] = replace(tags[body[0]], body_motion=odometry_motion(streams), x_m=x_m, y_m=y_m)
        anchors, settings = anchors_of(config), settings_of(config)
        located = locate(streams.ranges, anchors, list(tags.values()), settings)
    except QuadlogError as error:
        return empty, [f"UWB: {error}"]
    role_of = {tag: role for role, tag in roles_of(config, list(tags)).items()} | dict.fromkeys(body, "robot")
    robot = body[0] if body else None
    errors = errors_of_tags(located, levers_on_robot(config, robot), streams.reference)
    found = {
        "uwb": _link_rows(located, streams, config),
        "uwb_tags": [_tag_row(each, role_of.get(each.tag), errors.get(each.tag), reference) for each in located.tags],
        "uwb_body": body if len(body) > 1 else [],
        "dilution": _dilution(located, robot, config),
    }
    first_ns = int(streams.ranges.t_ns.min())
    levers_m = {tag: lever_of(config, tag) for tag in body}
    places = []
    if whole:
        places = fault_warnings(check_located(located, anchors, settings, levers_m, streams.odometry), anchors)
    lost = [f"{each.topic}: {each.detail}" for each in streams.losses]
    return found, [*streams.warnings, *lost, *located_warnings(located, config, first_ns), *places]


def _link_rows(located: Located, streams: Streams, config: Config) -> list[dict[str, Any]]:
    """A row for each link that has ranges on a track."""
    assert streams.ranges is not None
    anchor_ids = np.array([anchor.id for anchor in config.uwb.anchors], dtype=np.int64)
    rows = []
    for result in located.tags:
        links = link_quality(result.ranges, anchor_ids, result.bias, config.uwb.range_std_m)
        weak = weak_first_path_share(streams.ranges, streams.range_gap_db, result.tag, anchor_ids)
        rows += [
            {
                "tag": result.tag,
                "anchor": int(anchor_ids[index]),
                "n": int(links.n[index]),
                "residual_m": float(links.residual_rms_m[index]),
                "residual_median_m": float(links.residual_median_m[index]),
                "bias_m": _number(links.bias_m[index]),
                "bias_std_m": _number(links.bias_std_m[index]),
                "bias_applied": bool(links.bias_applied[index]),
                "why_not": links.why_not[index],
                "nlos_share": float(links.nlos_share[index]),
                "weak_first_path_share": _number(weak[index]),
            }
            for index in np.flatnonzero(links.n)
        ]
    return rows


def _tag_row(result: TagResult, role: str | None, errors: TagErrors | None, reference: str | None) -> dict[str, Any]:
    """Medians over a tag's fixes, its epochs without one, and with a reference its errors."""
    solved, fixes = result.fixes.solved, result.fixes
    major_m, minor_m = ellipse_95(fixes.covariance_m2[solved])
    row = {
        "tag": result.tag,
        "role": role,
        "height_m": result.height_m,
        "epochs": len(result.fix_t_ns),
        "fixes": int(solved.sum()),
        "too_few_ranges": result.n_too_few,
        "degenerate": result.n_degenerate,
        "outliers": int(fixes.outlier.sum()),
        "hdop_median": _median(fixes.hdop[solved]),
        "ellipse_major_median_m": _median(major_m),
        "ellipse_minor_median_m": _median(minor_m),
        "nis": float(np.mean(result.nis)) if len(result.nis) else None,
        "calibration": "calibration is off" if result.bias is None else result.bias.reason,
    }
    if errors is None:
        return row | {"reference": None, "fix_error": None, "track_error": None}
    return row | {
        "reference": reference,
        "fix_error": _error_summary(errors.fixes),
        "track_error": _error_summary(errors.track),
    }


def _error_summary(errors: PositionErrors) -> dict[str, Any] | None:
    """RMSE, mean error and the share inside the claimed 95 % ellipses; None where the reference covers nothing."""
    if len(errors.t_ns) == 0:
        return None
    bias_x_m, bias_y_m = errors.error_m.mean(axis=0)
    return {
        "n": len(errors.t_ns),
        "rmse_m": float(np.sqrt(np.mean(errors.distance_m**2))),
        "bias_x_m": float(bias_x_m),
        "bias_y_m": float(bias_y_m),
        "share_in_ellipse": float(np.mean(errors.distance_m <= errors.bound_m)),
        "nees": float(np.mean(CHI2_95 * (errors.distance_m / errors.bound_m) ** 2)),
    }


def _dilution(located: Located, robot: int | None, config: Config) -> dict[str, Any] | None:
    """A coarse map of HDOP, rows from south to north, None in a cell without a fix."""
    grid = dilution_of(located, robot, config, MAP_ROWS, MAP_COLUMNS)
    if grid is None:
        return None
    return {
        "origin_x_m": float(grid.origin_m[0]),
        "origin_y_m": float(grid.origin_m[1]),
        "cell_m": grid.cell_m,
        "tag_height_m": grid.tag_height_m,
        "hdop": [[_number(value) for value in row] for row in grid.hdop],
    }


def _median(values: Float) -> float | None:
    return float(np.median(values)) if len(values) else None


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
