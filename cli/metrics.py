"""`quadlog metrics`: the metrics of saved runs, compared, checked and explained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from quadlog.cli.terminal.parameters import HERE, PLACE, examples, say_skipped

FORMATS = ("table", "json", "csv", "markdown", "latex")


@click.command(
    name="metrics",
    short_help="The metrics of runs, compared, checked and explained.",
    epilog=examples(
        "quadlog metrics runs/walk --explain ate_rmse_m",
        "quadlog metrics runs --format csv",
        "quadlog metrics runs --reference truth.tum --fail-if 'ate_rmse_m>0.3'",
    ),
)
@click.argument("runs", nargs=-1, metavar="RUN...", type=PLACE)
@click.option("--reference", type=HERE, metavar="FILE.tum", help="A trajectory that counts as true.")
@click.option("--t-offset", type=float, default=0.0, metavar="S", help="Added to the runs' times (evo's --t_offset).")
@click.option("--t-max-diff", type=click.FloatRange(min=0), default=0.01, metavar="S", help="Of a pair of poses.")
@click.option("--align", is_flag=True, help="Move each trajectory onto the reference first (evo's --align).")
@click.option("--project-to-plane", type=click.Choice(["xy"]), help="Compare without heights, roll and pitch.")
@click.option("--format", "to", type=click.Choice(FORMATS), default="table", help="On stdout.")
@click.option("--fail-if", "fail_if", multiple=True, metavar="CONDITION", help="Exit 4 if it holds: 'eta_m>0.3'.")
@click.option("--explain", metavar="METRIC", help="What it means, and when each run was at its worst.")
def command(
    runs: tuple[Path, ...],
    reference: Path | None,
    t_offset: float,
    t_max_diff: float,
    align: bool,
    project_to_plane: str | None,
    to: str,
    fail_if: tuple[str, ...],
    explain: str | None,
) -> int:
    """Print every metric of the runs RUN, from their saved files alone; nothing is written.

    A RUN is a run folder, or a folder of them. One run is shown with the scatter of its samples, several side by side
    with the spread between them; json is a flat object per run, csv a row per run and metric.

    A CONDITION is NAME OPERATOR NUMBER, with > >= < <= == or !=. A run that lacks the metric fails it, too.
    """
    from quadlog.errors import UsageError
    from quadlog.metrics.conditions import check_metric, parse_condition

    conditions = [parse_condition(text) for text in fail_if]
    if explain is not None:
        check_metric(explain)
    if not runs and explain is None:
        raise UsageError("quadlog metrics needs a RUN, a run folder or a folder of them; see  quadlog metrics --help")
    if not runs and conditions:
        raise UsageError("--fail-if needs a RUN")
    if explain is not None and to != "table":
        raise UsageError(f"--explain prints text; leave out  --format {to}")
    if not runs:
        from quadlog.results.text.metrics import explain_text

        click.echo(explain_text(str(explain), []), nl=False)
        return 0
    from quadlog.errors import printable
    from quadlog.pipelines.evaluation.metrics import measure_runs
    from quadlog.pipelines.evaluation.reference import OnTime, Reference
    from quadlog.results.run.find_runs import MEASURED, runs_here
    from quadlog.results.text.metrics import format_metrics
    from quadlog.storage.remote_path import to_path

    how = OnTime(t_max_diff, t_offset, align, project_to_plane is not None)
    truth = None if reference is None else Reference.read(reference, how)
    say_skipped(runs)
    with runs_here(runs, MEASURED) as found:
        outcome = measure_runs(found, truth, conditions, in_detail=True if to == "csv" else None)
        for line in (*outcome.said, *outcome.problems):
            click.echo(printable(line), err=True)
        if explain is None:
            shown = [replace(run, path=to_path(found.as_given(run.path))) for run in outcome.runs]
            click.echo(format_metrics(shown, outcome.spreads, to), nl=False)
        else:
            from quadlog.pipelines.evaluation.metrics import explain_runs

            click.echo(explain_runs(explain, outcome.runs, truth), nl=False)
    for line in outcome.failing:
        click.echo(f"--fail-if {printable(line)}", err=True)
    return outcome.exit_code
