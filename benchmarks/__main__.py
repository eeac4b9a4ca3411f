"""`make bench`: every figure with its limit and its floor; ratios are taken within one run.

Nothing here decides whether a change lands: machines differ and are shared.
Read the ratios, run twice, and mind what else the machine was doing.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from benchmarks import (
    batch,
    info,
    metrics,
    perception,
    planning,
    positioning,
    reading,
    remote,
    report,
    startup,
    walking,
)
from benchmarks.figures import print_figures

PARTS = {
    "startup": startup,
    "reading": reading,
    "info": info,
    "remote": remote,
    "positioning": positioning,
    "perception": perception,
    "planning": planning,
    "walking": walking,
    "metrics": metrics,
    "report": report,
    "batch": batch,
}


def main() -> None:
    """Measure every part, or those named (`make bench PARTS=perception`), one table at the end of each."""
    named = sys.argv[1:] or list(PARTS)
    if unknown := sorted(set(named) - set(PARTS)):
        raise SystemExit(f"benchmarks: no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    with tempfile.TemporaryDirectory(prefix="quadlog-bench-") as folder:
        for name in named:
            print_figures(PARTS[name].__doc__ or "", PARTS[name].measure(Path(folder)))


if __name__ == "__main__":
    main()
