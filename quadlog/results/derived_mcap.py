"""`derived.mcap`: everything a run found out, as messages on the input's clock, for Foxglove to show beside it.

Messages carry the SDK's schemas and encodings; the file itself is written by
the mcap package, whose channel numbers depend on nothing but the order here.
"""

from __future__ import annotations

import heapq
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import foxglove.messages as fox
import numpy as np
from mcap.writer import CompressionType, Writer

from quadlog.errors import NotARun
from quadlog.results import foxglove_messages as content
from quadlog.results.files import whole_file
from quadlog.results.maps import load_maps
from quadlog.results.run_folder import read_metrics
from quadlog.results.tables import has_table, read_table
from quadlog.version import __version__

PLAN_NUMBERS = ("found", "expanded", "generated", "cost", "length_m", "from_scratch", "us")
TRACKING_NUMBERS = ("error_m", "cross_track_m", "time_error_m", "heading_error_rad", "lookahead_m", "cmd_v_mps")


@dataclass(frozen=True, slots=True)
class Topic:
    """One channel: its messages' encoding and schema, and the messages in time order."""

    name: str
    encoding: str
    schema_name: str
    schema: bytes
    messages: content.Stream


def write_derived(run: Path, path: Path | None = None) -> Path:
    """`derived.mcap` of the run folder `run`, or `path`, from saved results alone; what a run has not is left out.

    Topics: /quadlog/{tf, pose, target, map, path, path_smooth, plan, metrics},
    /quadlog/uwb/fix/<tag>, and /quadlog/resim/{pose, path, path_smooth, error}.
    The same results give the same bytes. Raises NotARun, CannotWrite.
    """
    path = path or run / "derived.mcap"
    with whole_file(path) as part, part.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(library=f"quadlog {__version__}")
        topics = list(_topics(run))
        channels = [_register(writer, topic) for topic in topics]
        sequence = [0] * len(topics)
        # Merged as streams: the maps of a long run never lie in memory together.
        streams = [_numbered(k, topic) for k, topic in enumerate(topics)]
        try:
            for t_ns, k, message in heapq.merge(*streams, key=lambda entry: entry[:2]):
                writer.add_message(channels[k], t_ns, message, t_ns, sequence[k])
                sequence[k] += 1
        except (OverflowError, struct.error) as error:
            raise NotARun(run, f"has a time that Foxglove cannot show, before 1970 or after 2106: {error}") from error
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _topics(run: Path) -> Iterator[Topic]:
    if has_table(run, "poses"):
        poses = read_table(run, "poses", ["t_ns", "x_m", "y_m", "yaw_rad"])
        yield _foxglove("/quadlog/tf", fox.FrameTransform, content.transforms(poses))
        yield _foxglove("/quadlog/pose", fox.PoseInFrame, content.poses(poses))
    if has_table(run, "target"):
        target = read_table(run, "target", ["t_ns", "x_m", "y_m"])
        yield _foxglove("/quadlog/target", fox.PoseInFrame, content.poses(target))
    if has_table(run, "fixes"):
        fixes = read_table(run, "fixes", ["t_ns", "tag", "x_m", "y_m", "z_m"])
        for tag in np.unique(fixes["tag"]).tolist():
            mine = {name: column[fixes["tag"] == tag] for name, column in fixes.items()}
            yield _foxglove(f"/quadlog/uwb/fix/{tag}", fox.PoseInFrame, content.poses(mine))
    if (run / "maps.npz").is_file():
        yield _foxglove("/quadlog/map", fox.Grid, content.grids(load_maps(run)))
    if has_table(run, "plans"):
        plans = read_table(run, "plans", ["t_ns", *PLAN_NUMBERS])
        yield _json("/quadlog/plan", "quadlog.Plan", content.numbers(plans, PLAN_NUMBERS), PLAN_NUMBERS)
    yield from _path_topics(run, "paths", "/quadlog")
    yield from _resimulation_topics(run)
    if (run / "metrics.json").is_file():
        yield _foxglove("/quadlog/metrics", fox.Log, content.metric_lines(read_metrics(run), _first_instant(run)))


def _resimulation_topics(run: Path) -> Iterator[Topic]:
    if has_table(run, "control"):
        control = read_table(run, "control", ["t_ns", "x_m", "y_m", "z_m", "yaw_rad", *TRACKING_NUMBERS])
        tracking = content.numbers(control, TRACKING_NUMBERS)
        yield _foxglove("/quadlog/resim/pose", fox.PoseInFrame, content.poses(control))
        yield _json("/quadlog/resim/error", "quadlog.Tracking", tracking, TRACKING_NUMBERS)
    yield from _path_topics(run, "resim_paths", "/quadlog/resim")


def _path_topics(run: Path, table: str, prefix: str) -> Iterator[Topic]:
    if has_table(run, table):
        paths = read_table(run, table)
        yield _foxglove(f"{prefix}/path", fox.PosesInFrame, content.paths(paths))
        yield _foxglove(f"{prefix}/path_smooth", fox.PosesInFrame, content.paths(paths, "smooth_"))


def _first_instant(run: Path) -> int:
    """The first instant of the run: the earliest row of any table, 0 for a run without any."""
    tables = [name for name in ("fixes", "poses", "scans", "plans", "control") if has_table(run, name)]
    instants = [read_table(run, name, ["t_ns"])["t_ns"] for name in tables]
    return min((int(t_ns.min()) for t_ns in instants if len(t_ns)), default=0)


def _foxglove(name: str, kind: Any, messages: content.Stream) -> Topic:
    schema = kind.get_schema()
    return Topic(name, "protobuf", schema.name, schema.data, messages)


def _json(name: str, schema_name: str, messages: content.Stream, numbers: tuple[str, ...]) -> Topic:
    return Topic(name, "json", schema_name, content.numbers_schema(schema_name, numbers), messages)


def _register(writer: Writer, topic: Topic) -> int:
    schema_encoding = "protobuf" if topic.encoding == "protobuf" else "jsonschema"
    schema = writer.register_schema(topic.schema_name, schema_encoding, topic.schema)
    return writer.register_channel(topic.name, topic.encoding, schema)


def _numbered(k: int, topic: Topic) -> Iterator[tuple[int, int, bytes]]:
    """The topic's messages with its number, so that equal times come in the order of the topics."""
    for t_ns, message in topic.messages:
        yield t_ns, k, message
