"""`quadlog check`: bounds on the metrics of runs, for CI."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click

from quadlog.cli.terminal.parameters import HERE, PLACE, examples, say_skipped


@click.command(
    name="check",
    short_help="Hold the metrics of runs to bounds, for CI.",
    epilog=examples(
        "quadlog check runs/yesterday --expect bounds.toml --write",
        "quadlog check runs --expect bounds.toml --junit checks.xml",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=PLACE)
@click.option("--expect", type=HERE, required=True, metavar="FILE.toml", help="The bounds.")
@click.option("--write", is_flag=True, help="Propose bounds from the runs, and write them to FILE.toml.")
@click.option("--junit", type=HERE, metavar="FILE.xml", help="Also as JUnit XML.")
@click.option("--json", "as_json", is_flag=True, help="As a JSON list on stdout, one object per run.")
@click.option("--force", is_flag=True, help="Replace FILE.xml; with --write, replace the runs' bounds in FILE.toml.")
def command(runs: tuple[Path, ...], expect: Path, write: bool, junit: Path | None, as_json: bool, force: bool) -> int:
    """Hold the saved metrics of each RUN, a run folder or a folder of them, to the bounds in FILE.toml.

    \b
    [default]                                    for every run
    success_rate = { min = 0.99 }
    [recordings.follow]                          for runs of that name
    eta_m = { max = 0.05 }
    following_distance_mean_m = { min = 1.5, max = 2.5 }

    NAME is the name of the run's folder; where that is a walk's seed it is the folder above, as in line-fpmw, or
    "line-fpmw/seed-000" for one seed. A bound under a name replaces that of [default] for this metric; {} takes it
    away. A bound on a metric that a run does not have does not hold, and neither does a run of which nothing is
    expected.

    --write bounds each metric on the side that is worse, a tenth beyond the worst run of that name (0.01 for shares,
    nothing for counts), and leaves realtime_factor out. An existing file is changed only with --force, and then
    keeps its comments and every other bound.

    Exit code 0: all bounds hold, 4: one does not, 1: a run or FILE.toml cannot be read.
    """  # noqa: D301 - click takes this for a paragraph whose lines stay
    from quadlog.errors import ExitCode, UsageError, printable
    from quadlog.pipelines.evaluation.check import check_runs, propose_bounds
    from quadlog.results.compare.check_text import check_json, check_text
    from quadlog.results.run.find_runs import RECORDS, runs_here

    say_skipped(runs)
    if write:
        if junit is not None or as_json:
            raise UsageError("--write proposes bounds and checks none: leave out --junit and --json")
        with runs_here(runs, RECORDS) as found:
            proposed = propose_bounds(found, expect, force)
        for name, count in proposed.items():
            click.echo(f"{printable(expect)}: {count} bounds for {printable(name)}")
        return ExitCode.DONE
    with runs_here(runs, RECORDS) as found:
        checks = check_runs(found, expect, junit, force, lambda text: click.echo(printable(text), err=True))
        checks = [replace(check, run=found.as_given(check.run)) for check in checks]
    click.echo(
        json.dumps(check_json(checks), indent=2, allow_nan=False) + "\n" if as_json else check_text(checks), nl=False
    )
    errors = [check.error for check in checks if check.error is not None]
    for error in errors:
        click.echo(f"quadlog: {printable(error)}", err=True)
    if errors:
        return ExitCode.FAILED
    return ExitCode.DONE if all(check.holds for check in checks) else ExitCode.CHECK_FAILED
