"""`make bench`: every figure with its limit and its floor; ratios are taken within one run.

Nothing here decides whether a change lands: machines differ and are shared.
Read the ratios, run twice, and mind what else the machine was doing.
"""

from __future__ import annotations

import importlib
import sys
import tempfile
from pathlib import Path

from benchmarks.figures import print_figures

PARTS = ("startup", "reading", "estimators", "perception", "planning", "walking", "saved", "batch")


def main() -> None:
    """Measure every part, or those named (`make bench PARTS=perception`)."""
    named = sys.argv[1:] or PARTS
    if unknown := sorted(set(named) - set(PARTS)):
        raise SystemExit(f"benchmarks: no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    for name in named:
        part = importlib.import_module(f"benchmarks.{name}")
        with tempfile.TemporaryDirectory(prefix="quadlog-bench-") as folder:
            print_figures(part.__doc__ or "", part.measure(Path(folder)))


if __name__ == "__main__":
    main()
