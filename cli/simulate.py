"""`quadlog simulate`: a quadruped walks a course in MuJoCo, one run folder per seed."""

from __future__ import annotations

import sys
from typing import Any

import click

from quadlog.cli import options
from quadlog.cli.progress import open_progress, print_json, show
from quadlog.config.controllers import CONTROLLERS
from quadlog.errors import UsageError

TERRAINS = ("flat", "3cm", "6cm")
TROT = "trot-32s"


@options.command("simulate", "s-curve --controller fpmw --seeds 10", "path.csv --terrain 3cm --disturbed --json")
@click.argument("course", metavar="COURSE", shell_complete=options.files("line", "circle", "s-curve", TROT))
@options.controller_option([*CONTROLLERS])
@options.named("--terrain", choices=TERRAINS, what="Ground")
@click.option("--speed", metavar="MPS", type=float, help="Walking speed. Default: 0.6; s-curve: 0.5.")
@click.option("--disturbed", is_flag=True, help="Add pushes, mass and velocity errors, pose noise and lag.")
@options.SEED
@options.SEEDS
@options.CONFIG
@options.set_option("mpc.mu=0.5")
@options.output_option("Folder for the run folders.", "runs")
@options.JOBS
@options.FORCE
@options.NO_PLOTS
@options.AS_JSON
def command(
    course: str, disturbed: bool, seed: int, seeds: int, no_plots: bool, as_json: bool, jobs: int | None, **given: Any
) -> None:
    """Walk a course with a simulated quadruped (MuJoCo).

    A COURSE is line, circle, s-curve (on its own terrain), trot-32s, or a path: a TUM trajectory, or a CSV file with
    the columns x_m and y_m. Each seed has a run folder.

    Controllers: fpmw (fuzzy look-ahead, MPC, whole-body control), fpm (without whole-body control), pmw (fixed
    look-ahead), kinematic (a point without a body), plug-ins. The default terrain is flat. A fall is a result, not an
    error.

    trot-32s has no controller: the joints follow a foot curve. Its runs are OUTPUT/trot-32s/baseline and 3d-curve; its
    keys are simulation.trot.*.
    """
    from quadlog.pipelines.simulation.simulate import DISTURBED_OVERRIDES, SimulateRequest, simulate
    from quadlog.results.text import values_text

    keys = {"controller": "simulation.controller", "terrain": "simulation.terrain", "speed": "pursuit.speed_mps"}
    if course == TROT and (disturbed or any(given[name] is not None for name in keys)):
        raise UsageError(f"{TROT} takes no --controller, --terrain, --speed or --disturbed; see --help")
    given["overrides"] = [*(DISTURBED_OVERRIDES if disturbed else ()), *given["overrides"]]
    config, how = options.configured(given, **keys).config, {"command": ("quadlog", *sys.argv[1:]), **given}
    request = SimulateRequest(course, config, range(seed, seed + seeds), plots=not no_plots, **how)
    with open_progress() as progress:
        runs = simulate(request, jobs, progress)
    if as_json:
        print_json([each.to_dict() for each in runs])
        return
    for name in dict.fromkeys(each.controller for each in runs):
        mine = [each for each in runs if each.controller == name]
        show(f"{mine[0].run.parent}: {mine[0].course}, {name}")
        by_seed = {f"seed {each.seed}": {name: of["value"] for name, of in each.metrics.items()} for each in mine}
        show(values_text(by_seed))
        for each in mine:
            show(f"{each.run / 'report.html'}{': ' + each.ended if each.ended else ''}")
