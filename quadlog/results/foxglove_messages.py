"""Saved columns as Foxglove messages: what each topic of `derived.mcap` carries, one generator per kind of topic."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import foxglove.messages as fox
import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import quat_from_yaw
from quadlog.results.maps import MapSequence

Columns = Mapping[str, NDArray[Any]]
Stream = Iterator[tuple[int, bytes]]  # (t_ns, encoded message), in time order

MAP_FRAME, BASE_FRAME = "map", "base"
_NS = 1_000_000_000
_BLOCK_ROWS = 1000
_UPRIGHT = fox.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


def poses(columns: Columns) -> Stream:
    """`foxglove.PoseInFrame` for each row with a finite place; z and yaw are 0 where there is no such column."""
    for t, position, orientation in _timed_poses(columns):
        pose = fox.Pose(position=position, orientation=orientation)
        yield t, fox.PoseInFrame(timestamp=_timestamp(t), frame_id=MAP_FRAME, pose=pose).encode()


def transforms(columns: Columns) -> Stream:
    """`foxglove.FrameTransform` of base in map for each pose."""
    for t, position, orientation in _timed_poses(columns):
        transform = fox.FrameTransform(
            timestamp=_timestamp(t),
            parent_frame_id=MAP_FRAME,
            child_frame_id=BASE_FRAME,
            translation=position,
            rotation=orientation,
        )
        yield t, transform.encode()


def paths(columns: Columns, prefix: str = "") -> Stream:
    """`foxglove.PosesInFrame` for each instant of a paths table: `prefix` is "" or "smooth_"."""
    t_ns = columns["t_ns"]
    starts = np.flatnonzero(np.diff(t_ns, prepend=t_ns[:1] - 1))
    for rows in np.split(np.arange(len(t_ns)), starts[1:]) if len(t_ns) else []:
        t = int(t_ns[rows[0]])
        points = np.column_stack([columns[f"{prefix}x_m"][rows], columns[f"{prefix}y_m"][rows]])
        places = [_upright_pose(x, y) for x, y in points[np.isfinite(points).all(axis=1)].tolist()]
        yield t, fox.PosesInFrame(timestamp=_timestamp(t), frame_id=MAP_FRAME, poses=places).encode()


def grids(maps: MapSequence) -> Stream:
    """`foxglove.Grid` for each map: one byte a cell, 1 where occupied."""
    columns = maps.shape[1]
    cell = fox.Vector2(x=maps.cell_m, y=maps.cell_m)
    field = fox.PackedElementField(name="occupied", offset=0, type=fox.PackedElementFieldNumericType.Uint8)
    for t, (x, y), occupied in maps:
        grid = fox.Grid(
            timestamp=_timestamp(t),
            frame_id=MAP_FRAME,
            pose=_upright_pose(float(x), float(y)),
            column_count=columns,
            cell_size=cell,
            row_stride=columns,
            cell_stride=1,
            fields=[field],
            data=occupied.astype(np.uint8).tobytes(),
        )
        yield t, grid.encode()


def metric_lines(metrics: Mapping[str, Mapping[str, Any]], t_ns: int) -> Stream:
    """`foxglove.Log`, one line for each metric, all at the start so that they are there whatever is shown."""
    for name in sorted(metrics):
        metric = metrics[name]
        message = f"{name} = {metric['value']:.6g} {metric.get('unit', '')}".rstrip() + f" (n = {metric.get('n')})"
        log = fox.Log(timestamp=_timestamp(t_ns), level=fox.LogLevel.Info, message=message, name="quadlog")
        yield t_ns, log.encode()


def numbers(columns: Columns, names: tuple[str, ...]) -> Stream:
    """JSON objects of the columns `names`, for plots; Foxglove has no schema of its own for bare numbers.

    A value that does not exist is left out; true and false are 1 and 0.
    """
    for part in _blocks(columns):
        table = [part[name].astype(np.float64).tolist() for name in names]
        for t, *row in zip(part["t_ns"].tolist(), *table, strict=True):
            content = {name: value for name, value in zip(names, row, strict=True) if math.isfinite(value)}
            yield t, json.dumps(content).encode()


def numbers_schema(title: str, names: tuple[str, ...]) -> bytes:
    """JSON schema of the objects that `numbers` makes."""
    properties = {name: {"type": "number"} for name in names}
    return json.dumps({"title": title, "type": "object", "properties": properties}).encode()


def _timed_poses(columns: Columns) -> Iterator[tuple[int, fox.Vector3, fox.Quaternion]]:
    for part in _blocks(columns):
        zero = np.zeros(len(part["t_ns"]))
        quat = quat_from_yaw(part.get("yaw_rad", zero))
        place = np.column_stack([part["x_m"], part["y_m"], np.nan_to_num(part.get("z_m", zero)), quat[:, 2:]])
        whole = np.isfinite(place).all(axis=1)
        for t, (x, y, z, qz, qw) in zip(part["t_ns"][whole].tolist(), place[whole].tolist(), strict=True):
            yield t, fox.Vector3(x=x, y=y, z=z), fox.Quaternion(x=0.0, y=0.0, z=qz, w=qw)


def _blocks(columns: Columns) -> Iterator[dict[str, NDArray[Any]]]:
    """The columns in pieces, since Python's numbers take ten times the memory of numpy's."""
    for first in range(0, len(columns["t_ns"]), _BLOCK_ROWS):
        yield {name: column[first : first + _BLOCK_ROWS] for name, column in columns.items()}


def _upright_pose(x_m: float, y_m: float) -> fox.Pose:
    return fox.Pose(position=fox.Vector3(x=x_m, y=y_m, z=0.0), orientation=_UPRIGHT)


def _timestamp(t_ns: int) -> fox.Timestamp:
    return fox.Timestamp(sec=t_ns // _NS, nsec=t_ns % _NS)
