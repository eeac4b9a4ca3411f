"""`quadlog info`: what is in a recording, how regular it is, and how good its ranges are."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from quadlog.cli.terminal.parameters import HERE, PLACE, examples
from quadlog.errors import AmbiguousTopic, ExitCode, printable

COLUMNS = ("topic", "type", "messages", "Hz", "gaps", "offset", "role", "why")
RIGHT = {"messages", "Hz", "gaps", "offset", "tag", "anchor", "ranges", "residual m", "median m", "NLOS", "weak path"}


@click.command(
    name="info",
    short_help="What is in a recording: topics, rates, roles and why, losses.",
    epilog=examples(
        "quadlog info walk.mcap",
        "quadlog info walk.mcap --full -c quadlog.toml",
        "quadlog info s3://lab/walk.mcap --json",
    ),
)
@click.argument("recording", type=PLACE)
@click.option("-c", "--config", "config_path", type=HERE, help="A quadlog.toml.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="One key, as in topics.lidar=/points.")
@click.option("--msg-path", type=HERE, multiple=True, help="Folder of further .msg definitions.")
@click.option(
    "--full", is_flag=True, help="Read every message: all damage, clocks and UWB ranges; check where anchors stand."
)
@click.option("--json", "as_json", is_flag=True, help="Everything as one JSON object.")
def command(
    recording: Path,
    config_path: Path | None,
    overrides: tuple[str, ...],
    msg_path: tuple[Path, ...],
    full: bool,
    as_json: bool,
) -> int:
    """Per topic: type, count, rate, gaps, clock offset, role and why; and what was lost.

    Of a large recording only the index and a sample of the messages are read: counts, rates and gaps are those of
    all messages; clock offsets, UWB ranges and damage are known from the sample alone. --full reads everything.
    """
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.config.file import load_config
    from quadlog.pipelines.info import describe_recording

    config = load_config(config_path, overrides)
    info = describe_recording(recording, config, msg_path, full=full, open_progress=open_progress)
    tell_health(info["warnings"], [(loss["topic"], loss["detail"]) for loss in info["losses"]])
    if as_json:
        click.echo(json.dumps(info, indent=2, allow_nan=False))
    else:
        print_info(info)
    return ExitCode.WITH_LOSS if info["losses"] else ExitCode.DONE


def tell_health(warnings: Iterable[str], losses: Iterable[tuple[str | None, str]]) -> None:
    """One line on stderr for each warning, and for each loss, a topic and what happened."""
    for line in warnings:
        click.echo(f"warning: {printable(line)}", err=True)
    for topic, detail in losses:
        click.echo(f"lost: {printable(f'{topic}: {detail}' if topic else detail)}", err=True)


def print_info(info: dict[str, Any]) -> None:
    """The object of `info --json` for people."""
    click.echo(f"{printable(info['path'])}: {info['messages']} messages{_span(info)}")
    if info["sampled"]:
        click.echo(
            f"sampled: clock offsets, UWB ranges and damage are known from {info['messages_read']} messages alone; "
            "--full reads all"
        )
    rows = [[printable(cell) for cell in _cells(topic)] for topic in info["topics"]]
    if rows:
        _print_table(COLUMNS, rows)
    for role, choices in info["ambiguous"].items():
        click.echo(printable(AmbiguousTopic(role, choices)))
    if info["links"]:
        _print_links(info["links"])
    if info["uwb_tags"]:
        _print_uwb(info)


def _print_links(links: Sequence[dict[str, Any]]) -> None:
    """Who ranges whom, and how far apart they were."""
    click.echo(f"UWB: tags {_ids(links, 'tag')}; anchors {_ids(links, 'anchor')}")
    for line in reach_lines(links):
        click.echo(printable(line))


def _print_uwb(info: dict[str, Any]) -> None:
    """What only a log with known anchors has: its links, its tags, and where the geometry is good."""
    if info["uwb"]:
        click.echo("")
        _print_table(*link_table(info["uwb"]))
    lines = ["", *(line for row in info["uwb_tags"] for line in tag_lines(row))]
    if info["dilution"] is not None:
        lines += ["", *dilution_lines(info["dilution"])]
    for line in lines:
        click.echo(printable(line))


def _span(info: dict[str, Any]) -> str:
    if info["start_ns"] is None:
        return ""
    from quadlog.recordings.formatting import instant

    seconds = (info["end_ns"] - info["start_ns"]) * 1e-9
    return f" in {seconds:.1f} s, {instant(info['start_ns'])} to {instant(info['end_ns'])}"


def _cells(topic: dict[str, Any]) -> list[str]:
    offset = topic["clock_offset_s"]
    return [
        topic["name"],
        topic["type"],
        str(topic["messages"]),
        "" if topic["hz_min"] is None else f"{topic['hz_min']:.4g}..{topic['hz_max']:.4g}",
        str(topic["gaps"] or ""),
        "" if offset is None else f"{offset:+.3f} s",
        topic["role"] or "",
        topic["why"],
    ]


def _ids(links: Sequence[dict[str, Any]], end: str) -> str:
    return ", ".join(str(each) for each in sorted({link[end] for link in links}))


def _print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    if sys.stdout.isatty() and "NO_COLOR" not in os.environ:
        _print_rich(columns, rows)
        return
    widths = [max(len(row[i]) for row in (columns, *rows)) for i in range(len(columns))]
    for row in (columns, *rows):
        cells = [
            cell.rjust(width) if column in RIGHT else cell.ljust(width)
            for column, cell, width in zip(columns, row, widths, strict=True)
        ]
        click.echo("  ".join(cells).rstrip())


def _print_rich(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="bold")
    for column in columns:
        table.add_column(column, justify="right" if column in RIGHT else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)


MOST_LINKS = 40  # as many lines of links as a terminal or two hold
CELL = 6  # characters of a number of the map, with the space before it


def reach_lines(links: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Each link with its count and its shortest and longest range, or as many as fit, and how many more there are."""
    for link in links[:MOST_LINKS]:
        ends = f"  {link['topic']}  tag {link['tag']}  anchor {link['anchor']}  {link['n']} ranges"
        known = link["range_min_m"] is not None
        yield ends + (f"  {link['range_min_m']:.2f}..{link['range_max_m']:.2f} m" if known else "  none a number")
    if len(links) > MOST_LINKS:
        yield f"  and {len(links) - MOST_LINKS} more links, all of them in --json"


def link_table(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Names of the columns and the cells of `uwb`; an estimate is applied or not."""
    columns = ["tag", "anchor", "ranges", "residual m", "median m", "NLOS", "bias m", ""]
    cells = [_link_cells(row) for row in rows]
    if any(row["weak_first_path_share"] is not None for row in rows):
        columns.insert(6, "weak path")
        for row, line in zip(rows, cells, strict=True):
            share = row["weak_first_path_share"]
            line.insert(6, "" if share is None else f"{100 * share:.1f} %")
    return columns, cells


def _link_cells(row: dict[str, Any]) -> list[str]:
    bias = "" if row["bias_m"] is None else f"{row['bias_m']:+.3f} +- {row['bias_std_m']:.3f}"
    return [
        *(str(row[name]) for name in ("tag", "anchor", "n")),
        f"{row['residual_m']:.3f}",
        f"{row['residual_median_m']:+.3f}",
        f"{100 * row['nlos_share']:.1f} %",
        bias,
        "applied" if row["bias_applied"] else "not applied",
    ]


def tag_lines(row: dict[str, Any]) -> Iterator[str]:
    """How good a tag's fixes are by themselves, and against the reference if there is one."""
    name = f"tag {row['tag']}" + (f" ({row['role']})" if row["role"] else "")
    causes = {"with too few ranges": row["too_few_ranges"], "degenerate": row["degenerate"]}
    without = ", ".join(f"{count} {cause}" for cause, count in causes.items() if count)
    line = f"{name}: {row['fixes']} fixes in {row['epochs']} epochs" + (f" ({without})" if without else "")
    if row["fixes"]:
        axes = f"{row['ellipse_major_median_m']:.3f} x {row['ellipse_minor_median_m']:.3f} m"
        line += f"; median HDOP {row['hdop_median']:.2f}, median 95 % semi-axes {axes}"
    yield line
    if row["nis"] is not None:
        yield f"  normalised innovation squared {row['nis']:.2f} per range (1 where uwb.range_std_m is right)"
    yield f"  biases: {row['calibration']}"
    for what, error in (("fixes", row["fix_error"]), ("track", row["track_error"])):
        if error is not None:
            yield (
                f"  {what} against {row['reference']}: RMSE {error['rmse_m']:.3f} m, "
                f"bias ({error['bias_x_m']:+.3f}, {error['bias_y_m']:+.3f}) m, "
                f"{100 * error['share_in_ellipse']:.1f} % in their 95 % ellipses, NEES {error['nees']:.1f}"
            )


def dilution_lines(dilution: dict[str, Any]) -> Iterator[str]:
    """HDOP on a coarse map, north up, at the cells' centres."""
    cell_m, rows = dilution["cell_m"], dilution["hdop"]
    yield f"HDOP (std of a fix per std of a range) for a tag at {dilution['tag_height_m']:g} m; '-': no fix"
    labels = [f"{dilution['origin_y_m'] + (index + 0.5) * cell_m:g}" for index in range(len(rows))]
    width = max(len(label) for label in [*labels, "y m"])
    yield "y m".rjust(width)
    for label, row in zip(reversed(labels), reversed(rows), strict=True):
        yield label.rjust(width) + " |" + "".join(_hdop(value).rjust(CELL) for value in row)
    x_labels = [f"{dilution['origin_x_m'] + (index + 0.5) * cell_m:g}" for index in range(len(rows[0]))]
    yield " " * width + " +" + "-" * (CELL) * len(x_labels)
    yield "x m".rjust(width) + "  " + "".join(label.rjust(CELL) for label in x_labels)


def _hdop(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if value < 10 else ">10"
