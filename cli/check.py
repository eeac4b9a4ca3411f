"""`quadlog check`: bounds on the metrics of runs, for CI."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click

from quadlog.cli.terminal.parameters import AS_JSON, LOCAL_PATH, PATH_OR_URL, examples, report_skipped


@click.command(
    name="check",
    short_help="Check metrics of runs against bounds, for CI.",
    epilog=examples(
        "quadlog check runs/yesterday --expect bounds.toml --write",
        "quadlog check runs --expect bounds.toml --junit checks.xml",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=PATH_OR_URL)
@click.option("--expect", type=LOCAL_PATH, required=True, metavar="FILE.toml", help="File of bounds.")
@click.option("--write", is_flag=True, help="Propose bounds from the runs and write them to a new FILE.toml.")
@click.option("--junit", type=LOCAL_PATH, metavar="FILE.xml", help="Write JUnit XML, too.")
@AS_JSON
@click.option("--force", is_flag=True, help="Replace FILE.xml; with --write, FILE.toml.")
def command(runs: tuple[Path, ...], expect: Path, write: bool, junit: Path | None, as_json: bool, force: bool) -> int:
    """Check the saved metrics of each RUN, a run folder or a folder of runs, against the bounds in FILE.toml.

    \b
    [default]                                    for every run
    success_rate = { min = 0.99 }
    [recordings.follow]                          for runs of that name
    eta_m = { max = 0.05 }
    following_distance_mean_m = { min = 1.5, max = 2.5 }

    A run is named by its folder. Simulated walks in seed folders are named by the folder above, as in line-fpmw;
    "line-fpmw/seed-000" names a single seed. A bound under a name replaces the bound of [default] on the same
    metric; {} removes it. A check fails if the run lacks the metric, or if no bounds apply to the run.

    --write makes FILE.toml: each metric is bounded on the worse side, or on both where neither is better (uwb_nees,
    uwb_coverage_95), 10 % beyond the worst run of that name (0.01 for shares, 0 for falls and contacts);
    realtime_factor is left out. A bound that accepts a contact or a fall is named on stderr and has a comment. An
    existing file is replaced only with --force.

    Exit code 0: all bounds hold, 4: one does not, 1: a run or FILE.toml cannot be read.
    """  # noqa: D301 - click reads \b as: keep the lines of this paragraph
    from quadlog.errors import ExitCode, UsageError, printable
    from quadlog.pipelines.evaluation.check import check_runs, propose_bounds
    from quadlog.results.check import check_text
    from quadlog.results.find_runs import RECORDS, runs_here

    report_skipped(runs)
    if write and (junit is not None or as_json):
        raise UsageError("--write proposes bounds and checks none: leave out --junit and --json")
    with runs_here(runs, RECORDS) as found:
        if write:
            said = propose_bounds(found, expect, force, lambda text: click.echo(printable(text), err=True))
            for name, count in said.items():
                click.echo(f"{printable(expect)}: {count} bounds for {printable(name)}")
            return ExitCode.DONE
        checks = check_runs(found, expect, junit, force, lambda text: click.echo(printable(text), err=True))
        checks = [replace(check, run=found.as_given(check.run)) for check in checks]
    text = (
        json.dumps([check.to_dict() for check in checks], indent=2, allow_nan=False) + "\n"
        if as_json
        else check_text(checks)
    )
    click.echo(text, nl=False)
    errors = [check.error for check in checks if check.error is not None]
    for error in errors:
        click.echo(f"quadlog: {printable(error)}", err=True)
    if errors:
        return ExitCode.FAILED
    return ExitCode.DONE if all(check.holds for check in checks) else ExitCode.CHECK_FAILED
