"""UWB in a replay: positions of every tag, their tables, and messages about ranges, tags and anchors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.config.schema import Anchor, Config
from quadlog.geometry import yaw_from_quat
from quadlog.messages import Float, PoseSeries, RangeSeries
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.stages.outlook import may_use_uwb, wants_uwb
from quadlog.pipelines.stages.positions import uwb_tags
from quadlog.pipelines.stages.positions.check_anchors import check_located, fault_warnings
from quadlog.pipelines.stages.positions.legs import legs_motion
from quadlog.pipelines.stages.positions.uwb_tags import solve_body, tell_body, tell_roles, velocity_words
from quadlog.positioning.batch.links import link_quality, scatter_in_sight, weak_first_path_share
from quadlog.positioning.batch.robust import USUAL_STD_M
from quadlog.positioning.body import LocatedBody
from quadlog.positioning.epochs import USUAL_EPOCH_S, RangeCounts, likely_unit
from quadlog.positioning.lidar_odometry import body_motion
from quadlog.positioning.locate import Anchors, Located, TagInfo, TagResult, locate
from quadlog.positioning.odometry import BodyMotion
from quadlog.recordings.decoders.anchor_places import FEWEST_ANCHORS, AnchorPlace, place_warnings
from quadlog.recordings.formatting import listed
from quadlog.recordings.streams import Streams
from quadlog.results.tables import TABLES, TableWriter

if TYPE_CHECKING:
    from quadlog.pipelines.stages.log import LogData

NO_RANGES = "anchors are configured, but the recording has no UWB ranges to use"
MOST_DESCRIBED = 10
MOST_OFF = 2.0
"""A given std of ranges that is off by more is warned of."""
MISFIT_STD = 5.0
"""Of clean ranges half miss by less than 0.7 std, of heavily blocked ones by less than 3."""
MOSTLY_LATE = 0.5
"""A link with a larger share of NLOS is warned of."""


def located_warnings(located: Located, config: Config, first_ns: int) -> list[str]:
    """Every range and epoch that could not be used, and what does not fit; first_ns: where the log starts."""
    texts = _range_warnings(located.counts)
    if config.uwb.method == "huber" and not config.uwb.calibrate and not located.on_line:
        texts.append(
            'uwb.method = "huber" needs calibrated ranges: where all are too long by a bias it trusts the wrong ones; '
            "set uwb.calibrate = true, or take another method"
        )
    described = _described(located, config)
    biases = {each.tag: each.bias for each in described if each.bias is not None and each.bias.scale != 0}
    if biases:
        words = ", ".join(f"tag {tag} {1 + bias.scale:.3f} +- {bias.scale_std:.3f}" for tag, bias in biases.items())
        texts.append(
            f"ranges are measured with a wrong scale, by which they are divided: {words}; check unit and clock of the "
            "radios, or leave the ranges as they are by  --set uwb.calibrate=false"
        )
    texts += [text for result in described for text in _tag_warnings(result, config, first_ns)]
    if len(described) < len(located.tags):
        texts.append(
            f"{len(located.tags)} tags are located; messages for {len(located.tags) - len(described)} of them are "
            "omitted: see links.parquet and ranges.parquet"
        )
    return texts


def _described(located: Located, config: Config) -> list[TagResult]:
    """The tags that have messages of their own: at most MOST_DESCRIBED, those with a role first."""
    with_role = set(uwb_tags.roles_of(config, [result.tag for result in located.tags]).values())
    return sorted(located.tags, key=lambda result: result.tag not in with_role)[:MOST_DESCRIBED]


def _located_notes(located: Located, config: Config) -> list[str]:
    """Choices that decided the result."""
    texts = []
    if located.on_line:
        first, *_, last = (anchor.id for anchor in config.uwb.anchors)
        texts.append(
            f"the anchors lie on a line: tracks start to the {config.uwb.mirror} of the way from anchor {first} to "
            f"anchor {last} (uwb.mirror); on the other side their mirror images fit as well; uwb.method and uwb.height "
            "do not apply"
        )
    for result in _described(located, config):
        if config.uwb.epoch_s is None and result.epoch_s != USUAL_EPOCH_S:
            texts.append(
                f"tag {result.tag}: single ranges within {result.epoch_s:.2f} s make one fix, a round of its anchors "
                "in this log (uwb.epoch_s)"
            )
        if result.height_solved:
            std_m = np.median(result.track.z_std_m) if len(result.track) else np.nan
            texts.append(f"tag {result.tag}: its height is solved for, to {std_m:.2f} m")
        if result.velocity is not None:
            texts.append(f"tag {result.tag}: {velocity_words(result.velocity, 'its track')}")
        if result.bias is not None and result.bias.n.any():
            links = zip(config.uwb.anchors, result.bias.applied_m, result.bias.std_m, strict=True)
            words = ", ".join(f"{anchor.id}: {applied:+.3f} +- {std:.3f}" for anchor, applied, std in links)
            texts.append(
                f"tag {result.tag}: ranges corrected by each anchor's bias in m: {words}; {result.bias.reason}"
            )
        if result.shared_m != 0:
            texts.append(
                f"tag {result.tag}: a bias of {result.shared_m:+.3f} m that all links share is estimated with its track"
            )
    return texts


def _tag_warnings(result: TagResult, config: Config, first_ns: int) -> list[str]:
    """Epochs without a fix, ranges that fit no track, and a track that was lost."""
    texts = []
    flat = int(result.fixes.degenerate.sum())
    if unsolved := int(np.sum(~result.fixes.solved)):
        causes = {
            f"fewer than {'four' if result.height_solved else 'three'} ranges": unsolved - flat,
            "anchors on a line or a mirror image": flat,
        }
        words = " and ".join(f"{count} with {cause}" for cause, count in causes.items() if count)
        texts.append(f"tag {result.tag}: of {len(result.epochs.t_ns)} epochs, {words} give no fix")
    residual_m, given_m = np.abs(result.ranges.range_m - result.ranges.predicted_m), config.uwb.range_std_m
    known_m, usual_m = residual_m[np.isfinite(residual_m)], max(given_m or 0.0, USUAL_STD_M)
    if len(known_m) and (median_m := np.median(known_m)) >= MISFIT_STD * usual_m:  # they fit no position at all
        texts.append(
            f"tag {result.tag}: half of its ranges miss its track by more than {median_m:.2f} m; "
            "check ids and places in [[uwb.anchors]]"
        )
    elif len(known_m) and given_m is not None:
        found_m = scatter_in_sight(result.ranges, given_m)
        if not 1 / MOST_OFF < found_m / given_m < MOST_OFF:
            texts.append(
                f"tag {result.tag}: its ranges in sight scatter by {found_m:.3f} m about its track, and "
                f"uwb.range_std_m is {given_m:g}: leave it out, and it is estimated"
            )
    anchors = np.array([anchor.id for anchor in config.uwb.anchors], dtype=np.int64)
    share = link_quality(result.ranges, anchors, result.bias, result.range_std_m)["nlos_share"]
    texts += [
        f"anchor {anchors[k]}: {share[k]:.0%} of its ranges to tag {result.tag} count as NLOS; its view was "
        "blocked, or its place in [[uwb.anchors]] or that of another anchor is wrong"
        for k in np.flatnonzero(share > MOSTLY_LATE)
    ]
    n = len(result.restart_ns)
    if n:
        seconds = ", ".join(f"{(t_ns - first_ns) * 1e-9:.1f} s" for t_ns in result.restart_ns[:5].tolist())
        texts.append(f"tag {result.tag}: its track was lost and restarted {n} times, at {seconds}")
    return texts


def _range_warnings(counts: RangeCounts) -> list[str]:
    def words(pairs: tuple[tuple[int, int], ...]) -> str:
        return listed([f"{number} ({count} ranges)" for number, count in pairs])

    causes = {
        "that are NaN or infinite": counts.not_finite,
        "of zero or below": counts.not_positive,
        "below uwb.min_range_m": counts.too_short,
        "above uwb.max_range_m": counts.too_long,
        f"of {counts.total} that are repeats (equal to one of the same tag and anchor right before)": counts.repeated,
    }
    texts = [f"{count} ranges {cause} are left out" for cause, count in causes.items() if count]
    if counts.unknown_anchors:
        texts.append(f"anchors seen, but not in [[uwb.anchors]]: {words(counts.unknown_anchors)}")
    if counts.other_tags:
        texts.append(f"tags seen, but not in [[uwb.tags]]: {words(counts.other_tags)}")
    if counts.silent_anchors:
        texts.append(f"anchors configured, but silent: {listed(counts.silent_anchors)}")
    return texts


@dataclass(frozen=True, slots=True)
class UwbPositions:
    """All tags located, and which of them are the robot's (the first, where it has several) and the person's.

    body: the track of all tags of the robot together, None where it has one.
    """

    located: Located
    robot: TagResult | None
    person: TagResult | None
    body: LocatedBody | None = None


def locate_tags(data: LogData, journal: Journal) -> UwbPositions | None:
    """Every tag of the recording located, those of the robot together; None when UWB is not used, with a warning."""
    config, ranges, places = data.config, data.streams.ranges, data.streams.anchor_places
    if not config.uwb.anchors:
        known = f" and its messages place {len(places)} of the {FEWEST_ANCHORS} that a fix needs" if places else ""
        for topic in data.log.roles.found["uwb"].topics if "uwb" in data.log.roles.found else ():
            journal.warn(
                f"{topic}: ranges are not used, no [[uwb.anchors]] are configured{known}; quadlog init writes a form"
            )
        return None
    if not wants_uwb(config):
        return None
    if ranges is None:
        journal.warn(NO_RANGES)
        return None
    _tell_places(data, journal)
    if text := unit_warning(config, ranges, data.log.roles.topics("uwb")):
        journal.warn(text)
        return None
    motion = _body_motion(data) if config.uwb.odometry else None
    (located, robot), body = locate_each(config, ranges, motion), None
    if robot and motion is not None and motion.source == "odometry":
        journal.use("odometry")
    if len(robot) > 1:
        located, body = solve_body(config, located, robot, anchors_of(config), config.uwb, motion)
        tell_body(journal, body)
    tell_roles(config, journal, located)
    journal.warn(*place_faults(config, located, robot, data.streams.odometry))
    counts = located.counts
    journal.counts |= {"ranges": counts.total, "ranges_used": counts.used}
    journal.counts["ranges_off_track"] = sum(int(np.isnan(each.ranges.predicted_m).sum()) for each in located.tags)
    journal.warn(*located_warnings(located, config, data.first_ns))
    journal.note(*_located_notes(located, config))
    by_id = {result.tag: result for result in located.tags}
    roles = uwb_tags.roles_of(config, list(by_id))
    journal.use("uwb")
    return UwbPositions(located, by_id.get(roles.get("robot", -1)), by_id.get(roles.get("person", -1)), body)


def locate_each(config: Config, ranges: RangeSeries, motion: BodyMotion | None) -> tuple[Located, list[int]]:
    """Every tag located by itself, with the robot's motion where it carries one; and the tags that it carries."""
    tags = tags_of(config, ranges)
    robot = uwb_tags.body_tags_of(config, list(tags))
    if len(robot) == 1 and motion is not None:
        x_m, y_m = uwb_tags.lever_of(config, robot[0])
        tags[robot[0]] = replace(tags[robot[0]], body_motion=motion, x_m=x_m, y_m=y_m)
    return locate(ranges, anchors_of(config), list(tags.values()), config.uwb), robot


def unit_warning(config: Config, ranges: RangeSeries, topics: Sequence[str]) -> str:
    """A line with the key to set where ranges fit the anchors in cm or mm, and not in metres; empty elsewhere."""
    anchors, usable = anchors_of(config), ranges.range_m <= config.uwb.max_range_m
    for tag in tags_of(config, ranges):
        mine = ranges.tag == tag
        units = [likely_unit(ranges.rows(rows), anchors.ids, anchors.position_m) for rows in (mine & usable, mine)]
        if units[1] and "m" not in units:
            low, high = np.nanquantile(ranges.range_m[mine], [0.05, 0.95])
            rows = ", ".join(f'{{topic = "{topic}", unit = "{units[1]}"}}' for topic in topics)
            return (
                f"tag {tag}: its ranges, most from {low:.0f} to {high:.0f}, fit the anchors in {units[1]} and not in "
                f"metres: UWB is not used; give their unit below [uwb]: range_topics = [{rows}]"
            )
    return ""


def place_faults(config: Config, located: Located, robot: list[int], odometry: PoseSeries | None) -> list[str]:
    """A line for each anchor that seems to stand elsewhere. robot: the tags that it carries."""
    anchors, levers_m = anchors_of(config), {tag: uwb_tags.lever_of(config, tag) for tag in robot}
    return fault_warnings(check_located(located, anchors, config.uwb, levers_m, odometry), anchors)


def _tell_places(data: LogData, journal: Journal) -> None:
    """Where the anchors' positions come from, and a warning where sources contradict one another."""
    places = data.streams.anchor_places
    if data.anchors_carried:
        journal.note(
            f"positions of {len(places)} anchors from the messages; quadlog init writes them as [[uwb.anchors]]"
        )
    journal.warn(*place_warnings(places, {} if data.anchors_carried else configured_places(data.config)))


def configured_places(config: Config) -> dict[int, Float]:
    """Anchor id -> position (3,) in map, of the configured anchors."""
    return {each.id: np.array([each.x_m, each.y_m, each.z_m]) for each in config.uwb.anchors}


def with_carried_anchors(config: Config, places: Mapping[int, AnchorPlace]) -> Config:
    """The configuration with the anchors that the messages place, where it has none and they are enough for a fix."""
    if config.uwb.anchors or len(places) < FEWEST_ANCHORS or not may_use_uwb(config):
        return config
    return with_anchors(config, {anchor: place.position_m for anchor, place in places.items()})


def with_anchors(config: Config, places_m: Mapping[int, Sequence[float]]) -> Config:
    """The configuration with anchors at these places (x, y, z)."""
    anchors = [
        Anchor(id=anchor, **dict(zip(("x_m", "y_m", "z_m"), place_m, strict=True)))
        for anchor, place_m in places_m.items()
    ]
    return config.model_copy(update={"uwb": config.uwb.model_copy(update={"anchors": anchors})})


def odometry_motion(streams: Streams) -> BodyMotion | None:
    """The robot's own motion by its odometry; None without one that gives velocities."""
    odometry, linear_mps, angular_radps = streams.odometry, streams.odometry_linear_mps, streams.odometry_angular_radps
    if odometry is None or linear_mps is None or angular_radps is None or not linear_mps.any():
        return None
    return BodyMotion(
        odometry.t_ns,
        linear_mps[:, :2],
        yaw_from_quat(odometry.quat_xyzw),
        angular_radps[:, 2],
    )


def _body_motion(data: LogData) -> BodyMotion | None:
    """The robot's own motion by odometry, or else its legs or the lidar; None where nothing gives velocities."""
    causal = not data.config.uwb.smooth
    motion = odometry_motion(data.streams)
    if motion is None and data.legs is not None:
        return legs_motion(data.legs, causal=causal)
    track = None if motion is not None or data.tracker is None else data.tracker.track()
    return motion if track is None else body_motion(track, causal=causal)


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
    person = uwb_tags.roles_of(config, wanted).get("person")
    heights = {tag: config.uwb.person_height_m if tag == person else config.uwb.tag_height_m for tag in wanted}
    heights |= {tag: row.height_m for tag, row in table.items() if row.height_m is not None and tag in heights}
    return {tag: TagInfo(tag, heights[tag]) for tag in wanted}


def write_uwb(folder: Path, data: LogData, uwb: UwbPositions) -> None:
    """fixes, ranges, innovations and links, tag after tag; uwb_errors of the tags on the robot."""
    names = ("fixes", "ranges", "innovations", "links")
    places = {f"{axis}_m": [getattr(each, f"{axis}_m") for each in data.config.uwb.anchors] for axis in "xyz"}
    with ExitStack() as stack:
        fixes, ranges, innovations, links = (
            stack.enter_context(TableWriter(folder / f"{name}.parquet", TABLES[name])) for name in names
        )
        for result in uwb.located.tags:
            track, rows = result.track, result.ranges
            fixes.append(_fix_columns(result))
            innovations.append({"t_ns": track.t_ns, "tag": result.tag, "n_ranges": result.n_ranges, "nis": result.nis})
            columns = {"t_ns": rows.t_ns, "anchor": rows.anchor, "range_m": rows.range_m}
            ranges.append(columns | {"tag": result.tag, "predicted_m": rows.predicted_m, "weight": rows.weight})
            links.append(places | link_columns(result, data.streams, data.config))
    robot_tag = None if uwb.robot is None else uwb.robot.tag
    if errors := uwb_tags.errors_of_tags(
        uwb.located, uwb_tags.levers_on_robot(data.config, robot_tag), data.streams.reference
    ):
        with TableWriter(folder / "uwb_errors.parquet", TABLES["uwb_errors"]) as table:
            for tag, of_tag in errors.items():
                for source, part in of_tag.items():
                    columns = {"error_x_m": part.error_m[:, 0], "error_y_m": part.error_m[:, 1]}
                    table.append({"t_ns": part.t_ns, "tag": tag, "source": source, "bound_m": part.bound_m} | columns)


def link_columns(result: TagResult, streams: Streams, config: Config) -> dict[str, Any]:
    """Columns of links.parquet, but for the anchors' places: a row for each configured anchor, also a silent one."""
    assert streams.ranges is not None
    anchor = np.array([anchor.id for anchor in config.uwb.anchors], dtype=np.int64)
    weak = weak_first_path_share(streams.ranges, streams.range_gap_db, result.tag, anchor)
    return {
        "tag": result.tag,
        "anchor": anchor,
        **link_quality(result.ranges, anchor, result.bias, result.range_std_m),
        "weak_first_path_share": weak,
    }


def _fix_columns(result: TagResult) -> dict[str, object]:
    solved, fixes = result.fixes.solved, result.fixes
    covariance = fixes.covariance_m2[solved]
    return {
        "t_ns": result.epochs.t_ns[solved],
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
