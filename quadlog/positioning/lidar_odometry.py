"""Where a lidar was, from its scans alone: each is matched with a voxel map of those before it, by [small_gicp].

The state is the pose in the middle of a sweep. Were it that of the sweep's first point, an error in speed would shift
the deskewed scan, the shift would make the next speed wrong the other way, and the track would swing up.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from quadlog.messages import Float, Float32, Int
from quadlog.positioning.heading.odometry_velocity import BodyMotion, motion_between

FEWEST_POINTS = 50
"""After thinning; a scan with fewer is no place."""
FEWEST_MATCHED = 0.4
"""Share of a scan's points that find their voxel, below which it shows another place than the map."""
FARTHEST_MATCH_M = 1.0
MAX_SPEED_MPS, MAX_TURN_RADPS = 5.0, np.pi
"""Faster than a quadruped is a wrong match."""
DEGENERATE_RATIO = 0.35
"""Least over greatest horizontal spread of the surfaces' normals: .2-.3 in a corridor, .5-.9 among trees or boxes."""
MAX_GAP_NS = 1_000_000_000
"""After a longer one the last speed says nothing."""


class ScanMatch(IntEnum):
    """How well a scan's pose is known."""

    MATCHED = 0
    DEGENERATE = 1  # surfaces face one way: along them the pose slides
    LOST = 2  # the pose is that of constant speed


@dataclass(frozen=True, slots=True)
class LidarOdometrySettings:
    """Points farther or nearer do not count; they are thinned to one per cube of thinned_m; voxel_m is the map's."""

    min_range_m: float = 0.5
    max_range_m: float = 60.0
    thinned_m: float = 0.5
    voxel_m: float = 0.5


@dataclass(frozen=True, slots=True)
class LidarTrack:
    """Poses in the frame of the first one: t_ns (N,), position_m (N, 3), rotation (N, 3, 3); match (N,) a ScanMatch."""

    t_ns: Int
    position_m: Float
    rotation: Float
    match: Int


class LidarOdometry:
    """The track of a lidar, scan by scan, as causal as the robot's own would be."""

    def __init__(self, settings: LidarOdometrySettings) -> None:
        import small_gicp  # only where a lidar has to tell the position

        self._settings, self._gicp = settings, small_gicp
        self._map = small_gicp.GaussianVoxelMap(settings.voxel_m)
        self._t_ns: list[int] = []
        self._poses: list[Float] = []
        self._match: list[ScanMatch] = []
        self._per_s: Float = np.zeros(6)

    def __len__(self) -> int:
        """Number of poses so far."""
        return len(self._t_ns)

    def take(self, t_ns: int, xyz_m: Float32, offset_ns: Int | None) -> None:
        """The next scan: points (N, 3) in upright axes about the robot, measured offset_ns (N,) after t_ns.

        A scan without times, None, is taken to have been measured at once. One that is no later than the last is left
        out.
        """
        middle_ns = t_ns if offset_ns is None or len(offset_ns) == 0 else t_ns + _middle(offset_ns)
        if self._t_ns and middle_ns <= self._t_ns[-1]:
            return
        points = self._thinned(xyz_m, None if offset_ns is None else t_ns + offset_ns - middle_ns)
        if not self._poses:
            if points is not None:
                self._keep(middle_ns, np.eye(4), ScanMatch.MATCHED, points)
            return
        gap_ns = middle_ns - self._t_ns[-1]
        if gap_ns > MAX_GAP_NS:
            self._per_s[:] = 0.0
        guess = self._poses[-1] @ _motion(self._per_s * (gap_ns * 1e-9))
        if points is None:
            self._keep(middle_ns, guess, ScanMatch.LOST, None)
            return
        pose, match = self._matched(points, guess, gap_ns)
        self._keep(middle_ns, pose, match, None if match is ScanMatch.LOST else points)

    def track(self) -> LidarTrack:
        """All of it so far."""
        poses = np.array(self._poses).reshape(-1, 4, 4)
        match = np.array(self._match, dtype=np.int64)
        return LidarTrack(np.array(self._t_ns, dtype=np.int64), poses[:, :3, 3], poses[:, :3, :3], match)

    def _thinned(self, xyz_m: Float32, since_middle_ns: Int | None) -> object | None:
        """small_gicp's cloud with normals and covariances, None of a scan with too little in it."""
        range2_m2 = np.einsum("ij,ij->i", xyz_m, xyz_m)
        near_m, far_m = self._settings.min_range_m, self._settings.max_range_m
        used = (range2_m2 > near_m * near_m) & (range2_m2 < far_m * far_m)  # NaN fails both comparisons
        points = xyz_m[used]
        if len(points) < FEWEST_POINTS:
            return None
        if since_middle_ns is not None and self._per_s.any():
            points = self._deskewed(points, (since_middle_ns[used] * 1e-9).astype(np.float32))
        thinned, _ = self._gicp.preprocess_points(points.astype(np.float64), self._settings.thinned_m, 10, 1)
        return thinned if thinned.size() >= FEWEST_POINTS else None

    def _deskewed(self, xyz_m: Float32, since_s: Float32) -> Float32:
        """Points (N, 3) at the instants since_s (N,) from the middle of the sweep, where they were in the middle."""
        speed_mps, turn_rad = self._per_s[:3].astype(np.float32), np.float32(self._per_s[5]) * since_s
        cos, sin = np.cos(turn_rad), np.sin(turn_rad)
        x_m, y_m, z_m = xyz_m.T
        moved = [cos * x_m - sin * y_m, sin * x_m + cos * y_m, z_m]
        return np.stack([each + speed * since_s for each, speed in zip(moved, speed_mps, strict=True)], axis=1)

    def _matched(self, points: object, guess: Float, gap_ns: int) -> tuple[Float, ScanMatch]:
        found = self._gicp.align(self._map, points, guess, FARTHEST_MATCH_M, 1, 20)
        pose = np.array(found.T_target_source)
        step, count = _vector(np.linalg.inv(self._poses[-1]) @ pose), points.size()  # type: ignore[attr-defined]
        per_s = np.abs(step) / (gap_ns * 1e-9)
        too_fast = np.hypot(*per_s[:2]) > MAX_SPEED_MPS or per_s[3:].max() > MAX_TURN_RADPS
        if not np.isfinite(pose).all() or too_fast or found.num_inliers < FEWEST_MATCHED * count:
            return guess, ScanMatch.LOST
        return pose, ScanMatch.DEGENERATE if _faces_one_way(points) else ScanMatch.MATCHED

    def _keep(self, t_ns: int, pose: Float, match: ScanMatch, points: object | None) -> None:
        if self._poses and match is not ScanMatch.LOST:
            step = np.linalg.inv(self._poses[-1]) @ pose
            self._per_s = _vector(step) / ((t_ns - self._t_ns[-1]) * 1e-9)
        if points is not None:
            self._map.insert(points, pose)
        self._t_ns.append(t_ns)
        self._poses.append(pose)
        self._match.append(match)


def body_motion(track: LidarTrack, *, causal: bool) -> BodyMotion | None:
    """Velocities between successive scans that are both matched well; None with fewer than two."""
    matched = track.match == ScanMatch.MATCHED
    usable = matched[1:] & matched[:-1] & (np.diff(track.t_ns) <= MAX_GAP_NS)
    yaw_rad = np.unwrap(np.arctan2(track.rotation[:, 1, 0], track.rotation[:, 0, 0]))
    return motion_between(track.t_ns, track.position_m[:, :2], yaw_rad, usable, "lidar", causal=causal)


def _middle(offset_ns: Int) -> int:
    return (int(offset_ns.min()) + int(offset_ns.max())) // 2


def _vector(motion: Float) -> Float:
    """(6,) shift and rotation vector of a transform (4, 4)."""
    from scipy.spatial.transform import Rotation

    return np.concatenate([motion[:3, 3], Rotation.from_matrix(motion[:3, :3]).as_rotvec()])


def _motion(vector: Float) -> Float:
    """The transform (4, 4) of what `_vector` gives."""
    from scipy.spatial.transform import Rotation

    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(vector[3:]).as_matrix()
    motion[:3, 3] = vector[:3]
    return motion


def _faces_one_way(points: object) -> bool:
    normals = np.asarray(points.normals())[:, :2]  # type: ignore[attr-defined]
    least, greatest = np.linalg.eigvalsh(normals.T @ normals)
    return bool(least < DEGENERATE_RATIO * greatest)
