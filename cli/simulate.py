"""`quadlog simulate`: a quadruped walks a course in MuJoCo, one run folder per seed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from quadlog.cli.terminal import parameters
from quadlog.config.controllers import CONTROLLERS

TERRAINS = ("flat", "3cm", "6cm")
TROT = "trot-32s"


def _terrain(_context: click.Context, _option: click.Parameter, terrain: str | None) -> str | None:
    """The terrain as --set takes it: a folder gets a leading ./, so that its name is never read as another value."""
    if terrain is None or terrain in TERRAINS:
        return terrain
    if not Path(terrain).is_dir():
        raise click.BadParameter(f"{terrain!r} is neither one of {', '.join(TERRAINS)} nor a run folder.")
    return terrain if Path(terrain).is_absolute() else f"./{terrain}"


@click.command(
    name="simulate",
    short_help="Walk a course with a simulated quadruped (MuJoCo).",
    epilog=parameters.examples(
        "quadlog simulate s-curve --controller fpmw --seeds 10",
        "quadlog simulate path.csv --terrain 3cm --disturbed --json",
    ),
)
@click.argument("course", metavar="COURSE", shell_complete=parameters.files("line", "circle", "s-curve", TROT))
@parameters.controller_option(*CONTROLLERS)
@click.option(
    "--terrain",
    metavar=f"{'|'.join(TERRAINS)}|RUN",
    callback=_terrain,
    shell_complete=parameters.files(*TERRAINS),
    help="Terrain, or a run folder with a ground map. Default: flat.",
)
@click.option("--speed", "speed_mps", metavar="MPS", type=float, help="Walking speed. Default: 0.6; s-curve: 0.5.")
@click.option("--disturbed", is_flag=True, help="Add pushes, mass and velocity errors, pose noise and lag.")
@parameters.seed_option("First random seed.")
@parameters.seeds_option("Number of walks, one per seed.")
@parameters.CONFIG
@parameters.set_option("mpc.mu=0.5")
@click.option("-o", "--output", type=parameters.LOCAL_PATH, default=Path("runs"), help="Folder for the run folders.")
@parameters.jobs_option("Walks")
@parameters.FORCE
@parameters.AS_JSON
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
    """Walk a course with a simulated quadruped, one run folder per seed.

    A COURSE is line, circle, s-curve (on its own terrain), trot-32s, or a path: a TUM trajectory, or a CSV file with
    the columns x_m and y_m.

    Controllers: fpmw (fuzzy look-ahead, MPC, whole-body control), fpm (without whole-body control), pmw (fixed
    look-ahead), kinematic (a point without a body). A fall is a result, not an error.

    trot-32s has no controller: the joints follow a foot curve. Its runs are OUTPUT/trot-32s/baseline and 3d-curve; its
    keys are simulation.trot.*.
    """
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.config.file import Flag, configure
    from quadlog.pipelines.simulate import DISTURBED_OVERRIDES, SimulateRequest, simulate, trot_32s
    from quadlog.results.text import values_text

    if course == TROT and (controller or terrain or speed_mps is not None or disturbed):
        raise click.UsageError(f"{TROT} takes no --controller, --terrain, --speed or --disturbed; see --help.")

    flags = [
        Flag("--controller", "simulation.controller", controller),
        Flag("--terrain", "simulation.terrain", terrain),
        Flag("--speed", "pursuit.speed_mps", speed_mps),
    ]
    settings = [*(DISTURBED_OVERRIDES if disturbed else ()), *overrides]
    config = configure(config_path, settings, flags=flags).config
    walked, line = range(seed, seed + seeds), ("quadlog", *sys.argv[1:])
    with open_progress() as progress:
        walk = trot_32s if course == TROT else simulate
        runs = walk(SimulateRequest(course, config, walked, output, force, line), jobs, progress)
    if as_json:
        click.echo(json.dumps([each.to_dict() for each in runs], indent=2, allow_nan=False))
        return
    for name in dict.fromkeys(each.controller for each in runs):
        mine = [each for each in runs if each.controller == name]
        click.echo(f"{mine[0].run.parent}: {mine[0].course}, {name}")
        by_seed = {f"seed {each.seed}": {name: of["value"] for name, of in each.metrics.items()} for each in mine}
        click.echo(values_text(by_seed), nl=False)
        for each in mine:
            click.echo(f"{each.run / 'report.html'}{': ' + each.ended if each.ended else ''}")
