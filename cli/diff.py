"""`quadlog diff`: whether two runs have the same results, and where they differ first."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import AS_JSON, PATH_OR_URL, examples
from quadlog.errors import printable

_AMOUNT = click.FloatRange(min=0)


@click.command(
    name="diff",
    short_help="Find the first difference between two runs.",
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

    The first difference is named by stage, result, column, time and both values; then each column that differs, with
    the number of rows, the first values, and the largest difference. Rows are matched by their time stamps.
    --json prints the list of differences.

    Exit code 0: all saved results are the same, 4: one differs, 1: a run is unfinished, or a file is damaged.
    Differences in config, seed, options, versions and input are listed, but do not change the exit code, so that
    two versions of quadlog can be compared.

    Not compared: durations (ms, us, us_*, realtime_factor), pages, plots and derived.mcap, which repeat what the
    tables hold. NaN equals NaN. With both tolerances, numbers within either of them are the same.
    """
    import math

    from quadlog.errors import ExitCode, UsageError
    from quadlog.results.diff import COLUMNS, COMPARED, diff_runs, diff_text, of_results
    from quadlog.results.find_runs import runs_here
    from quadlog.results.run import Run
    from quadlog.results.text import print_table

    if not math.isfinite(tolerance + relative):
        raise UsageError("--tolerance and --relative must be finite numbers")
    with runs_here([run_a, run_b], COMPARED) as found:
        a, b = map(Run, found)
        differences = diff_runs(a, b, tolerance, relative)
        start_ns = min(a.start_ns, b.start_ns)
    if as_json:
        click.echo(print_table(COLUMNS, differences.to_numpy().tolist(), "json"), nl=False)
    else:
        click.echo(f"A  {printable(run_a)}\nB  {printable(run_b)}\n{diff_text(differences, start_ns)}", nl=False)
    return ExitCode.CHECK_FAILED if len(of_results(differences)) else ExitCode.DONE
