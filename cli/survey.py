"""`quadlog survey`: positions of UWB anchors from ranges and odometry."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import click

from quadlog.cli.terminal.parameters import (
    AS_JSON,
    CONFIG,
    FORCE,
    LOCAL_PATH,
    MSG_PATH,
    PATH_OR_URL,
    STAMP,
    examples,
    set_option,
)
from quadlog.errors import ExitCode, UsageError

COLUMNS = ("anchor", "x m", "+-", "y m", "+-", "z m", "+-", "bias m", "+-", "NLOS", "ranges", "")


@click.command(
    name="survey",
    short_help="Estimate the positions of UWB anchors.",
    epilog=examples(
        "quadlog survey walk.mcap -o anchors.toml",
        "quadlog survey walk.mcap -c quadlog.toml --set topics.position=lidar --json",
        "quadlog survey walk.mcap --anchor-height 2.1 --anchor-height 4=1.6",
    ),
)
@click.argument("recording", type=PATH_OR_URL)
@CONFIG
@set_option("topics.position=/mocap/pose")
@click.option("-o", "--output", type=LOCAL_PATH, help="Configuration file to write, for `quadlog replay -c`.")
@click.option(
    "--anchor-height",
    "heights",
    multiple=True,
    metavar="[ID=]M",
    help="Height above the floor of anchor ID or of all others, m; repeatable.",
)
@STAMP
@MSG_PATH
@AS_JSON
@FORCE
def command(
    recording: Path,
    config_path: Path | None,
    overrides: tuple[str, ...],
    output: Path | None,
    heights: tuple[str, ...],
    stamp: Literal["header", "log"],
    msg_path: tuple[Path, ...],
    as_json: bool,
    force: bool,
) -> int:
    """Estimate the position and range bias of every UWB anchor, with 95 % bounds.

    Uses the ranges of the robot's tags and any odometry: tf, an odometry topic, joints, lidar scans, or the source
    named by topics.position. Walk a loop of 10 m or more, several metres in each direction. The bounds hold on walks
    whose errors of ranges and odometry are like the model's.

    Positions are in the frame base at the first pose, or in map if [[uwb.anchors]] has two anchors or more. Configure
    three to detect an odometry that turns to the wrong side, which mirrors all positions. Anchors without a known
    height are placed above the tag.

    Exit code 1: the walk does not determine the positions, or the ranges contradict the odometry or the known anchors.
    """
    given = _heights(heights)
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.config.file import load_config
    from quadlog.pipelines.init import write_new
    from quadlog.pipelines.request import ReplayOptions
    from quadlog.pipelines.survey.output import survey_json, survey_toml
    from quadlog.pipelines.survey.survey import survey_recording
    from quadlog.results.find_runs import refuse_existing

    if output is not None:
        refuse_existing(output, force)  # before the recording is read, which may take a while
    config = load_config(config_path, overrides)
    with open_progress() as progress:
        outcome = survey_recording(recording, config, ReplayOptions(stamp=stamp, msg_path=msg_path), given, progress)
    if output is not None:
        write_new(output, survey_toml(outcome), force=force)
    found = survey_json(outcome)
    click.echo(json.dumps(found, indent=2, allow_nan=False) + "\n" if as_json else table_text(found), nl=False)
    return ExitCode.WITH_LOSS if outcome.losses else ExitCode.DONE


def _heights(texts: tuple[str, ...]) -> dict[int | None, float]:
    """Anchor id, or None for all others -> height. Raises UsageError."""
    given: dict[int | None, float] = {}
    for text in texts:
        name, equals, value = text.rpartition("=")
        try:
            key, height_m = int(name) if equals else None, float(value)
        except ValueError:
            raise UsageError(f"--anchor-height {text}: write M or ID=M, as in 2.1 or 4=1.6") from None
        if not abs(height_m) <= 1000:
            raise UsageError(f"--anchor-height {text}: a height lies within 1000 m")
        given[key] = height_m
    return given


def table_text(found: dict[str, Any]) -> str:
    """The object of `survey --json` as a table."""
    from quadlog.results.text import print_table, terminal_width

    return print_table(COLUMNS, [_cells(each) for each in found["anchors"]], width=terminal_width())


def _cells(row: dict[str, Any]) -> list[str]:
    values = [row[f"{name}_{what}"] for name in "xyz" for what in ("m", "bound_m")]
    values += [row["bias_m"], row["bias_bound_m"]]
    share = "" if row["nlos_share"] is None else f"{100 * row['nlos_share']:.0f} %"
    height = "" if row["z_observed"] else "z is as given" if row["z_given"] else "z is a guess"
    note = row["why_not"] or ("known" if row["known"] else height)
    return [str(row["id"]), *("" if each is None else f"{each:.3f}" for each in values), share, str(row["n"]), note]
