"""`quadlog info`: what a recording contains, how regular it is, and how good its ranges are."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from quadlog.cli import options
from quadlog.cli.progress import laid_out, left_out, open_progress, print_json, say, show, table_lines
from quadlog.errors import AmbiguousTopic, ExitCode, printable
from quadlog.recordings.formatting import instant, listed

MOST_CHAINS, MOST_TAGS, MOST_HINTS = 6, 10, 3
"""Chains of tf frames, tags whose biases are explained, and hints on topics that are not used, that are printed."""


@options.command("info", "walk.mcap", "walk.mcap --full -c quadlog.toml", "s3://lab/walk.mcap --json")
@click.argument("recording", type=options.PATH_OR_URL)
@options.CONFIG
@options.set_option("topics.lidar=/points")
@options.MSG_PATH
@click.option("--full", is_flag=True, help="Read all messages; also checks the anchor positions.")
@options.AS_JSON
def command(recording: Path, as_json: bool, **given: Any) -> int:
    """Describe a recording: topics, rates, roles, losses.

    For each topic: type, count, rate, gaps, clock offset, role and why. Of a large recording only the index and a
    sample of the messages are read: counts, rates and gaps cover all messages; clock offsets, UWB ranges and damage
    only the sample.
    """
    from quadlog.pipelines.info import describe_recording

    config = options.configured(given).config
    info = describe_recording(recording, config, open_progress=open_progress, **given)
    report_health(info["warnings"], [(loss["topic"], loss["detail"]) for loss in info["losses"]])
    if as_json:
        print_json(info)
    else:
        for line in info_lines(info):
            show(line)
    return ExitCode.WITH_LOSS if info["losses"] else ExitCode.DONE


def report_health(warnings: Iterable[str], losses: Iterable[tuple[str | None, str]]) -> None:
    """One line on stderr for each warning, and for each loss: topic and detail."""
    for line in warnings:
        say(f"warning: {line}")
    for topic, detail in losses:
        say(f"lost: {topic}: {detail}" if topic else f"lost: {detail}")


def info_lines(info: dict[str, Any]) -> Iterator[str]:
    """The object of `info --json` for readers."""
    seconds = "" if info["start_ns"] is None else f" in {(info['end_ns'] - info['start_ns']) * 1e-9:.1f} s"
    yield f"{info['path']}: {info['messages']} messages{seconds}"
    if seconds:
        yield f"  {instant(info['start_ns'])} to {instant(info['end_ns'])}"
    if info["sampled"]:
        yield f"sampled: offsets, ranges and damage are of {info['messages_read']} messages; --full reads all"
    yield from _topics(info["topics"])
    yield from _hints(info["topics"])
    yield from (str(AmbiguousTopic(role, choices)) for role, choices in info["ambiguous"].items())
    yield from map(_chain, info["tf"][:MOST_CHAINS])
    yield from left_out(len(info["tf"]) - MOST_CHAINS)
    if links := info["links"]:
        tags, anchors = (", ".join(map(str, sorted({link[end] for link in links}))) for end in ("tag", "anchor"))
        yield f"UWB: tags {tags}; anchors {anchors}"
        yield from table_lines(links, REACH)
    yield from table_lines(info["anchors"], ANCHOR)
    yield from _uwb(info)
    outlook = info["replay"]
    missing = "; ".join(outlook["missing"]) or "nothing"
    words = (f"a replay will go to: {outlook['until']}", f"position: {outlook['position']}")
    yield "; ".join([*words, f"target: {outlook['target']}", f"missing: {missing}"])


TOPIC = {"name": "topic", "messages": "messages", "rate": "Hz", "gaps": "gaps", "offset": "offset", "role": "role"}


def _topics(topics: Sequence[dict[str, Any]]) -> Iterator[str]:
    """A line of numbers for each topic; below it the type, and why the topic has its role or none."""
    from quadlog.results.text import terminal_width, wrapped

    rows = []
    for row in topics:
        rate = None if row["hz_min"] is None else f"{row['hz_min']:.4g}..{row['hz_max']:.4g}"
        offset = None if row["clock_offset_s"] is None else f"{row['clock_offset_s']:+.3f} s"
        rows.append(row | {"rate": rate, "offset": offset, "gaps": row["gaps"] or None, "role": row["role"] or ""})
    head, *laid, rest = laid_out(rows, TOPIC) or ([], ["no topics: nothing was recorded"])
    yield from head
    for row, lines in zip(topics, laid, strict=True):
        yield from lines
        parts, width = [printable(part) for part in (row["type"], row["why"]) if part], terminal_width() - 4
        parts = [whole] if len(whole := ": ".join(parts)) <= width else parts
        yield from (f"    {line}" for part in parts for line in wrapped(part, width, "  "))
    yield from rest


def _hints(topics: Sequence[dict[str, Any]]) -> Iterator[str]:
    """What makes topics usable that are not: keys to paste into quadlog.toml, or a driver."""
    from quadlog.results.text import wrapped

    names: dict[str, list[str]] = {}
    for row in topics:
        if row["hint"] is not None and row["hint"] not in row["why"]:
            names.setdefault(row["hint"], []).append(row["name"])
    # Keys are of one topic each; what holds for many comes behind them.
    for hint in sorted(names, key=lambda hint: "\n" not in hint)[:MOST_HINTS]:
        keys = "\n" in hint
        yield from wrapped(f"to use {listed(names[hint], 2)}: {'in quadlog.toml' if keys else hint}", 80, "    ")
        yield from (f"    {part}" for line in hint.splitlines() if keys for part in wrapped(line, 76, "  "))
    yield from left_out(len(names) - MOST_HINTS)


def _chain(chain: dict[str, Any]) -> str:
    """Frames of tf, with the number of transforms between neighbours."""
    steps = zip(chain["frames"][1:], chain["transforms"], chain["static"], strict=True)
    words = (f"{frame} ({'static' if static else count})" for frame, count, static in steps)
    return f"tf: {' → '.join([chain['frames'][0], *words])}"


REACH = {"topic": "topic", "tag": "tag", "anchor": "anchor", "n": "ranges", "range_min_m": "min m"}
REACH |= {"range_max_m": "max m"}
ANCHOR = {"id": "anchor", "messages": "messages", "x_m": "x m", "y_m": "y m", "z_m": "z m"}
LINK = {"tag": "tag", "anchor": "anchor", "n": "ranges", "residual_m": "residual m", "residual_median_m": "median m"}
LINK |= {"nlos": "NLOS", "weak_path": "weak path", "bias_m": "bias m", "bias_std_m": "+-", "applied": ""}
TAG = {"tag": "tag", "role": "role", "epochs": "epochs", "fixes": "fixes", "too_few_ranges": "too few"}
TAG |= {"degenerate": "degenerate", "hdop_median": "HDOP", "ellipse_major_median_m": "95 % m"}
TAG |= {"ellipse_minor_median_m": "x m", "nis": "NIS"}


def _uwb(info: dict[str, Any]) -> Iterator[str]:
    """How good links and fixes are."""
    tags = sorted(info["uwb_tags"], key=lambda row: row["role"] is None)  # those of the robot and the person first
    said = {row["calibration"] for row in tags}
    if tags:
        yield ""
    yield from table_lines([row | _link_words(row, said) for row in info["uwb"]], LINK)
    yield from table_lines(tags, TAG)
    if any(row["nis"] is not None for row in tags):
        yield "HDOP and 95 % semi-axes are medians; NIS per range: 1 where its std is right"
    yield from (f"biases of tag {row['tag']}: {row['calibration']}" for row in tags[:MOST_TAGS])
    if info["uwb_body"]:
        yield f"tags {listed(info['uwb_body'])} are one body: replay takes its position and yaw from all"


def _link_words(row: dict[str, Any], said: Collection[str]) -> dict[str, Any]:
    """NLOS, weak paths and the bias in words; one that is not applied has the reason, unless that is said below."""
    from quadlog.results.text import percent

    weak, why = row["weak_first_path_share"], row["why_not"]
    applied = "applied" if row["bias_applied"] else "not applied" if why in said else f"not applied: {why}"
    return {"nlos": percent(row["nlos_share"]), "weak_path": weak and percent(weak), "applied": applied}
