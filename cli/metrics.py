"""`quadlog metrics`: metrics of saved runs, compared, checked and explained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from quadlog.cli import options
from quadlog.cli.progress import report_skipped, say, show
from quadlog.errors import UsageError

METRIC: dict[str, Any] = {"shell_complete": options.metrics}


@options.command(
    "metrics",
    "runs/walk --explain ate_rmse_m",
    "runs --format csv",
    "runs --reference truth.tum --fail-if 'ate_rmse_m>0.3'",
)
@click.argument("runs", nargs=-1, metavar="RUN...", type=options.PATH_OR_URL)
@click.option("--reference", type=options.LOCAL_PATH, metavar="FILE.tum", help="Ground-truth trajectory.")
@click.option("--t-offset", type=float, default=0.0, metavar="S", help="Added to the runs' time stamps.")
@click.option("--t-max-diff", type=click.FloatRange(0), default=0.01, metavar="S", help="Most between paired poses.")
@click.option("--align", is_flag=True, help="Align each trajectory with the reference first.")
@click.option("--project-to-plane", type=click.Choice(["xy"]), help="Ignore height, roll and pitch.")
@options.FORMAT
@options.repeated("--fail-if", **METRIC, metavar="CONDITION", help="Exit with 4 if it holds, as in 'eta_m>0.3'")
@click.option("--explain", **METRIC, metavar="METRIC", help="Explain a metric; list worst instants.")
def command(
    runs: tuple[Path, ...], reference: Path | None, to: str, fail_if: tuple[str, ...], explain: str | None, **how: Any
) -> int:
    """Print, compare and explain the metrics of runs.

    A RUN is a run folder or a folder of runs; its saved files are read, nothing is written. One run is shown with
    95 % intervals, several side by side and with their mean. json prints a flat object per run, csv a row per run and
    metric, with the statistics of its samples.

    --t-offset and --align are those of evo. A CONDITION is NAME OPERATOR NUMBER with > >= < <= == or !=; a run that
    lacks the metric also fails.
    """
    from quadlog.metrics.catalogue import check_metric, parse_condition

    conditions = [parse_condition(text) for text in fail_if]
    if explain is not None:
        check_metric(explain)
        if to != "table":
            raise UsageError(f"--explain prints text; leave out  --format {to}")
    if not runs and (explain is None or conditions):
        raise UsageError("quadlog metrics needs a RUN, a run folder or a folder of runs; see  quadlog metrics --help")
    from quadlog.pipelines.evaluation.metrics import explain_runs, measure_runs
    from quadlog.pipelines.evaluation.reference import OnTime, Reference
    from quadlog.results.find_runs import MEASURED, RECORDS, runs_here
    from quadlog.results.text import metrics_text
    from quadlog.storage.remote_path import to_path

    if not runs:
        show(explain_runs(str(explain), [], None))
        return 0
    on_time = OnTime(how["t_max_diff"], how["t_offset"], how["align"], how["project_to_plane"] is not None)
    truth = None if reference is None else Reference.read(reference, on_time)
    has_samples = to == "csv"
    report_skipped(runs)
    with runs_here(runs, MEASURED if has_samples or truth or explain else RECORDS) as (found, as_given):
        outcome = measure_runs(found, truth, conditions, has_samples)
        said = () if truth is None else (f"warning: {words}" for words in truth.warnings)
        for line in (*said, *outcome.said, *outcome.problems):
            say(line)
        if explain is None:
            shown = [replace(run, path=to_path(as_given(run.path))) for run in outcome.runs]
            show(metrics_text(shown, to, outcome.differing), to)
        else:
            show(explain_runs(explain, outcome.runs, truth))
    for line in outcome.failing:
        say(f"--fail-if {line}")
    return outcome.exit_code
