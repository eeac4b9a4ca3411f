"""The stages of a replay, in order, as `--until` takes them and reports show them."""

from __future__ import annotations

from collections.abc import Sequence

STAGES = ("ingest", "position", "filter", "map", "plan", "control", "report")


def stages_until(last: str) -> tuple[str, ...]:
    """The stages up to and including `last`."""
    return STAGES[: STAGES.index(last) + 1]


def reused_words(reused: Sequence[str], last: str) -> str:
    """How many are reused of the stages up to `last`; `ingest` opens the recording every time and is none of them."""
    stages = stages_until(last)[1:]
    names = f": {', '.join(reused)}" if reused else ""
    return f"reused {len(reused)} of {len(stages)} stages{names}"


STAGE_FILES: dict[str, tuple[str, ...]] = {
    "ingest": ("reference.tum",),
    "position": (
        *("fixes.parquet", "ranges.parquet", "links.parquet", "dilution.npz", "poses.parquet"),
        *("pose_uncertainty.parquet", "target.parquet", "uwb_errors.parquet"),
    ),
    "filter": ("scans.parquet", "cloud_samples.npz"),
    "map": ("maps.npz", "ground.npz", "map.pgm", "map.yaml"),
    "plan": ("plans.parquet", "paths.parquet", "astar.parquet"),
    "control": (
        *("resim_plans.parquet", "resim_paths.parquet", "control.parquet", "clearances.parquet", "contacts.parquet"),
    ),
    "report": ("metrics.json", "trajectory.tum"),
}
