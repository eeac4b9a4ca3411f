"""`quadlog synthesize`: recordings with known ground truth."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.terminal.parameters import HERE, SEED, examples
from quadlog.simulation.synthetic.registry import SCENARIOS

MAX_DURATION_S = 3600.0
MAX_AZIMUTH_STEPS = 4000


@click.command(
    name="synthesize",
    epilog=examples(
        "quadlog synthesize follow -o walk.mcap --config-output walk.toml",
        "quadlog synthesize forest -o forest.bag --duration 60 --seed 7",
    ),
)
@click.argument("scenario", type=click.Choice(list(SCENARIOS)))
@click.option("-o", "--output", required=True, type=HERE, help="The recording to write.")
@click.option(
    "--format",
    "container",
    type=click.Choice(["mcap", "bag", "db3"]),
    help="Default: what the output's extension says.",
)
@click.option(
    "--duration",
    "duration_s",
    type=click.FloatRange(min=0.1, max=MAX_DURATION_S),
    default=20.0,
    show_default=True,
    help="Seconds recorded.",
)
@click.option(
    "--seed",
    type=SEED,
    default=0,
    show_default=True,
    help="Draws every error, and what stands where in forest and corridor.",
)
@click.option(
    "--azimuth-steps",
    type=click.IntRange(min=16, max=MAX_AZIMUTH_STEPS),
    default=1875,
    show_default=True,
    help="Of one sweep, 16 rays each.",
)
@click.option("--config-output", type=HERE, help="Also write the quadlog.toml that replays the recording.")
@click.option("--force", is_flag=True, help="Overwrite.")
def command(
    scenario: str,
    output: Path,
    container: str | None,
    duration_s: float,
    seed: int,
    azimuth_steps: int,
    config_output: Path | None,
    force: bool,
) -> None:
    """Write a recording with known ground truth.

    A robot follows a walking person; the true poses are in the recording, as
    /truth/robot/pose and /truth/person/pose.

    follow: among boxes, walls and trees, on flat ground.

    forest: between trees, saplings and low branches, over uneven ground.

    corridor: round the bends of a corridor two metres wide.
    """
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.pipelines.simulation.synthesize import make_recording, synthesize

    recording = make_recording(scenario, seed, duration_s, azimuth_steps)
    with open_progress() as progress:
        counts = synthesize(recording, output, container, config_output, force, progress)
    click.echo(f"{output}: {sum(counts.values())} messages, {duration_s:g} s")
    for topic, count in sorted(counts.items()):
        click.echo(f"  {topic}  {count}")
