"""The rigid motion that brings one trajectory onto another, and the plane they are compared in: evo's two options."""

from __future__ import annotations

import numpy as np

from quadlog.geometry import quat_from_yaw, yaw_from_quat
from quadlog.messages import Float
from quadlog.metrics.positioning import Trajectory

_RANK = 1e-9  # of the largest singular value


def align_rigidly(estimate: Trajectory, reference: Trajectory) -> Trajectory | None:
    """The estimate moved, without scaling, so that the sum of its squared distances from the reference is least.

    M poses each, in pairs [Umeyama]. None for poses on one line, about which any turn fits as well.
    """
    mean_m, true_mean_m = estimate.position_m.mean(axis=0), reference.position_m.mean(axis=0)
    u, singular, vh = np.linalg.svd((reference.position_m - true_mean_m).T @ (estimate.position_m - mean_m))
    if singular[1] <= _RANK * singular[0]:
        return None
    mirrored = np.diag([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vh))])
    from scipy.spatial.transform import Rotation  # slow to import

    turn = Rotation.from_matrix(u @ mirrored @ vh)
    position_m = turn.apply(estimate.position_m - mean_m) + true_mean_m
    return Trajectory(estimate.t_ns, position_m, (turn * Rotation.from_quat(estimate.quat_xyzw)).as_quat())


def project_to_plane(trajectory: Trajectory) -> Trajectory:
    """The trajectory in the plane z = 0: heights, roll and pitch left out."""
    position_m = trajectory.position_m * np.array([1.0, 1.0, 0.0])
    return Trajectory(trajectory.t_ns, position_m, quat_from_yaw(yaw_from_quat(trajectory.quat_xyzw)))


def aligned_square_m2(spread_m2: Float, other_spread_m2: Float, covariance_m2: Float) -> Float:
    """Mean squared distance (L,) that the best rigid motion leaves between the pairs of each of L sets [Umeyama].

    From what a set can be summed up in: the variances (L,) of both trajectories, as mean squared distances from
    their means, and covariance_m2 (L, 3, 3), one row for each axis of the first. On one line, too.
    """
    turned = np.linalg.svd(covariance_m2, compute_uv=False)
    turned[:, 2] *= np.sign(np.linalg.det(covariance_m2))
    left_m2: Float = np.maximum(spread_m2 + other_spread_m2 - 2 * turned.sum(axis=1), 0)
    return left_m2
