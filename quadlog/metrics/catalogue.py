"""What every metric means: its formula, where that comes from, and what its n counts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

ValueKind = Literal["quantity", "share", "factor", "count", "yes or no"]


@dataclass(frozen=True, slots=True)
class MetricEntry:
    """One metric of the contract.

    formula: in plain characters, N samples x_i; source: a key of docs/references.md with the equation, or quadlog
    itself; counted: what n counts; worst_is_lowest: of the samples; 1 and the largest of all are not bad. kind: of a
    run's value: shares are shown in percent, factors with ×; counts and yes or no have no interval.
    better: the lower or the higher value; empty where neither is better. theme, label: group and words in which readers
    see it, see THEMES. alarm: the range outside of which a page warns without any configuration.
    """

    name: str
    unit: str
    meaning: str
    formula: str
    source: str
    counted: str
    worst_is_lowest: bool = False
    kind: ValueKind = "quantity"
    better: Literal["lower", "higher", ""] = "lower"
    theme: str = ""
    label: str = ""
    alarm: tuple[float, float] | None = None


_OURS = "quadlog's own definition"
_TICKS = "control ticks whose error is known"
_BODY = "ticks of the simulation"
_JOINTS = "joint torques, 12 at each tick of the simulation"
_REPLANS = "replans"

_BODIES = (
    ("torque_rms_nm", "N·m", "root mean square of the joint torques", "√( 1/N Σ tau_ij² )", "known joint torques"),
    (
        *("duty_factor", "", "share of the time in which a foot stands, mean over all,"),
        *("1/N Σ stance_i, of instants at 0.1 m/s or faster", "instants of the walk with known contacts"),
    ),
    (
        *("stride_frequency_hz", "Hz", "mean frequency of the strides, a foot's touch-downs,"),
        *("1/N Σ 1/T_i", "strides of all feet"),
    ),
)
"""Name, unit, meaning, formula and what is counted, of metrics that a logged and a re-simulated body both have."""

_ENTRIES = (
    MetricEntry(
        *("eta_m", "m", "mean distance from the robot to the nearest point of its reference path"),
        *("η = 1/N Σ error_i", "[Tracking] eq. 46", _TICKS),
    ),
    MetricEntry(
        *("sigma_m", "m", "sample standard deviation of the distance to the reference path"),
        *("σ = √( Σ (error_i − η)² / (N − 1) )", "[Tracking] eq. 47", _TICKS),
    ),
    MetricEntry(
        *("eta_time_m", "m", "mean distance from the robot to where the reference is at that instant"),
        *("1/N Σ time_error_i", "[Tracking] eq. 46, of the timed reference", _TICKS),
    ),
    MetricEntry(
        *("sigma_time_m", "m", "sample standard deviation of the distance to where the reference is at that instant"),
        *("√( Σ (time_error_i − eta_time)² / (N − 1) )", "[Tracking] eq. 47, of the timed reference", _TICKS),
    ),
    MetricEntry(
        *("completion_time_s", "s", "time from the first tick until the course's end was reached"),
        *("t_end − t_0", _OURS, "courses finished: 1"),
    ),
    MetricEntry(
        *("max_error_m", "m", "largest distance from the robot to its reference path"),
        *("max error_i", _OURS, _TICKS),
    ),
    MetricEntry(
        *("cross_track_rmse_m", "m", "root mean square of the signed distance to the reference path, left positive"),
        *("√( 1/N Σ cross_track_i² )", _OURS, _TICKS),
    ),
    MetricEntry(
        *("heading_rmse_rad", "rad", "root mean square of the heading less the reference path's direction"),
        *("√( 1/N Σ heading_error_i² )", _OURS, _TICKS),
    ),
    MetricEntry(
        *(
            "plan_error_m",
            "m",
            "mean distance from the re-simulated robot to the current plan, which starts at the robot",
        ),
        *("1/N Σ plan_error_i", _OURS, "control ticks with a plan"),
    ),
    MetricEntry(
        *("fallen", "", "1 when the robot fell, else 0; absent for a robot without a body"),
        *("max fallen_i", _OURS, "control ticks"),
        kind="yes or no",
    ),
    MetricEntry(
        *("pitch_rms_rad", "rad", "root mean square of the body's pitch less the pitch that the ground asks for"),
        *("√( 1/N Σ (pitch_i − wanted_i)² )", _OURS, _BODY),
    ),
    MetricEntry(
        *("height_rms_m", "m", "root mean square of the body's height less the height that the ground asks for"),
        *("√( 1/N Σ (z_i − wanted_i)² )", _OURS, _BODY),
    ),
    MetricEntry(
        *("torque_max_nm", "N·m", "largest joint torque"),
        *("max |tau_ij|", _OURS, _JOINTS),
    ),
    MetricEntry(
        *("torque_saturation_share", "", "share of joint torques that were cut at the joint's limit"),
        *("cut / N", _OURS, _JOINTS),
    ),
    MetricEntry(
        *("cost_of_transport", "", "energy of the joints per weight and distance; braking costs as driving does"),
        *("Σ |tau_ij ω_ij| Δt / (m g d)", _OURS, _BODY),
    ),
    *(
        MetricEntry(prefix + name, unit, f"{meaning} of {whose}", formula, _OURS, counted, better="")
        for prefix, whose in (("", "the re-simulated body, given logged joints"), ("logged_", "the logged body"))
        for name, unit, meaning, formula, counted in _BODIES
    ),
    MetricEntry(
        *("logged_torque_max_nm", "N·m", "largest joint torque of the logged body"),
        *("max |tau_ij|", _OURS, "instants with a known torque"),
    ),
    MetricEntry(
        *("logged_cost_of_transport", "", "cost_of_transport of the logged body, by the configured robot's mass"),
        *("mean Σ_j |tau_ij ω_ij| / (m g mean v_i), v_i 0 below 0.1 m/s", _OURS, "instants with known power and speed"),
    ),
    MetricEntry(
        *("clearance_min_m", "m", "smallest distance from the body to an obstacle, below 0 inside of one"),
        *("min clearance_i", _OURS, "control ticks with an obstacle on the map"),
        worst_is_lowest=True,
        better="higher",
    ),
    MetricEntry(
        *("collisions", "", "how often contact began with an obstacle that did not first appear inside the body"),
        *("number of ticks with clearance ≤ 0 after one without", _OURS, "control ticks inside the map"),
        kind="count",
    ),
    MetricEntry(
        *("following_distance_mean_m", "m", "mean distance to who is followed"),
        *("1/N Σ |target_i − robot_i|", _OURS, "control ticks with a known target"),
        better="",
    ),
    MetricEntry(
        *("lateral_drift_m", "m", "how far to the left a trot along x ended"),
        *("y_end − y_start", "[Foot] Figs 5, 6", "samples of the trot"),
        better="",
    ),
    MetricEntry(
        *("yaw_rate_degps", "deg/s", "rate at which a trot along x turns to the left"),
        *("slope of the line through the mean yaw of each gait cycle", "[Foot] Figs 5, 6", "gait cycles"),
        better="",
    ),
    MetricEntry(
        *("forward_m", "m", "how far along x a trot went"),
        *("x_end − x_start", "[Foot] Figs 5, 6", "samples of the trot"),
        better="",
    ),
    MetricEntry(
        *("expanded_total", "", "cells that the planner closed, over all replans"),
        *("Σ expanded_i", _OURS, _REPLANS),
        kind="count",
    ),
    MetricEntry(
        *("generated_total", "", "distinct cells that the planner ever opened, over all replans"),
        *("Σ generated_i", _OURS, _REPLANS),
        kind="count",
    ),
    MetricEntry(
        *("expanded_mean", "", "cells that the planner closed, per replan"),
        *("1/N Σ expanded_i", _OURS, _REPLANS),
    ),
    MetricEntry(
        *("ratio_to_astar", "", "cells that A* closes on the same queries per cell closed; above 1 is better"),
        *("Σ astar_expanded_i / Σ expanded_i", _OURS, _REPLANS),
        better="higher",
    ),
    MetricEntry(
        *("fallback_share", "", "share of replans in which an incremental planner reused nothing of its last search"),
        *("Σ from_scratch_i / N, without the first, which always does", _OURS, "replans after the first"),
    ),
    MetricEntry(
        *("suboptimality_mean", "", "mean excess of the path's cost, as a fraction of the optimal cost"),
        *("1/N Σ (cost_i / optimal_cost_i − 1)", _OURS, "replans that found a path of some length"),
    ),
    MetricEntry(
        *("success_rate", "", "share of replans that found a path"),
        *("Σ found_i / N", _OURS, _REPLANS),
        worst_is_lowest=True,
        better="higher",
    ),
    MetricEntry(
        *("uwb_rmse_m", "m", "root mean square distance of the robot's UWB fixes from the truth, unsmoothed"),
        *("√( 1/N Σ |fix_i − truth_i|² )", _OURS, "fixes of the robot's tag with a truth"),
    ),
    MetricEntry(
        *("uwb_bias_m", "m", "length of the mean error of the robot's UWB fixes: what averaging would not remove"),
        *("| 1/N Σ (fix_i − truth_i) |", _OURS, "fixes of the robot's tag with a truth"),
    ),
    MetricEntry(
        *("uwb_residual_m", "m", "root mean square of the ranges of the robot's fixes less what the fixes predict"),
        *("√( Σ n_i residual_i² / Σ n_i ), n_i ranges in fix i", _OURS, "ranges"),
    ),
    MetricEntry(
        *(
            "uwb_nis",
            "",
            "mean squared residual per range over its variance, causal: innovation; 1 if uwb.range_std_m is the noise",
        ),
        *("1/N Σ rᵢᵀ Sᵢ⁻¹ rᵢ / nᵢ, nᵢ ranges, by weight", "[BarShalom]", "instants of the robot's track"),
        better="",
    ),
    MetricEntry(
        *(
            "uwb_nees",
            "",
            "mean normalised error squared of the robot's track; 2 if its covariance is consistent",
        ),
        *("1/N Σ eᵢᵀ Cᵢ⁻¹ eᵢ", "[BarShalom]", "positions of the robot's tag with a truth"),
        better="",
    ),
    MetricEntry(
        *("uwb_coverage_95", "", "share of the truth that lies in the 95 % ellipses of the robot's track"),
        *("share of eᵢᵀ Cᵢ⁻¹ eᵢ ≤ 5.99", _OURS, "positions of the robot's tag with a truth"),
        worst_is_lowest=True,
        better="",
    ),
    MetricEntry(
        *("ate_rmse_m", "m"),
        "absolute trajectory error, in 3-D where heights are known (no tag's is a default); evo_ape's rmse",
        *("√( 1/N Σ |p_i − p_ref_i|² )", "[Sturm]", "pairs of poses within 0.01 s"),
    ),
    MetricEntry(
        *("ate_time_corrected_rmse_m", "m", "ate_rmse_m with reference_time_offset_s added to the poses' times"),
        *("√( 1/N Σ |p_i − p_ref(t_i + offset)|² )", "[Sturm]", "pairs of poses within 0.01 s"),
    ),
    MetricEntry(
        *("ate_aligned_rmse_m", "m", "the same after the rigid motion that fits best; of the plane where heights lack"),
        *("√( 1/N Σ |R p_i + t − p_ref(t_i + offset)|² )", "[Umeyama]", "pairs of poses within 0.01 s"),
    ),
    MetricEntry(
        *("lidar_uwb_rmse_m", "m", "root mean square distance between the lidar's and UWB's tracks once aligned"),
        *("√( 1/N Σ |R lidar_i + t − uwb_i|² ), R and t a rigid motion in the plane", "[Umeyama]"),
        "poses of the lidar at which UWB has one",
    ),
    MetricEntry(
        *(
            "reference_time_offset_s",
            "s",
            "what to add to the poses' times to have the reference's",
        ),
        *("argmin over offset, R, t of Σ |R p_i + t − p_ref(t_i + offset)|²", _OURS, "poses compared"),
        better="",
    ),
    MetricEntry(
        *(
            "rpe_rmse_m",
            "m",
            "relative pose error from pair to pair, translation, in 3-D or 2-D as ate_rmse_m; as evo_rpe",
        ),
        *("√( 1/N Σ |trans( (Q_i⁻¹ Q_i+1)⁻¹ (P_i⁻¹ P_i+1) )|² )", "[Sturm]", "steps between neighbouring pairs"),
    ),
    MetricEntry(
        *("realtime_factor", "", "recorded seconds per second of computing, start-up and compilation apart"),
        *("recorded_s / Σ stage seconds", _OURS, "runs: 1"),
        better="higher",
    ),
)

THEMES: dict[str, dict[str, str]] = {
    "Position": {
        "ate_rmse_m": "position error",
        "uwb_coverage_95": "truth inside the 95 % ellipse",
        "uwb_rmse_m": "error of single fixes",
        "ate_aligned_rmse_m": "position error, aligned",
        "uwb_residual_m": "range residual",
        "uwb_nis": "NIS of the ranges (1 is consistent)",
        "uwb_nees": "NEES of the track (2 is consistent)",
        "uwb_bias_m": "constant error of fixes",
        "rpe_rmse_m": "relative pose error",
        "ate_time_corrected_rmse_m": "position error, clocks aligned",
        "lidar_uwb_rmse_m": "lidar track against UWB",
        "reference_time_offset_s": "clock offset to the reference",
    },
    "Planning": {
        "success_rate": "replans with a path",
        "ratio_to_astar": "fewer cells than A*",
        "suboptimality_mean": "extra path cost",
        "expanded_mean": "cells per replan",
        "fallback_share": "replans from scratch",
        "expanded_total": "cells expanded",
        "generated_total": "cells generated",
    },
    "Walking": {
        "collisions": "contacts",
        "fallen": "falls",
        "eta_m": "distance to the path",
        "clearance_min_m": "nearest obstacle",
        "following_distance_mean_m": "distance to the target",
        "completion_time_s": "time to the end of the course",
        "max_error_m": "largest distance to the path",
        "sigma_m": "scatter of the distance to the path",
        "cross_track_rmse_m": "cross-track error",
        "heading_rmse_rad": "heading error",
        "eta_time_m": "distance to the schedule",
        "sigma_time_m": "scatter of the distance to the schedule",
        "plan_error_m": "distance to the current plan",
        "lateral_drift_m": "drift to the left",
        "yaw_rate_degps": "turning drift",
        "forward_m": "distance forward",
    },
    "Body": {
        "cost_of_transport": "cost of transport",
        "torque_max_nm": "largest torque",
        "torque_saturation_share": "torques at the limit",
        "pitch_rms_rad": "pitch error",
        "height_rms_m": "height error",
        "torque_rms_nm": "torque, rms",
        "duty_factor": "duty factor",
        "stride_frequency_hz": "stride frequency",
        "logged_cost_of_transport": "cost of transport, logged",
        "logged_torque_max_nm": "largest torque, logged",
        "logged_torque_rms_nm": "torque, rms, logged",
        "logged_duty_factor": "duty factor, logged",
        "logged_stride_frequency_hz": "stride frequency, logged",
    },
    "Computing": {"realtime_factor": "times real time"},
}
"""Metrics by theme, the ones that matter most first, with their labels."""
_SHARES = frozenset({
    *("uwb_coverage_95", "success_rate", "suboptimality_mean", "fallback_share", "torque_saturation_share"),
    *("duty_factor", "logged_duty_factor"),
})  # fmt: skip
_FACTORS = frozenset({"realtime_factor", "ratio_to_astar"})
_ALARMS = {"uwb_coverage_95": (0.85, 1.0), "uwb_nees": (1.0, 4.0), "clearance_min_m": (0.05, math.inf)}
"""Half a cell of the default map is the least clearance."""


def _with_words(entry: MetricEntry) -> MetricEntry:
    theme = next(theme for theme, labels in THEMES.items() if entry.name in labels)
    kind: ValueKind = "share" if entry.name in _SHARES else "factor" if entry.name in _FACTORS else entry.kind
    return replace(entry, theme=theme, label=THEMES[theme][entry.name], kind=kind, alarm=_ALARMS.get(entry.name))


CATALOGUE: dict[str, MetricEntry] = {entry.name: _with_words(entry) for entry in _ENTRIES}
"""Every metric of the contract by name, in the contract's order."""
