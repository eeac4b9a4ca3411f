"""UWB in a replay: which tag is whose, its fixes and track, and what became of every range."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from quadlog.config import Config
from quadlog.messages import RangeSeries
from quadlog.pipelines.stages.walk import Walk
from quadlog.positioning.calibration import AnchorBias
from quadlog.positioning.locate import Anchors, Located, LocateSettings, TagInfo, TagResult, locate
from quadlog.positioning.screening import RangeCounts
from quadlog.results.schemas import TABLES
from quadlog.results.tables import TableWriter

MISFIT_STD = 5.0
"""Of clean ranges half miss by less than 0.7 std, of heavily blocked ones by less than 3."""


@dataclass(frozen=True, slots=True)
class UwbPositions:
    """All tags located, and which of them are the robot's and the person's."""

    located: Located
    robot: TagResult | None
    person: TagResult | None


def locate_tags(walk: Walk) -> UwbPositions | None:
    """Every tag in the recording located on its own; None when UWB is not used, which is said."""
    config, ranges = walk.config, walk.streams.ranges
    if not config.uwb.anchors:
        for topic in walk.roles.found["uwb"].topics if "uwb" in walk.roles.found else ():
            walk.warn(f"{topic}: ranges are not used, no [[uwb.anchors]] are configured; quadlog init writes a form")
        return None
    if not wants_uwb(config):
        return None
    if ranges is None:
        walk.warn("anchors are configured, but the recording has no UWB ranges")
        return None
    tags = tags_of(config, ranges)
    located = locate(ranges, anchors_of(config), list(tags.values()), settings_of(config))
    _tell(walk, located)
    by_id = {result.tag: result for result in located.tags}
    roles = roles_of(config, list(tags))
    walk.use("uwb")
    return UwbPositions(located, by_id.get(roles.get("robot", -1)), by_id.get(roles.get("person", -1)))


def wants_uwb(config: Config) -> bool:
    """Whether the robot or the target may be located by UWB."""
    return bool(config.uwb.anchors) and not {"auto", "uwb"}.isdisjoint({config.topics.position, config.topics.target})


def anchors_of(config: Config) -> Anchors:
    """The configured anchors as arrays."""
    anchors = config.uwb.anchors
    return Anchors(
        np.array([anchor.id for anchor in anchors], dtype=np.int64),
        np.array([[anchor.x_m, anchor.y_m, anchor.z_m] for anchor in anchors]),
        np.array([anchor.bias_m for anchor in anchors]),
    )


def roles_of(config: Config, tags: list[int]) -> dict[str, int]:
    """Role -> tag id: as the table says; without one the lowest id is the robot, the next one the person."""
    if config.uwb.tags:
        return {tag.role: tag.id for tag in reversed(config.uwb.tags) if tag.role != "none" and tag.id in tags}
    return dict(zip(("robot", "person"), sorted(tags), strict=False))


def lever_of(config: Config, tag: int) -> tuple[float, float]:
    """Where a tag sits in base, x_m and y_m; at its origin unless the table says otherwise."""
    row = next((each for each in config.uwb.tags if each.id == tag), None)
    return (row.x_m, row.y_m) if row is not None else (0.0, 0.0)


def tags_of(config: Config, ranges: RangeSeries) -> dict[int, TagInfo]:
    """The tags to locate, by id, with their heights: those seen, and of a configured table only those on it."""
    seen = [int(tag) for tag in np.unique(ranges.tag)]
    table = {tag.id: tag for tag in config.uwb.tags}
    wanted = [tag for tag in seen if tag in table] if table else seen
    person = roles_of(config, wanted).get("person")
    heights = {tag: config.uwb.person_height_m if tag == person else config.uwb.tag_height_m for tag in wanted}
    heights |= {tag: row.height_m for tag, row in table.items() if row.height_m is not None and tag in heights}
    return {tag: TagInfo(tag, heights[tag]) for tag in wanted}


def settings_of(config: Config) -> LocateSettings:
    """The section `uwb` as the algorithms take it."""
    uwb = config.uwb
    return LocateSettings(
        range_std_m=uwb.range_std_m,
        min_range_m=uwb.min_range_m,
        max_range_m=uwb.max_range_m,
        epoch_s=uwb.epoch_s,
        outlier_m=uwb.outlier_m,
        acceleration_std_mps2=uwb.acceleration_std_mps2,
        calibrate=uwb.calibrate,
        smooth=uwb.smooth,
    )


def write_uwb(walk: Walk, uwb: UwbPositions) -> None:
    """fixes.parquet and ranges.parquet, tag after tag."""
    with ExitStack() as stack:
        fixes = stack.enter_context(TableWriter(walk.run.path / "fixes.parquet", TABLES["fixes"]))
        ranges = stack.enter_context(TableWriter(walk.run.path / "ranges.parquet", TABLES["ranges"]))
        for result in uwb.located.tags:
            fixes.append(_fix_columns(result))
            rows = result.ranges
            columns = {"t_ns": rows.t_ns, "anchor": rows.anchor, "range_m": rows.range_m}
            ranges.append(columns | {"tag": result.tag, "predicted_m": rows.predicted_m, "weight": rows.weight})


def _fix_columns(result: TagResult) -> dict[str, object]:
    solved, fixes = result.fixes.solved, result.fixes
    covariance = fixes.covariance_m2[solved]
    return {
        "t_ns": result.fix_t_ns[solved],
        "tag": result.tag,
        "x_m": fixes.position_m[solved, 0],
        "y_m": fixes.position_m[solved, 1],
        "z_m": result.height_m,
        "cov_xx_m2": covariance[:, 0, 0],
        "cov_xy_m2": covariance[:, 0, 1],
        "cov_yy_m2": covariance[:, 1, 1],
        "n_ranges": fixes.n_ranges[solved],
        "residual_rms_m": fixes.residual_rms_m[solved],
        "outlier": fixes.outlier[solved],
    }


def _tell(walk: Walk, located: Located) -> None:
    """Counts for `run.json`, and a warning for every range and epoch that could not be used."""
    counts = located.counts
    walk.counts |= {"ranges": counts.total, "ranges_used": counts.used}
    for text in _range_warnings(counts):
        walk.warn(text)
    walk.counts["ranges_off_track"] = sum(result.n_untracked for result in located.tags)
    for result in located.tags:
        if result.n_too_few or result.n_degenerate:
            causes = {"fewer than three ranges": result.n_too_few, "anchors on a line": result.n_degenerate}
            words = " and ".join(f"{count} with {cause}" for cause, count in causes.items() if count)
            walk.warn(f"tag {result.tag}: of {len(result.fix_t_ns)} epochs, {words} give no fix")
        misfit = _misfit_warning(result, walk.config)
        if misfit is not None:
            walk.warn(misfit)
        if result.bias is not None:
            walk.note(_bias_words(result.tag, result.bias, walk.config))


def _misfit_warning(result: TagResult, config: Config) -> str | None:
    """Ranges that fit no position at all: ids or places of anchors are wrong, and the worst anchor is named."""
    residual_m = np.abs(result.ranges.range_m - result.ranges.predicted_m)
    known = np.isfinite(residual_m)
    if not known.any() or np.median(residual_m[known]) < MISFIT_STD * config.uwb.range_std_m:
        return None
    anchors = np.unique(result.ranges.anchor[known])
    worst = max(anchors, key=lambda anchor: np.median(residual_m[known & (result.ranges.anchor == anchor)]))
    return (
        f"tag {result.tag}: half of its ranges miss its track by more than {np.median(residual_m[known]):.2f} m "
        f"(uwb.range_std_m is {config.uwb.range_std_m} m); check [[uwb.anchors]], anchor {worst} first"
    )


def _bias_words(tag: int, bias: AnchorBias, config: Config) -> str:
    if not bias.significant.any():
        std_m = bias.std_m[bias.n > 0].max(initial=0.0)
        return (
            f"tag {tag}: ranges are not corrected by anchor biases, which this log tells from positions "
            f"only to {std_m:.2f} m (a longer walk tells more)"
        )
    links = zip(config.uwb.anchors, bias.applied_m, bias.std_m, strict=True)
    words = ", ".join(f"{anchor.id}: {applied:+.3f} +- {std:.3f}" for anchor, applied, std in links)
    return f"tag {tag}: ranges corrected by each anchor's bias in m: {words}"


def _range_warnings(counts: RangeCounts) -> list[str]:
    def words(pairs: tuple[tuple[int, int], ...]) -> str:
        return ", ".join(f"{number} ({count} ranges)" for number, count in pairs)

    causes = {
        "that are no numbers": counts.not_finite,
        "of zero or below": counts.not_positive,
        "below uwb.min_range_m": counts.too_short,
        "above uwb.max_range_m": counts.too_long,
    }
    texts = [f"{count} ranges {cause} are left out" for cause, count in causes.items() if count]
    if counts.unknown_anchors:
        texts.append(f"anchors seen, but not in [[uwb.anchors]]: {words(counts.unknown_anchors)}")
    if counts.other_tags:
        texts.append(f"tags seen, but not in [[uwb.tags]]: {words(counts.other_tags)}")
    if counts.silent_anchors:
        texts.append(f"anchors configured, but silent: {', '.join(map(str, counts.silent_anchors))}")
    return texts
