"""`quadlog synthesize`: recordings with known ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from quadlog.cli import options
from quadlog.cli.progress import open_progress
from quadlog.simulation.synthetic import SCENARIOS

SECONDS = click.FloatRange(min=0.1, max=3600)
STEPS = click.IntRange(min=16, max=4000)


@options.command(
    "synthesize",
    "follow -o walk.mcap --config-output walk.toml",
    "forest -o forest.mcap --duration 60 --seed 7",
    "follow -o walk.mcap --body --config-output walk.toml",
)
@click.argument("scenario", type=click.Choice(list(SCENARIOS)))
@options.output_option("Recording to write.", required=True)
@click.option("--duration", "duration_s", type=SECONDS, default=20.0, metavar="S", help="Length of the recording.")
@options.SEED
@click.option("--azimuth-steps", type=STEPS, default=1875, metavar="N", help="Steps per lidar sweep (16 beams).")
@click.option("--body", is_flag=True, help="Simulate a quadruped on the path; adds /joint_states and foot forces.")
@click.option("--config-output", type=options.LOCAL_PATH, help="Also write the quadlog.toml for its replay.")
@options.FORCE
def command(output: Path, config_output: Path | None, force: bool, **what: Any) -> None:
    """Write a recording with known ground truth.

    A robot follows a walking person among:

    \b
    follow    boxes, walls and trees on flat ground
    forest    trees, saplings and low branches on uneven ground
    corridor  a winding corridor, 2 m wide

    True poses are in the topics /truth/robot/pose and /truth/person/pose.
    """  # noqa: D301 - click reads \b as: keep the lines of this paragraph
    from quadlog.pipelines.simulation.synthesize import make_recording, synthesize

    recording = make_recording(**what)
    with open_progress() as progress:
        counts = synthesize(recording, output, config_output, force, progress)
    click.echo(f"{output}: {sum(counts.values())} messages, {what['duration_s']:g} s")
    for topic, count in sorted(counts.items()):
        click.echo(f"  {topic}  {count}")
