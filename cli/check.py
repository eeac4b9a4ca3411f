"""`quadlog check`: bounds on the metrics of runs, for CI."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from quadlog.cli import options
from quadlog.cli.progress import print_json, report_skipped, say, show


@options.command("check", "runs/yesterday --expect bounds.toml --write", "runs --expect bounds.toml --junit checks.xml")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=options.PATH_OR_URL)
@click.option("--expect", type=options.LOCAL_PATH, required=True, metavar="FILE.toml", help="File of bounds.")
@click.option("--write", is_flag=True, help="Propose bounds from the runs and write them to a new FILE.toml.")
@click.option("--junit", type=options.LOCAL_PATH, metavar="FILE.xml", help="Write JUnit XML, too.")
@options.AS_JSON
@click.option("--force", is_flag=True, help="Replace FILE.xml; with --write, FILE.toml.")
def command(runs: tuple[Path, ...], expect: Path, write: bool, junit: Path | None, as_json: bool, force: bool) -> int:
    """Check metrics of runs against bounds, for CI.

    A RUN is a run folder or a folder of runs; nothing is measured again. FILE.toml has:

    \b
    [default]                                    for every run
    success_rate = { min = 0.99 }
    [recordings.follow]                          for runs in folders of that name
    following_distance_mean_m = { min = 1.5, max = 2.5 }

    Simulated walks are named by the folder above their seeds, as in line-fpmw, or by both: "line-fpmw/seed-000". A
    bound under a name replaces that of [default]; {} removes it. A metric that was not measured, and a run without
    bounds, fail.

    --write bounds metrics on the worse side, or on both where neither is better, 10 % beyond the worst run of that
    name (0.01 for shares, 0 for falls and contacts, which are named on stderr if a bound accepts them).

    Exit code 0: all bounds hold, 4: one does not, 1: a run or FILE.toml cannot be read.
    """  # noqa: D301 - click reads \b as: keep the lines of this paragraph
    from quadlog.errors import ExitCode, UsageError, printable
    from quadlog.pipelines.evaluation.metrics import check_runs, propose_bounds
    from quadlog.results.check import check_text
    from quadlog.results.find_runs import RECORDS, runs_here

    report_skipped(runs)
    if write and (junit is not None or as_json):
        raise UsageError("--write proposes bounds and checks none: leave out --junit and --json")
    with runs_here(runs, RECORDS) as (found, as_given):
        if write:
            for name, count in propose_bounds(found, expect, force, say).items():
                click.echo(f"{printable(expect)}: {count} bounds for {printable(name)}")
            return ExitCode.DONE
        checks = check_runs(found, expect, junit, force, say)
        checks = [replace(check, run=as_given(check.run)) for check in checks]
    if as_json:
        print_json([check.to_dict() for check in checks])
    else:
        show(check_text(checks))
    for error in (errors := [check.error for check in checks if check.error is not None]):
        say(f"quadlog: {error}")
    held = all(check.holds for check in checks)
    return ExitCode.FAILED if errors else ExitCode.DONE if held else ExitCode.CHECK_FAILED
