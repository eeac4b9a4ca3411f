"""`quadlog survey`: positions of UWB anchors from ranges and odometry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from quadlog.cli import options
from quadlog.cli.progress import open_progress, print_json, show, table_lines
from quadlog.errors import ExitCode

COLUMNS = {"id": "anchor", "x_m": "x m", "x_bound_m": "+-", "y_m": "y m", "y_bound_m": "+-", "z_m": "z m"}
COLUMNS |= {"z_bound_m": "+-", "bias_m": "bias m", "bias_bound_m": "+-", "nlos": "NLOS", "n": "ranges", "note": ""}


def anchor_height(text: str) -> tuple[int | None, float]:
    """Anchor id, or None for all others, and its height."""
    name, equals, value = text.rpartition("=")
    try:
        key, height_m = int(name) if equals else None, float(value)
    except ValueError:
        raise click.BadParameter(f"{text!r}: write M or ID=M, as in 2.1 or 4=1.6") from None
    if not abs(height_m) <= 1000:
        raise click.BadParameter(f"{text!r}: a height lies within 1000 m")
    return key, height_m


@options.command(
    "survey",
    "walk.mcap -o anchors.toml",
    "walk.mcap -c quadlog.toml --set topics.position=lidar --json",
    "walk.mcap --anchor-height 2.1 --anchor-height 4=1.6",
)
@click.argument("recording", type=options.PATH_OR_URL)
@options.CONFIG
@options.set_option("topics.position=/mocap/pose")
@options.output_option("Configuration file to write, for `quadlog replay -c`.")
@options.repeated("--anchor-height", "heights", type=anchor_height, metavar="[ID=]M", help="Height above the floor, m")
@options.STAMP
@options.MSG_PATH
@options.AS_JSON
@options.FORCE
def command(
    recording: Path, output: Path | None, heights: tuple[Any, ...], as_json: bool, force: bool, **given: Any
) -> int:
    """Estimate the positions of UWB anchors.

    The position and range bias of every anchor, with 95 % bounds, from the ranges of the robot's tags and any
    odometry: tf, an odometry topic, joints, lidar scans, or the source named by topics.position. Walk a loop of 10 m
    or more, several metres in each direction. The bounds hold on walks whose errors of ranges and odometry are like
    the model's.

    Positions are in the frame base at the first pose, or in map if [[uwb.anchors]] has two anchors or more. Configure
    three to detect an odometry that turns to the wrong side, which mirrors all positions. Anchors without a height
    (of this ID, or of all others) are placed above the tag.

    Exit code 1: the walk does not determine the positions, or the ranges contradict the odometry or the known anchors.
    """
    from quadlog.pipelines.info import write_new
    from quadlog.pipelines.request import ReplayOptions
    from quadlog.pipelines.survey import survey_json, survey_recording, survey_toml
    from quadlog.results.find_runs import refuse_existing
    from quadlog.results.text import percent

    read = [recording, given["config_path"]]
    config = options.configured(given).config
    if output is not None:  # before the recording is read, which may take a while
        refuse_existing(output, force, [*read, Path(config.topics.position)])
    with open_progress() as progress:
        outcome = survey_recording(recording, config, ReplayOptions(**given), dict(heights), progress)
    if output is not None:
        write_new(output, survey_toml(outcome), force=force)
    found = survey_json(outcome)
    if as_json:
        print_json(found)
    else:
        rows = [row | {"nlos": percent(row["nlos_share"]), "note": _note(row)} for row in found["anchors"]]
        show("\n".join(table_lines(rows, COLUMNS)))
    return ExitCode.WITH_LOSS if outcome.losses else ExitCode.DONE


def _note(row: dict[str, Any]) -> str:
    height = "" if row["z_observed"] else "z is as given" if row["z_given"] else "z is a guess"
    return row["why_not"] or ("known" if row["known"] else height)
