"""`quadlog survey`: positions of unknown UWB anchors from one recording, by its ranges and any odometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from quadlog.config.schema import Config
from quadlog.errors import InvalidConfigValue, MissingInput, QuadlogError, TooLarge
from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int, RangeSeries
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.request import ReplayOptions
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.stages.log import Log, LogData, open_log, read_log, tell_recording
from quadlog.pipelines.stages.outlook import wants_lidar_track
from quadlog.pipelines.stages.positions.check_anchors import HEIGHT_STD_M, PRIORS, fault_warnings
from quadlog.pipelines.stages.positions.position import robot_track
from quadlog.pipelines.stages.positions.uwb import tags_of, with_carried_anchors
from quadlog.pipelines.stages.positions.uwb_tags import body_tags_of, lever_of
from quadlog.pipelines.stages.scans import LidarTracker
from quadlog.positioning.anchors.survey import AnchorSurvey, SurveyedAnchor, survey_anchors
from quadlog.positioning.anchors.walk import OdometryPrior, make_walk
from quadlog.positioning.batch.factors import TagRanges, Way
from quadlog.positioning.locate import Anchors
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.formatting import listed

POOR_FIT_M = 0.15
"""Ranges in line of sight that scatter more than this are warned of."""
NOTED_DELAY_S = 0.03
MOST_SCALE = 0.1
"""An odometry whose distances or turns are off by more is warned of."""
SOURCES = ("odometry", "tf", "lidar", "joints")
"""Roles of topics that positions other than UWB come from."""
NO_ODOMETRY = "give it an odometry, tf, a lidar, or a pose topic or TUM file by  --set topics.position=..."
ABOVE_TAG_M, ABOVE_TAG_STD_M = 1.0, 0.8
"""Anchors whose height nobody gives are expected this much above the tag: on a walk over a level floor, an anchor as
far below the tag fits as well."""
MOST_LISTED = 20
MOST_ANCHORS, MOST_LINKS = 256, 1024
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
LEAST_PRIOR = OdometryPrior(0.002, 0.001, 0.0003, (0.003, 0.002))
"""Of a pose topic or file that the configuration names, such as motion capture."""


@dataclass(frozen=True, slots=True)
class SurveyOutcome:
    """The survey of a recording, with ids of anchors by index.

    source: of the odometry. start_ns: its first pose. z_given: ids of the anchors whose heights were given.
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


def survey_recording(
    recording: Path,
    config: Config,
    options: ReplayOptions,
    given_heights: Mapping[int | None, float],
    progress: Progress,
) -> SurveyOutcome:
    """Survey the anchors of a recording. given_heights: id -> height in m above the floor, None for all others.

    Raises AnchorsNotObserved, MissingInput, QuadlogError for known
    anchors that contradict the ranges, and the errors of reading a recording.
    """
    if config.topics.position == "uwb":
        config = config.model_copy(update={"topics": config.topics.model_copy(update={"position": "auto"})})
    journal = Journal(progress)
    with open_log(recording, config, options) as log:
        _check_inputs(log, config)
        log = replace(log, by_uwb=True)
        data = read_log(log, progress)
        data = replace(data, config=with_carried_anchors(config, data.streams.anchor_places))
        tell_recording(data, journal)
        if wants_lidar_track(replace(log, by_uwb=False), config):
            data = replace(data, tracker=LidarTracker(data, config))
        return _survey_walk(data, journal, given_heights)


def _check_inputs(log: Log, config: Config) -> None:
    """Raises MissingInput before anything is read, and AmbiguousTopic."""
    if not log.roles.topics("uwb"):
        raise MissingInput("survey", log.roles.why_none("uwb"), "see  quadlog info")
    there = {*log.roles.found, *log.roles.ambiguous}
    if config.topics.position == "auto" and there.isdisjoint(SOURCES):
        raise MissingInput("survey", "the recording has ranges, but no odometry", NO_ODOMETRY)


def _survey_walk(data: LogData, journal: Journal, given_heights: Mapping[int | None, float]) -> SurveyOutcome:
    ranges, config = data.streams.ranges, data.config
    if ranges is None:
        raise MissingInput("survey", "the recording has no UWB ranges", "see  quadlog info")
    track = robot_track(data, journal)
    if track.source == "fixed" or len(track.t_ns) < 2:
        raise MissingInput("survey", "the recording has no odometry", NO_ODOMETRY)
    journal.progress.begin("survey", None)
    tags = robot_tags(config, journal, ranges)
    start_ns = int(track.t_ns[0])
    measured, anchor_ids = usable_ranges(config, journal, ranges, tags, start_ns)
    heights_m = height_prior(config, anchor_ids, float(np.mean(measured.height_m)), given_heights)
    # A topic that is named may be odometry all the same.
    types = {channel.type_name for channel in data.log.recording.channels if channel.topic == track.source}
    prior = PRIORS.get("odometry" if ODOMETRY_TYPE in types else track.source, LEAST_PRIOR)
    way = Way(seconds_since(track.t_ns, start_ns), track.xy_m, track.yaw_rad)
    walk, n_far = make_walk(way, measured, heights_m, prior)
    n_near = len(measured.t_s) - n_far
    if n_far:
        journal.warn(f"{n_far} of {len(measured.t_s)} ranges are left out: no pose of {track.source} is near them")
    if len(walk.ranges.range_m) < n_near:
        journal.note(f"an even selection of {len(walk.ranges.range_m)} of {n_near} ranges is used")
    known = {each.id: (each.x_m, each.y_m) for each in config.uwb.anchors}
    known_m = np.array([known.get(anchor, (np.nan, np.nan)) for anchor in anchor_ids.tolist()])
    survey = survey_anchors(walk, known_m)
    ids = tuple(anchor_ids.tolist())
    if survey.misplaced_m:
        worst = sorted(survey.misplaced_m.items(), key=lambda each: -each[1])[:8]
        remedy = (
            "mirrored they fit: the odometry turns to the wrong side, or y_m of [[uwb.anchors]] has the wrong sign"
            if survey.mirrored
            else "correct [[uwb.anchors]], or leave out the anchors that are wrong"
        )
        off = ", ".join(f"{ids[index]} by {off_m:.2f} m" for index, off_m in worst)
        raise QuadlogError(f"survey: known anchors contradict the ranges: {off}; {remedy}")
    if survey.faults is not None:
        positions_m = np.column_stack([known_m, np.zeros(len(ids))])
        journal.warn(*fault_warnings(survey.faults, Anchors(anchor_ids, positions_m, np.zeros(len(ids)))))
    z_given = frozenset(anchor_ids[heights_m[1] == HEIGHT_STD_M].tolist())
    outcome = SurveyOutcome(survey, ids, tags, track.source, start_ns, config, z_given, tuple(journal.losses))
    _tell(journal, outcome, survey.way_m / max(float(way.t_s[-1]), 1e-3))
    return outcome


def _tell(journal: Journal, outcome: SurveyOutcome, speed_mps: float) -> None:
    """Choices and what is not observed, on stderr; speed_mps: mean of the robot's."""
    survey, ids = outcome.survey, outcome.anchor_ids
    drift_m, drift_rad = survey.drift
    journal.note(
        f"odometry from {outcome.source}: {survey.way_m:.1f} m; scale of its distances {survey.scale:.3f}, of its "
        f"turns {survey.turn_scale:.3f}; its yaw drifts by {np.degrees(survey.yaw_drift_radps) * 60:+.1f} "
        f"degrees a minute, and at random by {100 * drift_m:.1f} cm and {np.degrees(drift_rad):.1f} degrees after 1 m"
    )
    if abs(survey.delay_s) > NOTED_DELAY_S:
        journal.note(
            f"the ranges' clock is offset by {-survey.delay_s:+.2f} s from the odometry's, or the tags sit "
            f"{survey.delay_s * speed_mps:+.2f} m ahead of where [[uwb.tags]] has them (x_m): at a constant speed "
            "these look the same"
        )
    known = len(outcome.configured.keys() & set(ids))
    if survey.aligned_to:
        journal.note(f"frame: map, by {survey.aligned_to} known anchors of [[uwb.anchors]]")
    else:
        few = "one known anchor does not turn it; " if known == 1 else ""
        journal.note(f"frame: base at the first pose; {few}two known anchors in [[uwb.anchors]] would give map")
    if not set(ids) - outcome.configured.keys():
        journal.note(
            "all anchors with ranges are configured already: their places only give the frame, and are surveyed again"
        )
    if outcome.kept and not survey.aligned_to:
        journal.warn(
            f"known anchors {listed(sorted(outcome.kept), MOST_LISTED)} stay in their configured frame, and the "
            "others are not surveyed in it: do not use them together"
        )
    for scale, goes in ((survey.scale, "goes"), (survey.turn_scale, "turns")):
        if abs(scale - 1) > MOST_SCALE:
            journal.warn(
                f"the ranges fit only if the odometry {goes} {scale:.2f} times as far as it says: if it does not, the "
                "ranges are wrong, and places are off by more than their bounds"
            )
    if survey.range_std_m > POOR_FIT_M:
        journal.warn(
            f"ranges in sight miss the survey by {survey.range_std_m:.2f} m: the odometry or the ranges are worse than "
            "the bounds allow for"
        )
    unseen = [ids[each.index] for each in survey.anchors if not each.why_not and not each.height_observed]
    blind = [anchor for anchor in unseen if anchor not in outcome.z_given]
    if blind:
        journal.warn(
            f"the heights of anchors {listed(blind)} are not observed on this walk: z is assumed {ABOVE_TAG_M:g} m "
            "above the tag; give what you know by  --anchor-height ID=M"
        )
    for each in survey.anchors:
        if each.why_not:
            journal.warn(f"anchor {ids[each.index]} is not surveyed: {each.why_not}")
    if sum(not each.why_not for each in survey.anchors) < 3:
        journal.warn("fewer than three anchors are surveyed: that is not enough for positions")


def robot_tags(config: Config, journal: Journal, ranges: RangeSeries) -> tuple[int, ...]:
    """The tags that sit on the robot. Raises MissingInput."""
    seen = [int(tag) for tag in np.unique(ranges.tag)]
    table = config.uwb.tags
    tags = tuple(body_tags_of(config, seen))
    if not tags:
        words = "no tag of role robot in [[uwb.tags]] has ranges"
        raise MissingInput("survey", words, f"the tags are {listed(seen, MOST_LISTED)}")
    nameless = len(set(seen) - {each.id for each in table} - set(tags))
    if nameless:
        taken = "" if table else f"tag {tags[0]} is taken to be the robot's, "
        journal.warn(f"{taken}{nameless} other tags are not used; name the robot's in [[uwb.tags]]")
    return tags


def usable_ranges(
    config: Config, journal: Journal, ranges: RangeSeries, tags: tuple[int, ...], start_ns: int
) -> tuple[TagRanges, Int]:
    """The ranges of the robot's tags within the configured limits, in seconds since start_ns; the anchors' ids (A,).

    Raises MissingInput, TooLarge.
    """
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
    infos = tags_of(config, ranges)
    levers_m = np.array([lever_of(config, tag) for tag in tags])
    heights_m = np.array([infos[tag].height_m for tag in tags])
    seen = seconds_since(ranges.t_ns[usable], start_ns), tag, np.asarray(anchor, np.int64), ranges.range_m[usable]
    return TagRanges(*seen, levers_m, heights_m, len(anchor_ids)), anchor_ids


def height_prior(config: Config, anchor_ids: Int, tag_height_m: float, given: Mapping[int | None, float]) -> Float:
    """(2, A) heights and their std: as given, else as configured, else above the tag. Raises InvalidConfigValue."""
    ids = anchor_ids.tolist()
    unknown = [each for each in given if each is not None and each not in ids]
    if unknown:
        raise InvalidConfigValue(str(unknown[0]), f"no such anchor; there are {listed(ids)}", "--anchor-height")
    heights = {each.id: each.z_m for each in config.uwb.anchors} | {
        key: value for key, value in given.items() if key is not None
    }
    usual_m, everywhere = tag_height_m + ABOVE_TAG_M, given.get(None)
    mean_m = np.array([heights.get(each, usual_m if everywhere is None else everywhere) for each in ids])
    std_m = np.array([HEIGHT_STD_M if each in heights or everywhere is not None else ABOVE_TAG_STD_M for each in ids])
    return np.array([mean_m, std_m])


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
        observed = axis != "z" or anchor.height_observed or z_given
        guess = "" if observed else ", a guess: not observed on this walk"
        lines.append(f"{axis}_m = {value:.4f}  # +- {bound:.3f}{guess}")
    lines.append(f"bias_m = {anchor.bias_m:.4f}  # +- {1.96 * anchor.bias_std_m:.3f}")
    return "\n".join(lines) + "\n"
