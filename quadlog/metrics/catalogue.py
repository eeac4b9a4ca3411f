"""What every metric means: its formula, where that comes from, and what its n counts; and conditions on metrics."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from quadlog.errors import UnknownMetric, nearest

ValueKind = Literal["quantity", "share", "factor", "count", "yes or no"]


@dataclass(frozen=True, slots=True)
class MetricEntry:
    """One metric of the contract.

    label: words in which readers see it. formula: in plain characters, N samples x_i; source: a key of
    docs/references.md with the equation, or quadlog itself; counted: what n counts; worst_is_lowest: of the samples; 1
    and the largest of all are not bad. kind: of a run's value: shares are shown in percent, factors with ×; counts and
    yes or no have no interval. better: the lower or the higher value; empty where neither is better. alarm: the range
    outside of which a page warns without any configuration. one_draw: the biases of a log's links are drawn once, so
    that no log alone shows how the value scatters; these have no interval.
    """

    name: str
    unit: str
    label: str
    meaning: str
    formula: str
    source: str
    counted: str
    worst_is_lowest: bool = False
    kind: ValueKind = "quantity"
    better: Literal["lower", "higher", ""] = "lower"
    alarm: tuple[float, float] | None = None
    one_draw: bool = False


_OURS = "quadlog's own definition"
_TICKS = "control ticks whose error is known"
_BODY = "ticks of the simulation"
_JOINTS = "joint torques, 12 at each tick of the simulation"
_REPLANS = "replans"

_RESIMULATED = (
    MetricEntry("torque_rms_nm", "N·m", "torque, rms",
        "root mean square of the joint torques of the re-simulated body, given logged joints",
        "√( Σ tau_ij² / known torques )", _OURS, "instants with a known torque", better=""),
    MetricEntry("duty_factor", "", "duty factor",
        "share of the time in which a foot stands, mean over all, of the re-simulated body, given logged joints",
        "1/N Σ stance_i, of instants at 0.1 m/s or faster", _OURS, "instants of the walk with known contacts",
        kind="share", better=""),
    MetricEntry("stride_frequency_hz", "Hz", "stride frequency",
        "mean frequency of the strides, a foot's touch-downs, of the re-simulated body, given logged joints",
        "1/N Σ 1/T_i", _OURS, "strides of all feet", better=""),
)  # fmt: skip
_LOGGED = [
    replace(each, name=f"logged_{each.name}", label=f"{each.label}, logged", meaning=f"{each.name} of the logged body")
    for each in _RESIMULATED
]

_POSITION = (
    MetricEntry("ate_rmse_m", "m", "position error",
        "absolute trajectory error, in 3-D where heights are known (no tag's is a default); evo_ape's rmse",
        "√( 1/N Σ |p_i − p_ref_i|² )", "[Sturm]", "pairs of poses within 0.01 s", one_draw=True),
    MetricEntry("uwb_coverage_95", "", "truth inside the 95 % ellipse",
        "share of the truth that lies in the 95 % ellipses of the robot's track", "share of eᵢᵀ Cᵢ⁻¹ eᵢ ≤ 5.99",
        _OURS, "positions of the robot's tag with a truth", worst_is_lowest=True, kind="share", better="",
        alarm=(0.85, 1.0), one_draw=True),
    MetricEntry("uwb_rmse_m", "m", "error of single fixes",
        "root mean square distance of the robot's UWB fixes from the truth, unsmoothed",
        "√( 1/N Σ |fix_i − truth_i|² )", _OURS, "fixes of the robot's tag with a truth", one_draw=True),
    MetricEntry("ate_aligned_rmse_m", "m", "position error, aligned",
        "the same after the rigid motion that fits best; of the plane where heights lack",
        "√( 1/N Σ |R p_i + t − p_ref(t_i + offset)|² )", "[Umeyama]", "pairs of poses within 0.01 s", one_draw=True),
    MetricEntry("uwb_residual_m", "m", "range residual",
        "root mean square of the ranges of the robot's fixes less what the fixes predict",
        "√( Σ n_i residual_i² / Σ n_i ), n_i ranges in fix i", _OURS, "ranges"),
    MetricEntry("uwb_nis", "", "NIS of the ranges (1 is consistent)",
        "mean squared residual per range over its variance, causal: innovation; 1 if the std of a range is right",
        "1/N Σ rᵢᵀ Sᵢ⁻¹ rᵢ / nᵢ, nᵢ ranges, by weight", "[BarShalom]", "instants of the robot's track", better=""),
    MetricEntry("uwb_nees", "", "NEES of the track (2 is consistent)",
        "mean normalised error squared of the robot's track; 2 if its covariance is consistent", "1/N Σ eᵢᵀ Cᵢ⁻¹ eᵢ",
        "[BarShalom]", "positions of the robot's tag with a truth", better="", alarm=(1.0, 4.0), one_draw=True),
    MetricEntry("uwb_bias_m", "m", "constant error of fixes",
        "length of the mean error of the robot's UWB fixes: what averaging would not remove",
        "| 1/N Σ (fix_i − truth_i) |", _OURS, "fixes of the robot's tag with a truth", one_draw=True),
    MetricEntry("rpe_rmse_m", "m", "relative pose error",
        "relative pose error from pair to pair, translation, in 3-D or 2-D as ate_rmse_m; as evo_rpe",
        "√( 1/N Σ |trans( (Q_i⁻¹ Q_i+1)⁻¹ (P_i⁻¹ P_i+1) )|² )", "[Sturm]", "steps between neighbouring pairs"),
    MetricEntry("ate_time_corrected_rmse_m", "m", "position error, clocks aligned",
        "ate_rmse_m with reference_time_offset_s added to the poses' times",
        "√( 1/N Σ |p_i − p_ref(t_i + offset)|² )", "[Sturm]", "pairs of poses within 0.01 s", one_draw=True),
    MetricEntry("lidar_uwb_rmse_m", "m", "lidar track against UWB",
        "root mean square distance between the lidar's and UWB's tracks once aligned",
        "√( 1/N Σ |R lidar_i + t − uwb_i|² ), R and t a rigid motion in the plane", "[Umeyama]",
        "poses of the lidar at which UWB has one"),
    MetricEntry("reference_time_offset_s", "s", "clock offset to the reference",
        "what to add to the poses' times to have the reference's",
        "argmin over offset, R, t of Σ |R p_i + t − p_ref(t_i + offset)|²", _OURS, "poses compared", better=""),
)  # fmt: skip
_PLANNING = (
    MetricEntry("success_rate", "", "replans with a path", "share of replans that found a path", "Σ found_i / N",
        _OURS, _REPLANS, worst_is_lowest=True, kind="share", better="higher"),
    MetricEntry("ratio_to_astar", "", "fewer cells than A*",
        "cells that A* closes on the same queries per cell closed; above 1 is better",
        "Σ astar_expanded_i / Σ expanded_i", _OURS, _REPLANS, kind="factor", better="higher"),
    MetricEntry("suboptimality_mean", "", "extra path cost",
        "mean excess of the path's cost, as a fraction of the optimal cost", "1/N Σ (cost_i / optimal_cost_i − 1)",
        _OURS, "replans that found a path of some length", kind="share"),
    MetricEntry("expanded_mean", "", "cells per replan", "cells that the planner closed, per replan",
        "1/N Σ expanded_i", _OURS, _REPLANS),
    MetricEntry("fallback_share", "", "replans from scratch",
        "share of replans in which an incremental planner reused nothing of its last search",
        "Σ from_scratch_i / N, without the first, which always does", _OURS, "replans after the first", kind="share"),
    MetricEntry("expanded_total", "", "cells expanded", "cells that the planner closed, over all replans",
        "Σ expanded_i", _OURS, _REPLANS, kind="count"),
    MetricEntry("generated_total", "", "cells generated",
        "distinct cells that the planner ever opened, over all replans", "Σ generated_i", _OURS, _REPLANS,
        kind="count"),
)  # fmt: skip
_WALKING = (
    MetricEntry("collisions", "", "contacts",
        "how often contact began with an obstacle that did not first appear inside the body",
        "number of ticks with clearance ≤ 0 after one without", _OURS, "control ticks inside the map", kind="count"),
    MetricEntry("fallen", "", "falls", "1 when the robot fell, else 0; absent for a robot without a body",
        "max fallen_i", _OURS, "control ticks", kind="yes or no"),
    MetricEntry("eta_m", "m", "distance to the path",
        "mean distance from the re-simulated robot to the nearest point of the path it follows", "η = 1/N Σ error_i",
        "[Tracking] eq. 46", _TICKS),
    MetricEntry("clearance_min_m", "m", "nearest obstacle",
        "smallest distance from the body to an obstacle, below 0 inside of one", "min clearance_i", _OURS,
        "control ticks with an obstacle on the map", worst_is_lowest=True, better="higher", alarm=(0.05, math.inf)),
    MetricEntry("following_distance_mean_m", "m", "distance to the target", "mean distance to who is followed",
        "1/N Σ |target_i − robot_i|", _OURS, "control ticks with a known target", better=""),
    MetricEntry("completion_time_s", "s", "time to the end of the course",
        "time from the first tick until the course's end was reached", "t_end − t_0", _OURS, "courses finished: 1"),
    MetricEntry("max_error_m", "m", "largest distance to the path",
        "largest distance from the robot to its reference path", "max error_i", _OURS, _TICKS),
    MetricEntry("sigma_m", "m", "scatter of the distance to the path",
        "sample standard deviation of the distance to the path it follows", "σ = √( Σ (error_i − η)² / (N − 1) )",
        "[Tracking] eq. 47", _TICKS),
    MetricEntry("cross_track_rmse_m", "m", "cross-track error",
        "root mean square of the signed distance to the reference path, left positive", "√( 1/N Σ cross_track_i² )",
        _OURS, _TICKS),
    MetricEntry("heading_rmse_rad", "rad", "heading error",
        "root mean square of the heading less the reference path's direction", "√( 1/N Σ heading_error_i² )", _OURS,
        _TICKS),
    MetricEntry("eta_time_m", "m", "distance to the schedule",
        "mean distance from the robot to where the reference is at that instant", "1/N Σ time_error_i",
        "[Tracking] eq. 46, of the timed reference", _TICKS),
    MetricEntry("sigma_time_m", "m", "scatter of the distance to the schedule",
        "sample standard deviation of the distance to where the reference is at that instant",
        "√( Σ (time_error_i − eta_time)² / (N − 1) )", "[Tracking] eq. 47, of the timed reference", _TICKS),
    MetricEntry("plan_error_m", "m", "distance to the current plan",
        "mean distance from the re-simulated robot to the current plan, which starts at the robot",
        "1/N Σ plan_error_i", _OURS, "control ticks with a plan"),
    MetricEntry("speed_difference_rms_mps", "m/s", "speed beside the log's",
        "root mean square of the speed of a robot driven by the log's commands less the logged robot's",
        "√( 1/N Σ (v_i − v_logged_i)² ), v over 1 s", _OURS, "control ticks with a logged pose"),
    MetricEntry("lateral_drift_m", "m", "drift to the left", "how far to the left a trot along x ended",
        "y_end − y_start", "[Foot] Figs 5, 6", "samples of the trot", better=""),
    MetricEntry("yaw_rate_degps", "deg/s", "turning drift", "rate at which a trot along x turns to the left",
        "slope of the line through the mean yaw of each gait cycle", "[Foot] Figs 5, 6", "gait cycles", better=""),
    MetricEntry("forward_m", "m", "distance forward", "how far along x a trot went", "x_end − x_start",
        "[Foot] Figs 5, 6", "samples of the trot", better=""),
)  # fmt: skip
_OF_BODY = (
    MetricEntry("cost_of_transport", "", "cost of transport",
        "energy of the joints per weight and way; braking costs as driving does",
        "Σ |tau_ij ω_ij| Δt / (m g Σ v_i Δt), v_i over 1 s, 0 below 0.1 m/s",
        _OURS, _BODY),
    MetricEntry("torque_max_nm", "N·m", "largest torque", "largest joint torque", "max |tau_ij|", _OURS, _JOINTS),
    MetricEntry("torque_saturation_share", "", "torques at the limit",
        "share of joint torques that were cut at the joint's limit", "cut / N", _OURS, _JOINTS, kind="share"),
    MetricEntry("pitch_rms_rad", "rad", "pitch error",
        "root mean square of the body's pitch less the pitch that the ground asks for",
        "√( 1/N Σ (pitch_i − wanted_i)² )", _OURS, _BODY),
    MetricEntry("height_rms_m", "m", "height error",
        "root mean square of the body's height less the height that the ground asks for",
        "√( 1/N Σ (z_i − wanted_i)² )", _OURS, _BODY),
    MetricEntry("force_error_rms_n", "N", "forces beside the MPC's",
        "root mean square of the normal forces that the MPC plans less those on the feet",
        "√( 1/N Σ 1/4 Σ_j (wanted_ij − fz_ij)² )", _OURS, "control ticks with planned forces", better=""),
    *_RESIMULATED,
    *_LOGGED,
    MetricEntry("logged_cost_of_transport", "", "cost of transport, logged",
        "cost_of_transport of the logged body, by the configured robot's mass",
        "mean Σ_j |tau_ij ω_ij| / (m g mean v_i), v_i over 1 s, 0 below 0.1 m/s", _OURS,
        "instants with known power and speed"),
    MetricEntry("logged_torque_max_nm", "N·m", "largest torque, logged", "largest joint torque of the logged body",
        "max |tau_ij|", _OURS, "instants with a known torque"),
)  # fmt: skip
_COMPUTING = (
    MetricEntry("realtime_factor", "", "times real time",
        "recorded seconds per second of computing, start-up and compilation apart", "recorded_s / Σ stage seconds",
        _OURS, "runs: 1", kind="factor", better="higher"),
    MetricEntry("us_step_median", "µs", "time of a controller's step",
        "median time that the controller takes for a tick of the simulation, with the MPC when it is due",
        "median us_median_i", _OURS, "control ticks"),
    MetricEntry("us_step_p95", "µs", "longest step in 95 % of the ticks",
        "95th percentile of the longest step within a control tick", "p95 us_max_i", _OURS, "control ticks"),
)  # fmt: skip
_BY_THEME = {
    "Position": _POSITION, "Planning": _PLANNING, "Walking": _WALKING, "Body": _OF_BODY, "Computing": _COMPUTING
}  # fmt: skip
THEMES = {theme: tuple(each.name for each in entries) for theme, entries in _BY_THEME.items()}
"""Metrics by theme, the ones that matter most first."""
CATALOGUE: dict[str, MetricEntry] = {each.name: each for entries in _BY_THEME.values() for each in entries}
"""Every metric of the contract by name, theme by theme."""

OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_LONGEST = 200
_CONDITION = re.compile(
    rf"\s*([A-Za-z_]\w*)\s*({'|'.join(OPERATORS)})\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*", re.ASCII
)


@dataclass(frozen=True, slots=True)
class Condition:
    """As in `eta_m > 0.3`: a name, an operator, a number, and nothing else."""

    name: str
    operator: str
    limit: float

    def holds(self, value: float) -> bool:
        """Whether the condition is true of the value; == and != compare to the last digit."""
        return OPERATORS[self.operator](value, self.limit)

    def __str__(self) -> str:
        """As one would write it."""
        return f"{self.name} {self.operator} {self.limit:.12g}"


def parse_condition(text: str) -> Condition:
    """The condition that the text states: NAME OPERATOR NUMBER, white space between them as one likes.

    Raises UnknownMetric for anything else, and for a name that no metric has.
    """
    found = _CONDITION.fullmatch(text) if len(text) <= _LONGEST else None
    if found is None or not math.isfinite(float(found[3])):
        raise UnknownMetric(
            f"condition {text[:_LONGEST]!r}: write NAME OPERATOR NUMBER, as in 'eta_m>0.3'; "
            f"operators: {' '.join(OPERATORS)}"
        )
    check_metric(found[1])
    return Condition(found[1], found[2], float(found[3]))


def check_metric(name: str) -> None:
    """Raises UnknownMetric, with the nearest name there is, when no metric has this one."""
    if name not in CATALOGUE:
        near = nearest(name, CATALOGUE)
        hint = f"did you mean {near}?" if near else f"there are: {', '.join(CATALOGUE)}"
        raise UnknownMetric(f"unknown metric {name!r}; {hint}")
