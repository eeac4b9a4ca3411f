"""What a metric means, and when runs were at their worst by it, as text for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.text import printable


@dataclass(frozen=True, slots=True)
class Instant:
    """When, since when the run started, and the sample then."""

    t_ns: int
    since_start_s: float
    value: float


@dataclass(frozen=True, slots=True)
class RunAtWorst:
    """A run's value and its worst instants, the worst first; why there are none, where there are none."""

    label: str
    value: float | None
    n: int
    instants: Sequence[Instant]
    why_none: str = ""


def explain_text(name: str, runs: Sequence[RunAtWorst]) -> str:
    """Meaning, formula, source, unit and what n counts; then each run. The metric has to be one of the catalogue."""
    entry = CATALOGUE[name]
    facts = [
        ("formula", entry.formula),
        ("source", entry.source),
        ("unit", entry.unit or "none"),
        ("n counts", entry.counted),
    ]
    lines = [f"{name}: {entry.meaning}", *(f"  {title:<9} {what}" for title, what in facts)]
    for run in runs:
        lines += ["", *_run_lines(run, entry.unit)]
    return "\n".join(lines) + "\n"


def _run_lines(run: RunAtWorst, unit: str) -> list[str]:
    if run.value is None:
        return [f"{printable(run.label)}: has no such metric"]
    title = f"{printable(run.label)}: {run.value:.6g} {unit}".rstrip() + f", n = {run.n}"
    if not run.instants:
        return [f"{title}; {run.why_none}"]
    rows = [(str(each.t_ns), f"{each.since_start_s:.3f}", f"{each.value:.6g}") for each in run.instants]
    cells = [("t_ns", "s from start", f"sample {unit}".rstrip()), *rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        f"{title}; worst, at least 1 s apart:",
        *("  " + "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells),
    ]
