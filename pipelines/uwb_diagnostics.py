"""What the ranges of each anchor look like once every tag is located: for `info`, whenever anchors are known."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.config import Config
from quadlog.errors import QuadlogError
from quadlog.pipelines.stages.uwb import anchors_of, settings_of, tags_of
from quadlog.positioning.locate import TagResult, locate
from quadlog.recordings.recording import Recording
from quadlog.recordings.roles import Roles
from quadlog.recordings.streams import gather

NLOS_STD = 3.0
"""A range longer than predicted by so many std was late: its straight way was blocked."""


def uwb_diagnostics(recording: Recording, roles: Roles, config: Config) -> tuple[list[dict[str, Any]], list[str]]:
    """A row for each tag and anchor, and why there is none: residual_m is an rms, bias_m with its std, nlos_share.

    residual_m: range less prediction, the bias taken out.
    """
    if not config.uwb.anchors:
        return [], []
    try:
        ranges = gather(recording, uwb=roles.topics("uwb")).ranges
        if ranges is None:
            return [], ["anchors are configured, but the recording has no UWB ranges"]
        located = locate(ranges, anchors_of(config), list(tags_of(config, ranges).values()), settings_of(config))
    except QuadlogError as error:
        return [], [f"UWB: {error}"]
    anchor_ids = [anchor.id for anchor in config.uwb.anchors]
    return [row for result in located.tags for row in _rows(result, anchor_ids, config.uwb.range_std_m)], []


def _rows(result: TagResult, anchor_ids: list[int], range_std_m: float) -> list[dict[str, Any]]:
    rows = []
    for index, anchor in enumerate(anchor_ids):
        mine = (result.ranges.anchor == anchor) & np.isfinite(result.ranges.predicted_m)
        if not mine.any():
            continue
        residual_m = result.ranges.range_m[mine] - result.ranges.predicted_m[mine]
        bias = result.bias
        rows.append(
            {
                "tag": result.tag,
                "anchor": anchor,
                "n": int(mine.sum()),
                "residual_m": float(np.sqrt(np.mean(residual_m**2))),
                "bias_m": None if bias is None else float(bias.bias_m[index]),
                "bias_std_m": None if bias is None else float(bias.std_m[index]),
                "bias_applied": bool(bias is not None and bias.significant[index]),
                "nlos_share": float(np.mean(residual_m > NLOS_STD * range_std_m)),
            }
        )
    return rows
