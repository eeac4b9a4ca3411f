"""report.html of a sweep: one page with a table, charts over the values, and all paths on one map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from quadlog.errors import ExitCode
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.page.html import render_page
from quadlog.results.run.names import run_name
from quadlog.results.sweep.charts import overlay, value_charts
from quadlog.results.sweep.summary import Setting, SweepSummary, summarise_sweep
from quadlog.results.sweep.table import PAGE, SweepRow, read_sweep_table, text_of
from quadlog.storage.atomic_write import write_whole

MAX_LINKS = 12
"""Links to runs in a row of the table."""


def write_sweep_page(folder: Path) -> Path:
    """The page of the runs of sweep.parquet. Raises NotARun, CannotWrite."""
    rows = read_sweep_table(folder)
    summary = summarise_sweep(rows)
    content = render_page(
        "sweep.html.jinja",
        scripts=("sort.js",),
        styles=("sweep.css",),
        title=f"{folder.resolve().name}: sweep of {' and '.join(summary.keys) or 'seeds'}",
        tiles=_tiles(summary, rows),
        notes=summary.notes(),
        findings=_findings(summary),
        keys=summary.keys,
        metrics=[(name, CATALOGUE[name].unit) for name in summary.varying],
        constant=[(name, value, CATALOGUE[name].unit) for name, value in summary.constant.items()],
        settings=[_row(folder, summary, number) for number in range(len(summary.settings))],
        told=any(row.reason for row in rows),
        charts=value_charts(summary),
        overlay=overlay(folder, summary.settings),
    )
    write_whole(folder / PAGE, content)
    return folder / PAGE


def _tiles(summary: SweepSummary, rows: Sequence[SweepRow]) -> list[tuple[str, int, str]]:
    """Name, number and kind of state."""
    failed = sum(row.exit_code == ExitCode.FAILED for row in rows)
    lossy = sum(row.exit_code == ExitCode.WITH_LOSS for row in rows)
    counted = [("done", len(rows) - failed - lossy, "good"), ("with loss", lossy, "warn"), ("failed", failed, "bad")]
    return [
        ("combinations", len(summary.settings), ""),
        ("seeds", summary.seeds, ""),
        *(each for each in counted if each[1]),
    ]


def _findings(summary: SweepSummary) -> list[tuple[str, str]]:
    """Each metric that has a best setting, and this setting."""
    return [(name, summary.settings[summary.best[name]].label) for name in summary.varying if name in summary.best]


def _row(folder: Path, summary: SweepSummary, number: int) -> dict[str, Any]:
    setting = summary.settings[number]
    over = {name: summary.over[name][number] for name in summary.varying}
    cells = [
        {
            "mean": each.mean if np.isfinite(each.mean) else None,
            "low": each.low,
            "high": each.high,
            "best": summary.best.get(name) == number,
        }
        for name, each in over.items()
    ]
    failed = sum(row.exit_code == ExitCode.FAILED for row in setting.rows)
    return {
        "values": [text_of(value) for value in setting.values.values()],
        "failed": failed,
        "lossy": sum(row.exit_code == ExitCode.WITH_LOSS for row in setting.rows),
        "runs": len(setting.rows),
        "reason": setting.reason,
        "cells": cells,
        "links": _links(folder, setting),
    }


def _links(folder: Path, setting: Setting) -> list[tuple[str, str]]:
    """Text and relative URL of the first runs: their page where they have one, else their folder."""
    found = []
    for row in setting.rows[:MAX_LINKS]:
        if row.run == run_name(row.run) and (folder / row.run).is_dir():
            page = PAGE if (folder / row.run / PAGE).is_file() else ""
            text = "run" if len(setting.rows) == 1 else str(row.seed)
            found.append((text, f"./{quote(row.run)}/{page}"))
    return found
