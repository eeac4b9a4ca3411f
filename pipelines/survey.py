"""`quadlog survey`: places of anchors from the ranges and the odometry of one recording, and the config they make."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tomli_w

from quadlog.config.schema import Config
from quadlog.errors import InvalidConfigValue, MissingInput, TooLarge
from quadlog.messages import Int, RangeSeries
from quadlog.pipelines.executor.progress import Progress, StageClock
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.stages.context import ReplayContext, RobotTrack
from quadlog.pipelines.stages.ingest import OpenLog, open_log, open_walk
from quadlog.pipelines.stages.positions.position import robot_track
from quadlog.pipelines.stages.positions.tag_errors import lever_of, roles_of
from quadlog.pipelines.stages.scans import wants_lidar_track
from quadlog.positioning.lidar_odometry import ScanMatch
from quadlog.positioning.self_survey.batch import HeightPrior, OdometryPrior
from quadlog.positioning.self_survey.problem import MeasuredRanges, OdometryPoses, RobotTags, make_problem
from quadlog.positioning.self_survey.survey import AnchorSurvey, SurveyedAnchor, survey_anchors
from quadlog.recordings.containers.container import Loss

ABOVE_TAG_M, ABOVE_TAG_STD_M = 1.0, 0.8
"""Anchors whose height nobody gives are expected this much above the tag: on a walk over a level floor, an anchor as
far below the tag fits as well."""
HEIGHT_STD_M = 0.05
"""How well heights that are given are known."""
MOST_ANCHORS = 256
POOR_FIT = 1.5
"""Ranges in line of sight that scatter more than this times uwb.range_std_m are warned of."""
PRIORS = {
    "odometry": OdometryPrior(0.03, 0.05, 0.01, (0.02, 0.02)),
    "legs": OdometryPrior(0.05, 0.05, 0.01, (0.03, 0.02)),
    "lidar": OdometryPrior(0.003, 0.003, 0.001, (0.01, 0.005), first_pose_std=(0.02, 0.003)),
    "tf": OdometryPrior(0.01, 0.01, 0.003, (0.01, 0.01)),
}
LEAST_PRIOR = OdometryPrior(0.002, 0.001, 0.0003, (0.003, 0.002))
"""Of a pose topic or file that the configuration names, such as motion capture."""
SOURCES = ("odometry", "tf", "lidar", "joints")
"""Roles of topics that positions other than UWB come from."""
NO_ODOMETRY = "give it an odometry, tf, a lidar, or a pose topic or TUM file by  --set topics.position=..."


@dataclass(frozen=True, slots=True)
class SurveyOutcome:
    """The survey of a recording, with ids of anchors by index; source: where the odometry came from; start_ns: its
    first pose; losses.

    """

    survey: AnchorSurvey
    anchor_ids: tuple[int, ...]
    tags: tuple[int, ...]
    source: str
    start_ns: int
    config: Config
    losses: tuple[Loss, ...]

    @property
    def configured(self) -> dict[int, tuple[float, float, float]]:
        """Anchor id -> position in map, of the anchors that are known."""
        return {each.id: (each.x_m, each.y_m, each.z_m) for each in self.config.uwb.anchors}

    @property
    def kept(self) -> frozenset[int]:
        """Ids of known anchors that keep their places in the config: all, unless there was nothing else to survey."""
        known = frozenset(self.configured)
        return known if set(self.anchor_ids) - known else frozenset()


def survey_recording(
    recording: Path,
    config: Config,
    options: ReplayOptions,
    given_heights: Mapping[int | None, float],
    progress: Progress,
) -> SurveyOutcome:
    """Survey the anchors of a recording. given_heights: id -> height in m above the floor, None for all others.

    Raises AnchorsNotObserved, MissingInput, and the errors of reading a recording.
    """
    if config.topics.position == "uwb":
        config = config.model_copy(update={"topics": config.topics.model_copy(update={"position": "auto"})})
    clock = StageClock()
    with TemporaryDirectory(prefix="quadlog-survey-") as folder:
        request = ReplayRequest(recording, Path(folder) / "run", config, options)
        with open_log(request, clock, progress) as log:
            _check_inputs(log, config)
            tracked = wants_lidar_track(config, log.roles, by_uwb=False)
            with open_walk(log._replace(by_uwb=True), request, clock, progress, tracked=tracked) as walk:
                return _survey_walk(walk, given_heights)


def _check_inputs(log: OpenLog, config: Config) -> None:
    """Raises MissingInput before anything is read, and AmbiguousTopic."""
    if not log.roles.topics("uwb"):
        raise MissingInput("survey", log.roles.why_none("uwb"), "see  quadlog info")
    there = {*log.roles.found, *log.roles.ambiguous}
    if config.topics.position == "auto" and there.isdisjoint(SOURCES):
        raise MissingInput("survey", "the recording has ranges, but nothing tells how the robot moves", NO_ODOMETRY)


def _survey_walk(walk: ReplayContext, given_heights: Mapping[int | None, float]) -> SurveyOutcome:
    ranges = walk.streams.ranges
    if ranges is None:
        raise MissingInput("survey", "the recording has no UWB ranges", "see  quadlog info")
    track = robot_track(walk)
    if track.source == "fixed" or len(track.t_ns) < 2:
        raise MissingInput("survey", "nothing in the recording tells how the robot moves", NO_ODOMETRY)
    walk.progress.begin("survey", None)
    tags = _robot_tags(walk, ranges)
    measured, anchor_ids = _measured(walk, ranges, tags)
    heights = _height_prior(walk, anchor_ids, tags, given_heights)
    levers = RobotTags(np.array([lever_of(walk.config, tag) for tag in tags]), _tag_heights(walk.config, tags))
    odometry = OdometryPoses(track.t_ns, track.xy_m, track.yaw_rad, _doubtful(walk, track))
    problem, n_far = make_problem(odometry, measured, levers, len(anchor_ids))
    if n_far:
        walk.warn(f"{n_far} of {len(measured.t_ns)} ranges are left out: no pose of {track.source} is near them")
    known = {each.id: (each.x_m, each.y_m) for each in walk.config.uwb.anchors}
    known_m = np.array([known.get(anchor, (np.nan, np.nan)) for anchor in anchor_ids.tolist()])
    survey = survey_anchors(problem, heights, PRIORS.get(track.source, LEAST_PRIOR), known_m)
    ids, start_ns = tuple(anchor_ids.tolist()), int(track.t_ns[0])
    outcome = SurveyOutcome(survey, ids, tags, track.source, start_ns, walk.config, tuple(walk.losses))
    _tell(walk, outcome, track)
    return outcome


def _doubtful(walk: ReplayContext, track: RobotTrack) -> np.ndarray | None:
    """Poses of the lidar whose scans do not tell all of the motion; None of other sources."""
    if track.source != "lidar" or walk.tracker is None:
        return None
    doubtful: np.ndarray = walk.tracker.track().match != ScanMatch.MATCHED
    return doubtful


def _robot_tags(walk: ReplayContext, ranges: RangeSeries) -> tuple[int, ...]:
    """The tags that sit on the robot. Raises MissingInput."""
    seen = [int(tag) for tag in np.unique(ranges.tag)]
    table = walk.config.uwb.tags
    tags = tuple(each.id for each in table if each.role == "robot" and each.id in seen)
    if not table:
        tags = (roles_of(walk.config, seen)["robot"],)
        if len(seen) > 1:
            walk.warn(
                f"tag {tags[0]} is taken to be the robot's, {len(seen) - 1} other tags are not used; name the robot's "
                "in [[uwb.tags]]"
            )
    if not tags:
        raise MissingInput("survey", "no tag of role robot in [[uwb.tags]] has ranges", f"the tags are {_listed(seen)}")
    return tags


def _tag_heights(config: Config, tags: Iterable[int]) -> np.ndarray:
    own = {tag.id: tag.height_m for tag in config.uwb.tags if tag.height_m is not None}
    return np.array([own.get(tag, config.uwb.tag_height_m) for tag in tags])


def _measured(walk: ReplayContext, ranges: RangeSeries, tags: tuple[int, ...]) -> tuple[MeasuredRanges, Int]:
    """The ranges of the robot's tags within the configured limits, and the ids (A,) of the anchors."""
    uwb = walk.config.uwb
    own = np.isin(ranges.tag, tags)
    with np.errstate(invalid="ignore"):
        usable = own & (ranges.range_m >= uwb.min_range_m) & (ranges.range_m <= uwb.max_range_m)
    bad = int((own & ~usable).sum())
    if bad:
        walk.warn(f"{bad} ranges that are no numbers, or outside uwb.min_range_m and uwb.max_range_m, are left out")
    if not usable.any():
        raise MissingInput("survey", f"no usable range of tag {_listed(tags)}", "see  quadlog info")
    anchor_ids, anchor = np.unique(ranges.anchor[usable], return_inverse=True)
    if len(anchor_ids) > MOST_ANCHORS:
        raise TooLarge("survey: anchors", len(anchor_ids), MOST_ANCHORS)
    tag = np.argsort(tags)[np.searchsorted(np.sort(tags), ranges.tag[usable])]
    anchor = np.asarray(anchor, dtype=np.int64)
    return MeasuredRanges(ranges.t_ns[usable], tag, anchor, ranges.range_m[usable]), anchor_ids


def _height_prior(
    walk: ReplayContext, anchor_ids: Int, tags: tuple[int, ...], given: Mapping[int | None, float]
) -> HeightPrior:
    """Expected heights: as given, else as configured, else above the tag. Raises InvalidConfigValue for unknown ids."""
    ids = anchor_ids.tolist()
    unknown = [each for each in given if each is not None and each not in ids]
    if unknown:
        raise InvalidConfigValue(str(unknown[0]), f"no such anchor; there are {_listed(ids)}", "--anchor-height")
    heights = {each.id: each.z_m for each in walk.config.uwb.anchors} | {
        key: value for key, value in given.items() if key is not None
    }
    usual_m = float(np.mean(_tag_heights(walk.config, tags))) + ABOVE_TAG_M
    everywhere = given.get(None)
    mean_m = np.array([heights.get(each, usual_m if everywhere is None else everywhere) for each in ids])
    std_m = np.array([HEIGHT_STD_M if each in heights or everywhere is not None else ABOVE_TAG_STD_M for each in ids])
    return HeightPrior(mean_m, std_m)


def _tell(walk: ReplayContext, outcome: SurveyOutcome, track: RobotTrack) -> None:
    """Choices and what is not observed, on stderr."""
    survey, ids = outcome.survey, outcome.anchor_ids
    walk.note(
        f"odometry from {track.source}: {survey.way_m:.1f} m of way; its steps count {survey.scale:.3f} times, "
        f"its yaw drifts by {np.degrees(survey.yaw_drift_radps) * 60:+.1f} degrees a minute, and at random by "
        f"{100 * survey.drift[0]:.1f} cm and {np.degrees(survey.drift[1]):.1f} degrees after 1 m"
    )
    known = len(outcome.configured.keys() & set(ids))
    if survey.aligned_to:
        walk.note(f"frame: map, by {survey.aligned_to} known anchors of [[uwb.anchors]]")
    else:
        few = "one known anchor does not turn it; " if known == 1 else ""
        walk.note(f"frame: base at the first pose; {few}two known anchors in [[uwb.anchors]] would give map")
    if known and not outcome.kept:
        walk.note("every anchor is configured already: their places only give the frame, and are surveyed again")
    if survey.range_std_m > POOR_FIT * walk.config.uwb.range_std_m:
        walk.warn(
            f"ranges miss the survey by {survey.range_std_m:.2f} m, and uwb.range_std_m is "
            f"{walk.config.uwb.range_std_m:g}: the odometry or the ranges are worse than the bounds allow for"
        )
    blind = [ids[each.index] for each in survey.anchors if not each.why_not and not each.height_observed]
    if blind:
        walk.warn(
            f"the walk does not tell the height of anchors {_listed(blind)}: z is the guess of {ABOVE_TAG_M:g} m above "
            "the tag; give what you know by  --anchor-height ID=M"
        )
    for each in survey.anchors:
        if each.why_not:
            walk.warn(f"anchor {ids[each.index]} is not surveyed: {each.why_not}")
    if sum(not each.why_not for each in survey.anchors) < 3:
        walk.warn("fewer than three anchors are surveyed: that is not enough for positions")


def _listed(ids: Iterable[int]) -> str:
    return ", ".join(map(str, ids))


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
            lines.append(_anchor_table(anchor_id, each))
    for anchor_id in sorted(outcome.kept):
        lines.append("# known\n" + tomli_w.dumps({"uwb": {"anchors": [configured[anchor_id]]}}))
    return "\n".join(lines)


def _anchor_table(anchor_id: int, anchor: SurveyedAnchor) -> str:
    if anchor.why_not:
        return f"# anchor {anchor_id} is not surveyed: {anchor.why_not}\n"
    lines = ["[[uwb.anchors]]", f"id = {anchor_id}"]
    for axis, value, bound in zip("xyz", anchor.position_m, anchor.bound_m, strict=True):
        guess = "" if axis != "z" or anchor.height_observed else ", a guess: the walk does not tell it"
        lines.append(f"{axis}_m = {value:.4f}  # +- {bound:.3f}{guess}")
    lines.append(f"bias_m = {anchor.bias_m:.4f}  # +- {1.96 * anchor.bias_std_m:.3f}")
    return "\n".join(lines) + "\n"
