"""Where a lidar was, from its scans alone: every scan is matched with a voxel map of those before it, by [small_gicp].

The state is the pose in the middle of a sweep. Were it that of the sweep's first point, an error in speed would shift
the deskewed scan, the shift would make the next speed wrong the other way, and the track would swing up.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from quadlog.geometry import transform_from_rpy, turned
from quadlog.messages import Float, Float32, Int
from quadlog.positioning.odometry import BodyMotion, motion_between

FEWEST_RETURNS_MATCHED, FEWEST_POINTS = 10, 30
"""Of a scan, and of what is left after thinning; scans with fewer are not matched."""
FEWEST_MATCHED = 0.5
"""Share of a scan's points that find their voxel, below which it shows another place than the map."""
FARTHEST_MATCH_M = 1.0
MAX_SPEED_MPS, MAX_TURN_RADPS = 5.0, np.pi
"""Faster than a quadruped is a wrong match."""
DEGENERATE_RATIO = 0.35
"""Least over greatest horizontal spread of the surfaces' normals: .2-.3 in a corridor, .5-.9 among trees or boxes."""
MOST_SCANS_UNSEEN = 100
"""What the map has not shown for so many scans is removed from it."""
MAX_GAP_NS = 1_000_000_000
"""After a longer one the last speed says nothing."""
FLAT_M = 0.001
"""RMS distance from a level plane below which a scan is that of a planar scanner: theirs are in it exactly."""
LEVEL = 0.9
"""Least upright part of that plane's normal: it is tilted by up to 25 degrees."""
NEIGHBOURS = 10
"""Points that a surface's normal is estimated from."""
STEP_RAD, STEP_M = 0.01, 0.005
"""A match whose last step was smaller is not improved further."""


class ScanMatch(IntEnum):
    """How well a scan's pose is known."""

    MATCHED = 0
    DEGENERATE = 1  # surfaces face one way: along them the pose slides
    LOST = 2  # no pose was measured; the one given is that of constant speed


VOXEL_M, THINNED_M, PLANAR_THINNED_M = 0.25, 0.25, 0.1
"""Cubes of the map, and those of which one point is matched, of scans in space and of those in a level plane. Where
points are thinned more coarsely than the map, the first scan leaves gaps in it, and the next ones are lost."""


@dataclass(frozen=True, slots=True)
class LidarTrack:
    """Poses in the frame of the first one: t_ns (N,), position_m (N, 3), rotation (N, 3, 3); match (N,) a ScanMatch."""

    t_ns: Int
    position_m: Float
    rotation: Float
    match: Int

    def measured(self) -> LidarTrack:
        """The same without the poses of lost scans."""
        rows = self.match != ScanMatch.LOST
        return LidarTrack(self.t_ns[rows], self.position_m[rows], self.rotation[rows], self.match[rows])


class LidarOdometry:
    """The track of a lidar, scan by scan, as causal as the robot's own would be."""

    def __init__(self, min_range_m: float = 0.3, max_range_m: float = 60.0) -> None:
        import small_gicp  # only where a lidar has to tell the position
        from scipy.spatial.transform import Rotation

        self._range2_m2, self._gicp, self._turns = (min_range_m**2, max_range_m**2), small_gicp, Rotation
        self._planar, self._map = False, small_gicp.GaussianVoxelMap(VOXEL_M)
        self._found: list[tuple[int, Float, ScanMatch]] = []
        self._per_s: Float = np.zeros(6)
        self._last_match: tuple[int, Float] = (0, np.eye(4))

    def __len__(self) -> int:
        """Number of poses so far."""
        return len(self._found)

    def take(self, t_ns: int, xyz_m: Float32, offset_ns: Int | None) -> None:
        """The next scan: points (N, 3) in upright axes about the robot, measured offset_ns (N,) after t_ns.

        A scan without times, None, counts as measured at once. One that is no later than the last is left out.
        """
        middle_ns = t_ns
        if offset_ns is not None and len(offset_ns):
            middle_ns += (int(offset_ns.min()) + int(offset_ns.max())) // 2
        if self._found and middle_ns <= self._found[-1][0]:
            return
        pose: Float = np.eye(4)
        clouds, match = self._thinned(xyz_m, offset_ns, middle_ns - t_ns), ScanMatch.MATCHED
        if self._found:
            last_ns, last_pose, _ = self._found[-1]
            if middle_ns - self._last_match[0] > MAX_GAP_NS:
                self._per_s[:] = 0.0
            moved, motion = self._per_s * ((middle_ns - last_ns) * 1e-9), np.eye(4)
            motion[:3, :3], motion[:3, 3] = self._turns.from_rotvec(moved[3:]).as_matrix(), moved[:3]
            guess = last_pose @ motion
            pose, match = self._matched(clouds[0], guess, middle_ns) if clouds else (guess, ScanMatch.LOST)
        elif not clouds:
            return
        if match is not ScanMatch.LOST:
            self._per_s = self._speed(middle_ns, pose) if self._found else self._per_s
            self._last_match = middle_ns, pose
            for cloud in clouds:
                self._map.insert(cloud, pose)
        self._found.append((middle_ns, pose, match))

    def track(self) -> LidarTrack:
        """All of it so far."""
        poses = np.array([pose for _, pose, _ in self._found]).reshape(-1, 4, 4)
        t_ns, match = (np.array([each[k] for each in self._found], dtype=np.int64) for k in (0, 2))
        return LidarTrack(t_ns, poses[:, :3, 3], poses[:, :3, :3], match)

    def _thinned(self, xyz_m: Float32, offset_ns: Int | None, middle_ns: int) -> tuple[object, ...]:
        """small_gicp's clouds: the one to match, then others for the map; none for a scan with too few points."""
        range2_m2 = np.einsum("ij,ij->i", xyz_m, xyz_m)
        near_m2, far_m2 = self._range2_m2
        used = (range2_m2 > near_m2) & (range2_m2 < far_m2)  # NaN fails both comparisons
        points = xyz_m[used]
        if len(points) < FEWEST_RETURNS_MATCHED:
            return ()
        if offset_ns is not None and self._per_s.any():
            since_s, per_s = ((offset_ns[used] - middle_ns) * 1e-9).astype(np.float32), self._per_s.astype(np.float32)
            points = turned(per_s[5] * since_s, points) + since_s[:, None] * per_s[:3]
        if not self._found and _is_planar(points):
            self._planar, self._map = True, self._gicp.GaussianVoxelMap(VOXEL_M)
            self._map.set_lru(2 * MOST_SCANS_UNSEEN)  # each scan is inserted twice
        parts, thinned_m = (_walls_and_points(points), PLANAR_THINNED_M) if self._planar else ((points,), THINNED_M)
        clouds = [self._gicp.preprocess_points(part.astype(np.float64), thinned_m, NEIGHBOURS, 1)[0] for part in parts]
        return tuple(clouds) if clouds[0].size() >= FEWEST_POINTS else ()

    def _matched(self, points: object, guess: Float, t_ns: int) -> tuple[Float, ScanMatch]:
        found = self._gicp.align(self._map, points, guess, FARTHEST_MATCH_M, 1, 20, STEP_RAD, STEP_M)
        pose = np.array(found.T_target_source)
        if self._planar:
            yaw_rad = np.arctan2(pose[1, 0], pose[0, 0])
            pose = transform_from_rpy(np.array([pose[0, 3], pose[1, 3], 0.0]), 0.0, 0.0, yaw_rad)
        per_s, count = np.abs(self._speed(t_ns, pose)), points.size()  # type: ignore[attr-defined]
        too_fast = np.hypot(*per_s[:2]) > MAX_SPEED_MPS or per_s[3:].max() > MAX_TURN_RADPS
        if not np.isfinite(pose).all() or too_fast or found.num_inliers < FEWEST_MATCHED * count:
            return guess, ScanMatch.LOST
        normals = np.asarray(points.normals())[:, :2]  # type: ignore[attr-defined]
        least, greatest = np.linalg.eigvalsh(normals.T @ normals)
        return pose, ScanMatch.DEGENERATE if least < DEGENERATE_RATIO * greatest else ScanMatch.MATCHED

    def _speed(self, t_ns: int, pose: Float) -> Float:
        """(6,) shift and rotation vector per second since the last match."""
        since_ns, matched = self._last_match
        moved = np.linalg.inv(matched) @ pose
        turn_rad = self._turns.from_matrix(moved[:3, :3]).as_rotvec()
        return np.concatenate([moved[:3, 3], turn_rad]) / ((t_ns - since_ns) * 1e-9)


def body_motion(track: LidarTrack, *, causal: bool) -> BodyMotion | None:
    """Velocities between successive scans that are both matched well; None with fewer than two."""
    matched = track.match == ScanMatch.MATCHED
    usable = matched[1:] & matched[:-1] & (np.diff(track.t_ns) <= MAX_GAP_NS)
    yaw_rad = np.unwrap(np.arctan2(track.rotation[:, 1, 0], track.rotation[:, 0, 0]))
    return motion_between(track.t_ns, track.position_m[:, :2], yaw_rad, usable, "lidar", causal=causal)


def _is_planar(xyz_m: Float32) -> bool:
    """Whether points (N, 3) lie in one plane that is about level."""
    spread_m2, axes = np.linalg.eigh(np.cov(xyz_m.T))
    return bool(spread_m2[0] < FLAT_M * FLAT_M and abs(axes[2, 0]) > LEVEL)


def _walls_and_points(xyz_m: Float32) -> tuple[Float32, Float32]:
    """Points of a planar scan (N, 3) as upright walls (3 N, 3), and as they are (N, 3), in one layer of cubes.

    Normals of walls lie in the plane. The bare points' covariances are round in it: with both in the map, a match is
    held along a wall, too, where by the walls alone it slides.
    """
    points_m = np.column_stack([xyz_m[:, :2], np.full(len(xyz_m), VOXEL_M / 2)])
    up_m = np.array([0.0, 0.0, PLANAR_THINNED_M], np.float32)
    return np.concatenate([points_m - up_m, points_m, points_m + up_m]), points_m
