"""`make bench`: every figure with its limit and its floor beside it; ratios are taken within one run.

Nothing here decides whether a change lands: machines differ and are shared.
Read the ratios, run twice, and mind what else the machine was doing.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks import perception, positioning, reading, startup
from benchmarks.figures import print_figures


def main() -> None:
    """Measure everything, one table at the end of each part."""
    with tempfile.TemporaryDirectory(prefix="quadlog-bench-") as folder:
        for part in (startup, reading, positioning, perception):
            print_figures(part.__doc__ or "", part.measure(Path(folder)))


if __name__ == "__main__":
    main()
