"""Quality of a recording's ranges for `quadlog info`: links, tags, geometry, and the survey of the anchors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.config.schema import Config
from quadlog.errors import QuadlogError
from quadlog.messages import Float
from quadlog.pipelines.stages.mount import find_mount, poses_in_base
from quadlog.pipelines.stages.outlook import unless_ambiguous
from quadlog.pipelines.stages.positions import uwb, uwb_tags
from quadlog.positioning.ellipses import ellipse_95
from quadlog.positioning.locate import Located, TagResult
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import Streams, gather
from quadlog.recordings.topics.look import Roles


def uwb_diagnostics(
    recording: Recording, roles: Roles, config: Config, whole: bool
) -> tuple[dict[str, Any], list[str]]:
    """`uwb`, a row for each tag and anchor, `uwb_tags`, one for each tag, and `uwb_body`, the tags that a replay solves
    together, or nothing; and warnings.

    Anchors are configured. residual_m of a link is an rms, the applied bias taken out; a number that there is not is
    None. whole: whether all of the recording is read; the anchors' places are checked only then, since excerpts of a
    walk show them too badly.
    """
    try:
        odometry = unless_ambiguous(roles, "odometry") if config.uwb.odometry else None
        streams = gather(recording, uwb=roles.topics("uwb"), odometry=odometry)
        mount = find_mount(recording, roles, config, unless_ambiguous(roles, "lidar"), odometry)
        streams = poses_in_base(
            replace(streams, tf=roles.frames), roles.frames.base or "", mount, {"odometry": odometry}
        )
        if streams.ranges is None:
            return {}, [*streams.warnings, uwb.NO_RANGES]
        if text := uwb.unit_warning(config, streams.ranges, roles.topics("uwb")):
            return {}, [*streams.warnings, text]
        # With odometry as in a replay, so that both have the same residuals.
        located, body = uwb.locate_each(config, streams.ranges, uwb.odometry_motion(streams) if odometry else None)
    except QuadlogError as error:
        return {}, [f"UWB: {error}"]
    tags = [each.tag for each in located.tags]
    role_of = {tag: role for role, tag in uwb_tags.roles_of(config, tags).items()} | dict.fromkeys(body, "robot")
    found = {
        "uwb": _link_rows(located, streams, config),
        "uwb_tags": [_tag_row(each, role_of.get(each.tag)) for each in located.tags],
        "uwb_body": body if len(body) > 1 else [],
    }
    first_ns = int(streams.ranges.t_ns.min())
    places = uwb.place_faults(config, located, body, streams.odometry) if whole else []
    lost = [f"{each.topic}: {each.detail}" for each in streams.losses]
    return found, [*streams.warnings, *lost, *uwb.located_warnings(located, config, first_ns), *places]


def _link_rows(located: Located, streams: Streams, config: Config) -> list[dict[str, Any]]:
    """A row for each link that has ranges on a track."""
    rows = []
    for result in located.tags:
        columns = uwb.link_columns(result, streams, config)
        values = {name: np.broadcast_to(column, len(columns["n"])).tolist() for name, column in columns.items()}
        values = {"residual_m" if name == "residual_rms_m" else name: each for name, each in values.items()}
        for at in np.flatnonzero(columns["n"]):
            row = {name: each[at] for name, each in values.items()}
            rows.append({name: _number(each) if isinstance(each, float) else each for name, each in row.items()})
    return rows


def _tag_row(result: TagResult, role: str | None) -> dict[str, Any]:
    """Medians over a tag's fixes, and its epochs without one."""
    solved, fixes = result.fixes.solved, result.fixes
    major_m, minor_m = ellipse_95(fixes.covariance_m2[solved])
    return {
        "tag": result.tag,
        "role": role,
        "height_m": result.height_m,
        "epochs": len(result.epochs.t_ns),
        "fixes": int(solved.sum()),
        "too_few_ranges": int(np.sum(~solved & ~fixes.degenerate)),
        "degenerate": int(fixes.degenerate.sum()),
        "outliers": int(fixes.outlier.sum()),
        "hdop_median": _median(fixes.hdop[solved]),
        "ellipse_major_median_m": _median(major_m),
        "ellipse_minor_median_m": _median(minor_m),
        "nis": float(np.mean(result.nis)) if len(result.nis) else None,
        "calibration": "calibration is off" if result.bias is None else result.bias.reason,
    }


def _median(values: Float) -> float | None:
    return float(np.median(values)) if len(values) else None


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
