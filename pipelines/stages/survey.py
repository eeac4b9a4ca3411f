"""Whether the anchors stand where the configuration has them: asked of the log itself, and told."""

from __future__ import annotations

from dataclasses import replace

from quadlog.pipelines.stages.walk import Walk
from quadlog.positioning.anchor_order import TagEpochs
from quadlog.positioning.locate import Anchors, Located, LocateSettings
from quadlog.positioning.survey_check import SurveyCheck, check_survey


def tell_survey(walk: Walk, located: Located, anchors: Anchors, settings: LocateSettings) -> None:
    """Warn of anchors that seem to be swapped or at another place."""
    for text in survey_warnings(check_located(located, anchors, settings), anchors):
        walk.warn(text)


def check_located(located: Located, anchors: Anchors, settings: LocateSettings) -> SurveyCheck:
    """The check, by all tags that were located."""
    logs = [
        TagEpochs(replace(result.epochs, range_m=result.epochs.range_m - anchors.known_bias_m), result.height_m)
        for result in located.tags
    ]
    return check_survey(logs, anchors.position_m, settings.range_std_m, settings.acceleration_std_mps2)


def survey_warnings(check: SurveyCheck, anchors: Anchors) -> list[str]:
    """A line for each thing that seems to be wrong; several are alternatives."""
    ids = anchors.ids.tolist()
    texts = [f"anchors {ids[i]} and {ids[j]} seem to be swapped in [[uwb.anchors]]" for i, j in check.swapped]
    for steps in check.turned:
        texts.append(f"the ids in [[uwb.anchors]] seem to be turned around by {steps} in the list")
    for shifted in check.shifted:
        x_m, y_m = shifted.place_m
        texts.append(
            f"anchor {ids[shifted.anchor]} seems to stand at x_m = {x_m:.2f}, y_m = {y_m:.2f}, "
            f"{shifted.distance_m:.2f} +- {shifted.distance_std_m:.2f} m from where [[uwb.anchors]] has it"
        )
    if len(texts) > 1:
        texts.append("one of these is wrong, the first most likely: the ranges cannot tell which")
    return texts
