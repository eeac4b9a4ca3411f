"""The samples behind UWB's metrics, from a run's saved tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import ValidationError

from quadlog.config import Config
from quadlog.errors import NotARun
from quadlog.messages import Float, Int
from quadlog.metrics.summary import Samples, finite_samples
from quadlog.pipelines.tag_roles import roles_of
from quadlog.results.run_folder import read_run_json
from quadlog.results.tables import has_table, read_table


def robot_tag_of(run: Path) -> tuple[Config, int | None]:
    """The run's config, and the tag that the robot carried by it; None when there is none. Raises NotARun."""
    try:
        config = Config.model_validate(read_run_json(run).get("config", {}))
    except ValidationError as error:
        raise NotARun(run / "run.json", f"is damaged: config: {error.errors()[0]['msg']}") from error
    name = "ranges" if has_table(run, "ranges") else "fixes"
    tags = np.unique(read_table(run, name, ["tag"])["tag"])
    return config, roles_of(config, [int(tag) for tag in tags]).get("robot")


def residual_samples(run: Path) -> dict[str, Samples]:
    """Of uwb_residual_m, from fixes.parquet: a residual of each fix, which counts as often as it has ranges."""
    _, robot_tag = robot_tag_of(run)
    table = read_table(run, "fixes", ["t_ns", "tag", "residual_rms_m", "n_ranges"])
    used = (table["tag"] == robot_tag) & np.isfinite(table["residual_rms_m"]) & (table["n_ranges"] > 0)
    residuals = Samples(table["t_ns"][used], table["residual_rms_m"][used], "rms", table["n_ranges"][used])
    return {"uwb_residual_m": residuals}


def saved_error_samples(run: Path) -> dict[str, Samples]:
    """Of uwb_rmse_m and uwb_bias_m against the recording's own reference, from uwb_errors.parquet."""
    _, robot_tag = robot_tag_of(run)
    table = read_table(run, "uwb_errors", ["t_ns", "tag", "source", "error_x_m", "error_y_m"])
    own = (table["tag"] == robot_tag) & (table["source"] == "fixes")
    return error_samples(table["t_ns"][own], np.column_stack([table["error_x_m"][own], table["error_y_m"][own]]))


def error_samples(t_ns: Int, error_m: Float) -> dict[str, Samples]:
    """Of uwb_rmse_m and uwb_bias_m, from fix less truth (N, 2), NaN without a truth.

    A bias's samples are the errors in the direction of their mean, whose mean is the mean's length.
    """
    known_m = error_m[np.isfinite(error_m).all(axis=1)]
    mean_m = known_m.mean(axis=0) if len(known_m) else np.zeros(2)
    length_m = float(np.hypot(*mean_m))
    direction = mean_m / length_m if length_m > 0 else np.array([1.0, 0.0])
    distance_m = np.hypot(error_m[:, 0], error_m[:, 1])
    return {
        "uwb_rmse_m": finite_samples(t_ns, distance_m, "rms"),
        "uwb_bias_m": finite_samples(t_ns, error_m @ direction, "mean"),
    }
