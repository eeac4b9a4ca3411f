"""`quadlog diff`: whether two runs have the same results, and where they differ first."""

from __future__ import annotations

import math
from pathlib import Path

import click

from quadlog.cli import options
from quadlog.cli.progress import show
from quadlog.errors import ExitCode, UsageError, printable

_AMOUNT = click.FloatRange(min=0)


@options.command("diff", "runs/before runs/after", "runs/before runs/after --tolerance 1e-6 --json")
@click.argument("run_a", metavar="RUN_A", type=options.PATH_OR_URL)
@click.argument("run_b", metavar="RUN_B", type=options.PATH_OR_URL)
@click.option("--tolerance", metavar="X", type=_AMOUNT, default=0.0, help="Absolute tolerance.")
@click.option("--relative", metavar="X", type=_AMOUNT, default=0.0, help="Relative tolerance.")
@options.AS_JSON
def command(run_a: Path, run_b: Path, tolerance: float, relative: float, as_json: bool) -> int:
    """Find the first difference between two runs.

    It is named by stage, result, column, time and both values; then each column that differs, with the number of
    rows, the first values, and the largest difference. Rows are matched by their time stamps. --json prints the list.

    Exit code 0: all saved results are the same, 4: one differs, 1: a run is unfinished, or a file is damaged.
    Differences in config, seed, options, versions and input are listed, but do not change the exit code.

    Durations (ms, us, us_*, realtime_factor), pages, plots and derived.mcap are not compared. NaN equals NaN. With
    both tolerances, numbers within either of them are the same.
    """
    from quadlog.results.diff import COLUMNS, diff_runs, diff_text, of_results
    from quadlog.results.run import load_run
    from quadlog.results.text import print_table

    if not math.isfinite(tolerance + relative):
        raise UsageError("--tolerance and --relative must be finite numbers")
    a, b = load_run(run_a), load_run(run_b)
    differences = diff_runs(a, b, tolerance, relative)
    start_ns = min(a.start_ns, b.start_ns)
    if as_json:
        click.echo(print_table(COLUMNS, differences.to_numpy().tolist(), "json"), nl=False)
    else:
        show(f"A  {printable(run_a)}\nB  {printable(run_b)}\n{diff_text(differences, start_ns)}")
    return ExitCode.CHECK_FAILED if len(of_results(differences)) else ExitCode.DONE
