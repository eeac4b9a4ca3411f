"""Frames and the transforms between them, static and moving, as tf has them."""

from __future__ import annotations

from array import array
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quadlog.geometry import invert_transform, seconds_since, transform_from_quat
from quadlog.messages import Float, Int, Pose, PoseSeries
from quadlog.recordings.clock import kept_rows

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

BASE_FRAMES = ("base_link", "base", "base_footprint", "body")


@dataclass
class Edge:
    """Poses of a child frame in its parent over time; a static one has a single pose that always holds.

    order: which of the poses came first. topic: of the last one.
    """

    parent: str
    child: str
    static: bool
    t_ns: array[int] = field(default_factory=lambda: array("q"))
    pose: array[float] = field(default_factory=lambda: array("d"))
    order: array[int] = field(default_factory=lambda: array("q"))
    topic: str = ""

    def add(self, t_ns: int, pose: Pose, order: int) -> None:
        """One more pose; a static one replaces what was there."""
        if self.static:
            del self.t_ns[:], self.pose[:], self.order[:]
        self.order.append(order)
        self.t_ns.append(t_ns)
        self.pose.extend((*pose.position_m.tolist(), *pose.quat_xyzw.tolist()))

    def logged(self) -> tuple[Int, Int]:
        """Rows (N,) in the order in which they came, and their times."""
        rows = np.argsort(np.array(self.order, np.int64), kind="stable")
        return rows, np.array(self.t_ns, np.int64)[rows]

    def series(self) -> tuple[Int, Float]:
        """t_ns (N,) strictly increasing and the poses (N, 7) as position, quaternion; see clock.kept_rows."""
        rows, t_ns = self.logged()
        kept = kept_rows(t_ns)
        return t_ns[kept], np.array(self.pose, np.float64).reshape(-1, 7)[rows[kept]]


class TransformTree:
    """All frames of a recording."""

    def __init__(self) -> None:
        self._edges: dict[tuple[str, str], Edge] = {}

    def add(self, t_ns: int, pose: Pose, *, static: bool, order: int = 0, topic: str = "") -> None:
        """The pose of pose.child_frame_id in pose.frame_id. order: its place in the log."""
        key = (pose.frame_id, pose.child_frame_id)
        edge = self._edges.get(key)
        if edge is None or (edge.static and not static):
            edge = self._edges[key] = Edge(*key, static)
        if edge.static or not static:
            edge.topic = topic
            edge.add(t_ns, pose, order)

    def add_moving(self, topic: str, frame_id: str, child_frame_id: str, order: Int, t_ns: Int, pose: Float) -> None:
        """Poses (N, 7), position and quaternion, at t_ns (N,); what is static stays as it is."""
        edge = self._edges.setdefault((frame_id, child_frame_id), Edge(frame_id, child_frame_id, static=False))
        if not edge.static:
            edge.topic = topic
            edge.order.frombytes(order.tobytes())
            edge.t_ns.frombytes(t_ns.tobytes())
            edge.pose.frombytes(np.ascontiguousarray(pose, np.float64).tobytes())

    def recent(self, count: int) -> TransformTree:
        """The same frames with the last few poses of each."""
        tree = TransformTree()
        for key, edge in self._edges.items():
            tree._edges[key] = Edge(
                *(edge.parent, edge.child, edge.static),
                *(edge.t_ns[-count:], edge.pose[-7 * count :], edge.order[-count:]),
            )
        return tree

    def stamps(self, topic: str) -> list[Int]:
        """Times (N,) of each moving transform of a topic, in the order in which they came."""
        return [edge.logged()[1] for edge in self._edges.values() if edge.topic == topic and not edge.static]

    def __len__(self) -> int:
        return len(self._edges)

    @property
    def frames(self) -> list[str]:
        """Every frame, sorted."""
        return sorted({frame for key in self._edges for frame in key})

    def base_frame(self, configured: str = "") -> str | None:
        """The robot's frame: the configured one, or the first usual name that occurs."""
        choices = (configured,) if configured else BASE_FRAMES
        return next((name for name in choices if name in self.frames), None)

    def static_transform(self, source: str, target: str) -> Float | None:
        """(4, 4) transform_source_to_target through static transforms alone, or None where they do not connect."""
        path = self._path(source, target, static_only=True)
        if path is None:
            return None
        transform = np.eye(4)
        for edge, upwards in path:
            step = transform_from_quat(np.array(edge.pose[:3]), np.array(edge.pose[3:7]))
            transform = (step if upwards else invert_transform(step)) @ transform
        return transform

    def pose_series(self, child: str, frame: str) -> PoseSeries | None:
        """Poses of child in frame, at the times of the busiest moving transform between them.

        The others are interpolated there (straight lines and great arcs); times
        that not all of them cover are left out. None where the frames do not
        connect, nothing moves between them, or no time is covered by all.
        """
        from scipy.spatial.transform import Rotation  # slow to import, and few recordings need it

        path = self._path(child, frame, static_only=False)
        moving = [edge for edge, _ in path or [] if not edge.static]
        if path is None or not moving:
            return None
        series = {id(edge): edge.series() for edge in moving}
        busiest = max(moving, key=lambda edge: len(series[id(edge)][0]))
        t_ns = series[id(busiest)][0]
        for known_ns, _ in series.values():
            if len(known_ns) == 0:
                return None
            t_ns = t_ns[(t_ns >= known_ns[0]) & (t_ns <= known_ns[-1])]
        if len(t_ns) == 0:
            return None
        rotation, position = Rotation.identity(len(t_ns)), np.zeros((len(t_ns), 3))
        for edge, upwards in path:
            if edge.static:
                turn, shift = Rotation.from_quat(np.array(edge.pose[3:7])), np.array(edge.pose[:3])
            else:
                turn, shift = _interpolated(*series[id(edge)], t_ns)
            if not upwards:
                turn = turn.inv()
                shift = -turn.apply(shift)
            rotation, position = turn * rotation, turn.apply(position) + shift
        return PoseSeries(t_ns, position, rotation.as_quat(), frame, child)

    def _path(self, source: str, target: str, *, static_only: bool) -> list[tuple[Edge, bool]] | None:
        """Edges from source to target, each with whether it is walked from child to parent; shortest first."""
        if source == target:
            return []
        neighbours: dict[str, list[tuple[str, Edge, bool]]] = {}
        for (parent, child), edge in sorted(self._edges.items()):
            if edge.static or not static_only:
                neighbours.setdefault(child, []).append((parent, edge, True))
                neighbours.setdefault(parent, []).append((child, edge, False))
        reached: dict[str, list[tuple[Edge, bool]]] = {source: []}
        queue = deque([source])
        while queue:
            here = queue.popleft()
            for there, edge, upwards in neighbours.get(here, []):
                if there not in reached:
                    reached[there] = [*reached[here], (edge, upwards)]
                    queue.append(there)
        return reached.get(target)


def _interpolated(known_ns: Int, poses: Float, t_ns: Int) -> tuple[Rotation, Float]:
    from scipy.spatial.transform import Rotation, Slerp

    start_ns = int(known_ns[0])
    known_s, wanted_s = seconds_since(known_ns, start_ns), seconds_since(t_ns, start_ns)
    position = np.column_stack([np.interp(wanted_s, known_s, poses[:, axis]) for axis in range(3)])
    if len(known_ns) == 1:
        return Rotation.from_quat(np.repeat(poses[:, 3:], len(t_ns), axis=0)), position
    inside = np.clip(wanted_s, known_s[0], known_s[-1])
    return Slerp(known_s, Rotation.from_quat(poses[:, 3:]))(inside), position
