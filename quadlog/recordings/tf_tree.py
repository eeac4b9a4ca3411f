"""Frames and the transforms between them, static and moving, as tf has them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import invert_transform, rotation_from_quat, seconds_since, transform_from_quat
from quadlog.messages import Float, Int, PoseSeries

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

BASE_FRAMES = ("base_link", "base", "base_footprint", "body", "trunk", "torso", "chassis")
WORLD_FRAMES = ("map", "world", "odom", "odom_combined", "camera_init", "earth")
"""Usual names, which may follow a robot's prefix."""
STILL_M, STILL_COS = 1e-3, 1 - 5e-7
"""What rounding may move a fixed mount by: 1 mm, and 0.1 degrees as the cosine of half the angle."""
LEAST_JUMP_M, FEWEST_TURNS, TURN_ROWS, ROUGHNESS = 0.05, 10, 3, 4.0
"""Two senders of a transform jump to and fro by more than the first, so often, each time within so many poses, and by
so many times more than the distance between them changes meanwhile."""


def is_named(frame: str, names: Sequence[str]) -> bool:
    """Whether a frame has one of the names, with or without a robot's prefix."""
    return frame.rsplit("/", 1)[-1] in names


def is_static(topic: str) -> bool:
    """Whether a topic of transforms carries static ones, by its name, as tf2 has it."""
    return topic.rsplit("/", 1)[-1] == "tf_static"


@dataclass(eq=False)
class Edge:
    """Poses of a child frame in its parent over time; static: from a topic of such, with one pose that always holds.

    t_ns: (N,) increasing. pose: (N, 7) position and quaternion. topic: of the last one.
    """

    parent: str
    child: str
    static: bool
    t_ns: Int
    pose: Float
    topic: str = ""

    @property
    def is_still(self) -> bool:
        """Whether the pose never changes, whichever topic it is on."""
        shift_m, turn_cos = np.ptp(self.pose[:, :3], axis=0), np.abs(self.pose[:, 3:] @ self.pose[0, 3:])
        return self.static or bool((shift_m < STILL_M).all() and (turn_cos > STILL_COS).all())

    def keep_one_sender(self, like: PoseSeries | None) -> tuple[int, int, float] | None:
        """Where two senders take turns, keep the poses of that nearer to `like`, in the same parent, or of the busier.

        Returns how many are kept and left out, and how far apart (m) they are; None where there is one sender.
        """
        t_ns, pose = self.t_ns, self.pose
        t_s, place_m = seconds_since(t_ns, t_ns[0]), pose[:, :3] + rotation_from_quat(pose[:, 3:])[..., 0]
        step_m = np.diff(place_m, axis=0)
        far_m = np.linalg.norm(step_m, axis=1)
        jumps = np.flatnonzero(far_m > LEAST_JUMP_M)
        out, back = jumps[:-1], jumps[1:]
        turned = (step_m[out] * step_m[back]).sum(axis=1) < -0.5 * far_m[out] * far_m[back]
        turns = out[turned & (back - out <= TURN_ROWS)]
        second = _second_sender(t_s, place_m, int(turns[0])) if len(turns) else np.zeros(len(t_s), np.bool_)
        if not FEWEST_TURNS <= min(second.sum(), (~second).sum()) <= 2 * len(turns):
            return None
        offset_m = place_m[second] - _between(t_s[second], t_s[~second], place_m[~second])
        apart_m, rough_m = (float(np.median(np.linalg.norm(m, axis=1))) for m in (offset_m, np.diff(offset_m, axis=0)))
        if not max(LEAST_JUMP_M, ROUGHNESS * rough_m) < apart_m < 2 * np.median(far_m[turns]):
            return None
        kept = second if 2 * second.sum() > len(second) else ~second
        if like is not None and like.frame_id == self.parent:
            away_m = np.linalg.norm(pose[:, :3] - _between(t_ns, like.t_ns, like.position_m), axis=1)
            kept = second if np.median(away_m[second]) < np.median(away_m[~second]) else ~second
        self.t_ns, self.pose = t_ns[kept], pose[kept]
        return int(kept.sum()), int((~kept).sum()), apart_m

    def poses(self) -> set[tuple[float, ...]]:
        """All different poses, rounded."""
        return set(map(tuple, self.pose.round(4).tolist()))


class TransformTree:
    """All frames of a recording.

    configured: the robot's frame by configuration, empty: detected. seen: the frames that clouds and odometry are of;
    bodies: those of odometry alone.
    """

    def __init__(self, configured: str = "") -> None:
        self._edges: dict[tuple[str, str], Edge] = {}
        self.configured = configured
        self.seen: set[str] = set()
        self.bodies: set[str] = set()

    def add(self, topic: str, frame_id: str, child: str, t_ns: Int, pose: Float, *, static: bool = False) -> None:
        """Poses (N, 7) of child in frame_id, position and quaternion, at t_ns (N,), increasing.

        Of static ones the last holds, and they go before moving ones.
        """
        edge = self._edges.get((frame_id, child))
        if len(t_ns) and (edge is None or static or not edge.static):
            last = slice(-1, None) if static else slice(None)
            self._edges[frame_id, child] = Edge(frame_id, child, static, t_ns[last], pose[last], topic)

    def contradicts(self, other: TransformTree) -> bool:
        """Whether the other one has poses of its own for a transform of this one: it is of a robot with equal names."""
        pairs = [(edge.poses(), other._edges[key].poses()) for key, edge in self._edges.items() if key in other._edges]
        return any(2 * len(mine & others) < min(len(mine), len(others)) for mine, others in pairs)

    def __len__(self) -> int:
        return len(self._edges)

    @property
    def _moving(self) -> list[Edge]:
        return [edge for _, edge in sorted(self._edges.items()) if not edge.static]

    @property
    def frames(self) -> list[str]:
        """Every frame, sorted."""
        return sorted({frame for key in self._edges for frame in key})

    @property
    def base(self) -> str | None:
        """The robot's frame: the configured one; else the first of BASE_FRAMES that moves, or that occurs.

        One that moves in its parent goes before those that are fixed to it: base_footprint, if odom has base_link only
        through it. Of several robots the one that what is seen is fixed to. Without these names the only frame that
        moves in one of WORLD_FRAMES, or that odometry is of.
        """
        if self.configured:
            return self.configured
        frames = sorted(self.frames, key=lambda frame: frame.count("/"))
        named = [frame for name in BASE_FRAMES for frame in frames if is_named(frame, (name,))]
        if named:
            placed = [frame for frame in named if self.fixed_frame(frame) is not None]
            moved = [frame for frame in placed if not all(edge.is_still for edge in self.chain(frame)[-1:])]
            first = [*moved, *placed, *named][0]
            robots = [first, *self.other_robots(first)]
            near = (each for each in robots if any(self.static_transform(seen, each) is not None for seen in self.seen))
            return next(near, first)
        riders = {edge.child for edge in self._moving if is_named(edge.parent, WORLD_FRAMES)}
        riders = riders if len(riders) == 1 else self.bodies.intersection(self.frames)
        return riders.pop() if len(riders) == 1 else None

    def other_robots(self, base: str) -> list[str]:
        """Frames named as base is, but for their prefix, that move apart from it."""
        alike = [frame for frame in self.frames if frame != base and is_named(frame, (base.rsplit("/", 1)[-1],))]
        moving = [frame for frame in alike if self.fixed_frame(frame) is not None]
        return [frame for frame in moving if self.static_transform(frame, base) is None]

    def fixed_frame(self, base: str, configured: str = "map") -> str | None:
        """The frame in which base moves: the configured one, else the root of the tree that base hangs on.

        Else one of WORLD_FRAMES that hangs on base. None where base moves in no frame but the robot's own.
        """
        frames = self.frames
        roots = [edge.parent for edge in self.chain(base)[:1] if not is_named(edge.parent, BASE_FRAMES)]
        worlds = [frame for name in WORLD_FRAMES for frame in frames if is_named(frame, (name,))]
        return next((frame for frame in (configured, *roots, *worlds) if self.moving(base, frame)), None)

    def is_world(self, frame: str, base: str | None) -> bool:
        """Whether a frame is one in which the robot moves: above base, or with a name of WORLD_FRAMES."""
        chain = [] if base is None else self.chain(base)
        while chain and chain[-1].is_still:
            chain.pop()
        return is_named(frame, WORLD_FRAMES) or frame in [edge.parent for edge in chain]

    def connects(self, source: str, target: str) -> bool:
        """Whether transforms lead from one frame to the other."""
        return self._path(source, target, still_only=False) is not None

    def moving(self, child: str, frame: str) -> list[Edge]:
        """The transforms on topics of moving ones between two frames; none where the frames do not connect."""
        return [edge for edge, _ in self._path(child, frame, still_only=False) or [] if not edge.static]

    def chain(self, frame: str) -> list[Edge]:
        """The transforms from the root of a frame's tree down to it; of several parents the one with most poses."""
        above: dict[str, Edge] = {}
        for _, edge in sorted(self._edges.items()):
            if edge.child not in above or len(edge.t_ns) > len(above[edge.child].t_ns):
                above[edge.child] = edge
        found: list[Edge] = []
        while (upper := above.pop(frame, None)) is not None:
            found.insert(0, upper)
            frame = upper.parent
        return found

    def chains(self, base: str | None) -> list[list[Edge]]:
        """The chain of base, and that of each other frame with a transform over time, if none such hangs on it."""
        first = [] if base is None else self.chain(base)
        chains = [self.chain(edge.child) for edge in self._moving]
        inner = {id(edge) for chain in [*chains, first] for edge in chain[:-1]} | {id(edge) for edge in first}
        return [each for each in (first, *chains) if each and (each is first or id(each[-1]) not in inner)]

    def span_between_ns(self, child: str, frame: str) -> tuple[int, int] | None:
        """The first and the last instant that all transforms between two frames cover; None where none moves."""
        changing = self._changing(child, frame)
        return (int(max(e.t_ns[0] for e in changing)), int(min(e.t_ns[-1] for e in changing))) if changing else None

    def _changing(self, child: str, frame: str) -> list[Edge]:
        """Those that move between two frames; where all stand still, all."""
        moving = self.moving(child, frame)
        return [edge for edge in moving if not edge.is_still] or moving

    def span_ns(self) -> tuple[int, int] | None:
        """The first and the last instant of all transforms but the static ones; None without one."""
        ends = [end for edge in self._moving for end in edge.t_ns[[0, -1]].tolist()]
        return (min(ends), max(ends)) if ends else None

    def static_transform(self, source: str, target: str) -> Float | None:
        """(4, 4) transform_source_to_target through transforms that never change; None where these do not connect."""
        path = self._path(source, target, still_only=True)
        if path is None:
            return None
        transform = np.eye(4)
        for edge, upwards in path:
            step = transform_from_quat(edge.pose[0, :3], edge.pose[0, 3:])
            transform = (step if upwards else invert_transform(step)) @ transform
        return transform

    def pose_series(self, child: str, frame: str, at_ns: Int | None = None) -> PoseSeries | None:
        """Poses of child in frame at given instants, or at those of the busiest changing transform between them.

        All are interpolated there (straight lines and great arcs); times
        that not all of them cover are left out. None where the frames do not
        connect, nothing moves between them, or no time is covered by all.
        """
        from scipy.spatial.transform import Rotation  # slow to import, and few recordings need it

        path, changing = self._path(child, frame, still_only=False), self._changing(child, frame)
        if path is None or not changing:
            return None
        t_ns = max((edge.t_ns for edge in changing), key=len) if at_ns is None else at_ns
        for edge in changing:
            t_ns = t_ns[(t_ns >= edge.t_ns[0]) & (t_ns <= edge.t_ns[-1])]
        if len(t_ns) == 0:
            return None
        rotation, position = Rotation.identity(len(t_ns)), np.zeros((len(t_ns), 3))
        for edge, upwards in path:
            if edge in changing:
                turn, shift = _interpolated(edge.t_ns, edge.pose, t_ns)
            else:
                turn, shift = Rotation.from_quat(edge.pose[0, 3:]), edge.pose[0, :3]
            if not upwards:
                turn = turn.inv()
                shift = -turn.apply(shift)
            rotation, position = turn * rotation, turn.apply(position) + shift
        return PoseSeries(t_ns, position, rotation.as_quat(), frame, child)

    def _path(self, source: str, target: str, *, still_only: bool) -> list[tuple[Edge, bool]] | None:
        """Edges from source to target, each with whether it is walked from child to parent; shortest first."""
        if source == target:
            return []
        neighbours: dict[str, list[tuple[str, Edge, bool]]] = {}
        for (parent, child), edge in sorted(self._edges.items()):
            if not still_only or edge.is_still:
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


def _second_sender(t_s: Float, place_m: Float, begin: int) -> NDArray[np.bool_]:
    """(N,) which places (N, 3) lie nearest to where the last two of a second sender lead, first seen behind begin."""
    second = np.arange(len(t_s)) == begin + 1
    ways = [(t_s[row], place_m[row], np.zeros(3)) for row in (begin, begin + 1)]
    for row in range(begin + 2, len(t_s)):
        off_m = [np.linalg.norm(place_m[row] - last_m - mps * (t_s[row] - last_s)) for last_s, last_m, mps in ways]
        which = int(off_m[1] < off_m[0])
        last_s, last_m, _ = ways[which]
        ways[which] = t_s[row], place_m[row], (place_m[row] - last_m) / (t_s[row] - last_s)
        second[row] = which
    return second


def _between(t: Float | Int, known_t: Float | Int, known_m: Float) -> Float:
    """Places (N, 3) at t (N,), on straight lines between known ones."""
    return np.column_stack([np.interp(t, known_t, axis_m) for axis_m in known_m.T])


def _interpolated(known_ns: Int, poses: Float, t_ns: Int) -> tuple[Rotation, Float]:
    from scipy.spatial.transform import Rotation, Slerp

    start_ns = int(known_ns[0])
    known_s, wanted_s = seconds_since(known_ns, start_ns), seconds_since(t_ns, start_ns)
    position = _between(wanted_s, known_s, poses[:, :3])
    if len(known_ns) == 1:
        return Rotation.from_quat(np.repeat(poses[:, 3:], len(t_ns), axis=0)), position
    inside = np.clip(wanted_s, known_s[0], known_s[-1])
    return Slerp(known_s, Rotation.from_quat(poses[:, 3:]))(inside), position
