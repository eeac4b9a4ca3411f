"""Whether the configured anchors stand where they are: by the robot's odometry if any, else by ranges alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from quadlog.errors import AnchorsNotObserved
from quadlog.geometry import seconds_since, yaw_from_quat
from quadlog.messages import PoseSeries
from quadlog.positioning.anchors.check import SurveyFaults, TagEpochs, check_survey
from quadlog.positioning.anchors.survey import survey_anchors
from quadlog.positioning.anchors.walk import OdometryPrior, make_walk
from quadlog.positioning.batch.factors import TagRanges, Way
from quadlog.positioning.locate import Anchors, Located, usual_std_m
from quadlog.positioning.settings import LocateSettings

HEIGHT_STD_M = 0.05
"""How well heights that are given are known."""
PRIORS = {
    "odometry": OdometryPrior(0.03, 0.05, 0.01, (0.02, 0.02)),
    "legs": OdometryPrior(0.05, 0.05, 0.01, (0.03, 0.02)),
    "lidar": OdometryPrior(0.003, 0.003, 0.001, (0.01, 0.005)),
    "tf": OdometryPrior(0.01, 0.01, 0.003, (0.01, 0.01)),
}
"""How well sources of odometry are known."""
CHECK_RANGES = 1500
"""An even selection of so many ranges shows an anchor that is a metre off, in half a second."""


def check_located(
    located: Located,
    anchors: Anchors,
    settings: LocateSettings,
    levers_m: Mapping[int, tuple[float, float]],
    odometry: PoseSeries | None,
) -> SurveyFaults:
    """What the ranges say against the anchors' places. levers_m: x_m, y_m in base of the tags on the robot.

    Wrong places may look like a scale of the ranges: what is wrong with it is looked for without it as well.
    """
    found = None if odometry is None else _by_odometry(located, anchors, levers_m, odometry)
    if (found is None or found.unfit) and not located.on_line:
        range_m = [each.without_scale(each.epochs.range_m - anchors.known_bias_m) for each in located.tags]
        logs = [
            TagEpochs(replace(each.epochs, range_m=own_m), each.height_m)
            for each, own_m in zip(located.tags, range_m, strict=True)
        ]
        named = check_survey(logs, anchors.position_m, usual_std_m(settings), settings.acceleration_std_mps2)
        found = named if found is None or named.swapped or named.shifted else found
    found = found or SurveyFaults()
    if found == SurveyFaults() or all(each.bias is None or each.bias.scale == 0 for each in located.tags):
        return found
    unscaled = replace(located, tags=tuple(replace(each, bias=None) for each in located.tags))
    named = check_located(unscaled, anchors, settings, levers_m, odometry)
    return named if named.swapped or named.shifted else found


def _by_odometry(
    located: Located, anchors: Anchors, levers_m: Mapping[int, tuple[float, float]], odometry: PoseSeries
) -> SurveyFaults | None:
    """The check of a survey along the odometry; None where that does not show the places of all anchors heard."""
    tags = [result for result in located.tags if result.tag in levers_m]
    xy_m, yaw_rad = odometry.position_m[:, :2], yaw_from_quat(odometry.quat_xyzw)
    if not tags or len(odometry) < 2 or not np.isfinite(np.column_stack([xy_m, yaw_rad])).all():
        return None
    index = [anchors.columns_of(each.ranges.anchor) for each in tags]
    start_ns = int(odometry.t_ns[0])
    measured = TagRanges(
        seconds_since(np.concatenate([each.ranges.t_ns for each in tags]), start_ns),
        np.concatenate([np.full(len(each.ranges.t_ns), k) for k, each in enumerate(tags)]),
        np.concatenate(index),
        np.concatenate(
            [
                each.without_scale(each.ranges.range_m - anchors.known_bias_m[k])
                for each, k in zip(tags, index, strict=True)
            ]
        ),
        np.array([levers_m[each.tag] for each in tags]),
        np.array([each.height_m for each in tags]),
        len(anchors.ids),
    )
    heights = np.array([anchors.position_m[:, 2], np.full(len(anchors.ids), HEIGHT_STD_M)])
    in_time = measured.rows(np.argsort(measured.t_s, kind="stable"))
    way = Way(seconds_since(odometry.t_ns, start_ns), xy_m, yaw_rad)
    try:
        walk, _ = make_walk(way, in_time, heights, PRIORS["odometry"], most_ranges=CHECK_RANGES)
        survey = survey_anchors(walk, anchors.position_m[:, :2])
    except (AnchorsNotObserved, np.linalg.LinAlgError):
        return None
    unseen = any(each.why_not and each.n_ranges for each in survey.anchors)
    return None if unseen else survey.faults


def fault_warnings(faults: SurveyFaults, anchors: Anchors) -> list[str]:
    """A line for each thing that seems to be wrong; several are alternatives."""
    ids = anchors.ids.tolist()
    texts = [f"anchors {ids[i]} and {ids[j]} seem to be swapped in [[uwb.anchors]]" for i, j in faults.swapped]
    for shifted in faults.shifted:
        x_m, y_m = anchors.position_m[shifted.anchor, :2] + shifted.shift_m
        texts.append(
            f"anchor {ids[shifted.anchor]} seems to stand at x_m = {x_m:.2f}, y_m = {y_m:.2f}, "
            f"{shifted.distance_m:.2f} +- {shifted.distance_std_m:.2f} m from where [[uwb.anchors]] has it"
        )
    if faults.unfit:
        texts.append(
            f"the ranges do not fit the places in [[uwb.anchors]], and one wrong anchor does not explain it; those of "
            f"{' and '.join(str(ids[k]) for k in faults.unfit)} fit worst: measure these again"
        )
    if len(texts) > 1:
        texts.append("one of these is wrong, the first most likely: the ranges cannot distinguish them")
    return texts
