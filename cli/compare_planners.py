"""`quadlog compare-planners`: all planners on the same maps, with paired statistics."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from quadlog.cli import options
from quadlog.cli.progress import open_progress, say, show


def cell(text: str) -> tuple[int, int]:
    """Column and row of a map cell: two whole numbers, 0 or more."""
    match = re.fullmatch(r"\s*([0-9]{1,9})\s*,\s*([0-9]{1,9})\s*", text)
    if match is None:
        raise click.BadParameter(f"{text!r} is not two whole numbers of 0 or more, as in 12,34")
    return int(match[1]), int(match[2])


@options.command(
    "compare-planners",
    "runs/walk",
    "forest:0.2 --preset paper -o comparison",
    "brc202d.map --scen brc202d.map.scen --planner astar",
)
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, shell_complete=options.files("forest:"))
@options.planner_option("--planner", "planners", multiple=True, help="Planner (astar, …); repeatable. Default: all.")
@click.option("--preset", type=click.Choice(["honest", "paper"]), default="honest", help="Baseline: A* or the paper's.")
@click.option("--costs", type=click.Choice(["integer", "exact"]), help="Steps: 10 and 14, or 1 and √2 (with --scen).")
@click.option("--ties", type=click.Choice(["larger-g", "smaller-g"]), default="larger-g", help="Order of equal f.")
@options.named("--count", "counted", choices=("expanded", "generated", "touched"), what="Cells", metavar="CELLS")
@click.option("--corner-cutting", is_flag=True, help="Allow diagonal steps past a blocked cell.")
@click.option("--scen", type=options.LOCAL_PATH, help="MovingAI scenario file with queries.")
@click.option("--start-cell", type=cell, metavar="COL,ROW", help="Start cell on a map from a file.")
@click.option("--goal-cell", type=cell, metavar="COL,ROW", help="Goal cell on a map from a file.")
@click.option("--episodes", type=click.IntRange(1, 100_000), default=40, metavar="N", help="Episodes per forest.")
@options.planner_option("--leader", help="Planner that drives in forests.")
@options.CONFIG
@options.set_option("grid.cell_m=0.2")
@options.FORMAT
@options.output_option("Folder for tables and a page.")
@options.SEED
@options.FORCE
def command(sources: tuple[str, ...], to: str, output: Path | None, force: bool, ties: str, **given: Any) -> int:
    """Compare planners on the same maps.

    A SOURCE is a run folder (its recorded maps), a recording, a MovingAI .map (with --scen, or --start-cell and
    --goal-cell), a ROS map_server .yaml (with --start-cell and --goal-cell, from the lower left), or forest:DENSITY
    (simulated episodes, trees per m²).

    Baseline, --leader and --count are astar, astar and expanded; with --preset paper astar_paper, ia_star, generated.
    """
    from quadlog.pipelines.comparison.compare import compare
    from quadlog.pipelines.comparison.sources import CompareOptions
    from quadlog.results.studies.planners import format_rows

    baseline, config = given.pop("preset"), options.configured(given).config
    problems = CompareOptions(preset=baseline, ties=ties.replace("-", "_"), config=config, **given)
    with open_progress() as progress:
        outcome = compare(sources, problems, output, force, progress)
    words = [*outcome.findings, *outcome.about]
    show(format_rows(outcome.rows, to, words), to)
    for line in words if to in ("json", "csv") else ():
        say(line)
    return outcome.exit_code
