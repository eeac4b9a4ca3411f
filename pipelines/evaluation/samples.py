"""The samples behind a run's metrics, as far as its tables hold them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quadlog.errors import QuadlogError
from quadlog.metrics.planning import SEARCH_METRICS, Replans, search_samples
from quadlog.metrics.summary import Samples, finite_samples
from quadlog.metrics.walking import TrackedWalk, clearance_samples, tracking_samples
from quadlog.pipelines.evaluation.reference import (
    OnTime,
    Reference,
    compare_trajectory,
    residual_samples,
    saved_error_samples,
)
from quadlog.results.run.tables import read_table


@dataclass(frozen=True, slots=True)
class _Source:
    """A saved file, the metrics whose samples it holds, and how they are read from it.

    newer: runs are still about that were made before quadlog saved it.
    """

    file: str
    metrics: tuple[str, ...]
    read: Callable[[Path], dict[str, Samples]]
    newer: bool = False


def read_samples(run: Path, wanted: Iterable[str] | None) -> tuple[dict[str, Samples], list[str]]:
    """The samples of the metrics that are wanted, and a line for each file that does not give them.

    With None, of all metrics of which the files alone tell that they apply; a missing file then tells that they do not.
    """
    samples: dict[str, Samples] = {}
    problems: list[str] = []
    names = SELF_EVIDENT if wanted is None else frozenset(wanted)
    for source in _SOURCES:
        may_lack = wanted is None or source.newer
        if names.isdisjoint(source.metrics) or (may_lack and not (run / source.file).is_file()):
            continue
        try:
            found = source.read(run)
        except QuadlogError as error:
            problems.append(str(error))
        else:
            samples |= {name: each for name, each in found.items() if name in names}
    return samples, problems


def _control(run: Path) -> dict[str, Samples]:
    errors = ("error_m", "cross_track_m", "time_error_m", "heading_error_rad", "plan_error_m")
    table = read_table(run, "control", ["t_ns", "tau_00_nm", "fallen", *errors])
    # A robot without joints cannot fall.
    fallen = table["fallen"] if np.isfinite(table["tau_00_nm"]).any() else None
    return tracking_samples(TrackedWalk(table["t_ns"], **{name: table[name] for name in errors}, fallen=fallen))


def _clearances(run: Path) -> dict[str, Samples]:
    table = read_table(run, "clearances")
    distance = finite_samples(table["t_ns"], table["target_distance_m"], "mean")
    return clearance_samples(table["t_ns"], table["clearance_m"]) | {"following_distance_mean_m": distance}


def _plans(run: Path) -> dict[str, Samples]:
    columns = ("t_ns", "found", "expanded", "generated", "cost", "optimal_cost", "from_scratch")
    return search_samples(Replans(**read_table(run, "plans", columns)))


def _own_reference(run: Path) -> dict[str, Samples]:
    return compare_trajectory(run, Reference.read(run / "reference.tum", OnTime(planar=True))).samples


_SOURCES = (
    _Source(
        "control.parquet",
        (
            *("eta_m", "sigma_m", "eta_time_m", "sigma_time_m", "max_error_m", "cross_track_rmse_m"),
            *("heading_rmse_rad", "plan_error_m", "fallen"),
        ),
        _control,
    ),
    _Source(
        "clearances.parquet", ("clearance_min_m", "collisions", "following_distance_mean_m"), _clearances, newer=True
    ),
    _Source("plans.parquet", tuple(name for name in SEARCH_METRICS if name != "ratio_to_astar"), _plans),
    _Source("uwb_errors.parquet", ("uwb_rmse_m", "uwb_bias_m"), saved_error_samples),
    _Source("fixes.parquet", ("uwb_residual_m",), residual_samples),
    _Source("reference.tum", ("ate_rmse_m", "rpe_rmse_m"), _own_reference),
)
SAMPLED = frozenset(name for source in _SOURCES for name in source.metrics)
"""The metrics whose samples a run saves."""
# The others need an incremental planner, or a reference in the frame of the poses, which no table tells.
SELF_EVIDENT = SAMPLED - {"fallback_share", "ate_rmse_m", "rpe_rmse_m"}
