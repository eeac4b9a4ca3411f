from __future__ import annotations

import numpy as np
import pytest

from quadlog.geometry import transform_from_rpy
from quadlog.lidar.classified_scan import PointClass
from quadlog.lidar.range_image_method import RangeImageSettings, classify_scan_range_image

MOUNT = transform_from_rpy(np.array([0.0, 0.0, 0.5]), 0.0, 0.0, 0.0)


def scattered(slope: float, box_height_m: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """20,000 points in base of a floor and of the top of a box of 2 m on it, and which are the box's."""
    random = np.random.default_rng(seed)
    xy_m = random.uniform(-8, 8, (20_000, 2))
    box = (np.abs(xy_m[:, 0] - 4) < 1) & (np.abs(xy_m[:, 1]) < 1)
    z_m = slope * xy_m[:, 0] + box_height_m * box + random.normal(0, 0.005, len(xy_m))
    return np.column_stack([xy_m, z_m]), box


@pytest.mark.parametrize("slope", [0.0, 0.15, np.tan(np.deg2rad(20))])
@pytest.mark.parametrize("box_height_m", [0.3, 0.8])
def test_a_floor_and_what_stands_on_it(slope: float, box_height_m: float) -> None:
    xyz_base_m, box = scattered(slope, box_height_m)
    result = classify_scan_range_image(
        (xyz_base_m - MOUNT[:3, 3]).astype(np.float32), None, MOUNT, RangeImageSettings()
    )
    assert result.route == "height_map"
    looked_at = result.label > PointClass.OUTLIER
    assert (result.label[looked_at & ~box] == PointClass.GROUND).mean() > 0.95
    inside = looked_at & box
    assert (result.label[inside] == PointClass.OBSTACLE).mean() > 0.95
    assert np.median(result.height_m[inside]) == pytest.approx(box_height_m, abs=0.1)
