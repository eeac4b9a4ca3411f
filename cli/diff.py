"""`quadlog diff`: whether two runs have the same results, and where they differ first."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click

from quadlog.cli.terminal.parameters import AS_JSON, PATH_OR_URL, examples

_AMOUNT = click.FloatRange(min=0)


@click.command(
    name="diff",
    short_help="Where two runs differ first: stage, time, column, and by how much.",
    epilog=examples(
        "quadlog diff runs/before runs/after",
        "quadlog diff runs/before runs/after --tolerance 1e-6 --json",
    ),
)
@click.argument("run_a", metavar="RUN_A", type=PATH_OR_URL)
@click.argument("run_b", metavar="RUN_B", type=PATH_OR_URL)
@click.option("--tolerance", metavar="X", type=_AMOUNT, default=0.0, help="Absolute tolerance.")
@click.option("--relative", metavar="X", type=_AMOUNT, default=0.0, help="Relative tolerance.")
@AS_JSON
def command(run_a: Path, run_b: Path, tolerance: float, relative: float, as_json: bool) -> int:
    """Compare two run folders: how they were made, then the saved results stage by stage.

    For each stage, every table whose values differ is listed: the columns that differ, the time and both values of
    the first difference, the number of rows, and the largest difference. Rows are matched by their time stamps.

    Exit code 0: all saved results are the same, 4: one differs, 1: a run is unfinished, or a file is damaged.
    Differences in config, seed, options, versions and input are listed, but do not change the exit code, so that
    two versions of quadlog can be compared.

    Not compared: durations (ms, us, us_*, realtime_factor), pages, plots and derived.mcap, which repeat what the
    tables hold. NaN equals NaN. With both tolerances, numbers within either of them are the same.
    """
    import math

    from quadlog.errors import ExitCode, UsageError
    from quadlog.results.compare.diff_text import diff_json, diff_text
    from quadlog.results.compare.differences import Tolerance
    from quadlog.results.compare.run_diff import diff_runs
    from quadlog.results.run.find_runs import runs_here

    if not math.isfinite(tolerance + relative):
        raise UsageError("--tolerance and --relative must be finite numbers")
    with runs_here([run_a, run_b]) as found:
        here_a, here_b = found
        runs = diff_runs(here_a, here_b, Tolerance(tolerance, relative))
        runs = replace(runs, a=found.as_given(runs.a), b=found.as_given(runs.b))
    if as_json:
        click.echo(json.dumps(diff_json(runs), indent=2, allow_nan=False))
    else:
        click.echo(diff_text(runs), nl=False)
    return ExitCode.DONE if runs.same else ExitCode.CHECK_FAILED
