"""When a run starts: 0 s of every time axis of its."""

from __future__ import annotations

from pathlib import Path

from quadlog.results.tables import has_table, read_table

# The earliest instant of these, so that all figures share one time axis.
TIMED = ("ranges", "fixes", "poses", "target", "scans", "plans", "control")


def start_ns(run: Path) -> int:
    """The earliest instant of all the run's tables, 0 without any. Raises NotARun for a damaged one."""
    columns = [read_table(run, name, ["t_ns"])["t_ns"] for name in TIMED if has_table(run, name)]
    return min((int(t_ns.min()) for t_ns in columns if len(t_ns)), default=0)
