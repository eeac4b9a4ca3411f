"""`quadlog compare-planners`: all planners on the same maps, with paired statistics."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from quadlog.cli.terminal import parameters


class Cell(click.ParamType):
    """Column and row of a map cell."""

    name = "COL,ROW"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Two whole numbers, 0 or more."""
        match = re.fullmatch(r"\s*([0-9]{1,9})\s*,\s*([0-9]{1,9})\s*", str(value))
        if match is None:
            self.fail(f"{value!r} is not two whole numbers of 0 or more, as in 12,34", param, ctx)
        return int(match[1]), int(match[2])


@click.command(
    name="compare-planners",
    short_help="Compare planners on the same maps.",
    epilog=parameters.examples(
        "quadlog compare-planners runs/walk",
        "quadlog compare-planners forest:0.2 --preset paper -o comparison",
        "quadlog compare-planners brc202d.map --scen brc202d.map.scen --planner astar",
    ),
)
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, shell_complete=parameters.files("forest:"))
@click.option(
    "--planner",
    "planners",
    multiple=True,
    type=parameters.PlannerName(),
    metavar="NAME",
    help="Planner (astar, …); repeatable. Default: all.",
)
@click.option("--preset", type=click.Choice(["honest", "paper"]), default="honest", help="Baseline.")
@click.option("--costs", type=click.Choice(["integer", "exact"]), help="Steps: 10 and 14, or 1 and √2 (with --scen).")
@click.option("--ties", type=click.Choice(["larger-g", "smaller-g"]), default="larger-g", help="Order of equal f.")
@click.option(
    "--count",
    "counted",
    type=click.Choice(["expanded", "generated", "touched"]),
    metavar="CELLS",
    help="Cells to count: expanded, generated or touched.",
)
@click.option("--corner-cutting", is_flag=True, help="Allow diagonal steps past a blocked cell.")
@click.option("--scen", type=parameters.LOCAL_PATH, help="MovingAI scenario file with queries.")
@click.option("--start-cell", type=Cell(), help="Start cell on a map from a file.")
@click.option("--goal-cell", type=Cell(), help="Goal cell on a map from a file.")
@click.option("--episodes", type=click.IntRange(1, 100_000), default=40, metavar="N", help="Episodes per forest.")
@click.option("--leader", type=parameters.PlannerName(), metavar="NAME", help="Planner that drives in forests.")
@parameters.CONFIG
@parameters.set_option("grid.cell_m=0.2")
@parameters.FORMAT
@click.option("-o", "--output", type=parameters.LOCAL_PATH, help="Folder for tables, plots and a page.")
@parameters.seed_option()
@parameters.FORCE
def command(
    sources: tuple[str, ...],
    config_path: Path | None,
    overrides: tuple[str, ...],
    to: str,
    output: Path | None,
    force: bool,
    ties: str,
    **options: Any,
) -> int:
    """Run planners on the same problems; compare cells, time, cost and length with 95 % intervals.

    A SOURCE is a run folder (its recorded maps), a recording, a MovingAI .map (with --scen, or --start-cell and
    --goal-cell), a ROS map_server .yaml (with --start-cell and --goal-cell, from the lower left), or forest:DENSITY
    (simulated episodes, trees per m²).

    Baseline, --leader and --count are astar, astar and expanded; with --preset paper astar_paper, ia_star, generated.
    """
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.config.file import load_config
    from quadlog.pipelines.comparison.compare import compare
    from quadlog.pipelines.comparison.problems import CompareOptions
    from quadlog.results.planners import format_rows

    config = load_config(config_path, overrides)
    problems = CompareOptions(ties=ties.replace("-", "_"), config=config, **options)
    with open_progress() as progress:
        outcome = compare(sources, problems, output, force, progress)
    words = [*outcome.findings, *outcome.about]
    click.echo(format_rows(outcome.rows, to, words), nl=False)
    if to in ("json", "csv"):
        for line in words:
            click.echo(line, err=True)
    return outcome.exit_code
