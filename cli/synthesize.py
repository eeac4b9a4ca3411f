"""`quadlog synthesize`: recordings with known ground truth."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import FORCE, LOCAL_PATH, examples, seed_option
from quadlog.simulation.synthetic.registry import SCENARIOS

MAX_DURATION_S = 3600.0
MAX_AZIMUTH_STEPS = 4000


@click.command(
    name="synthesize",
    epilog=examples(
        "quadlog synthesize follow -o walk.mcap --config-output walk.toml",
        "quadlog synthesize forest -o forest.bag --duration 60 --seed 7",
        "quadlog synthesize follow -o walk.mcap --body --config-output walk.toml",
    ),
)
@click.argument("scenario", type=click.Choice(list(SCENARIOS)))
@click.option("-o", "--output", required=True, type=LOCAL_PATH, help="Recording to write.")
@click.option(
    "--format",
    "container",
    type=click.Choice(["mcap", "bag", "db3"]),
    help="Container. Default: by the extension of the output.",
)
@click.option(
    "--duration",
    "duration_s",
    type=click.FloatRange(min=0.1, max=MAX_DURATION_S),
    default=20.0,
    metavar="S",
    help="Length of the recording.",
)
@seed_option("Random seed, for sensor errors and the layout of forest and corridor.")
@click.option(
    "--azimuth-steps",
    type=click.IntRange(min=16, max=MAX_AZIMUTH_STEPS),
    default=1875,
    help="Azimuths per lidar sweep, 16 rays each.",
)
@click.option(
    "--body",
    is_flag=True,
    help="Let a simulated quadruped walk the robot's way; adds its joints, torques and foot forces, /joint_states.",
)
@click.option("--config-output", type=LOCAL_PATH, help="Also write the quadlog.toml for replaying it.")
@FORCE
def command(
    scenario: str,
    output: Path,
    container: str | None,
    duration_s: float,
    seed: int,
    azimuth_steps: int,
    body: bool,
    config_output: Path | None,
    force: bool,
) -> None:
    """Write a recording with known ground truth.

    A robot follows a walking person; their true poses are in the topics
    /truth/robot/pose and /truth/person/pose.

    follow: among boxes, walls and trees, on flat ground.

    forest: between trees, saplings and low branches, over uneven ground.

    corridor: through a winding corridor two metres wide.
    """
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.pipelines.simulation.synthesize import make_recording, synthesize

    recording = make_recording(scenario, seed, duration_s, azimuth_steps, body)
    with open_progress() as progress:
        counts = synthesize(recording, output, container, config_output, force, progress)
    click.echo(f"{output}: {sum(counts.values())} messages, {duration_s:g} s")
    for topic, count in sorted(counts.items()):
        click.echo(f"  {topic}  {count}")
