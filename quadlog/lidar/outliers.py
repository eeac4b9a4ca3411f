"""The statistical outlier filter [Following]: isolated points lie far from their nearest neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.neighbours import mean_neighbour_distances
from quadlog.messages import Float

# A hair above the limit still counts as within it: the mean of equal numbers may round to less than each of them.
ROUNDING = 1e-12


def statistical_outliers(xyz_m: Float, neighbours: int, std_ratio: float) -> NDArray[np.bool_]:
    """Which of the finite points (N, 3) are outliers: (N,) bool. [Following]

    D_i is the mean distance to the nearest `neighbours` points, the point
    itself excluded; a point stays when D_i <= mu + std_ratio * sigma over the
    whole cloud (sigma with N - 1). A cloud of no more than `neighbours`
    points has no such D_i and no outliers.

    Open3D's filter finds the same set and is the tests' oracle, but on two
    kinds of clouds where it departs from the definition, because it keeps
    0 < D_i < mu + std_ratio * sigma: it removes points with enough exact
    duplicates, and all points when their D_i are equal.
    """
    if len(xyz_m) <= neighbours:
        return np.zeros(len(xyz_m), dtype=np.bool_)
    mean_m = mean_neighbour_distances(xyz_m, neighbours)
    limit_m = mean_m.mean() + std_ratio * mean_m.std(ddof=1)
    outlier: NDArray[np.bool_] = mean_m > limit_m * (1.0 + ROUNDING)
    return outlier
