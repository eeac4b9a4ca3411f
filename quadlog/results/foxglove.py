"""Foxglove: `derived.mcap`, the results of a run as messages on the input's clock, and a layout that shows them.

Messages have the SDK's schemas, numbers over time a JSON schema of their fields.
"""

from __future__ import annotations

import heapq
import json
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from io import FileIO
from itertools import chain, islice
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import foxglove.messages as fox
import numpy as np
from foxglove import Channel, Context, Schema, channels, open_mcap
from foxglove.mcap import MCAPWriteOptions

from quadlog.errors import NotARun
from quadlog.geometry import quat_from_euler
from quadlog.results.arrays import MapSequence
from quadlog.results.figures import with_rates
from quadlog.results.run import Run
from quadlog.results.scenes import plan_ways, position_errors
from quadlog.results.view import COLORS
from quadlog.storage.atomic_write import whole_file, write_whole

if TYPE_CHECKING:
    from pandas import DataFrame

Table = Any  # columns by name: a DataFrame, or arrays
Stream = Iterator[tuple[int, Any]]  # (t_ns, message), in time order
Numbers = dict[str, Any]  # DataFrames by topic
Logs = Iterator[tuple[int, Any, Callable[..., None]]]  # the same, each with what writes it

STEP_NS = 100_000_000
"""Of frames, which Foxglove interpolates, and of lines of errors, one in each such step."""
_LINE_M, _ANCHOR_M, _LABEL_PX = 0.05, 0.3, 14.0


def write_foxglove(run: Run) -> None:
    """`derived.mcap` and its `foxglove-layout.json`, both in the run's folder. Raises as write_derived does."""
    numbers = dict(_numbers(run))
    _write_mcap(run, run.path / "derived.mcap", numbers)
    _write_layout(run, numbers)


def write_derived(run: Run, path: Path | None = None) -> Path:
    """`derived.mcap` in the run's folder, or `path`, from saved results; missing results are left out.

    The topics are those of docs/files.md. A walk along a course was not logged: its tf is the simulated robot's, its
    path the course. The same results give the same bytes.
    Raises NotARun for damaged files and for times that Foxglove cannot show, TooLarge, CannotWrite.
    """
    path = path or run.path / "derived.mcap"
    _write_mcap(run, path, dict(_numbers(run)))
    return path


def _write_mcap(run: Run, path: Path, numbers: Numbers) -> None:
    context = Context()
    # Not as many threads as there are cores, which would show in the bytes. The name is known to `is_recording`.
    options = MCAPWriteOptions(profile="quadlog", compression_level=1, compression_threads=0)
    with whole_file(path) as part, _Steady(part, "wb") as file:
        try:
            with open_mcap(file, context=context, writer_options=options):
                logs = [_log_typed(topic, messages, context) for topic, messages in _topics(run)]
                logs += [_log_numbers(topic, table, context) for topic, table in numbers.items()]
                # Merged as streams, so that the maps of a long run are not in memory at once.
                for t_ns, message, log in heapq.merge(*logs, key=itemgetter(0)):
                    log(message, log_time=t_ns)
                    if file.error is not None:
                        break
        except OverflowError as error:
            words = f"has a time that Foxglove cannot show, before 1970 or after 2106: {error}"
            raise NotARun(run.path, words) from error
        if file.error is not None:
            raise file.error


class _Steady(FileIO):
    """A file that keeps its error, of which the SDK would print a line for each later message."""

    error: OSError | None = None

    def write(self, content: Any) -> int:
        """Whatever becomes of it."""
        try:
            return super().write(content)
        except OSError as error:
            self.error = error
            return len(content)


def _log_typed(topic: str, messages: Stream, context: Context) -> Logs:
    """Messages of one of the SDK's types."""
    for first in islice(messages, 1):
        channel: Any = getattr(channels, f"{type(first[1]).__name__}Channel")(topic, context=context)
        yield from ((t_ns, message, channel.log) for t_ns, message in chain([first], messages))


def _log_numbers(topic: str, table: DataFrame, context: Context) -> Logs:
    """A JSON object of each row, without what is not finite; the tables have more digits."""
    if table.empty:
        return
    rows = table.drop(columns="t_ns").astype(float)
    form = {"type": "object", "properties": {key: {"type": "number"} for key in rows}}
    schema = Schema(name=topic[1:].replace("/", "."), encoding="jsonschema", data=json.dumps(form).encode())
    channel: Any = Channel(topic, schema=schema, message_encoding="json", context=context)
    text = rows.to_json(orient="records", lines=True, double_precision=6)
    lines = re.sub(r'"[^"]+":null,?', "", text).replace(",}", "}").encode().splitlines()
    yield from ((t_ns, line, channel.log) for t_ns, line in zip(table["t_ns"].tolist(), lines, strict=True))


def _topics(run: Run) -> Iterator[tuple[str, Stream]]:
    poses, control, target = (run.table(name) for name in ("poses", "control", "target"))
    fixes = run.table("fixes")
    mount: dict[str, Any] = {name: [value] for name, value in run.config.lidar.mount.model_dump().items()}
    if any(value for (value,) in mount.values()):
        angles = {f"{name}_rad": np.radians(mount[f"{name}_deg"]) for name in ("roll", "pitch", "yaw")}
        yield "/quadlog/tf_static", _transforms({"t_ns": [run.start_ns], **mount, **angles}, "base", "lidar")
    in_map = partial(_transforms, parent="map")
    named: list[tuple[str, Any, Callable[[Any], Stream]]] = [
        ("/quadlog/tf", _sparse(control if poses is None else poses), partial(in_map, child="base")),
        ("/quadlog/resim/tf", None if poses is None else _sparse(control), partial(in_map, child="base_resim")),
        ("/quadlog/pose", poses, _poses),
        ("/quadlog/target", target, _poses),
        ("/quadlog/resim/pose", control, _poses),
        ("/quadlog/uwb/anchors", run.table("links"), partial(_anchors, t=run.start_ns)),
        ("/quadlog/map", run.maps, _grids),
        ("/quadlog/path", run.table("paths"), partial(_paths, color="plan")),
        ("/quadlog/resim/path", run.table("resim_paths"), partial(_paths, color="resim")),
        ("/quadlog/error", position_errors(run), _errors),
        ("/quadlog/resim/error", control, _errors),
    ]
    for topic, table, messages in named:
        if table is not None:
            yield topic, messages(table)
    for number, rows in () if fixes is None else fixes.groupby("tag"):
        yield f"/quadlog/uwb/fix/{number}", _poses(rows)


def _sparse(table: DataFrame | None) -> Any:
    """The first row in each step of STEP_NS."""
    return None if table is None else table[(table["t_ns"] // STEP_NS).diff() != 0]


_WALK = ["t_ns", "error_m", "cross_track_m", "time_error_m", "heading_error_rad", "vx_mps", "yaw_rate_radps"]
_SEARCH = ["t_ns", "expanded", "generated", "reused_cells"]


def _numbers(run: Run) -> Iterator[tuple[str, DataFrame]]:
    """Numbers over time by topic, all rows, with t_ns; columns of tags and links have their numbers in their names."""
    poses, errors, ranges, control = (run.table(name) for name in ("poses", "uwb_errors", "ranges", "control"))
    if poses is not None:
        values = poses[["t_ns"]].assign(speed_mps=with_rates(poses)["speed"])
        if errors is not None:
            names = errors["source"] + "_error_tag_" + errors["tag"].astype(str) + "_m"
            values = values.merge(_by_name(errors, names, np.hypot(errors["error_x_m"], errors["error_y_m"])), "outer")
        yield "/quadlog/values", values
    if ranges is not None:
        names = "tag_" + ranges["tag"].astype(str) + "_anchor_" + ranges["anchor"].astype(str) + "_m"
        yield "/quadlog/uwb/residuals", _by_name(ranges, names, ranges["range_m"] - ranges["predicted_m"])
    if control is not None:
        near = run.table("clearances")
        values = control[_WALK]
        yield "/quadlog/resim/values", values if near is None else values.merge(near.drop(columns="seconds"), "outer")
    for topic, plans in (("/quadlog/plan", run.table("plans")), ("/quadlog/resim/plan", run.table("resim_plans"))):
        if plans is not None:
            yield topic, plans[_SEARCH]


def _by_name(table: DataFrame, names: Any, values: Any) -> DataFrame:
    """A column of each name with the values (N,) of each instant."""
    rows = table[["t_ns"]].assign(name=names, value=values)
    return rows.pivot_table("value", "t_ns", "name", aggfunc="first").reset_index()


def _line(t: int, name: str, color: str, places: Sequence[Sequence[float]]) -> tuple[int, fox.SceneUpdate]:
    """A line on the ground, which replaces the one of this name before."""
    points = [fox.Point3(x=x, y=y, z=0.0) for x, y in places]
    form: dict[str, Any] = {"type": fox.LinePrimitiveLineType.LineStrip, "thickness": _LINE_M, "color": _color(color)}
    line = fox.LinePrimitive(pose=_pose(), points=points, **form)
    return t, fox.SceneUpdate(entities=[fox.SceneEntity(timestamp=_time(t), frame_id="map", id=name, lines=[line])])


def _errors(table: DataFrame) -> Stream:
    """In each step of STEP_NS a line from the robot to where it should be."""
    rows = _sparse(table)[["t_ns", "x_m", "y_m", "ref_x_m", "ref_y_m"]].dropna()
    return (_line(t, "error", "bad", [place[:2], place[2:]]) for t, *place in rows.itertuples(index=False))


def _placed(table: Table) -> Iterator[tuple[int, fox.Vector3, fox.Quaternion]]:
    """Instant, position and orientation of each row with a position; unknown heights and angles are 0."""
    names = ("x_m", "y_m", "yaw_rad", "z_m", "pitch_rad", "roll_rad")
    nothing = np.zeros(len(table["t_ns"]))
    rows = np.array([np.asarray(table.get(name, nothing), float) for name in names])
    known = np.isfinite(rows[:3]).all(axis=0)
    x_m, y_m, yaw_rad, z_m, pitch_rad, roll_rad = np.nan_to_num(rows[:, known])
    places = np.column_stack([x_m, y_m, z_m, quat_from_euler(yaw_rad, pitch_rad, roll_rad)]).tolist()
    for t, (x, y, z, *turn) in zip(np.asarray(table["t_ns"])[known].tolist(), places, strict=True):
        yield t, fox.Vector3(x=x, y=y, z=z), fox.Quaternion(x=turn[0], y=turn[1], z=turn[2], w=turn[3])


def _transforms(table: Table, parent: str, child: str) -> Stream:
    for t, place, turn in _placed(table):
        frames = {"parent_frame_id": parent, "child_frame_id": child}
        yield t, fox.FrameTransform(timestamp=_time(t), translation=place, rotation=turn, **frames)


def _in_map(t: int, place: fox.Vector3, turn: fox.Quaternion) -> dict[str, Any]:
    """What every message at a pose in map has."""
    return {"timestamp": _time(t), "frame_id": "map", "pose": fox.Pose(position=place, orientation=turn)}


def _poses(table: Table) -> Stream:
    for at in _placed(table):
        yield at[0], fox.PoseInFrame(**_in_map(*at))


def _grids(maps: MapSequence) -> Stream:
    """One byte a cell, 1 where occupied."""
    columns, size = maps.shape[1], fox.Vector2(x=maps.cell_m, y=maps.cell_m)
    form: dict[str, Any] = {"column_count": columns, "row_stride": columns, "cell_stride": 1, "cell_size": size}
    form["fields"] = [fox.PackedElementField(name="occupied", offset=0, type=fox.PackedElementFieldNumericType.Uint8)]
    corners = _placed({"t_ns": maps.t_ns, "x_m": maps.origin_m[:, 0], "y_m": maps.origin_m[:, 1]})
    for at, (*_, occupied) in zip(corners, maps, strict=True):
        yield at[0], fox.Grid(**_in_map(*at), data=occupied.astype(np.uint8).tobytes(), **form)


def _paths(paths: DataFrame, color: str) -> Stream:
    """One line for each replan."""
    first, *ways = plan_ways(paths)
    places = np.column_stack(ways)
    for t, start, end in zip(paths["t_ns"].to_numpy()[first[:-1]].tolist(), first, first[1:], strict=False):
        way = places[start:end]
        yield _line(t, "path", color, way[np.isfinite(way).all(axis=1)].tolist())


def _anchors(links: Table, t: int) -> Stream:
    """A ball and the number of each anchor, all in one message."""
    size, color, entities = fox.Vector3(x=_ANCHOR_M, y=_ANCHOR_M, z=_ANCHOR_M), _color("text"), []
    form: dict[str, Any] = {"billboard": True, "font_size": _LABEL_PX, "scale_invariant": True, "color": color}
    placed = links.drop_duplicates("anchor").dropna(subset=["x_m", "y_m"]).sort_values("anchor").fillna({"z_m": 0.0})
    for anchor, x, y, z in placed[["anchor", "x_m", "y_m", "z_m"]].itertuples(index=False):
        name = f"anchor {anchor}"
        ball = fox.SpherePrimitive(pose=_pose(x, y, z), size=size, color=color)
        label = fox.TextPrimitive(pose=_pose(x, y, z + _ANCHOR_M), text=name, **form)
        entities.append(fox.SceneEntity(timestamp=_time(t), frame_id="map", id=name, spheres=[ball], texts=[label]))
    yield t, fox.SceneUpdate(entities=entities)


def _pose(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> fox.Pose:
    return fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=fox.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))


def _time(t_ns: int) -> fox.Timestamp:
    """Raises OverflowError before 1970 and after 2106."""
    return fox.Timestamp(sec=t_ns // 10**9, nsec=t_ns % 10**9)


def _color(color: str) -> fox.Color:
    red, green, blue = (byte / 255 for byte in bytes.fromhex(COLORS[color].removeprefix("#")))
    return fox.Color(r=red, g=green, b=blue, a=1.0)


def _write_layout(run: Run, numbers: Numbers) -> None:
    """A layout as the app exports it.

    The camera follows `base` from above. Foxglove leaves out topics that are absent, so only the UWB tags depend on the
    run.
    """
    layout = json.loads((Path(__file__).parent / "templates" / "foxglove-layout.json").read_text("utf-8"))
    topics, fixes = layout["configById"]["3D!scene"]["topics"], run.table("fixes")
    for tag in () if fixes is None else fixes["tag"].sort_values().unique().tolist():
        form = {"visible": True, "type": "axis", "axisScale": 0.2, "color": COLORS["fix"]}
        topics[f"/quadlog/uwb/fix/{tag}"] = form
    plots = (config["paths"] for name, config in layout["configById"].items() if name.startswith("Plot!"))
    names = {topic: [name for name in table if name != "t_ns"] for topic, table in numbers.items()}
    for paths in plots:  # a topic stands for all its numbers
        every = [f"{topic}.{name}" for of in paths for topic in [of["value"]] for name in names.get(topic, [])]
        paths[:] = [{"value": value, "enabled": True, "timestampMethod": "receiveTime"} for value in every]
    write_whole(run.path / "foxglove-layout.json", f"{json.dumps(layout, indent=2)}\n".encode())
