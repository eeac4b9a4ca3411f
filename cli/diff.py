"""`quadlog diff`: whether two runs give the same results, and where they part."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click

from quadlog.cli.terminal.parameters import PLACE, examples

_AMOUNT = click.FloatRange(min=0)


@click.command(
    name="diff",
    short_help="Where two runs part: stage, instant, column, and by how much.",
    epilog=examples(
        "quadlog diff runs/before runs/after",
        "quadlog diff runs/before runs/after --tolerance 1e-6 --json",
    ),
)
@click.argument("run_a", metavar="RUN_A", type=PLACE)
@click.argument("run_b", metavar="RUN_B", type=PLACE)
@click.option("--tolerance", metavar="X", type=_AMOUNT, default=0.0, help="Numbers no further apart are the same.")
@click.option("--relative", metavar="X", type=_AMOUNT, default=0.0, help="Nor those apart by X of the larger one.")
@click.option("--json", "as_json", is_flag=True, help="All of it as one JSON object on stdout.")
def command(run_a: Path, run_b: Path, tolerance: float, relative: float, as_json: bool) -> int:
    """Compare two run folders: how they were made, then stage by stage what they saved.

    For every stage, in order, each table whose values differ is named, with the first instant of each column that
    does, both values, in how many rows, and the largest difference. Rows are matched by their time stamps.

    Exit code 0: every saved result is the same, 4: one is not, 1: no finished run, or a damaged file in it.
    How the runs were made does not count, so that two versions of quadlog can be held to give the same results:
    a config, seed, option, version or input that differs is listed, and the code is still 0 when the results agree.

    Durations are never compared (ms, us, us_*, realtime_factor), nor pages, plots and derived.mcap, which show what
    is compared already. NaN equals NaN. Both tolerances may be given: a number within either is the same.
    """
    import math

    from quadlog.errors import ExitCode, UsageError
    from quadlog.results.compare.diff_text import diff_json, diff_text
    from quadlog.results.compare.differences import Tolerance
    from quadlog.results.compare.run_diff import diff_runs
    from quadlog.results.run.find_runs import runs_here

    if not math.isfinite(tolerance + relative):
        raise UsageError("--tolerance and --relative are finite numbers")
    with runs_here([run_a, run_b]) as found:
        here_a, here_b = found
        runs = diff_runs(here_a, here_b, Tolerance(tolerance, relative))
        runs = replace(runs, a=found.as_given(runs.a), b=found.as_given(runs.b))
    if as_json:
        click.echo(json.dumps(diff_json(runs), indent=2, allow_nan=False))
    else:
        click.echo(diff_text(runs), nl=False)
    return ExitCode.DONE if runs.same else ExitCode.CHECK_FAILED
