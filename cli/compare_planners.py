"""`quadlog compare-planners`: every planner on the same recorded maps, with paired statistics."""

from __future__ import annotations

import re
from pathlib import Path

import click

from quadlog.cli.terminal.parameters import HERE, SEED, PlannerName, examples, files

FORMATS = ("table", "json", "csv", "markdown", "latex")


class Cell(click.ParamType):
    """COL,ROW."""

    name = "COL,ROW"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Two whole numbers."""
        match = re.fullmatch(r"\s*([0-9]{1,9})\s*,\s*([0-9]{1,9})\s*", str(value))
        if match is None:
            self.fail(f"{value!r} is not two whole numbers of 0 or more, as in 12,34", param, ctx)
        return int(match[1]), int(match[2])


@click.command(
    name="compare-planners",
    short_help="Every planner on the same maps, paired and with intervals.",
    epilog=examples(
        "quadlog compare-planners runs/walk",
        "quadlog compare-planners forest:0.1 forest:0.2 --preset paper -o comparison",
        "quadlog compare-planners brc202d.map --scen brc202d.map.scen --planner astar --planner ia_star",
    ),
)
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, shell_complete=files("forest:"))
@click.option("--planner", "planners", multiple=True, type=PlannerName(), help="Repeatable. Default: all.")
@click.option("--preset", type=click.Choice(["honest", "paper"]), default="honest", help="Baseline and counting rule.")
@click.option("--costs", type=click.Choice(["integer", "exact"]), help="10/14, or 1 and the root of 2 (with --scen).")
@click.option("--ties", type=click.Choice(["larger-g", "smaller-g"]), default="larger-g", help="Among equal f.")
@click.option(
    "--count",
    "counted",
    type=click.Choice(["expanded", "generated", "touched"]),
    help="What a searched cell is in the ratio. Default: expanded; preset paper: generated.",
)
@click.option("--corner-cutting", is_flag=True, help="A diagonal step may pass a blocked cell.")
@click.option("--scen", type=HERE, help="Queries for a MovingAI .map.")
@click.option("--start-cell", type=Cell(), help="On a map in a file.")
@click.option("--goal-cell", type=Cell(), help="On a map in a file.")
@click.option("--episodes", type=click.IntRange(1, 100_000), default=40, help="Walks through each forest.")
@click.option("--leader", type=PlannerName(), help="Walks the forests. Default: astar; preset paper: ia_star.")
@click.option("-c", "--config", "config_path", type=HERE, help="For recordings and ROS maps.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="One key of the config; repeatable.")
@click.option("--format", "to", type=click.Choice(FORMATS), default="table", help="On stdout.")
@click.option("-o", "--output", type=HERE, help="Folder for tables, plots and a page.")
@click.option("--seed", type=SEED, default=0, help="Draws forests and intervals.")
@click.option("--force", is_flag=True, help="Replace what is there.")
def command(
    sources: tuple[str, ...],
    planners: tuple[str, ...],
    preset: str,
    costs: str | None,
    ties: str,
    counted: str | None,
    corner_cutting: bool,
    scen: Path | None,
    start_cell: tuple[int, int] | None,
    goal_cell: tuple[int, int] | None,
    episodes: int,
    leader: str | None,
    config_path: Path | None,
    overrides: tuple[str, ...],
    to: str,
    output: Path | None,
    seed: int,
    force: bool,
) -> int:
    """Ask every planner the same questions: cells, time, cost and length, paired, with 95 % intervals.

    A SOURCE is a run folder (its recorded maps), a recording, a MovingAI .map (with --scen, or --start-cell and
    --goal-cell), a ROS map_server .yaml (with --start-cell and --goal-cell, from the lower left), or forest:DENSITY
    (simulated walks, trees per m²).
    """
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.config.file import load_config
    from quadlog.pipelines.comparison.compare import compare
    from quadlog.pipelines.comparison.problems import CompareOptions
    from quadlog.results.planner_comparison.tables import format_rows

    options = CompareOptions(
        planners=planners,
        preset=preset,
        costs=costs,
        ties=ties.replace("-", "_"),
        counted=counted,
        leader=leader,
        corner_cutting=corner_cutting,
        scen=scen,
        start_cell=start_cell,
        goal_cell=goal_cell,
        episodes=episodes,
        seed=seed,
        config=load_config(config_path, overrides),
    )
    with open_progress() as progress:
        outcome = compare(sources, options, output, force, progress)
    words = [*outcome.findings, *outcome.about]
    click.echo(format_rows(outcome.rows, to, words), nl=False)
    if to in ("json", "csv"):
        for line in words:
            click.echo(line, err=True)
    return outcome.exit_code
