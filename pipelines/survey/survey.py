"""`quadlog survey`: read a recording, survey its anchors, and say what was chosen and what is not observed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from quadlog.config.schema import Config
from quadlog.errors import KnownAnchorsContradict, MissingInput
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.journal import Journal
from quadlog.pipelines.log import Log, LogData, open_log, read_log, tell_recording
from quadlog.pipelines.request import ReplayOptions
from quadlog.pipelines.stages.positions.check_anchors import fault_warnings
from quadlog.pipelines.stages.positions.position import robot_track
from quadlog.pipelines.stages.positions.tag_errors import lever_of
from quadlog.pipelines.stages.positions.uwb import with_carried_anchors
from quadlog.pipelines.stages.scans import track_clouds, wants_lidar_track
from quadlog.pipelines.survey.inputs import (
    ABOVE_TAG_M,
    HEIGHT_STD_M,
    MOST_LISTED,
    height_prior,
    listed,
    odometry_poses,
    odometry_prior,
    robot_tags,
    tag_heights,
    usable_ranges,
)
from quadlog.pipelines.survey.output import SurveyOutcome
from quadlog.positioning.locate import Anchors
from quadlog.positioning.self_survey.problem import RobotTags, make_problem
from quadlog.positioning.self_survey.survey import survey_anchors

POOR_FIT = 1.5
"""Ranges in line of sight that scatter more than this times uwb.range_std_m are warned of."""
NOTED_DELAY_S = 0.03
SOURCES = ("odometry", "tf", "lidar", "joints")
"""Roles of topics that positions other than UWB come from."""
NO_ODOMETRY = "give it an odometry, tf, a lidar, or a pose topic or TUM file by  --set topics.position=..."


def survey_recording(
    recording: Path,
    config: Config,
    options: ReplayOptions,
    given_heights: Mapping[int | None, float],
    progress: Progress,
) -> SurveyOutcome:
    """Survey the anchors of a recording. given_heights: id -> height in m above the floor, None for all others.

    Raises AnchorsNotObserved, KnownAnchorsContradict, MissingInput, and the errors of reading a recording.
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
        if wants_lidar_track(config, log.roles, by_uwb=False):
            data = replace(data, tracker=track_clouds(data, config))
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
    measured, anchor_ids = usable_ranges(config, journal, ranges, tags)
    heights = height_prior(config, anchor_ids, tags, given_heights)
    levers = RobotTags(np.array([lever_of(config, tag) for tag in tags]), tag_heights(config, tags))
    problem, n_far = make_problem(odometry_poses(data, track), measured, levers, len(anchor_ids))
    n_near = len(measured.t_ns) - n_far
    if n_far:
        journal.warn(f"{n_far} of {len(measured.t_ns)} ranges are left out: no pose of {track.source} is near them")
    if len(problem.range_m) < n_near:
        journal.note(f"an even selection of {len(problem.range_m)} of {n_near} ranges is used")
    known = {each.id: (each.x_m, each.y_m) for each in config.uwb.anchors}
    known_m = np.array([known.get(anchor, (np.nan, np.nan)) for anchor in anchor_ids.tolist()])
    survey = survey_anchors(problem, heights, odometry_prior(data, track), known_m)
    ids, start_ns = tuple(anchor_ids.tolist()), int(track.t_ns[0])
    if survey.misplaced_m:
        misplaced_m = {ids[index]: off_m for index, off_m in survey.misplaced_m.items()}
        raise KnownAnchorsContradict(misplaced_m, survey.mirrored)
    if survey.faults is not None:
        positions_m = np.column_stack([known_m, np.zeros(len(ids))])
        for text in fault_warnings(survey.faults, Anchors(anchor_ids, positions_m, np.zeros(len(ids)))):
            journal.warn(text)
    z_given = frozenset(anchor_ids[heights.std_m == HEIGHT_STD_M].tolist())
    outcome = SurveyOutcome(survey, ids, tags, track.source, start_ns, config, z_given, tuple(journal.losses))
    _tell(journal, outcome, config.uwb.range_std_m, float(np.sqrt(np.mean(np.sum(problem.velocity_mps**2, axis=1)))))
    return outcome


def _tell(journal: Journal, outcome: SurveyOutcome, range_std_m: float, speed_mps: float) -> None:
    """Choices and what is not observed, on stderr; speed_mps: rms of the tags'."""
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
            f"known anchors {listed(sorted(outcome.kept)[:MOST_LISTED])} stay in their configured frame, and the "
            "others are not surveyed in it: do not use them together"
        )
    if survey.range_std_m > POOR_FIT * range_std_m:
        journal.warn(
            f"ranges miss the survey by {survey.range_std_m:.2f} m, and uwb.range_std_m is "
            f"{range_std_m:g}: the odometry or the ranges are worse than the bounds allow for"
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
