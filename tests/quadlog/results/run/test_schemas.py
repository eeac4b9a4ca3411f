"""The contract's columns, written out by hand: these names never change."""

from __future__ import annotations

import pyarrow as pa
import pytest

from quadlog.results.run.tables import TABLES

PLANS = (
    "t_ns planner found expanded generated cost length_m optimal_cost from_scratch reused_cells "
    "start_x_m start_y_m goal_x_m goal_y_m goal_projected us"
)
CONTRACT = {
    "fixes": "t_ns tag x_m y_m z_m cov_xx_m2 cov_xy_m2 cov_yy_m2 n_ranges residual_rms_m outlier",
    "ranges": "t_ns tag anchor range_m predicted_m weight",
    "links": "tag anchor x_m y_m z_m n residual_rms_m residual_median_m bias_m bias_std_m bias_applied why_not "
    "nlos_share weak_first_path_share",
    "uwb_errors": "t_ns tag source error_x_m error_y_m bound_m",
    "poses": "t_ns x_m y_m yaw_rad source",
    "pose_uncertainty": "t_ns cov_xx_m2 cov_xy_m2 cov_yy_m2 yaw_std_rad",
    "target": "t_ns x_m y_m source",
    "scans": "t_ns n_raw n_valid n_outlier n_ground n_obstacle ground_nx ground_ny ground_nz ground_d_m "
    "ground_found ms",
    "plans": PLANS,
    "resim_plans": PLANS,
    "paths": "t_ns i x_m y_m smooth_x_m smooth_y_m",
    "resim_paths": "t_ns i x_m y_m smooth_x_m smooth_y_m",
    "astar": "t_ns expanded",
    "clearances": "t_ns clearance_m target_distance_m",
    "contacts": "t_ns duration_s x_m y_m clearance_m cause collision",
    "control": "t_ns x_m y_m z_m roll_rad pitch_rad yaw_rad vx_mps vy_mps yaw_rate_radps ref_x_m ref_y_m error_m "
    "cross_track_m time_error_m heading_error_rad plan_error_m lookahead_m k_v k_w cmd_v_mps cmd_yaw_rate_radps "
    "tau_00_nm tau_01_nm tau_02_nm tau_03_nm tau_04_nm tau_05_nm tau_06_nm tau_07_nm tau_08_nm tau_09_nm tau_10_nm "
    "tau_11_nm fz_0_n fz_1_n fz_2_n fz_3_n fallen",
    "summary": "recording exit_code reason eta_m sigma_m eta_time_m sigma_time_m completion_time_s max_error_m "
    "cross_track_rmse_m heading_rmse_rad plan_error_m fallen pitch_rms_rad height_rms_m torque_max_nm "
    "torque_saturation_share "
    "cost_of_transport clearance_min_m collisions following_distance_mean_m lateral_drift_m yaw_rate_degps forward_m "
    "expanded_total generated_total expanded_mean ratio_to_astar fallback_share suboptimality_mean success_rate "
    "uwb_rmse_m uwb_bias_m uwb_residual_m ate_rmse_m rpe_rmse_m realtime_factor wall_s cpu_s peak_memory_mb "
    "input_bytes worker",
}
INTEGERS = {"tag", "anchor", "i", "expanded", "generated", "reused_cells", "t_ns", "n_ranges", "exit_code"}
INTEGERS |= {"n_raw", "n_valid", "n_outlier", "n_ground", "n_obstacle", "n"}
FLAGS = {"bias_applied", "outlier", "ground_found", "found", "from_scratch", "goal_projected", "collision"}


def test_there_are_exactly_these_tables() -> None:
    assert set(TABLES) == set(CONTRACT)


@pytest.mark.parametrize("name", CONTRACT)
def test_columns_are_the_contracts(name: str) -> None:
    assert TABLES[name].names == CONTRACT[name].split()


@pytest.mark.parametrize("name", CONTRACT)
def test_types_say_what_a_column_is(name: str) -> None:
    for field in TABLES[name]:
        if field.name in INTEGERS:
            assert (field.type, field.nullable) == (pa.int64(), False), field
        elif field.name in FLAGS or (name == "control" and field.name == "fallen"):
            assert (field.type, field.nullable) == (pa.bool_(), False), field
        elif field.name in {"source", "planner", "recording", "reason", "why_not", "worker"}:
            assert (field.type, field.nullable) == (pa.string(), False), field
        else:
            assert (field.type, field.nullable) == (pa.float64(), True), field
