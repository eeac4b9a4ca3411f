"""The run folder: written, read, drawn and exported; and the stages of a replay, which write its files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

STAGE_FILES: dict[str, tuple[str, ...]] = {
    "ingest": ("reference.tum",),
    "position": (
        *("fixes.parquet", "ranges.parquet", "links.parquet", "poses.parquet"),
        *("pose_uncertainty.parquet", "other_poses.parquet", "target.parquet", "uwb_errors.parquet"),
        *("innovations.parquet", "joints.parquet"),
    ),
    "filter": ("scans.parquet", "cloud_samples.npz"),
    "map": ("maps.npz", "ground.npz", "map.pgm", "map.yaml"),
    "plan": ("plans.parquet", "paths.parquet", "astar.parquet"),
    "control": (
        *("resim_plans.parquet", "resim_paths.parquet", "control.parquet", "clearances.parquet", "contacts.parquet"),
    ),
    "report": ("metrics.json", "trajectory.tum", "body.parquet", "gait.parquet"),
}
"""The stages in order, and the files that each writes into the run folder."""

STAGES = tuple(STAGE_FILES)


def stages_until(last: str) -> tuple[str, ...]:
    """The stages up to and including `last`."""
    return STAGES[: STAGES.index(last) + 1]


def reused_words(reused: Sequence[str], last: str) -> str:
    """The number and names of reused stages up to `last`; `ingest` is never reused."""
    stages = stages_until(last)[1:]
    names = f": {', '.join(reused)}" if reused else ""
    return f"reused {len(reused)} of {len(stages)} stages{names}"


def __getattr__(name: str) -> Any:
    """`quadlog.results.load_maps`, imported on first use."""
    if name != "load_maps":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from quadlog.results.arrays import load_maps

    return load_maps
