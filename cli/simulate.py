"""`quadlog simulate`: a quadruped walks a course in MuJoCo, one run folder for each seed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

CONTROLLERS = ("fpmw", "fpm", "pmw", "kinematic")
TERRAINS = ("flat", "3cm", "6cm")
MOST_SEEDS = 1000


@click.command(name="simulate", short_help="Walk a course with a simulated quadruped.")
@click.argument("course", metavar="COURSE")
@click.option("--controller", type=click.Choice(CONTROLLERS), help="Short for --set simulation.controller=NAME.")
@click.option("--terrain", type=click.Choice(TERRAINS), help="Default: flat; the s-curve has its own.")
@click.option("--speed", "speed_mps", metavar="MPS", type=float, help="Default: 0.6; the s-curve 0.5.")
@click.option("--disturbed", is_flag=True, help="Pushes, wrong mass and velocity, a noisy and late pose.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, help="The first; draws ground and disturbances.")
@click.option("--seeds", type=click.IntRange(1, MOST_SEEDS), default=1, metavar="N", help="How many walks.")
@click.option("-c", "--config", "config_path", type=click.Path(path_type=Path), help="A quadlog.toml.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="One key, as in mpc.mu=0.5.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("runs"), help="Where run folders go.")
@click.option("--jobs", type=click.IntRange(min=1), help="Walks at a time; default: the number of cores.")
@click.option("--force", is_flag=True, help="Replace existing runs.")
@click.option("--json", "as_json", is_flag=True, help="Metrics as JSON on stdout.")
def command(
    course: str,
    controller: str | None,
    terrain: str | None,
    speed_mps: float | None,
    disturbed: bool,
    seed: int,
    seeds: int,
    config_path: Path | None,
    overrides: tuple[str, ...],
    output: Path,
    jobs: int | None,
    force: bool,
    as_json: bool,
) -> None:
    """Walk a course with a simulated quadruped, one run folder for each seed.

    A COURSE is line, circle or s-curve [Tracking], or a path: a TUM trajectory, or a CSV file with the columns x_m and
    y_m.

    fpmw steers by the fuzzy look-ahead and walks by MPC and whole-body control, fpm without the latter, pmw with a
    fixed look-ahead; kinematic is a point that does as it is told. A fall is a result, not a failure.
    """
    from quadlog.cli.progress import open_progress
    from quadlog.config_file import load_config
    from quadlog.pipelines.simulate import DISTURBED_OVERRIDES, SimulateRequest, simulate
    from quadlog.results.walks_text import walks_text

    shorthands = [
        ("simulation.controller", controller),
        ("simulation.terrain", terrain),
        ("pursuit.speed_mps", speed_mps),
    ]
    settings = [
        *(DISTURBED_OVERRIDES if disturbed else ()),
        *(f"{key}={value}" for key, value in shorthands if value is not None),
        *overrides,
    ]
    request = SimulateRequest(
        course=course,
        config=load_config(config_path, settings),
        seeds=range(seed, seed + seeds),
        output=output,
        force=force,
        command=("quadlog", *sys.argv[1:]),
    )
    with open_progress() as progress:
        runs = simulate(request, jobs, progress)
    rows = [each.to_dict() for each in runs]
    if as_json:
        click.echo(json.dumps(rows, indent=2, allow_nan=False))
        return
    click.echo(f"{runs[0].run.parent}: {runs[0].course}, {runs[0].controller}")
    click.echo(walks_text(rows), nl=False)
    for each in runs:
        click.echo(f"{each.run / 'report.html'}{': ' + each.ended if each.ended else ''}")
