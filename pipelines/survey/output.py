"""What `quadlog survey` gives: the object of --json, and the configuration with the anchors in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import tomli_w

from quadlog.config.schema import Config
from quadlog.positioning.self_survey.survey import AnchorSurvey, SurveyedAnchor
from quadlog.recordings.containers.container import Loss


@dataclass(frozen=True, slots=True)
class SurveyOutcome:
    """The survey of a recording, with ids of anchors by index; source: where the odometry came from; start_ns: its
    first pose; z_given: ids of the anchors whose heights were given; losses.
    """

    survey: AnchorSurvey
    anchor_ids: tuple[int, ...]
    tags: tuple[int, ...]
    source: str
    start_ns: int
    config: Config
    z_given: frozenset[int]
    losses: tuple[Loss, ...]

    @property
    def configured(self) -> dict[int, tuple[float, float, float]]:
        """Anchor id -> position in map, of the anchors that are known."""
        return {each.id: (each.x_m, each.y_m, each.z_m) for each in self.config.uwb.anchors}

    @property
    def kept(self) -> frozenset[int]:
        """Ids of known anchors that keep their places in the config.

        All, unless there was nothing else to survey: then those whose positions are not observed.
        """
        known = frozenset(self.configured)
        if set(self.anchor_ids) - known:
            return known
        return known - {self.anchor_ids[each.index] for each in self.survey.anchors if not each.why_not}


def survey_json(outcome: SurveyOutcome) -> dict[str, Any]:
    """What `survey --json` prints."""
    survey = outcome.survey
    x_m, y_m, yaw_rad = survey.start.tolist()
    return {
        "frame": "map" if survey.aligned_to else "first_pose",
        "aligned_to": survey.aligned_to,
        "tags": list(outcome.tags),
        "range_std_m": survey.range_std_m,
        "odometry": {
            "source": outcome.source,
            "way_m": survey.way_m,
            "scale": survey.scale,
            "turn_scale": survey.turn_scale,
            "yaw_drift_radps": survey.yaw_drift_radps,
            "delay_s": survey.delay_s,
            "drift_m": survey.drift[0],
            "drift_rad": survey.drift[1],
            "start": {"t_ns": outcome.start_ns, "x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad},
        },
        "anchors": [_anchor_row(outcome, each) for each in survey.anchors],
    }


def _anchor_row(outcome: SurveyOutcome, anchor: SurveyedAnchor) -> dict[str, Any]:
    """One anchor; what is not known is None."""
    names = [f"{axis}_m" for axis in "xyz"]
    bounds = [f"{axis}_bound_m" for axis in "xyz"]
    values = dict(zip(names, anchor.position_m, strict=True)) | dict(zip(bounds, anchor.bound_m, strict=True))
    values |= {"bias_m": anchor.bias_m, "bias_bound_m": 1.96 * anchor.bias_std_m, "nlos_share": anchor.late_share}
    values |= {
        f"cov_{axes}_m2": anchor.covariance_m2[at] for axes, at in (("xx", (0, 0)), ("xy", (0, 1)), ("yy", (1, 1)))
    }
    observed = not anchor.why_not
    always = {"nlos_share"}
    numbers = {
        name: float(value) if np.isfinite(value) and (observed or name in always) else None
        for name, value in values.items()
    }
    anchor_id = outcome.anchor_ids[anchor.index]
    return {
        "id": anchor_id,
        **numbers,
        "n": anchor.n_ranges,
        "observed": observed,
        "z_observed": observed and anchor.height_observed,
        "z_given": anchor_id in outcome.z_given,
        "known": anchor_id in outcome.configured,
        "why_not": anchor.why_not,
    }


HEADER = """\
# Anchors surveyed by quadlog survey in the frame {frame}; a replay takes this file with -c.
# Positions and biases have 95 % bounds beside them.
"""


def survey_toml(outcome: SurveyOutcome) -> str:
    """A quadlog.toml: the configuration of the survey with the anchors in it; topics.position is left out."""
    frame = "map" if outcome.survey.aligned_to else "of base at the first pose"
    config = outcome.config.model_dump(exclude_unset=True, exclude_none=True)
    config.get("topics", {}).pop("position", None)
    configured = {each["id"]: each for each in config.get("uwb", {}).pop("anchors", ())}
    lines = [HEADER.format(frame=frame), tomli_w.dumps({name: keys for name, keys in config.items() if keys})]
    for each in outcome.survey.anchors:
        anchor_id = outcome.anchor_ids[each.index]
        if anchor_id not in outcome.kept:
            lines.append(_anchor_table(anchor_id, each, anchor_id in outcome.z_given))
    said = "# known" if outcome.survey.aligned_to else "# known; in its configured frame"
    for anchor_id in sorted(outcome.kept):
        lines.append(f"{said}\n[[uwb.anchors]]\n{tomli_w.dumps(configured[anchor_id])}")
    return "\n".join(lines)


def _anchor_table(anchor_id: int, anchor: SurveyedAnchor, z_given: bool) -> str:
    if anchor.why_not:
        return f"# anchor {anchor_id} is not surveyed: {anchor.why_not}\n"
    lines = ["[[uwb.anchors]]", f"id = {anchor_id}"]
    for axis, value, bound in zip("xyz", anchor.position_m, anchor.bound_m, strict=True):
        told = axis != "z" or anchor.height_observed or z_given
        guess = "" if told else ", a guess: not observed on this walk"
        lines.append(f"{axis}_m = {value:.4f}  # +- {bound:.3f}{guess}")
    lines.append(f"bias_m = {anchor.bias_m:.4f}  # +- {1.96 * anchor.bias_std_m:.3f}")
    return "\n".join(lines) + "\n"
