"""Recordings that a batch could not replay: they have no run, and only the summary of their folder tells of them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from quadlog.errors import ExitCode, NotARun
from quadlog.results.find_runs import is_run
from quadlog.results.names import run_name
from quadlog.results.tables import has_table, read_table


def failed_recordings(folders: Iterable[Path]) -> dict[Path, str]:
    """Where a run would be in one of the folders, had its replay not failed, and why it did.

    A folder that is a run itself, or without a summary of quadlog's, has none. The summary itself, which a shell's
    `runs/*` names, stands for its folder.
    """
    failed: dict[Path, str] = {}
    for path in folders:
        folder = path.parent if path.name == "summary.parquet" and path.is_file() else path
        if is_run(folder) or not has_table(folder, "summary"):
            continue
        try:
            summary = read_table(folder, "summary", ["recording", "exit_code", "reason"])
        except NotARun:
            continue  # somebody else's file of that name
        for name, code, reason in zip(summary["recording"], summary["exit_code"], summary["reason"], strict=True):
            if code == ExitCode.FAILED and name == run_name(name) and not is_run(folder / name):
                failed[folder / name] = f"{folder / name}: was not replayed: {reason}"
    return failed
