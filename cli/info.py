"""`quadlog info`: what a recording contains, how regular it is, and how good its ranges are."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from quadlog.cli.terminal.parameters import AS_JSON, CONFIG, MSG_PATH, PATH_OR_URL, examples, set_option
from quadlog.errors import AmbiguousTopic, ExitCode, printable
from quadlog.recordings.formatting import listed

COLUMNS = ("topic", "messages", "Hz", "gaps", "offset", "role")


@click.command(
    name="info",
    short_help="Describe a recording: topics, rates, roles, losses.",
    epilog=examples(
        "quadlog info walk.mcap",
        "quadlog info walk.mcap --full -c quadlog.toml",
        "quadlog info s3://lab/walk.mcap --json",
    ),
)
@click.argument("recording", type=PATH_OR_URL)
@CONFIG
@set_option("topics.lidar=/points")
@MSG_PATH
@click.option("--full", is_flag=True, help="Read all messages; also checks the anchor positions.")
@AS_JSON
def command(
    recording: Path,
    config_path: Path | None,
    overrides: tuple[str, ...],
    msg_path: tuple[Path, ...],
    full: bool,
    as_json: bool,
) -> int:
    """List for each topic type, count, rate, gaps, clock offset, role and why; and what was lost.

    Of a large recording only the index and a sample of the messages are read: counts, rates and gaps cover all
    messages; clock offsets, UWB ranges and damage only the sample. --full reads everything.
    """
    from quadlog.cli.terminal.progress_bars import open_progress
    from quadlog.config.file import load_config
    from quadlog.pipelines.info import describe_recording

    config = load_config(config_path, overrides)
    info = describe_recording(recording, config, msg_path, full=full, open_progress=open_progress)
    report_health(info["warnings"], [(loss["topic"], loss["detail"]) for loss in info["losses"]])
    if as_json:
        click.echo(json.dumps(info, indent=2, allow_nan=False))
    else:
        print_info(info)
    return ExitCode.WITH_LOSS if info["losses"] else ExitCode.DONE


def report_health(warnings: Iterable[str], losses: Iterable[tuple[str | None, str]]) -> None:
    """One line on stderr for each warning, and for each loss: topic and detail."""
    for line in warnings:
        click.echo(f"warning: {printable(line)}", err=True)
    for topic, detail in losses:
        click.echo(f"lost: {printable(f'{topic}: {detail}' if topic else detail)}", err=True)


def print_info(info: dict[str, Any]) -> None:
    """Print the object of `info --json` as text."""
    from quadlog.results.text import print_table, terminal_width

    _print_lines(_head_lines(info))
    if info["topics"]:
        _print_lines(topic_lines(info["topics"]))
    _print_lines(str(AmbiguousTopic(role, choices)) for role, choices in info["ambiguous"].items())
    _print_lines(chain_lines(info["tf"]))
    if links := info["links"]:
        tags, anchors = (", ".join(map(str, sorted({link[end] for link in links}))) for end in ("tag", "anchor"))
        _print_lines([f"UWB: tags {tags}; anchors {anchors}", *reach_lines(links)])
    _print_lines(anchor_lines(info["anchors"]))
    if info["uwb"]:
        said = {row["calibration"] for row in info["uwb_tags"]}
        click.echo("\n" + print_table(*link_table(info["uwb"][:MOST_LINKS], said), width=terminal_width()), nl=False)
        _print_lines(_left_out(len(info["uwb"]) - MOST_LINKS, "links"))
    if info["uwb_tags"]:
        rows = sorted(info["uwb_tags"], key=lambda row: row["role"] is None)  # those of the robot and the person first
        _print_lines(["", *(line for row in rows[:MOST_TAGS] for line in _wrapped(tag_lines(row)))])
        _print_lines(_left_out(len(rows) - MOST_TAGS, "tags"))
        if info["uwb_body"]:
            _print_lines([f"tags {listed(info['uwb_body'])} are one body: replay takes its position and yaw from all"])
        if info["dilution"] is not None:
            _print_lines(["", *dilution_lines(info["dilution"])])
    _print_lines([outlook_line(info["replay"])])


def _print_lines(lines: Iterable[str]) -> None:
    for line in lines:
        click.echo(printable(line))


def _head_lines(info: dict[str, Any]) -> Iterator[str]:
    from quadlog.recordings.formatting import instant

    seconds = "" if info["start_ns"] is None else f" in {(info['end_ns'] - info['start_ns']) * 1e-9:.1f} s"
    yield f"{info['path']}: {info['messages']} messages{seconds}"
    if seconds:
        yield f"  {instant(info['start_ns'])} to {instant(info['end_ns'])}"
    if info["sampled"]:
        yield f"sampled: offsets, ranges and damage are of {info['messages_read']} messages; --full reads all"


def _wrapped(lines: Iterable[str]) -> Iterator[str]:
    """The lines, broken at spaces where they do not fit the terminal."""
    from quadlog.results.text import terminal_width

    for line in lines:
        indent = "    " if line.startswith(" ") else "  "
        # Flags to paste are broken nowhere: a topic's name may hold hyphens.
        yield from textwrap.wrap(
            printable(line), terminal_width(), subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )


def topic_lines(topics: Sequence[dict[str, Any]]) -> Iterator[str]:
    """A line of numbers for each topic; below it the type, and why the topic has its role or none."""
    from quadlog.results.text import print_table, terminal_width

    head, *lines = print_table(COLUMNS, [_cells(topic) for topic in topics]).splitlines()
    yield head
    for topic, line in zip(topics, lines, strict=True):
        yield line
        parts = [printable(part) for part in (topic["type"], topic["why"]) if part]
        fits = len(": ".join(parts)) + 4 <= terminal_width()
        yield from (f"    {part}" for part in ([": ".join(parts)] if fits else parts))


def _cells(topic: dict[str, Any]) -> list[Any]:
    offset = topic["clock_offset_s"]
    return [
        topic["name"],
        str(topic["messages"]),
        "" if topic["hz_min"] is None else f"{topic['hz_min']:.4g}..{topic['hz_max']:.4g}",
        str(topic["gaps"] or ""),
        "" if offset is None else f"{offset:+.3f} s",
        topic["role"] or "",
    ]


MOST_LINKS, MOST_TAGS, MOST_CHAINS = 40, 10, 6  # that are printed
CELL = 6  # characters of a number of the HDOP map, with the space before it


def chain_lines(chains: Sequence[dict[str, Any]]) -> Iterator[str]:
    """A line for each of the first chains of tf frames, with the number of transforms between neighbours."""
    for chain in chains[:MOST_CHAINS]:
        steps = zip(chain["frames"][1:], chain["transforms"], chain["static"], strict=True)
        words = (f"{frame} ({'static' if static else count})" for frame, count, static in steps)
        yield f"tf: {' → '.join([chain['frames'][0], *words])}"
    yield from _left_out(len(chains) - MOST_CHAINS, "chains of frames")


def outlook_line(outlook: dict[str, Any]) -> str:
    """How far a replay will go, with what, and what is missing."""
    missing = "; ".join(outlook["missing"]) or "nothing"
    words = (f"a replay will go to: {outlook['until']}", f"position: {outlook['position']}")
    return "; ".join([*words, f"target: {outlook['target']}", f"missing: {missing}"])


def anchor_lines(anchors: Sequence[dict[str, Any]]) -> Iterator[str]:
    """The positions of anchors that the messages contain."""
    for anchor in anchors:
        place = ", ".join(f"{axis}_m = {anchor[f'{axis}_m']:.3f}" for axis in "xyz")
        yield f"  anchor {anchor['id']} in {anchor['messages']} messages: {place}"


def reach_lines(links: Sequence[dict[str, Any]]) -> Iterator[str]:
    """A line per link with its number of ranges and their span; at most MOST_LINKS of them."""
    for link in links[:MOST_LINKS]:
        ends = f"  {link['topic']}  tag {link['tag']}  anchor {link['anchor']}  {link['n']} ranges"
        known = link["range_min_m"] is not None
        yield ends + (f"  {link['range_min_m']:.2f}..{link['range_max_m']:.2f} m" if known else "  no finite range")
    yield from _left_out(len(links) - MOST_LINKS, "links")


def _left_out(count: int, what: str) -> Iterator[str]:
    if count > 0:
        yield f"  and {count} more {what}, all of them in --json"


def link_table(rows: Sequence[dict[str, Any]], said: Collection[str] = ()) -> tuple[list[str], list[list[str]]]:
    """Header and cells of the table of links; a bias that is not applied has the reason, unless that is said below."""
    columns = ["tag", "anchor", "ranges", "residual m", "median m", "NLOS", "bias m", ""]
    cells = [_link_cells(row, said) for row in rows]
    if any(row["weak_first_path_share"] is not None for row in rows):
        columns.insert(6, "weak path")
        for row, line in zip(rows, cells, strict=True):
            share = row["weak_first_path_share"]
            line.insert(6, "" if share is None else f"{100 * share:.1f} %")
    return columns, cells


def _link_cells(row: dict[str, Any], said: Collection[str]) -> list[str]:
    bias = "" if row["bias_m"] is None else f"{row['bias_m']:+.3f} +- {row['bias_std_m']:.3f}"
    why = row["why_not"]
    return [
        *(str(row[name]) for name in ("tag", "anchor", "n")),
        f"{row['residual_m']:.3f}",
        f"{row['residual_median_m']:+.3f}",
        f"{100 * row['nlos_share']:.1f} %",
        bias,
        "applied" if row["bias_applied"] else "not applied" if why in said else f"not applied: {why}",
    ]


def tag_lines(row: dict[str, Any]) -> Iterator[str]:
    """Quality of a tag's fixes, and their errors where there is a reference."""
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
    """HDOP at the centres of a coarse grid, north up."""
    cell_m, rows = dilution["cell_m"], dilution["hdop"]
    yield f"HDOP (std of a fix per std of a range) for a tag at {dilution['tag_height_m']:g} m; '-': no fix"
    labels = [f"{dilution['origin_y_m'] + (index + 0.5) * cell_m:g}" for index in range(len(rows))]
    width = max(len(label) for label in [*labels, "y m"])
    yield "y m".rjust(width)
    for label, row in zip(reversed(labels), reversed(rows), strict=True):
        yield label.rjust(width) + " |" + "".join(_hdop(value).rjust(CELL) for value in row)
    x_labels = [f"{dilution['origin_x_m'] + (index + 0.5) * cell_m:g}" for index in range(len(rows[0]))]
    yield " " * width + " +" + "-" * CELL * len(x_labels)
    yield "x m".rjust(width) + "  " + "".join(label.rjust(CELL) for label in x_labels)


def _hdop(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if value < 10 else ">10"
