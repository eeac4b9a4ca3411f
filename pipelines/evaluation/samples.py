"""The samples behind a run's metrics, from its saved tables: read by the replay itself and by `quadlog metrics`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadlog.errors import QuadlogError
from quadlog.geometry import interpolate_poses
from quadlog.metrics.alignment import track_difference_samples
from quadlog.metrics.planning import search_samples
from quadlog.metrics.positioning import ellipse_samples, residual_samples
from quadlog.metrics.reference_offset import TRAJECTORY_METRICS
from quadlog.metrics.summary import Samples, finite_samples
from quadlog.metrics.walking import body_samples, clearance_samples, speed_difference, tracking_samples
from quadlog.pipelines.evaluation import reference as references
from quadlog.pipelines.evaluation.body import logged_body, resimulated_body
from quadlog.results.tables import BODY_COLUMNS, read_table

_BOTH_TRACKS = ("poses", "other_poses")
_COMPARED_GAP_S = 0.5
# torque_max_nm of a simulated body is that of all its ticks, which are not saved.
OF_BODIES = ("torque_max_nm", "torque_rms_nm", "duty_factor", "stride_frequency_hz")
LOGGED = "logged_"


class _Run:
    """A run folder, and what several sources need of it, each read once and only when it is needed."""

    def __init__(self, path: Path, robot: references.RobotTag | None) -> None:
        self.path, self._known_robot = path, robot

    @cached_property
    def robot(self) -> references.RobotTag:
        return references.robot_tag_of(self.path) if self._known_robot is None else self._known_robot

    @cached_property
    def reference(self) -> references.Reference:
        """The recording's own."""
        return references.Reference.read(self.path / "reference.tum", references.OnTime(planar=None))


class _Source(NamedTuple):
    """Saved files, the metrics whose samples they hold, and how they are read from them."""

    files: tuple[str, ...]
    metrics: tuple[str, ...]
    read: Callable[[_Run], dict[str, Samples]]


def read_samples(
    run: Path, wanted: Iterable[str], robot: references.RobotTag | None = None
) -> tuple[dict[str, Samples], list[QuadlogError]]:
    """The samples of the wanted metrics, as far as their files are there, and an error for each damaged file.

    robot: the robot's tag; None reads it from the finished run.
    """
    samples: dict[str, Samples] = {}
    errors: list[QuadlogError] = []
    names, saved = frozenset(wanted), _Run(run, robot)
    for source in _SOURCES:
        is_complete = all((run / file).is_file() for file in source.files)
        if names.isdisjoint(source.metrics) or not is_complete:
            continue
        try:
            found = source.read(saved)
        except QuadlogError as error:
            errors.append(error)
        else:
            samples |= {name: found[name] for name in source.metrics if name in names and name in found}
    return samples, errors


def _residuals(run: _Run) -> dict[str, Samples]:
    fixes = read_table(run.path, "fixes", ["t_ns", "tag", "residual_rms_m", "n_ranges"])
    own = fixes["tag"] == run.robot.id
    return residual_samples(*(fixes[name][own] for name in ("t_ns", "residual_rms_m", "n_ranges")))


def _innovations(run: _Run) -> dict[str, Samples]:
    table = read_table(run.path, "innovations", ["t_ns", "tag", "nis"])
    own = table["tag"] == run.robot.id
    return {"uwb_nis": finite_samples(table["t_ns"][own], table["nis"][own], "mean")}


def _ellipses(run: _Run) -> dict[str, Samples]:
    table = read_table(run.path, "uwb_errors", ["t_ns", "tag", "source", "error_x_m", "error_y_m", "bound_m"])
    own = (table["tag"] == run.robot.id) & (table["source"] == "track")
    t_ns, x_m, y_m, bound_m = (table[name][own] for name in ("t_ns", "error_x_m", "error_y_m", "bound_m"))
    return ellipse_samples(t_ns, np.column_stack([x_m, y_m]), bound_m)


def _lidar_against_uwb(run: _Run) -> dict[str, Samples]:
    columns = ["t_ns", "x_m", "y_m", "yaw_rad", "source"]
    tracks = {str(each["source"][0]): each for each in (read_table(run.path, name, columns) for name in _BOTH_TRACKS)}
    if tracks.keys() != {"lidar", "uwb"}:
        return {}
    (t_ns, lidar_m), (uwb_ns, uwb_m) = (
        (track["t_ns"], np.column_stack([track["x_m"], track["y_m"]])) for track in (tracks["lidar"], tracks["uwb"])
    )
    at_scans_m, _, _ = interpolate_poses(t_ns, uwb_ns, uwb_m, tracks["uwb"]["yaw_rad"], _COMPARED_GAP_S)
    return track_difference_samples(t_ns, lidar_m, at_scans_m)


def _plans(run: _Run) -> dict[str, Samples]:
    columns = ("t_ns", "found", "expanded", "generated", "cost", "optimal_cost", "from_scratch")
    return search_samples(read_table(run.path, "plans", columns))


def _control(run: _Run) -> dict[str, Samples]:
    errors = ("error_m", "cross_track_m", "time_error_m", "heading_error_rad", "plan_error_m")
    table = read_table(run.path, "control", ["t_ns", "tau_00_nm", *BODY_COLUMNS, *errors])
    if not np.isfinite(table["tau_00_nm"]).any():
        del table["fallen"]  # a robot without joints cannot fall
    return tracking_samples(table)


def _speed_difference(run: _Run) -> dict[str, Samples]:
    walk = read_table(run.path, "control", ["t_ns", "x_m", "y_m", "cmd_vy_mps"])
    poses = read_table(run.path, "poses", ["t_ns", "x_m", "y_m", "source"])
    by_commands = np.isfinite(walk["cmd_vy_mps"]).any()  # others had another way than the log
    return {"speed_difference_rms_mps": speed_difference(walk, poses)} if by_commands else {}


_SOURCES = (
    _Source(
        ("fixes.parquet", "reference.tum"),
        ("uwb_rmse_m", "uwb_bias_m"),
        lambda run: references.compare_fixes(run.path, run.reference, run.robot),
    ),
    _Source(("fixes.parquet",), ("uwb_residual_m",), _residuals),
    _Source(("innovations.parquet",), ("uwb_nis",), _innovations),
    _Source(("uwb_errors.parquet",), ("uwb_nees", "uwb_coverage_95"), _ellipses),
    _Source(
        ("reference.tum",),
        TRAJECTORY_METRICS,
        lambda run: references.compare_trajectory(run.path, run.reference).samples,
    ),
    _Source(("other_poses.parquet",), ("lidar_uwb_rmse_m",), _lidar_against_uwb),
    _Source(
        ("plans.parquet",),
        ("expanded_total", "generated_total", "expanded_mean", "success_rate", "fallback_share", "suboptimality_mean"),
        _plans,
    ),
    _Source(
        ("control.parquet",),
        (
            *("eta_m", "sigma_m", "eta_time_m", "sigma_time_m", "max_error_m", "cross_track_rmse_m"),
            *("heading_rmse_rad", "plan_error_m", "fallen", "force_error_rms_n", "us_step_median", "us_step_p95"),
        ),
        _control,
    ),
    _Source(("control.parquet", "poses.parquet"), ("speed_difference_rms_mps",), _speed_difference),
    _Source(
        ("clearances.parquet",),
        ("clearance_min_m", "collisions", "following_distance_mean_m"),
        lambda run: clearance_samples(**read_table(run.path, "clearances")),
    ),
    _Source(
        ("joints.parquet", "poses.parquet"),
        tuple(LOGGED + name for name in OF_BODIES),
        lambda run: body_samples(logged_body(run.path), LOGGED),
    ),
    # Without a logged body there is nothing to compare it with.
    _Source(
        ("joints.parquet", "control.parquet"),
        OF_BODIES[1:],
        lambda run: {} if (body := resimulated_body(run.path)) is None else body_samples(body),
    ),
)
SAMPLED = frozenset(name for source in _SOURCES for name in source.metrics)
"""The metrics whose samples a run saves."""
