"""Pure pursuit: drive the arc that leads through a point of the path some way ahead [Tracking, section 3]."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from quadlog.control.following.path import FreeSpace, PathPosition, lookahead, nearest_between
from quadlog.errors import TooLarge
from quadlog.geometry import wrap_angle
from quadlog.messages import Float
from quadlog.planning.path import without_repeats

# Within this of its end the path has been walked.
ARRIVED_M = 0.05
# How hard the robot brakes towards the end of the path.
BRAKING_MPS2 = 0.5
# A look-ahead point farther to the side than this makes the robot slow down, until at 90 degrees it turns on the spot.
SHARP_TURN_RAD = math.pi / 4


class Command(NamedTuple):
    """Forward speed and yaw rate for the robot, and the look-ahead point in map that they lead to."""

    v_mps: float
    yaw_rate_radps: float
    lookahead_x_m: float
    lookahead_y_m: float


# Within this of its end, and of its length, a path counts as finished.
FINISHED_M = 0.1
# A robot that is pushed finds its place again so far behind and ahead of the last one.
BEHIND_M, AHEAD_M = 0.5, 1.0
# The look-ahead point lies at most so many look-aheads along the path: half a circle of that diameter.
# Farther it would only lie on a path that turns back, and the robot would leave out the turn.
REACH = math.pi / 2
# Two points of a user's path farther apart than this are a gap, not a straight.
GAP_M = 20.0
MAX_POINTS = 1_000_000
# Coordinates beyond this are no metres in a map, and their squares no distances.
FARTHEST_M = 1e6


class FollowState(NamedTuple):
    """Where the robot is on its path.

    near: the nearest point; near.distance_m is the cross-track error, left positive.
    progress_m, remaining_m: length of the path before and after it.
    heading_error_rad: the robot's yaw less the path's heading, in [-pi, pi); NaN on a path of one place.
    finished: the path's end is reached within FINISHED_M.
    """

    near: PathPosition
    progress_m: float
    remaining_m: float
    heading_error_rad: float
    finished: bool

    @property
    def error_m(self) -> float:
        """Distance to the path."""
        return abs(self.near.distance_m)


def checked_path(points: ArrayLike) -> Float:
    """A path (K, 2) in map, K >= 2, that can be walked: points repeated one after the other are dropped.

    Two points up to GAP_M apart are joined by a straight line. Raises ValueError, with the
    reason, for what is no path: a wrong shape, a coordinate that is no number or beyond
    FARTHEST_M, a single place, or a gap; and TooLarge.
    """
    try:
        path: Float = np.array(points, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise ValueError("a path is a list of points x, y in metres") from None
    if path.ndim != 2 or path.shape[1] != 2 or len(path) == 0:
        raise ValueError(f"a path is a list of points x, y in metres, not an array of shape {path.shape}")
    if len(path) > MAX_POINTS:
        raise TooLarge("points of the path", len(path), MAX_POINTS)
    bad = np.flatnonzero(~(np.abs(path) <= FARTHEST_M).all(axis=1))
    if len(bad):
        x, y = path[bad[0]]
        raise ValueError(f"point {bad[0] + 1} of the path, ({x:g}, {y:g}), is no place in metres")
    path = without_repeats(path)
    if len(path) == 1:
        raise ValueError("a path needs two different points; this one stays at ({:g}, {:g})".format(*path[0]))
    steps_m = np.hypot(*np.diff(path, axis=0).T)
    if steps_m.max() > GAP_M:
        i = int((steps_m > GAP_M).argmax())
        (x, y), (next_x, next_y) = path[i], path[i + 1]
        raise ValueError(
            f"the path has a gap of {steps_m[i]:.1f} m from ({x:g}, {y:g}) to ({next_x:g}, {next_y:g}); "
            f"points may lie up to {GAP_M:g} m apart"
        )
    return path


class PathFollower:
    """Follows a path (K, 2) in map from start_m along it on; K >= 1, points may repeat.

    space: where the robot may cut across; None for anywhere.
    """

    def __init__(self, path: Float, start_m: float = 0.0, space: FreeSpace | None = None) -> None:
        self._space = space
        self.path = np.array(path, dtype=np.float64, order="C")
        steps_m = np.hypot(*np.diff(self.path, axis=0).T)
        self._arc_m: list[float] = [0.0, *np.cumsum(steps_m).tolist()]
        self.length_m = self._arc_m[-1]
        self._end_m = (float(self.path[-1, 0]), float(self.path[-1, 1]))
        self._progress_m = min(max(start_m, 0.0), self.length_m)
        self._ahead_m = self._progress_m

    def step(self, x_m: float, y_m: float, yaw_rad: float) -> FollowState:
        """The robot's place on the path: the nearest point between BEHIND_M behind the last one and what is ahead.

        Ahead is AHEAD_M, or the last look-ahead point, where pursue sent the robot.
        """
        low = self._place(self._progress_m - BEHIND_M)
        high = self._place(max(self._progress_m + AHEAD_M, self._ahead_m))
        near = nearest_between(self.path, low, high, x_m, y_m)
        arc_m, i = self._arc_m, near.segment
        if i + 1 < len(arc_m):
            self._progress_m = arc_m[i] + near.fraction * (arc_m[i + 1] - arc_m[i])
        remaining_m = self.length_m - self._progress_m
        to_end_m = math.hypot(self._end_m[0] - x_m, self._end_m[1] - y_m)
        finished = max(remaining_m, to_end_m) <= FINISHED_M
        return FollowState(near, self._progress_m, remaining_m, float(wrap_angle(yaw_rad - near.heading_rad)), finished)

    def pursue(
        self,
        x_m: float,
        y_m: float,
        yaw_rad: float,
        state: FollowState,
        lookahead_m: float,
        speed_mps: float,
        max_yaw_rate_radps: float,
    ) -> Command:
        """The command for the pose in map whose state the last step gave.

        Curvature 2 y_l / l^2, y_l being how far left the look-ahead point lies and l its distance: lookahead_m, less
        near the path's end. In curves tighter than the yaw rate allows the robot goes slower, so it stays on the arc.
        """
        ahead_x, ahead_y, along_m = lookahead(
            self.path, x_m, y_m, state.near, lookahead_m, REACH * lookahead_m, self._space
        )
        self._ahead_m = state.progress_m + along_m
        to_walk_m = max(state.remaining_m, math.hypot(self._end_m[0] - x_m, self._end_m[1] - y_m))
        distance_m = math.hypot(ahead_x - x_m, ahead_y - y_m)
        if to_walk_m <= ARRIVED_M or distance_m == 0:
            return Command(0.0, 0.0, ahead_x, ahead_y)

        bearing = float(wrap_angle(math.atan2(ahead_y - y_m, ahead_x - x_m) - yaw_rad))
        # Behind the robot the arc would lead away from the point; it then turns as hard as for one at its side.
        curvature = 2 * math.sin(min(max(bearing, -math.pi / 2), math.pi / 2)) / distance_m
        speed = min(speed_mps, math.sqrt(2 * BRAKING_MPS2 * to_walk_m))
        if abs(curvature) * speed > max_yaw_rate_radps:
            speed = max_yaw_rate_radps / abs(curvature)
        forward = min(max(math.cos(bearing) / math.cos(SHARP_TURN_RAD), 0.0), 1.0)
        return Command(speed * forward, curvature * speed, ahead_x, ahead_y)

    def reference_at(self, s_m: float) -> tuple[float, float]:
        """(x_m, y_m) of the point s_m along the path, or of its end: where a reference is that walks for s_m."""
        segment, fraction = self._place(s_m)
        (x, y), (next_x, next_y) = self.path[[segment, min(segment + 1, len(self.path) - 1)]].tolist()
        return x + fraction * (next_x - x), y + fraction * (next_y - y)

    def _place(self, s_m: float) -> tuple[int, float]:
        """(segment, fraction) of the point s_m along the path."""
        arc_m = self._arc_m
        last = max(len(arc_m) - 2, 0)
        if s_m <= 0:
            return 0, 0.0
        if s_m >= self.length_m:
            return last, 1.0
        segment = bisect_right(arc_m, s_m) - 1
        return segment, (s_m - arc_m[segment]) / (arc_m[segment + 1] - arc_m[segment])
