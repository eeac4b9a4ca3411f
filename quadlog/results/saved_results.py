"""What each stage of a run saves, and how two runs' files of one name are compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import Any

from quadlog.results.differences import ResultDifference
from quadlog.results.equality import Tolerance
from quadlog.results.file_diffs import (
    compare_dilution,
    compare_ground,
    compare_map_yaml,
    compare_picture,
    compare_samples,
    compare_tum,
)
from quadlog.results.map_diff import compare_maps
from quadlog.results.run_folder import read_metrics
from quadlog.results.schemas import TABLES
from quadlog.results.table_diff import compare_tables
from quadlog.results.table_groups import open_table
from quadlog.results.value_diff import compare_values

STAGE_FILES: dict[str, tuple[str, ...]] = {
    "ingest": ("reference.tum",),
    "position": (
        *("fixes.parquet", "ranges.parquet", "links.parquet", "dilution.npz", "poses.parquet"),
        *("pose_uncertainty.parquet", "target.parquet", "uwb_errors.parquet"),
    ),
    "filter": ("scans.parquet", "cloud_samples.npz"),
    "map": ("maps.npz", "ground.npz", "map.pgm", "map.yaml"),
    "plan": ("plans.parquet", "paths.parquet", "astar.parquet"),
    "control": ("resim_plans.parquet", "resim_paths.parquet", "control.parquet", "clearances.parquet"),
    "report": ("metrics.json", "trajectory.tum"),
}
"""Pictures, pages and derived.mcap are left out: they show nothing that is not in these."""

KEYS: dict[str, tuple[str, ...]] = {
    "fixes": ("t_ns", "tag"),
    "ranges": ("t_ns", "tag", "anchor"),
    "links": ("tag", "anchor"),
    "uwb_errors": ("t_ns", "tag", "source"),
    "paths": ("t_ns", "i"),
    "resim_paths": ("t_ns", "i"),
}
"""The columns that tell a table's rows apart, where it is not t_ns alone."""


def is_timing(name: str) -> bool:
    """Whether a column or metric is a duration, which no two runs share."""
    return name in {"ms", "us", "realtime_factor"} or name.startswith("us_")


def compare_files(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """The file `name` of run folders a and b, which both have. Raises NotARun, TooLarge, UnreadableFile."""
    stem, _, suffix = name.rpartition(".")
    if suffix == "parquet":
        return _compare_parquet(stem, a, b, tolerance)
    return _COMPARERS[name](name, a, b, tolerance)


def _compare_parquet(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    keys = KEYS.get(name, ("t_ns",))
    columns = [column for column in TABLES[name].names if column not in keys and not is_timing(column)]
    with open_table(a, name) as one, open_table(b, name) as other:
        return compare_tables(name, one, other, keys, columns, tolerance)


def _compare_metrics(name: str, a: Path, b: Path, tolerance: Tolerance) -> ResultDifference:
    """Values by the metric's name; of how many samples as `NAME.n` and the unit as `NAME.unit`, where both have it."""
    one, other = (
        {metric: content for metric, content in read_metrics(run).items() if not is_timing(metric)} for run in (a, b)
    )
    both = one.keys() & other.keys()
    return ResultDifference(
        name,
        values=compare_values(_metric_values(one, both), _metric_values(other, both), tolerance),
    )


def _metric_values(metrics: Mapping[str, Mapping[str, Any]], both: Set[str]) -> dict[str, Any]:
    values = {name: metric["value"] for name, metric in metrics.items()}
    return values | {f"{name}.{part}": metrics[name].get(part) for name in both for part in ("n", "unit")}


_COMPARERS: dict[str, Callable[[str, Path, Path, Tolerance], ResultDifference]] = {
    "cloud_samples.npz": compare_samples,
    "dilution.npz": compare_dilution,
    "ground.npz": compare_ground,
    "map.pgm": compare_picture,
    "map.yaml": compare_map_yaml,
    "maps.npz": compare_maps,
    "metrics.json": _compare_metrics,
    "reference.tum": compare_tum,
    "trajectory.tum": compare_tum,
}
