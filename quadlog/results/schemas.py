"""The columns of every table in a run folder, in order, with their types.

A float that does not exist (no fix, no torque) is null in the file and NaN in
memory; every other column always has a value.
"""

from __future__ import annotations

import pyarrow as pa

_TYPES = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_(), "text": pa.string()}


def _schema(**columns: str) -> pa.Schema:
    """A schema from name="type" pairs, in the order given."""
    return pa.schema([pa.field(name, _TYPES[kind], nullable=kind == "float") for name, kind in columns.items()])


def _floats(*names: str) -> dict[str, str]:
    return dict.fromkeys(names, "float")


METRIC_NAMES = (
    *("eta_m", "sigma_m", "eta_time_m", "sigma_time_m", "completion_time_s", "max_error_m", "cross_track_rmse_m"),
    *("heading_rmse_rad", "fallen", "pitch_rms_rad", "height_rms_m", "torque_max_nm", "torque_saturation_share"),
    *("cost_of_transport", "clearance_min_m", "collisions", "following_distance_mean_m", "lateral_drift_m"),
    *("yaw_rate_degps", "forward_m", "expanded_total", "generated_total", "expanded_mean", "ratio_to_astar"),
    *("fallback_share", "suboptimality_mean", "success_rate", "uwb_rmse_m", "uwb_bias_m", "uwb_residual_m"),
    *("ate_rmse_m", "rpe_rmse_m", "realtime_factor"),
)

COST_NAMES = ("wall_s", "cpu_s", "peak_memory_mb", "input_bytes")
"""What the replay of a recording in a batch took, as far as it is a number."""

_TORQUES = tuple(f"tau_{joint:02d}_nm" for joint in range(12))
_FORCES = tuple(f"fz_{leg}_n" for leg in range(4))

_PLANS = _schema(
    t_ns="int",
    planner="text",
    found="bool",
    expanded="int",
    generated="int",
    cost="float",
    length_m="float",
    optimal_cost="float",
    from_scratch="bool",
    reused_cells="int",
    **_floats("start_x_m", "start_y_m", "goal_x_m", "goal_y_m"),
    goal_projected="bool",
    us="float",
)
_PATHS = _schema(t_ns="int", i="int", **_floats("x_m", "y_m", "smooth_x_m", "smooth_y_m"))

TABLES: dict[str, pa.Schema] = {
    "fixes": _schema(
        t_ns="int",
        tag="int",
        **_floats("x_m", "y_m", "z_m", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2"),
        n_ranges="int",
        residual_rms_m="float",
        outlier="bool",
    ),
    "ranges": _schema(t_ns="int", tag="int", anchor="int", **_floats("range_m", "predicted_m", "weight")),
    "links": _schema(
        tag="int",
        anchor="int",
        **_floats("x_m", "y_m", "z_m"),
        n="int",
        **_floats("residual_rms_m", "residual_median_m", "bias_m", "bias_std_m"),
        bias_applied="bool",
        why_not="text",
        **_floats("nlos_share", "weak_first_path_share"),
    ),
    "uwb_errors": _schema(t_ns="int", tag="int", source="text", **_floats("error_x_m", "error_y_m", "bound_m")),
    "poses": _schema(t_ns="int", **_floats("x_m", "y_m", "yaw_rad"), source="text"),
    "pose_uncertainty": _schema(t_ns="int", **_floats("cov_xx_m2", "cov_xy_m2", "cov_yy_m2", "yaw_std_rad")),
    "target": _schema(t_ns="int", **_floats("x_m", "y_m"), source="text"),
    "scans": _schema(
        **dict.fromkeys(("t_ns", "n_raw", "n_valid", "n_outlier", "n_ground", "n_obstacle"), "int"),
        **_floats("ground_nx", "ground_ny", "ground_nz", "ground_d_m"),
        ground_found="bool",
        ms="float",
    ),
    "plans": _PLANS,
    "paths": _PATHS,
    "astar": _schema(t_ns="int", expanded="int"),
    "resim_plans": _PLANS,
    "resim_paths": _PATHS,
    "control": _schema(
        t_ns="int",
        **_floats("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad", "vx_mps", "vy_mps", "yaw_rate_radps"),
        **_floats("ref_x_m", "ref_y_m", "error_m", "cross_track_m", "time_error_m", "heading_error_rad"),
        **_floats("lookahead_m", "k_v", "k_w", "cmd_v_mps", "cmd_yaw_rate_radps", *_TORQUES, *_FORCES),
        fallen="bool",
    ),
    "clearances": _schema(t_ns="int", **_floats("clearance_m", "target_distance_m")),
    "summary": _schema(
        recording="text", exit_code="int", reason="text", **_floats(*METRIC_NAMES, *COST_NAMES), worker="text"
    ),
}

# May be left out when writing, and are then null throughout: not every planner
# knows the optimum, a kinematic robot has no torques, a run has not every metric.
OPTIONAL = frozenset({"optimal_cost", "k_v", "k_w", *_TORQUES, *_FORCES, *METRIC_NAMES, *COST_NAMES, "worker"})

UNBOUNDED = frozenset({"clearance_m", "bias_std_m", "bound_m", "yaw_std_rad", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2"})
"""Columns in which infinity has a meaning: nothing near, or nothing known. Elsewhere it is damage."""

# Tables of before may lack these: read, they are NaN or empty.
ADDED = {"summary": frozenset({*COST_NAMES, "worker"})}
