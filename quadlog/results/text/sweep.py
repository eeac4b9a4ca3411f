"""A sweep as plain text: a line for each combination, with the first of the metrics that differ."""

from __future__ import annotations

from collections.abc import Sequence

from quadlog.errors import ExitCode, printable
from quadlog.results.sweep.summary import summarise_sweep
from quadlog.results.sweep.table import SweepRow, text_of
from quadlog.results.text.markup import aligned
from quadlog.results.text.numbers import significant

MOST_METRICS = 6
BEST = "*"


def sweep_text(rows: Sequence[SweepRow]) -> str:
    """The combinations with up to MOST_METRICS metrics, means over seeds; `*` marks a best by SweepSummary.best."""
    summary = summarise_sweep(rows)
    metrics = summary.varying[:MOST_METRICS]
    lines = [[*summary.keys, "failed", *metrics]]
    for number, setting in enumerate(summary.settings):
        failed = sum(row.exit_code == ExitCode.FAILED for row in setting.rows)
        cells = [
            significant(summary.over[name][number].mean) + (BEST if summary.best.get(name) == number else "")
            for name in metrics
        ]
        values = [printable(text_of(value)) for value in setting.values.values()]
        lines.append([*values, f"{failed}/{len(setting.rows)}", *cells])
    left_out = len(summary.varying) - len(metrics)
    more = [f"and {left_out} more metrics that differ, in report.html"] if left_out > 0 else []
    return "\n".join([*aligned(lines, left=range(len(summary.keys))), *more, *summary.notes()])
