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
@seed_option()
@click.option(
    "--azimuth-steps",
    type=click.IntRange(min=16, max=MAX_AZIMUTH_STEPS),
    default=1875,
    metavar="N",
    help="Azimuth steps per lidar sweep (16 beams).",
)
@click.option(
    "--body",
    is_flag=True,
    help="Simulate a quadruped on the robot's path; adds /joint_states and foot forces.",
)
@click.option("--config-output", type=LOCAL_PATH, help="Also write the quadlog.toml for its replay.")
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
    """Write a recording with known ground truth: a robot follows a walking person.

    \b
    follow    boxes, walls and trees on flat ground
    forest    trees, saplings and low branches on uneven ground
    corridor  a winding corridor, 2 m wide

    True poses are in the topics /truth/robot/pose and /truth/person/pose.
    """  # noqa: D301 - click reads \b as: keep the lines of this paragraph
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.pipelines.simulation.synthesize import make_recording, synthesize

    recording = make_recording(scenario, seed, duration_s, azimuth_steps, body)
    with open_progress() as progress:
        counts = synthesize(recording, output, container, config_output, force, progress)
    click.echo(f"{output}: {sum(counts.values())} messages, {duration_s:g} s")
    for topic, count in sorted(counts.items()):
        click.echo(f"  {topic}  {count}")
