"""The statistical outlier filter [Following]: isolated points lie far from their nearest neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from quadlog.messages import Float
from quadlog.open3d_import import import_open3d


def statistical_outliers(xyz_m: Float, neighbours: int, std_ratio: float) -> NDArray[np.bool_]:
    """Which of the finite points (N, 3) are outliers: (N,) bool. [Following]

    D_i is the mean distance to the nearest `neighbours` points, the point
    itself excluded; a point stays when D_i <= mu + std_ratio * sigma over the
    whole cloud (sigma with N - 1). A cloud of no more than `neighbours`
    points has no such D_i and no outliers.
    """
    outlier = np.zeros(len(xyz_m), dtype=np.bool_)
    if len(xyz_m) <= neighbours:
        return outlier
    open3d = import_open3d()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.ascontiguousarray(xyz_m, dtype=np.float64)))
    # Open3D counts the point itself as its own nearest neighbour.
    _, kept = cloud.remove_statistical_outlier(nb_neighbors=neighbours + 1, std_ratio=std_ratio)
    outlier[:] = True
    outlier[np.asarray(kept, dtype=np.int64)] = False
    if _open3d_differs(outlier, xyz_m, neighbours, std_ratio):
        return _by_definition(xyz_m, neighbours, std_ratio)
    return outlier


def _open3d_differs(outlier: NDArray[np.bool_], xyz_m: Float, neighbours: int, std_ratio: float) -> bool:
    """Whether the cloud is one of the two kinds for which Open3D departs from the definition.

    It keeps 0 < D_i < mu + n sigma and leaves D_i = 0 out of sigma: it removes
    points that have enough exact duplicates, and (nearly) all points when
    their D_i are equal. Either shows in what it removed: by Cantelli's
    inequality no more than 1 / (1 + n^2) of anything lies n sigma above its mean.
    """
    removed = np.flatnonzero(outlier)
    if len(removed) * (1 + std_ratio**2) > len(xyz_m):
        return True
    if len(removed) <= neighbours:
        return False
    _, coincident = np.unique(xyz_m[removed], axis=0, return_counts=True)
    return bool(coincident.max() > neighbours)


def _by_definition(xyz_m: Float, neighbours: int, std_ratio: float) -> NDArray[np.bool_]:
    """The same in plain scipy: slower, without Open3D's exceptions."""
    distances_m, _ = cKDTree(xyz_m).query(xyz_m, neighbours + 1)
    mean_m = distances_m[:, 1:].mean(axis=1)
    limit_m = mean_m.mean() + std_ratio * mean_m.std(ddof=1)
    # A hair more: the mean of equal numbers may round to less than each of them.
    outlier: NDArray[np.bool_] = mean_m > limit_m * (1 + 1e-12)
    return outlier
