"""`derived.mcap`: the results of a run as messages on the input's clock, for Foxglove.

Messages carry the SDK's schemas and encodings; the file itself is written by
the mcap package, whose channel numbers depend on nothing but the order here.
"""

from __future__ import annotations

import heapq
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import foxglove.messages as fox
import numpy as np
from mcap.writer import CompressionType, Writer

from quadlog.errors import NotARun
from quadlog.results.foxglove import messages as content
from quadlog.results.plots.run_data import RunData
from quadlog.results.plots.style import GREY, PLAN, RESIM
from quadlog.results.run.maps import load_maps, read_cloud_samples
from quadlog.results.run.record import RunRecord
from quadlog.results.run.run_folder import read_metrics
from quadlog.results.run.tables import has_table, read_table, start_ns
from quadlog.storage.atomic_write import whole_file
from quadlog.version import __version__

CELLS = ("expanded", "generated")
BODY = ("t_ns", "x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
TIMINGS = ("realtime_factor",)
ERRORS = ("error_m", "cross_track_m", "time_error_m")


class Topic(NamedTuple):
    """One channel: which of Foxglove's messages, and the messages in time order."""

    name: str
    kind: Any
    messages: content.Stream


def write_derived(run: Path, path: Path | None = None, record: RunRecord | None = None) -> Path:
    """`derived.mcap` of the run folder `run`, or `path`, from saved results; missing results are left out.

    Topics: /quadlog/{tf, tf_static, pose, target, map, scan, path, path_smooth, cells, log}, /quadlog/uwb/anchors,
    /quadlog/uwb/fix/<tag>, and /quadlog/resim/{tf, pose, path, path_smooth, error}, all of Foxglove's own schemas.
    cells are CELLS as x, y, and error is ERRORS as x, y, z: vectors are what Foxglove plots.
    A walk along a course was not logged: its tf is the simulated robot's, its path the course.
    record is that of a run whose run.json is not yet written. The same results give the same bytes, so how fast they
    came is left out. Raises NotARun, UnknownRunFormat, TooLarge, CannotWrite.
    """
    path = path or run / "derived.mcap"
    if record is None and (run / "run.json").is_file():
        record = RunData(run).record
    with whole_file(path) as part, part.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(library=f"quadlog {__version__}")
        topics = list(_topics(run, record))
        channels = [_register(writer, topic) for topic in topics]
        sequence = [0] * len(topics)
        # Merged as streams, so that the maps of a long run are not in memory at once.
        streams = [_numbered(k, topic) for k, topic in enumerate(topics)]
        try:
            for t_ns, k, message in heapq.merge(*streams, key=lambda entry: entry[:2]):
                writer.add_message(channels[k], t_ns, message, t_ns, sequence[k])
                sequence[k] += 1
        except (OverflowError, struct.error) as error:
            raise NotARun(run, f"has a time that Foxglove cannot show, before 1970 or after 2106: {error}") from error
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _topics(run: Path, record: RunRecord | None) -> Iterator[Topic]:
    start = start_ns(run)
    if has_table(run, "poses"):
        poses = read_table(run, "poses", ["t_ns", "x_m", "y_m", "yaw_rad"])
        yield Topic("/quadlog/tf", fox.FrameTransform, content.transforms(poses))
        yield Topic("/quadlog/pose", fox.PoseInFrame, content.poses(poses))
    elif has_table(run, "control"):
        yield Topic("/quadlog/tf", fox.FrameTransform, content.transforms(read_table(run, "control", BODY)))
    if (mount := _mount(run, record, start)) is not None:
        lidar = content.transforms(mount, content.LIDAR_FRAME, content.BASE_FRAME)
        yield Topic("/quadlog/tf_static", fox.FrameTransform, lidar)
    if has_table(run, "target"):
        target = read_table(run, "target", ["t_ns", "x_m", "y_m"])
        yield Topic("/quadlog/target", fox.PoseInFrame, content.poses(target))
    yield from _uwb_topics(run, start)
    if (run / "maps.npz").is_file():
        yield Topic("/quadlog/map", fox.Grid, content.grids(load_maps(run)))
    if (run / "cloud_samples.npz").is_file():
        yield Topic("/quadlog/scan", fox.PointCloud, content.scans(*read_cloud_samples(run)))
    if has_table(run, "plans"):
        plans = read_table(run, "plans", ["t_ns", *CELLS])
        yield Topic("/quadlog/cells", fox.Vector2, content.vectors(plans, CELLS))
    yield from _path_topics(run, "paths", "/quadlog", PLAN)
    yield from _resimulation_topics(run)
    if lines := list(_said(run, record)):
        yield Topic("/quadlog/log", fox.Log, content.log_lines(lines, start))


def _uwb_topics(run: Path, start: int) -> Iterator[Topic]:
    if has_table(run, "links"):
        links = read_table(run, "links", ["anchor", "x_m", "y_m", "z_m"])
        yield Topic("/quadlog/uwb/anchors", fox.SceneUpdate, content.anchors(links, start))
    if has_table(run, "fixes"):
        fixes = read_table(run, "fixes", ["t_ns", "tag", "x_m", "y_m", "z_m"])
        for tag in np.unique(fixes["tag"]).tolist():
            mine = {name: column[fixes["tag"] == tag] for name, column in fixes.items()}
            yield Topic(f"/quadlog/uwb/fix/{tag}", fox.PoseInFrame, content.poses(mine))


def _resimulation_topics(run: Path) -> Iterator[Topic]:
    if has_table(run, "control"):
        control = read_table(run, "control", [*BODY, *ERRORS])
        if has_table(run, "poses"):
            frames = content.transforms(control, content.RESIM_FRAME)
            yield Topic("/quadlog/resim/tf", fox.FrameTransform, frames)
        yield Topic("/quadlog/resim/pose", fox.PoseInFrame, content.poses(control))
        yield Topic("/quadlog/resim/error", fox.Vector3, content.vectors(control, ERRORS))
    yield from _path_topics(run, "resim_paths", "/quadlog/resim", RESIM)


def _path_topics(run: Path, table: str, prefix: str, color: str) -> Iterator[Topic]:
    if has_table(run, table):
        paths = read_table(run, table, ["t_ns", "x_m", "y_m", "smooth_x_m", "smooth_y_m"])
        yield Topic(f"{prefix}/path", fox.SceneUpdate, content.paths(paths, "", GREY))
        yield Topic(f"{prefix}/path_smooth", fox.SceneUpdate, content.paths(paths, "smooth_", color))


def _mount(run: Path, record: RunRecord | None, start: int) -> content.Columns | None:
    """The configured pose of the lidar in base, as one row; None if it is not configured."""
    try:
        mount = record.config.get("lidar", {}).get("mount", {}) if record is not None else {}
        place = {name: float(mount.get(name, 0.0)) for name in ("x_m", "y_m", "z_m")}
        angles = {f"{name}_rad": math.radians(mount.get(f"{name}_deg", 0.0)) for name in ("roll", "pitch", "yaw")}
    except (AttributeError, TypeError, ValueError) as error:
        raise NotARun(run / "run.json", f"is damaged: config.lidar.mount: {error}") from error
    pose = place | angles
    if not any(pose.values()):
        return None
    return {"t_ns": np.array([start]), **{name: np.array([value]) for name, value in pose.items()}}


def _said(run: Path, record: RunRecord | None) -> Iterator[tuple[fox.LogLevel, str, str]]:
    """Losses, warnings and metrics of the run."""
    if record is not None:
        for loss in record.losses:
            yield fox.LogLevel.Error, "loss", f"{loss.detail} ({loss.topic})" if loss.topic else loss.detail
        for warning in record.warnings:
            yield fox.LogLevel.Warning, "warning", warning
    metrics = read_metrics(run) if (run / "metrics.json").is_file() else {}
    for name, metric in sorted(metrics.items()):
        if name not in TIMINGS:
            words = f"{name} = {metric['value']:.6g} {metric.get('unit', '')}".rstrip() + f" (n = {metric.get('n')})"
            yield fox.LogLevel.Info, "metric", words


def _register(writer: Writer, topic: Topic) -> int:
    schema = topic.kind.get_schema()
    return writer.register_channel(topic.name, "protobuf", writer.register_schema(schema.name, "protobuf", schema.data))


def _numbered(k: int, topic: Topic) -> Iterator[tuple[int, int, bytes]]:
    """The topic's messages with its number, so that messages of equal time are in the order of the topics."""
    for t_ns, message in topic.messages:
        yield t_ns, k, message
