"""Saved columns as Foxglove messages: what each topic of `derived.mcap` carries, one generator per kind of topic."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import foxglove.messages as fox
import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import quat_from_euler
from quadlog.results.plots.scans import CLASS_COLOR
from quadlog.results.plots.style import BLACK
from quadlog.results.run.maps import CloudSample, MapSequence

Columns = Mapping[str, NDArray[Any]]
Stream = Iterator[tuple[int, bytes]]  # (t_ns, encoded message), in time order

MAP_FRAME, BASE_FRAME, RESIM_FRAME, LIDAR_FRAME = "map", "base", "base_resim", "lidar"
_NS = 1_000_000_000
_BLOCK_ROWS = 1000


def poses(columns: Columns) -> Stream:
    """`foxglove.PoseInFrame` for each row with a finite place; height and angles are 0 where it has none."""
    for t, position, orientation in _timed_poses(columns):
        pose = fox.Pose(position=position, orientation=orientation)
        yield t, fox.PoseInFrame(timestamp=timestamp(t), frame_id=MAP_FRAME, pose=pose).encode()


def transforms(columns: Columns, child: str = BASE_FRAME, parent: str = MAP_FRAME) -> Stream:
    """`foxglove.FrameTransform` of the frame `child` in `parent` for each pose."""
    for t, position, orientation in _timed_poses(columns):
        transform = fox.FrameTransform(
            timestamp=timestamp(t),
            parent_frame_id=parent,
            child_frame_id=child,
            translation=position,
            rotation=orientation,
        )
        yield t, transform.encode()


def grids(maps: MapSequence) -> Stream:
    """`foxglove.Grid` for each map: one byte a cell, 1 where occupied."""
    columns = maps.shape[1]
    cell = fox.Vector2(x=maps.cell_m, y=maps.cell_m)
    field = fox.PackedElementField(name="occupied", offset=0, type=fox.PackedElementFieldNumericType.Uint8)
    for t, (x, y), occupied in maps:
        grid = fox.Grid(
            timestamp=timestamp(t),
            frame_id=MAP_FRAME,
            pose=upright_pose(float(x), float(y)),
            column_count=columns,
            cell_size=cell,
            row_stride=columns,
            cell_stride=1,
            fields=[field],
            data=occupied.astype(np.uint8).tobytes(),
        )
        yield t, grid.encode()


def log_lines(lines: Iterable[tuple[fox.LogLevel, str, str]], t_ns: int) -> Stream:
    """`foxglove.Log` for each (level, name, words), all at the start time, so that they are always shown."""
    for level, name, words in lines:
        # JSON may contain lone surrogates, which cannot be encoded.
        words = words.encode("utf-8", "replace").decode()
        yield t_ns, fox.Log(timestamp=timestamp(t_ns), level=level, message=words, name=name).encode()


def vectors(columns: Columns, names: tuple[str, ...]) -> Stream:
    """`foxglove.Vector2` or `Vector3` of two or three columns, in the order of `names`, for plots.

    Foxglove has no schema for bare numbers; a vector's parts can be plotted. What does not exist is NaN, a gap.
    """
    kind = fox.Vector2 if len(names) == 2 else fox.Vector3
    for part in _blocks(columns):
        table = [part[name].astype(np.float64).tolist() for name in names]
        for t, *row in zip(part["t_ns"].tolist(), *table, strict=True):
            yield t, kind(**dict(zip("xyz", row, strict=False))).encode()


def _timed_poses(columns: Columns) -> Iterator[tuple[int, fox.Vector3, fox.Quaternion]]:
    for part in _blocks(columns):
        zero = np.zeros(len(part["t_ns"]))
        place = np.column_stack([part["x_m"], part["y_m"], part.get("yaw_rad", zero)])
        whole = np.isfinite(place).all(axis=1)
        # A robot without a body has neither height nor tilt.
        z, roll, pitch = (np.nan_to_num(part.get(name, zero)[whole]) for name in ("z_m", "roll_rad", "pitch_rad"))
        x, y, yaw = place[whole].T
        quat = quat_from_euler(yaw, pitch, roll).tolist()
        places = np.column_stack([x, y, z]).tolist()
        for t, (at_x, at_y, at_z), (qx, qy, qz, qw) in zip(part["t_ns"][whole].tolist(), places, quat, strict=True):
            yield t, fox.Vector3(x=at_x, y=at_y, z=at_z), fox.Quaternion(x=qx, y=qy, z=qz, w=qw)


def _blocks(columns: Columns) -> Iterator[dict[str, NDArray[Any]]]:
    """The columns in blocks, since Python's numbers take ten times the memory of numpy's."""
    for first in range(0, len(columns["t_ns"]), _BLOCK_ROWS):
        yield {name: column[first : first + _BLOCK_ROWS] for name, column in columns.items()}


def upright_pose(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> fox.Pose:
    """A pose with a rotation about z only."""
    turn = fox.Quaternion(x=0.0, y=0.0, z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2))
    return fox.Pose(position=fox.Vector3(x=x_m, y=y_m, z=z_m), orientation=turn)


def timestamp(t_ns: int) -> fox.Timestamp:
    """Raises OverflowError before 1970 and after 2106."""
    return fox.Timestamp(sec=t_ns // _NS, nsec=t_ns % _NS)


_FLOAT, _BYTE = fox.PackedElementFieldNumericType.Float32, fox.PackedElementFieldNumericType.Uint8
_FIELDS = {"x": _FLOAT, "y": _FLOAT, "z": _FLOAT, **dict.fromkeys(("label", "red", "green", "blue", "alpha"), _BYTE)}
POINT = np.dtype([(name, "<f4" if kind is _FLOAT else "u1") for name, kind in _FIELDS.items()])
"""A point as `scans` packs it: metres, the label that cloud_samples.npz gives it, and the colour of its class."""

_LINE_M, _ANCHOR_M, _LABEL_PX = 0.05, 0.3, 14.0


def paths(columns: Columns, prefix: str, color: str) -> Stream:
    """`foxglove.SceneUpdate` for each instant of a paths table: one line, which replaces the one before.

    prefix: "" or "smooth_"; color: #rrggbb.
    """
    t_ns = columns["t_ns"]
    x_m, y_m = columns[f"{prefix}x_m"], columns[f"{prefix}y_m"]
    # One path at a time: a long run has millions of points.
    starts = np.flatnonzero(np.diff(t_ns, prepend=t_ns[:1] - 1)).tolist()
    for first, last in pairwise([*starts, len(t_ns)]):
        points = np.column_stack([x_m[first:last], y_m[first:last]])
        line = fox.LinePrimitive(
            type=fox.LinePrimitiveLineType.LineStrip,
            pose=upright_pose(0.0, 0.0),
            thickness=_LINE_M,
            points=[fox.Point3(x=x, y=y, z=0.0) for x, y in points[np.isfinite(points).all(axis=1)].tolist()],
            color=_color(color),
        )
        t = int(t_ns[first])
        entity = fox.SceneEntity(timestamp=timestamp(t), frame_id=MAP_FRAME, id="path", lines=[line])
        yield t, fox.SceneUpdate(entities=[entity]).encode()


def anchors(links: Columns, t_ns: int) -> Stream:
    """One `foxglove.SceneUpdate` at `t_ns` with every anchor of a links table: a ball, and its number beside it."""
    ids, rows = np.unique(links["anchor"], return_index=True)
    place = np.column_stack([links[name][rows] for name in ("x_m", "y_m", "z_m")])
    known = np.isfinite(place[:, :2]).all(axis=1)
    entities = []
    for anchor, (x, y, z) in zip(ids[known].tolist(), np.nan_to_num(place[known]).tolist(), strict=True):
        at = upright_pose(x, y, z)
        size = fox.Vector3(x=_ANCHOR_M, y=_ANCHOR_M, z=_ANCHOR_M)
        ball = fox.SpherePrimitive(pose=at, size=size, color=_color(BLACK))
        words = fox.TextPrimitive(
            pose=upright_pose(x, y, z + _ANCHOR_M),
            billboard=True,
            font_size=_LABEL_PX,
            scale_invariant=True,
            color=_color(BLACK),
            text=f"anchor {anchor}",
        )
        entities.append(
            fox.SceneEntity(
                timestamp=timestamp(t_ns), frame_id=MAP_FRAME, id=f"anchor {anchor}", spheres=[ball], texts=[words]
            )
        )
    yield t_ns, fox.SceneUpdate(entities=entities).encode()


def scans(samples: Sequence[CloudSample], classes: Sequence[str]) -> Stream:
    """`foxglove.PointCloud` of each sample scan whose pose is known: points in base, and `pose` puts them into map."""
    colors = np.array([_rgba(CLASS_COLOR.get(name, BLACK)) for name in classes], np.uint8).reshape(-1, 4)
    fields = [
        fox.PackedElementField(name=name, offset=POINT.fields[name][1], type=kind)  # type: ignore[index]
        for name, kind in _FIELDS.items()
    ]
    for sample in samples:
        if not np.isfinite((sample.x_m, sample.y_m, sample.yaw_rad)).all():
            continue
        points = np.empty(len(sample.label), POINT)
        points["x"], points["y"], points["z"] = sample.xyz_m.T
        points["label"] = sample.label
        for k, name in enumerate(("red", "green", "blue", "alpha")):
            points[name] = colors[sample.label, k]
        cloud = fox.PointCloud(
            timestamp=timestamp(sample.t_ns),
            frame_id=MAP_FRAME,
            pose=upright_pose(sample.x_m, sample.y_m, yaw_rad=sample.yaw_rad),
            point_stride=POINT.itemsize,
            fields=fields,
            data=points.tobytes(),
        )
        yield sample.t_ns, cloud.encode()


def _rgba(color: str) -> tuple[int, int, int, int]:
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue, 255


def _color(color: str) -> fox.Color:
    red, green, blue, alpha = (value / 255 for value in _rgba(color))
    return fox.Color(r=red, g=green, b=blue, a=alpha)
