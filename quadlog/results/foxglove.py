"""Foxglove: `derived.mcap`, the results of a run as messages on the input's clock, and a layout that shows them.

Messages carry the SDK's schemas and encodings; the file itself is written by the mcap package, whose channel numbers
depend on nothing but the order here.
"""

from __future__ import annotations

import heapq
import json
import math
import struct
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import foxglove.messages as fox
import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from quadlog.errors import NotARun
from quadlog.geometry import quat_from_euler
from quadlog.results.run import Run
from quadlog.results.scenes import CLASSES
from quadlog.results.view import COLORS, look
from quadlog.results.words import value_text
from quadlog.storage.atomic_write import whole_file, write_whole
from quadlog.version import __version__

if TYPE_CHECKING:
    from pandas import DataFrame

Stream = Iterator[tuple[int, Any]]  # (t_ns, message), in time order
Topic = tuple[str, Any, Stream]  # its name, its kind of message

MAP_FRAME, BASE_FRAME, RESIM_FRAME, LIDAR_FRAME = "map", "base", "base_resim", "lidar"
PLOTTED = (
    ("Cells per replan", "plans", "/quadlog/cells", ("expanded", "generated")),
    ("Tracking error (m)", "control", "/quadlog/resim/error", ("error_m", "cross_track_m", "time_error_m")),
    ("Command", "control", "/quadlog/resim/command", ("cmd_v_mps", "cmd_yaw_rate_radps")),
    ("Distances (m)", "clearances", "/quadlog/resim/clearance", ("clearance_m", "target_distance_m")),
)
"""Title, table, topic, and the columns that are x, y and z: Foxglove has no schema for bare numbers."""
RESIDUAL = "/quadlog/uwb/residual"
MOST_RESIDUALS = 4000
"""Of all anchors together; of a longer or faster log every k-th of each anchor: they would take most of the time."""
TIMINGS = ("realtime_factor",)
_FLAT = ["t_ns", "x_m", "y_m", "yaw_rad"]
_FLOAT, _BYTE = fox.PackedElementFieldNumericType.Float32, fox.PackedElementFieldNumericType.Uint8
_RGBA = ["red", "green", "blue", "alpha"]
_POINT = np.dtype([*((name, "<f4") for name in "xyz"), *((name, "u1") for name in ["label", *_RGBA])])
_LINE_M, _ANCHOR_M, _LABEL_PX = 0.05, 0.3, 14.0
_TEMPLATE = Path(__file__).parent / "templates" / "foxglove-layout.json"


def write_derived(run: Run, path: Path | None = None) -> Path:
    """`derived.mcap` in the run's folder, or `path`, from saved results; missing results are left out.

    The topics are those of docs/files.md. A walk along a course was not logged: its tf is the simulated robot's, its
    path the course. The same results give the same bytes, so durations are left out.
    Raises NotARun for damaged files and for times that Foxglove cannot show, TooLarge, CannotWrite.
    """
    path = path or run.path / "derived.mcap"
    with whole_file(path) as part, part.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(library=f"quadlog {__version__}")
        # Merged as streams, so that the maps of a long run are not in memory at once.
        streams = [_numbered(_register(writer, name, kind), stream) for name, kind, stream in _topics(run)]
        try:
            for t_ns, channel, sequence, message in heapq.merge(*streams):
                writer.add_message(channel, t_ns, message.encode(), t_ns, sequence)
        except (OverflowError, struct.error) as error:
            words = f"has a time that Foxglove cannot show, before 1970 or after 2106: {error}"
            raise NotARun(run.path, words) from error
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _register(writer: Writer, name: str, kind: Any) -> int:
    schema = kind.get_schema()
    return writer.register_channel(name, "protobuf", writer.register_schema(schema.name, "protobuf", schema.data))


def _numbered(channel: int, stream: Stream) -> Iterator[tuple[int, int, int, Any]]:
    """The messages with their channel and number: those of equal time are in the order of the topics."""
    for sequence, (t_ns, message) in enumerate(stream):
        yield t_ns, channel, sequence, message


def _topics(run: Run) -> Iterator[Topic]:
    poses, control, target = run.table("poses"), run.table("control"), run.table("target")
    walk = control if poses is None else poses[_FLAT]
    if walk is not None:
        yield "/quadlog/tf", fox.FrameTransform, _transforms(walk, BASE_FRAME)
    if poses is not None:
        yield "/quadlog/pose", fox.PoseInFrame, _poses(poses[_FLAT])
    yield from _mount(run)
    if target is not None:
        yield "/quadlog/target", fox.PoseInFrame, _poses(target)
    yield from _uwb_topics(run)
    if run.maps is not None:
        yield "/quadlog/map", fox.Grid, _grids(run)
    samples = run.arrays("cloud_samples")
    if samples is not None:
        yield "/quadlog/scan", fox.PointCloud, _scans(samples)
    for name, prefix, color in (("paths", "/quadlog", "plan"), ("resim_paths", "/quadlog/resim", "resim")):
        paths = run.table(name)
        if paths is not None:
            yield f"{prefix}/path", fox.SceneUpdate, _paths(paths, "", "soft")
            yield f"{prefix}/path_smooth", fox.SceneUpdate, _paths(paths, "smooth_", color)
    if control is not None:
        if poses is not None:
            yield "/quadlog/resim/tf", fox.FrameTransform, _transforms(control, RESIM_FRAME)
        yield "/quadlog/resim/pose", fox.PoseInFrame, _poses(control)
    for _, name, topic, columns in PLOTTED:
        table = run.table(name)
        if table is not None:
            yield topic, _vector_of(columns), _vectors(table, columns)
    yield "/quadlog/log", fox.Log, _log(run)


def _uwb_topics(run: Run) -> Iterator[Topic]:
    links, fixes, ranges = run.table("links"), run.table("fixes"), run.table("ranges")
    if links is not None:
        yield "/quadlog/uwb/anchors", fox.SceneUpdate, _anchors(links, run.start_ns)
    for number, rows in () if fixes is None else fixes.groupby("tag"):
        yield f"/quadlog/uwb/fix/{number}", fox.PoseInFrame, _poses(rows)
    step = 1 if ranges is None else math.ceil(len(ranges) / MOST_RESIDUALS)
    for (tag, anchor), rows in () if ranges is None else ranges.groupby(["tag", "anchor"]):
        some = rows.iloc[::step]
        residuals = some.assign(residual_m=some["range_m"] - some["predicted_m"])
        yield f"{RESIDUAL}/{tag}/{anchor}", fox.Vector2, _vectors(residuals, ("residual_m", "weight"))


def _placed(table: DataFrame) -> Iterator[tuple[int, fox.Vector3, fox.Quaternion]]:
    """Instant, position and orientation of each row with a position; unknown heights and angles are 0."""
    known = table.dropna(subset=[name for name in ("x_m", "y_m", "yaw_rad") if name in table])
    zero = np.zeros(len(known))
    names = ("z_m", "yaw_rad", "pitch_rad", "roll_rad")
    z_m, *angles = (np.nan_to_num(known[name].to_numpy()) if name in known else zero for name in names)
    columns = (known["t_ns"], known["x_m"], known["y_m"], z_m.tolist(), quat_from_euler(*angles).tolist())
    for t, x, y, z, (qx, qy, qz, qw) in zip(*columns, strict=True):
        yield t, fox.Vector3(x=x, y=y, z=z), fox.Quaternion(x=qx, y=qy, z=qz, w=qw)


def _poses(table: DataFrame) -> Stream:
    for t, position, orientation in _placed(table):
        pose = fox.Pose(position=position, orientation=orientation)
        yield t, fox.PoseInFrame(timestamp=_time(t), frame_id=MAP_FRAME, pose=pose)


def _transforms(table: DataFrame, child: str, parent: str = MAP_FRAME) -> Stream:
    for t, position, orientation in _placed(table):
        frames = {"parent_frame_id": parent, "child_frame_id": child}
        yield t, fox.FrameTransform(timestamp=_time(t), **frames, translation=position, rotation=orientation)


def _mount(run: Run) -> Iterator[Topic]:
    """The configured pose of the lidar in base, once; nothing if it is not configured."""
    from pandas import DataFrame

    mount = run.config.lidar.mount
    row = {f"{axis}_m": getattr(mount, f"{axis}_m") for axis in "xyz"}
    row |= {f"{name}_rad": math.radians(getattr(mount, f"{name}_deg")) for name in ("roll", "pitch", "yaw")}
    if any(row.values()):
        table = DataFrame([{"t_ns": run.start_ns, **row}])
        yield "/quadlog/tf_static", fox.FrameTransform, _transforms(table, LIDAR_FRAME, BASE_FRAME)


def _grids(run: Run) -> Stream:
    """One byte a cell, 1 where occupied."""
    maps = run.maps
    assert maps is not None
    columns, size = maps.shape[1], fox.Vector2(x=maps.cell_m, y=maps.cell_m)
    form: dict[str, Any] = {"column_count": columns, "row_stride": columns, "cell_stride": 1, "cell_size": size}
    form["fields"] = [fox.PackedElementField(name="occupied", offset=0, type=_BYTE)]
    for t, (x, y), occupied in maps:
        pose, data = _upright(float(x), float(y)), occupied.astype(np.uint8).tobytes()
        yield t, fox.Grid(timestamp=_time(t), frame_id=MAP_FRAME, pose=pose, data=data, **form)


def _scans(samples: dict[str, NDArray[Any]]) -> Stream:
    """The sample scans whose pose is known: points in base with label and colour of their class, and that pose."""
    kinds = [(name, _FLOAT if name in "xyz" else _BYTE) for name in _POINT.names or ()]
    fields = [fox.PackedElementField(name=name, offset=_POINT.fields[name][1], type=kind) for name, kind in kinds]  # type: ignore[index]
    label = samples["label"]
    points = np.empty(len(label), _POINT)
    points["x"], points["y"], points["z"] = samples["xyz_m"].T
    points["label"] = label
    colors = np.array([_rgba(CLASSES.get(name.lower(), "soft")) for name in samples["classes"].tolist()], np.uint8)
    for number, name in enumerate(_RGBA):
        points[name] = colors[label, number]
    places = zip(*(samples[name].tolist() for name in ("t_ns", "x_m", "y_m", "yaw_rad")), strict=True)
    for (t, x, y, yaw_rad), (first, last) in zip(places, pairwise(samples["offset"].tolist()), strict=True):
        if np.isfinite((x, y, yaw_rad)).all():
            form: dict[str, Any] = {"frame_id": MAP_FRAME, "pose": _upright(x, y, yaw_rad=yaw_rad), "fields": fields}
            data = points[first:last].tobytes()
            yield t, fox.PointCloud(timestamp=_time(t), point_stride=_POINT.itemsize, data=data, **form)


def _paths(paths: DataFrame, prefix: str, color: str) -> Stream:
    """One line for each replan, which replaces the one before. prefix: "" or "smooth_"."""
    t_ns, points = paths["t_ns"].to_numpy(), paths[[f"{prefix}x_m", f"{prefix}y_m"]].to_numpy()
    first = np.flatnonzero(np.diff(t_ns, prepend=t_ns[:1] - 1))
    for t, rows in zip(t_ns[first].tolist(), np.split(points, first[1:]), strict=True):
        known = rows[np.isfinite(rows).all(axis=1)]
        line = fox.LinePrimitive(
            type=fox.LinePrimitiveLineType.LineStrip,
            pose=_upright(0.0, 0.0),
            thickness=_LINE_M,
            points=[fox.Point3(x=x, y=y, z=0.0) for x, y in known.tolist()],
            color=_color(color),
        )
        entity = fox.SceneEntity(timestamp=_time(t), frame_id=MAP_FRAME, id="path", lines=[line])
        yield t, fox.SceneUpdate(entities=[entity])


def _anchors(links: DataFrame, t: int) -> Stream:
    """A ball and the number of each anchor."""
    entities = []
    size, color = fox.Vector3(x=_ANCHOR_M, y=_ANCHOR_M, z=_ANCHOR_M), _color("text")
    placed = links.drop_duplicates("anchor").dropna(subset=["x_m", "y_m"]).sort_values("anchor").fillna({"z_m": 0.0})
    for anchor, x, y, z in placed[["anchor", "x_m", "y_m", "z_m"]].itertuples(index=False, name=None):
        name = f"anchor {anchor}"
        ball = fox.SpherePrimitive(pose=_upright(x, y, z), size=size, color=color)
        above = _upright(x, y, z + _ANCHOR_M)
        form: dict[str, Any] = {"billboard": True, "font_size": _LABEL_PX, "scale_invariant": True}
        label = fox.TextPrimitive(pose=above, text=name, color=color, **form)
        entities.append(fox.SceneEntity(timestamp=_time(t), frame_id=MAP_FRAME, id=name, spheres=[ball], texts=[label]))
    yield t, fox.SceneUpdate(entities=entities)


def _vector_of(columns: tuple[str, ...]) -> Any:
    return fox.Vector2 if len(columns) == 2 else fox.Vector3


def _vectors(table: DataFrame, columns: tuple[str, ...]) -> Stream:
    """Two or three columns, in their order; NaN is a gap in a plot."""
    kind = _vector_of(columns)
    numbers = table[[*columns]].astype(float)
    for t, *values in zip(table["t_ns"], *(numbers[name] for name in columns), strict=True):
        yield t, kind(**dict(zip("xyz", values, strict=False)))


def _log(run: Run) -> Stream:
    """Losses, warnings and metrics at the start of the run, so that they are always shown."""
    level = fox.LogLevel
    losses = [f"{loss.detail} ({loss.topic})" if loss.topic else loss.detail for loss in run.record.losses]
    lines = [*((level.Error, "loss", text) for text in losses)]
    lines += [(level.Warning, "warning", text) for text in run.record.warnings]
    for name, of in sorted(run.metrics.items()):
        if name not in TIMINGS:
            lines.append((level.Info, "metric", f"{name} = {value_text(name, of.value, of.unit, 6)} (n = {of.n})"))
    for kind, name, text in lines:
        text = text.encode("utf-8", "replace").decode()  # lone surrogates cannot be encoded
        yield run.start_ns, fox.Log(timestamp=_time(run.start_ns), level=kind, message=text, name=name)


def _upright(x: float, y: float, z: float = 0.0, yaw_rad: float = 0.0) -> fox.Pose:
    turn = fox.Quaternion(x=0.0, y=0.0, z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2))
    return fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=turn)


def _time(t_ns: int) -> fox.Timestamp:
    """Raises OverflowError before 1970 and after 2106."""
    return fox.Timestamp(sec=t_ns // 10**9, nsec=t_ns % 10**9)


def _rgba(color: str) -> tuple[int, int, int, int]:
    red, green, blue = bytes.fromhex(COLORS[color].removeprefix("#"))
    return red, green, blue, 255


def _color(color: str) -> fox.Color:
    red, green, blue, alpha = (value / 255 for value in _rgba(color))
    return fox.Color(r=red, g=green, b=blue, a=alpha)


def write_layout(run: Run) -> Path:
    """`foxglove-layout.json` in the run's folder, a layout as the app exports it. Raises NotARun, CannotWrite.

    The camera follows `base` from above. Foxglove leaves out topics that are absent, so only the UWB tags and anchors
    depend on the run.
    """
    path, layout = run.path / "foxglove-layout.json", json.loads(_TEMPLATE.read_text("utf-8"))
    panels, fixes, ranges = layout["configById"], run.table("fixes"), run.table("ranges")
    for tag in () if fixes is None else fixes["tag"].sort_values().unique().tolist():
        form = {"visible": True, "type": "axis", "axisScale": 0.2, "color": COLORS["fix"]}
        panels["3D!scene"]["topics"][f"/quadlog/uwb/fix/{tag}"] = form
    for title, _, topic, columns in PLOTTED:
        shown = [(f"{topic}.{part}", name) for part, name in zip("xyz", columns, strict=False)]
        panels[f"Plot!{topic.rpartition('/')[2]}"] = _plot(title, shown)
    if ranges is not None:
        links = ranges[["tag", "anchor"]].drop_duplicates().sort_values(["tag", "anchor"]).to_numpy().tolist()
        shown = [(f"{RESIDUAL}/{tag}/{anchor}.x", f"tag {tag}, anchor {anchor}") for tag, anchor in links]
        panels["Plot!residual"] = _plot("Range residuals (m)", shown)
    scene, last, *others = panels
    column: Any = last
    for number, plot in enumerate(others, start=2):
        column = {"direction": "column", "first": plot, "second": column, "splitPercentage": 100 / number}
    layout["layout"] = {"direction": "row", "first": scene, "second": column, "splitPercentage": 62}
    write_whole(path, f"{json.dumps(layout, indent=2)}\n".encode())
    return path


def _plot(title: str, shown: list[tuple[str, str]]) -> dict[str, Any]:
    """shown: the value and the label of each curve."""
    form = {"enabled": True, "timestampMethod": "receiveTime"}
    series = [
        {"value": value, "label": label, "color": COLORS[look(number)["color"]], **form}
        for number, (value, label) in enumerate(shown)
    ]
    axes = {"xAxisVal": "timestamp", "showXAxisLabels": True, "showYAxisLabels": True, "isSynced": True}
    return {"foxglovePanelTitle": title, "paths": series, "showLegend": True, "legendDisplay": "floating", **axes}
