"""Metrics for readers: grouped by theme, in plain words, with interval and bound; the few that matter as cards."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadlog.errors import NotARun
from quadlog.metrics.catalogue import ALARMS, CATALOGUE
from quadlog.metrics.intervals import Interval
from quadlog.results.compare.expectations import Bound
from quadlog.results.plots.run_data import RunData
from quadlog.results.text.numbers import count, short

MAX_PER_CARD = 3
OTHER = "Other"

# Theme -> metric: a name in plain words, and a sentence for readers who do not know the field. The first are the ones
# that matter most.
THEMES: dict[str, dict[str, tuple[str, str]]] = {
    "Position": {
        "ate_rmse_m": (
            "position error",
            "How far the robot's positions are from the true ones: a typical distance.",
        ),
        "uwb_coverage_95": (
            "truth inside 95 % bound",
            "How often the true place lies inside the area that was claimed to hold it 95 % of the time.",
        ),
        "uwb_rmse_m": (
            "error of single fixes",
            "How far single UWB positions are from the truth, before smoothing along the track.",
        ),
        "uwb_residual_m": (
            "misfit of ranges",
            "How badly the measured distances to the anchors agree with the position found from them.",
        ),
        "uwb_nis": ("range noise, 1 is right", "Whether ranges scatter as the configuration says: 1 when they do."),
        "uwb_bias_m": ("constant error of fixes", "The part of the error that stays the same, which averaging keeps."),
        "uwb_nees": ("claimed accuracy, 2 is right", "Whether the track is as accurate as it claims: 2 when it is."),
        "rpe_rmse_m": ("error from pose to pose", "How wrong the way from one pose to the next is: jitter and drift."),
        "ate_aligned_rmse_m": (
            "position error, shape only",
            "The position error after track and truth are laid on each other as well as possible.",
        ),
        "ate_time_corrected_rmse_m": (
            "position error, clocks aligned",
            "The position error after the offset between the two clocks is taken out.",
        ),
        "lidar_uwb_rmse_m": (
            "lidar track against UWB",
            "How far apart the tracks from lidar scans and from UWB are, once laid on each other.",
        ),
        "reference_time_offset_s": ("clock offset to the truth", "How far the truth's clock is from the poses' clock."),
    },
    "Perception": {},
    "Planning": {
        "success_rate": ("replans with a path", "How many of the questions for a path had an answer."),
        "ratio_to_astar": (
            "cells saved against A*",
            "How many cells A* looks at for each one that this planner looks at; above 1 the planner needs fewer.",
        ),
        "suboptimality_mean": ("extra path cost", "How much longer the paths are than the shortest ones there are."),
        "expanded_mean": ("cells per replan", "How many map cells the planner looked at for one path."),
        "fallback_share": (
            "replans from scratch",
            "How often an incremental planner could not reuse its earlier work.",
        ),
        "expanded_total": ("cells in all", "How many map cells the planner looked at in the whole run."),
        "generated_total": ("cells opened in all", "How many map cells the planner ever put on its list."),
    },
    "Walking": {
        "collisions": ("contacts", "How often the robot's body began to touch an obstacle on the map."),
        "fallen": ("falls", "1 when the robot fell, 0 when it stayed up."),
        "eta_m": ("distance to the path", "How far the robot was from the path it should follow, on average."),
        "completion_time_s": ("time to the end", "How long the robot took to the end of its course."),
        "clearance_min_m": ("nearest obstacle", "The smallest gap between the robot's body and an obstacle."),
        "forward_m": ("forward", "How far the trot went forward."),
        "lateral_drift_m": ("sideways drift", "How far to the left the trot ended."),
        "yaw_rate_degps": ("turning", "How fast the trot turned to the left, though it should go straight."),
        "following_distance_mean_m": ("distance to the target", "How far the robot was behind who it follows."),
        "max_error_m": ("largest distance to the path", "The worst moment of following the path."),
        "sigma_m": ("scatter of that distance", "How much the distance to the path changes."),
        "cross_track_rmse_m": ("sideways error", "Typical distance to the left or right of the path."),
        "heading_rmse_rad": ("heading error", "Typical angle between the robot and the direction of its path."),
        "eta_time_m": ("distance to the schedule", "How far the robot was from where it should be at that moment."),
        "sigma_time_m": ("scatter of that distance", "How much the distance to the schedule changes."),
        "plan_error_m": ("distance to the plan of the moment", "A plan starts at the robot, so this is always small."),
        "pitch_rms_rad": ("pitching", "How much the body tips forward and back."),
        "height_rms_m": ("bobbing", "How much the body moves up and down."),
        "torque_max_nm": ("largest joint torque", "The hardest that any joint had to push."),
        "torque_saturation_share": ("torques at the limit", "How often a joint was asked for more than it can do."),
        "torque_rms_nm": ("joint torque, typical", "How hard the joints of the simulated robot pushed."),
        "duty_factor": ("time on the ground", "How much of the time a foot of the simulated robot stands."),
        "stride_frequency_hz": ("strides", "How often each foot of the simulated robot steps."),
        "logged_torque_rms_nm": ("joint torque, typical, as logged", "How hard the joints of the logged robot pushed."),
        "logged_torque_max_nm": ("largest joint torque, as logged", "The hardest that any joint really pushed."),
        "logged_duty_factor": ("time on the ground, as logged", "How much of the time a foot really stood."),
        "logged_stride_frequency_hz": ("strides, as logged", "How often each foot really stepped."),
    },
    "Cost": {
        "realtime_factor": (
            "speed of computing",
            "Recorded seconds per second of computing: above 1 it is faster than the robot walked.",
        ),
        "cost_of_transport": (
            "energy to walk",
            "Energy of the joints for each newton of weight and metre of way.",
        ),
        "logged_cost_of_transport": (
            "energy to walk, as logged",
            "The same of the logged robot, from its joints' torques and speeds.",
        ),
    },
}
_SHARES = frozenset({
    *("uwb_coverage_95", "success_rate", "suboptimality_mean", "fallback_share", "torque_saturation_share"),
    *("duty_factor", "logged_duty_factor"),
})  # fmt: skip
_EVENTS = frozenset({"collisions", "fallen"})
"""Counts of single events, for which the interval of a mean says nothing."""


@dataclass(frozen=True, slots=True)
class ShownMetric:
    """A metric as the page has it. value, interval, bound: texts, empty where there is none.

    state: good, warn (it holds, but its interval reaches beyond the bound; or one of catalogue.ALARMS does not), bad,
    or empty without a bound.
    """

    name: str
    label: str
    help: str
    value: str
    interval: str = ""
    bound: str = ""
    state: str = ""


@dataclass(frozen=True, slots=True)
class MetricRow:
    """A metric in the table of all: the numbers and the interval as saved, and what is shown of it."""

    shown: ShownMetric
    value: float
    unit: str
    n: int | None
    interval: str


@dataclass(frozen=True, slots=True)
class ThemeGroup:
    """The metrics of one theme: all of them, and the few that matter."""

    title: str
    rows: list[MetricRow]
    card: list[ShownMetric]


def plain_name(metric: str) -> str:
    """What readers who do not know the field call it."""
    return next((of[metric][0] for of in THEMES.values() if metric in of), metric)


def metric_themes(run: RunData) -> list[ThemeGroup]:
    """The themes that the run has metrics or facts of. Raises NotARun for bounds that are damaged."""
    bounds, alarms = expected_bounds(run), missed_alarms(run)
    named = {name for metrics in THEMES.values() for name in metrics}
    others = {OTHER: {name: (name, "") for name in sorted(run.metrics.keys() - named)}}
    groups = []
    for title, metrics in (THEMES | others).items():
        rows = [_row(run, bounds, alarms, name, *words) for name, words in metrics.items() if name in run.metrics]
        lacking = bounds.keys() - run.metrics.keys()
        absent = [_absent(bounds[name], *words) for name, words in metrics.items() if name in lacking]
        # Bounds that do not hold come first: they are what a reader must not miss.
        first = sorted([*absent, *(row.shown for row in rows)], key=lambda each: _RANK[each.state])
        facts = list(_facts(run, title))
        card = [] if title == OTHER else [*first[: max(MAX_PER_CARD - len(facts), 1)], *facts]
        if rows or card:
            groups.append(ThemeGroup(title, rows, card))
    return groups


_RANK = {"bad": 0, "warn": 1, "good": 1, "": 2}


def expected_bounds(run: RunData) -> dict[str, Bound]:
    """The bounds of [expect] in the run's config, by metric. Raises NotARun for damaged ones."""
    try:
        expect = run.record.config.get("expect", {})
        return {
            name: Bound(name, *(None if side not in of else float(of[side]) for side in ("min", "max")))
            for name, of in expect.items()
        }
    except (AttributeError, TypeError, ValueError) as error:
        raise NotARun(run.path / "run.json", f"is damaged: config.expect: {error}") from error


def held_bounds(run: RunData) -> tuple[int, int]:
    """How many of the expected bounds hold, and how many there are. A metric that the run lacks does not hold."""
    bounds = expected_bounds(run)
    values = {name: run.metric(name) for name in bounds}
    return sum(value is not None and bounds[name].holds(value) for name, value in values.items()), len(bounds)


def missed_alarms(run: RunData) -> dict[str, Bound]:
    """The bounds of catalogue.ALARMS that do not hold, by metric, where [expect] has none. Raises NotARun."""
    own, bounds = expected_bounds(run), [Bound(name, *sides) for name, sides in ALARMS.items()]
    values = {bound.metric: run.metric(bound.metric) for bound in bounds if bound.metric not in own}
    return {
        bound.metric: bound
        for bound in bounds
        if (value := values.get(bound.metric)) is not None and not bound.holds(value)
    }


def in_words(name: str, value: float, unit: str = "") -> str:
    """A value of a metric with its unit, shares in percent."""
    if name in _SHARES:
        return f"{short(100 * value, 3)} %".replace("-", "\u2212")
    number = count(int(value)) if float(value).is_integer() and abs(value) < 1e15 else short(value, 3)
    return f"{number} {'×' if name == 'realtime_factor' else unit}".strip().replace("-", "\u2212")


def _row(
    run: RunData, bounds: dict[str, Bound], alarms: dict[str, Bound], name: str, label: str, words: str
) -> MetricRow:
    saved = run.metrics[name]
    value, unit = float(saved["value"]), str(saved.get("unit", ""))
    interval = _interval(name, saved)
    shown = ShownMetric(
        name,
        label,
        words or (CATALOGUE[name].meaning if name in CATALOGUE else ""),
        in_words(name, value, unit),
        "" if interval is None else interval_text(interval, *((100.0, " %") if name in _SHARES else ())),
        bound_words((bounds | alarms)[name], unit) if name in bounds or name in alarms else "",
        "warn" if name in alarms else _state(bounds.get(name), value, interval),
    )
    return MetricRow(shown, value, unit, saved.get("n"), "" if interval is None else interval_text(interval))


def _absent(bound: Bound, label: str, words: str) -> ShownMetric:
    """A bound on a metric that the run does not have: it does not hold."""
    return ShownMetric(bound.metric, label, words, "not measured", "", bound_words(bound, ""), "bad")


def _interval(name: str, saved: Mapping[str, Any]) -> Interval | None:
    ends = saved.get("low"), saved.get("high")
    if name in _EVENTS or not all(isinstance(end, int | float) and math.isfinite(end) for end in ends):
        return None
    return float(ends[0]), float(ends[1])  # type: ignore[arg-type]


def interval_text(interval: Interval, times: float = 1.0, unit: str = "") -> str:
    """An interval: both ends to two digits, or all before the point."""
    ends = (times * end for end in interval)
    low, high = ((count(round(end)) if abs(end) >= 99.5 else short(end, 2)).replace("-", "\u2212") for end in ends)
    return f"{low} to {high}{unit}"


def _state(bound: Bound | None, value: float, interval: Interval | None) -> str:
    if bound is None:
        return ""
    if not bound.holds(value):
        return "bad"
    return "good" if interval is None or all(bound.holds(end) for end in interval) else "warn"


def bound_words(bound: Bound, unit: str) -> str:
    """Its sides, as in "at least 85 %"."""
    sides = {"at least": bound.least, "at most": bound.most}
    return ", ".join(f"{word} {in_words(bound.metric, side, unit)}" for word, side in sides.items() if side is not None)


def _facts(run: RunData, title: str) -> Iterator[ShownMetric]:
    """Numbers of a card that are no metrics: what the lidar's filter saw, and what the run took."""
    if title == "Perception" and (scans := run.table("scans")) is not None:
        found = f"{short(100 * float(np.mean(scans['ground_found'])), 3)} %"
        yield ShownMetric("", "ground found", "In how many scans the filter found the floor.", found)
        points = count(int(np.median(scans["n_obstacle"])))
        yield ShownMetric(
            "", "obstacle points", "How many points of a scan are obstacles; median.", f"{points} per scan"
        )
        if np.isfinite(scans["ms"]).any():
            ms = f"{short(float(np.nanmedian(scans['ms'])), 3)} ms"
            yield ShownMetric("", "time per scan", "Computing time of the filter for one scan; median.", ms)
    if title == "Cost" and run.record.stages:
        peak_mb = max(stage.peak_memory_mb for stage in run.record.stages)
        yield ShownMetric("", "peak memory", "The most memory that the program held at once.", f"{peak_mb:.0f} MB")
