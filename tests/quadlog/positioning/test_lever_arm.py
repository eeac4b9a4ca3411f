from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from quadlog.positioning.lever_arm import base_to_tag, tag_to_base


def test_tag_is_where_a_rigid_transform_puts_it_and_back_again():
    rng = np.random.default_rng(0)
    base_m, yaw_rad = rng.uniform(-5, 5, (20, 2)), rng.uniform(-4, 4, 20)
    tag_m = base_to_tag(base_m, yaw_rad, -0.07, 0.14)
    rigid = base_m + Rotation.from_euler("z", yaw_rad[:, None]).apply([-0.07, 0.14, 0.0])[:, :2]
    np.testing.assert_allclose(tag_m, rigid)
    np.testing.assert_allclose(tag_to_base(tag_m, yaw_rad, -0.07, 0.14), base_m)
