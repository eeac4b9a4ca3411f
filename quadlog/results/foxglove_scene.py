"""What the 3D panel draws beside poses: paths as lines, anchors, and sample scans with the class of every point."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import foxglove.messages as fox
import numpy as np

from quadlog.results.foxglove_messages import MAP_FRAME, Columns, Stream, timestamp, upright_pose
from quadlog.results.plots.scans import CLASS_COLOR
from quadlog.results.plots.style import BLACK
from quadlog.results.samples import CloudSample

_FLOAT, _BYTE = fox.PackedElementFieldNumericType.Float32, fox.PackedElementFieldNumericType.Uint8
_FIELDS = {"x": _FLOAT, "y": _FLOAT, "z": _FLOAT, **dict.fromkeys(("label", "red", "green", "blue", "alpha"), _BYTE)}
POINT = np.dtype([(name, "<f4" if kind is _FLOAT else "u1") for name, kind in _FIELDS.items()])
"""A point as `scans` packs it: metres, the label that cloud_samples.npz gives it, and the colour of its class."""

_LINE_M, _ANCHOR_M, _LABEL_PX = 0.05, 0.3, 14.0


def paths(columns: Columns, prefix: str, color: str) -> Stream:
    """`foxglove.SceneUpdate` for each instant of a paths table: one line, which takes the place of the one before.

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
