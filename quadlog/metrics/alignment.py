"""One trajectory brought onto another by a rigid motion, and whether their frames differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import quat_from_euler, yaw_from_quat
from quadlog.messages import NS_PER_S, Float, Int, PoseSeries
from quadlog.metrics.summary import Samples, finite_samples


def rigid_motion(position_m: Float, wanted_m: Float) -> tuple[Float, Float]:
    """The rotation (D, D) and shift (D,) that bring positions (N, D) nearest to those wanted (N, D) [Umeyama]."""
    mean_m, wanted_mean_m = position_m.mean(axis=0), wanted_m.mean(axis=0)
    u, _, vh = np.linalg.svd((wanted_m - wanted_mean_m).T @ (position_m - mean_m))
    mirrored = np.ones(len(u))
    mirrored[-1] = np.sign(np.linalg.det(u) * np.linalg.det(vh))
    rotation: Float = (u * mirrored) @ vh
    return rotation, wanted_mean_m - rotation @ mean_m


def align_rigidly(estimate: PoseSeries, reference: PoseSeries, axes: int = 3) -> PoseSeries:
    """M poses, moved rigidly so that they lie nearest to their M partners; axes: 2 turns them in the plane alone."""
    from scipy.spatial.transform import Rotation  # slow to import

    rotation = np.eye(3)
    rotation[:axes, :axes], _ = rigid_motion(estimate.position_m[:, :axes], reference.position_m[:, :axes])
    centred_m = estimate.position_m - estimate.position_m.mean(axis=0)
    quat_xyzw = (Rotation.from_matrix(rotation) * Rotation.from_quat(estimate.quat_xyzw)).as_quat()
    return PoseSeries(estimate.t_ns, centred_m @ rotation.T + reference.position_m.mean(axis=0), quat_xyzw)


def project_to_plane(trajectory: PoseSeries) -> PoseSeries:
    """The trajectory in the plane z = 0: heights, roll and pitch left out."""
    position_m = trajectory.position_m * np.array([1.0, 1.0, 0.0])
    return PoseSeries(trajectory.t_ns, position_m, quat_from_euler(yaw_from_quat(trajectory.quat_xyzw)))


LEAST_MOVED_M = 0.25
"""The rms by which another frame moves a track: what moves it by less is its noise, as a turn of a robot that stood."""
EXPLAINED = 0.5
MIN_PAIRS = 10
STRAIGHT = 0.7
"""Share of a way that goes one way as the body sees it; a difference as large is that of 41 degrees."""


@dataclass(frozen=True, slots=True)
class FrameOffset:
    """The best rigid motion onto a reference: rotation (2, 2), then shift_m (2,); rmse before_m it and after_m."""

    rotation: Float
    shift_m: Float
    before_m: float
    after_m: float


def find_frame_offset(position_m: Float, reference_m: Float) -> FrameOffset | None:
    """The best rigid motion of N positions (N, 2); rows with a NaN do not count; None of too few."""
    known = np.isfinite(position_m).all(axis=1) & np.isfinite(reference_m).all(axis=1)
    position_m, reference_m = position_m[known], reference_m[known]
    if len(position_m) < MIN_PAIRS:
        return None
    rotation, shift_m = rigid_motion(position_m, reference_m)
    after_m = rms(reference_m - position_m @ rotation.T - shift_m)
    return FrameOffset(rotation, shift_m, rms(reference_m - position_m), after_m)


def track_difference_samples(t_ns: Int, lidar_xy_m: Float, uwb_xy_m: Float) -> dict[str, Samples]:
    """Of lidar_uwb_rmse_m: distances of positions (N, 2), NaN where unknown, once a rigid motion has aligned them."""
    offset = find_frame_offset(lidar_xy_m, uwb_xy_m)
    if offset is None:
        return {}
    apart_m = np.hypot(*(lidar_xy_m @ offset.rotation.T + offset.shift_m - uwb_xy_m).T)
    return {"lidar_uwb_rmse_m": finite_samples(t_ns, apart_m, "rms")}


def mirror_words(position_m: Float, reference_m: Float) -> str | None:
    """A warning where positions (N, 2) fit the reference's only mirrored, as NED against ENU; None elsewhere."""
    fit, mirrored = (find_frame_offset(each, reference_m) for each in (position_m, position_m * [1.0, -1.0]))
    if fit is None or mirrored is None or mirrored.after_m > EXPLAINED * fit.after_m:
        return None
    # A straight walk that bends a little the wrong way is not mirrored.
    if fit.after_m < max(0.1, 0.1 * rms(position_m - position_m.mean(axis=0))):
        return None
    return (
        f"the reference fits the poses only mirrored (x and y swapped, as in NED against ENU): {fit.after_m:.2f} m "
        f"aligned, {mirrored.after_m:.2f} m mirrored; errors against it count that too"
    )


def yaw_offset_words(estimate: PoseSeries, reference: PoseSeries) -> str | None:
    """A warning where the reference's yaw lies otherwise to its course than that of the M poses; None elsewhere."""
    ours, theirs = _course_in_body(estimate), _course_in_body(reference)
    if abs(ours) < STRAIGHT or abs(theirs - ours) < STRAIGHT:
        return None
    off = f"{abs(np.degrees(np.angle(theirs / ours))):.0f} degrees off" if abs(theirs) >= STRAIGHT else "unrelated to"
    return f"the reference's yaw is {off} its course, that of the poses is not; rpe_rmse_m counts that too"


def _course_in_body(poses: PoseSeries) -> complex:
    """Mean direction of N poses' steps of a second, x forward, of length 1 if it is always the same."""
    ends = np.searchsorted(poses.t_ns, poses.t_ns + NS_PER_S)
    begins = np.flatnonzero(ends < len(poses.t_ns))
    steps_m = (poses.position_m[ends[begins], :2] - poses.position_m[begins, :2]) @ [1, 1j]
    in_body_m = steps_m * np.exp(-1j * yaw_from_quat(poses.quat_xyzw)[begins])
    return complex(in_body_m.sum() / max(np.abs(steps_m).sum(), 1e-9))


def frame_offset_words(offset: FrameOffset) -> str | None:
    """A warning where the rigid motion is large and explains at least half of the error; None elsewhere."""
    moved_m2 = offset.before_m**2 - offset.after_m**2
    if moved_m2 <= LEAST_MOVED_M**2 or offset.after_m > EXPLAINED * offset.before_m:
        return None
    turn_deg, (x_m, y_m) = np.degrees(np.arctan2(offset.rotation[1, 0], offset.rotation[0, 0])), offset.shift_m
    return (
        f"the reference seems to lie in another frame than the poses: map turned by "
        f"{turn_deg:.1f} degrees and then shifted by ({x_m:.2f}, {y_m:.2f}) m would bring the "
        f"error from {offset.before_m:.2f} to {offset.after_m:.2f} m; errors against it count that too"
    )


def rms(vectors_m: Float) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors_m**2, axis=1))))
