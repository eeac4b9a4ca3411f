"""Saved columns as Foxglove messages: what each topic of `derived.mcap` carries, one generator per kind of topic."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import foxglove.messages as fox
import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import quat_from_euler
from quadlog.results.maps import MapSequence

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
    """`foxglove.Log` for each (level, name, words), all at the start so that they are there whatever is shown."""
    for level, name, words in lines:
        # Half a surrogate pair, as JSON may hold one, is no text that can be encoded.
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
    """The columns in pieces, since Python's numbers take ten times the memory of numpy's."""
    for first in range(0, len(columns["t_ns"]), _BLOCK_ROWS):
        yield {name: column[first : first + _BLOCK_ROWS] for name, column in columns.items()}


def upright_pose(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> fox.Pose:
    """A place, turned about z alone."""
    turn = fox.Quaternion(x=0.0, y=0.0, z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2))
    return fox.Pose(position=fox.Vector3(x=x_m, y=y_m, z=z_m), orientation=turn)


def timestamp(t_ns: int) -> fox.Timestamp:
    """Raises OverflowError before 1970 and after 2106."""
    return fox.Timestamp(sec=t_ns // _NS, nsec=t_ns % _NS)
