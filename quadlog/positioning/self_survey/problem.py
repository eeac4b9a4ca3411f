"""The survey's input: an odometry cut into steps between knots, and ranges tied to the knots around them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from quadlog.geometry import base_to_tag, interpolate_poses, seconds_since, wrap_angle
from quadlog.messages import Float, Int

KNOT_M, KNOT_RAD, KNOT_S = 0.7, 0.6, 10.0
"""Between two knots the odometry walks, turns or stands for at most this; all three grow in a long log."""
MOST_KNOTS = 300
MOST_RANGES = 10_000
PATH_S = 0.5
"""Interval over which the length of the way is summed, so that noise of single poses is not counted as walked."""
VELOCITY_S = 0.2
"""Interval over which a tag's velocity is taken."""
MAX_GAP_S = 1.0
"""A range farther than this from the odometry's poses is left out."""


@dataclass(frozen=True, slots=True)
class OdometryPoses:
    """Poses of base in the odometry's own frame: t_ns (M,) strictly increasing, xy_m (M, 2), yaw_rad (M,).

    doubtful (M,): whether the odometry doubts the pose, None if it doubts none.
    """

    t_ns: Int
    xy_m: Float
    yaw_rad: Float
    doubtful: np.ndarray | None = None

    def at(self, t_ns: Int) -> Float:
        """(N, 3) x_m, y_m, yaw_rad at instants (N,), NaN farther than MAX_GAP_S from any pose."""
        xy_m, yaw_rad, _ = interpolate_poses(t_ns, self.t_ns, self.xy_m, self.yaw_rad, MAX_GAP_S)
        return np.column_stack([xy_m, yaw_rad])

    def doubtful_shares(self, t_ns: Int) -> Float:
        """(N - 1,) share of doubtful poses between successive instants (N,)."""
        if self.doubtful is None:
            return np.zeros(len(t_ns) - 1)
        row = np.searchsorted(self.t_ns, t_ns, side="right")
        doubtful = np.concatenate([[0], np.cumsum(self.doubtful)])[row]
        return np.diff(doubtful) / np.maximum(np.diff(row), 1)


@dataclass(frozen=True, slots=True)
class MeasuredRanges:
    """N ranges in time order: t_ns (N,), tag and anchor (N,) as indices of the tags and anchors, range_m (N,)."""

    t_ns: Int
    tag: Int
    anchor: Int
    range_m: Float

    def rows(self, rows: np.ndarray) -> MeasuredRanges:
        """Those of a mask or of indices."""
        return MeasuredRanges(self.t_ns[rows], self.tag[rows], self.anchor[rows], self.range_m[rows])


@dataclass(frozen=True, slots=True)
class RobotTags:
    """T tags on the robot: lever_m (T, 2) in base, height_m (T,) above the floor."""

    lever_m: Float
    height_m: Float


@dataclass(frozen=True, slots=True)
class SurveyProblem:
    """K knots on the way and N ranges between them; poses are relative to the first knot.

    knot_s (K,); knots (K, 3) x_m, y_m, yaw_rad by odometry. step (K - 1, 3) from knot to knot, in the axes of the
    first one; length_m, step_s and doubtful_share (K - 1,) of the steps. Of the ranges: t_s, tag, anchor, range_m (N,);
    knot (N,) the one before, share (N,) of the way to the next; before_m, after_m (N, 2) the tag in the axes of the
    knots before and after, velocity_mps (N, 2) by odometry in those of the one before; height_m (N,) of the tag.
    n_anchors: A.
    """

    knot_s: Float
    knots: Float
    step: Float
    length_m: Float
    step_s: Float
    doubtful_share: Float
    t_s: Float
    tag: Int
    anchor: Int
    range_m: Float
    knot: Int
    share: Float
    before_m: Float
    after_m: Float
    velocity_mps: Float
    height_m: Float
    n_tags: int
    n_anchors: int

    @property
    def way_m(self) -> float:
        """Length of the way by odometry."""
        return float(self.length_m.sum())

    def of_anchors(self, anchors: Int) -> SurveyProblem:
        """The same walk with the ranges to some anchors alone, which are numbered as in anchors (B,)."""
        number = np.full(self.n_anchors, -1)
        number[anchors] = np.arange(len(anchors))
        rows = number[self.anchor] >= 0
        per_range = ("t_s", "tag", "range_m", "knot", "share", "before_m", "after_m", "velocity_mps", "height_m")
        kept = {name: getattr(self, name)[rows] for name in per_range}
        return replace(self, anchor=number[self.anchor[rows]], n_anchors=len(anchors), **kept)

    def tag_places(self, knots: Float) -> Float:
        """(N, 2) where the tags were at each range, for knots (K, 3): between what the two knots around it say."""
        before = _moved(knots[self.knot], self.before_m)
        after = _moved(knots[self.knot + 1], self.after_m)
        places: Float = before + self.share[:, None] * (after - before)
        return places


def make_problem(
    odometry: OdometryPoses,
    ranges: MeasuredRanges,
    tags: RobotTags,
    n_anchors: int,
    most_ranges: int = MOST_RANGES,
) -> tuple[SurveyProblem, int]:
    """The problem, and the number of ranges left out because the odometry has no pose near them.

    Of more than most_ranges ranges an even selection of each link's is used. The odometry has two poses or more.
    """
    begin_ns, end_ns = int(odometry.t_ns[0]), int(odometry.t_ns[-1])
    pose = odometry.at(ranges.t_ns)
    used = np.isfinite(pose[:, 0]) & (ranges.t_ns >= begin_ns) & (ranges.t_ns <= end_ns)
    rows = np.flatnonzero(used)
    if len(rows) > most_ranges:
        rows = _even_selection(rows, ranges.tag[rows] * n_anchors + ranges.anchor[rows], most_ranges)
    kept, pose = ranges.rows(rows), pose[rows]
    knot_ns, length_m = _knots(odometry)
    knots = _held(odometry, knot_ns)
    origin = knots[0].copy()
    knot = np.clip(np.searchsorted(knot_ns, kept.t_ns, side="right") - 1, 0, len(knot_ns) - 2)
    tag_m = _tags_at(pose, tags, kept.tag)
    apart_ns = np.array([[-1], [1]]) * round(VELOCITY_S / 2 * 1e9)
    earlier_m, later_m = (
        _in_axes(knots[knot], _tags_at(_held(odometry, at_ns), tags, kept.tag)) for at_ns in kept.t_ns + apart_ns
    )
    problem = SurveyProblem(
        knot_s=seconds_since(knot_ns, begin_ns),
        knots=_relative(knots, origin),
        step=np.array([_relative(after[None], before)[0] for before, after in pairwise(knots)]),
        length_m=length_m,
        step_s=np.diff(seconds_since(knot_ns, begin_ns)),
        doubtful_share=odometry.doubtful_shares(knot_ns),
        t_s=seconds_since(kept.t_ns, begin_ns),
        tag=kept.tag,
        anchor=kept.anchor,
        range_m=kept.range_m,
        knot=knot,
        share=(kept.t_ns - knot_ns[knot]) / (knot_ns[knot + 1] - knot_ns[knot]),
        before_m=_in_axes(knots[knot], tag_m),
        after_m=_in_axes(knots[knot + 1], tag_m),
        velocity_mps=(later_m - earlier_m) / VELOCITY_S,
        height_m=tags.height_m[kept.tag],
        n_tags=len(tags.height_m),
        n_anchors=n_anchors,
    )
    return problem, int((~used).sum())


def _tags_at(poses: Float, tags: RobotTags, tag: Int) -> Float:
    """(N, 2) where tags (N,) are at poses (N, 3)."""
    x_m, y_m = tags.lever_m[tag].T
    return base_to_tag(poses[:, :2], poses[:, 2], x_m, y_m)


def _even_selection(rows: Int, link: Int, most: int) -> Int:
    """Of rows (N,) with their links (N,) about `most`: as many of every link, evenly spread, all of rare ones."""
    links, counts = np.unique(link, return_counts=True)
    limit = max(most // len(links), 1)
    kept = []
    for each, count in zip(links, counts, strict=True):
        mine = rows[link == each]
        kept.append(mine if count <= limit else mine[np.linspace(0, count - 1, limit).astype(np.int64)])
    return np.sort(np.concatenate(kept))


def _knots(odometry: OdometryPoses) -> tuple[Int, Float]:
    """Instants (K,) of the knots, and the way walked (K - 1,) between them."""
    begin_ns, end_ns = int(odometry.t_ns[0]), int(odometry.t_ns[-1])
    count = max(2, 1 + round((end_ns - begin_ns) * 1e-9 / PATH_S))
    t_ns = np.linspace(begin_ns, end_ns, min(count, 1 << 20)).astype(np.int64)
    pose = _held(odometry, t_ns)
    walked_m = np.hypot(*np.diff(pose[:, :2], axis=0).T)
    turned_rad = np.abs(wrap_angle(np.diff(pose[:, 2])))
    waited_s = np.diff(t_ns) * 1e-9
    spent = np.concatenate([[0.0], np.cumsum(walked_m / KNOT_M + turned_rad / KNOT_RAD + waited_s / KNOT_S)])
    pieces = int(np.clip(np.ceil(spent[-1]), 1, MOST_KNOTS - 1))
    at = np.unique(np.searchsorted(spent, np.linspace(0.0, spent[-1], pieces + 1) - 1e-9).clip(0, len(t_ns) - 1))
    way_m = np.concatenate([[0.0], np.cumsum(walked_m)])
    return t_ns[at], np.diff(way_m[at])


def _held(odometry: OdometryPoses, t_ns: Int) -> Float:
    """(N, 3) poses at instants within the odometry's span, interpolated over gaps of any length."""
    xy_m, yaw_rad, _ = interpolate_poses(t_ns, odometry.t_ns, odometry.xy_m, odometry.yaw_rad, np.inf)
    return np.column_stack([xy_m, yaw_rad])


def _in_axes(pose: Float, point_m: Float) -> Float:
    """Points (N, 2) seen from poses (N, 3)."""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x_m, y_m = (point_m - pose[:, :2]).T
    return np.column_stack([cos * x_m + sin * y_m, cos * y_m - sin * x_m])


def _relative(poses: Float, origin: Float) -> Float:
    """Poses (N, 3) seen from one pose (3,)."""
    xy_m = _in_axes(np.broadcast_to(origin, poses.shape), poses[:, :2])
    return np.column_stack([xy_m, wrap_angle(poses[:, 2] - origin[2])])


def _moved(pose: Float, point_m: Float) -> Float:
    """Points (N, 2) in the axes of poses (N, 3), seen from where the poses are given."""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x_m, y_m = point_m.T
    return np.column_stack([pose[:, 0] + cos * x_m - sin * y_m, pose[:, 1] + sin * x_m + cos * y_m])
