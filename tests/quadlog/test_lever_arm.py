from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from quadlog.geometry import base_covariance, base_to_tag, tag_to_base


def test_tag_is_where_a_rigid_transform_puts_it_and_back_again():
    rng = np.random.default_rng(0)
    base_m, yaw_rad = rng.uniform(-5, 5, (20, 2)), rng.uniform(-4, 4, 20)
    tag_m = base_to_tag(base_m, yaw_rad, -0.07, 0.14)
    rigid = base_m + Rotation.from_euler("z", yaw_rad[:, None]).apply([-0.07, 0.14, 0.0])[:, :2]
    np.testing.assert_allclose(tag_m, rigid)
    np.testing.assert_allclose(tag_to_base(tag_m, yaw_rad, -0.07, 0.14), base_m)


def test_what_yaw_adds_to_the_covariance_is_its_finite_difference():
    rng = np.random.default_rng(1)
    yaw_rad, std_rad, tag_m = rng.uniform(-4, 4, 20), rng.uniform(0, 0.3, 20), rng.uniform(-5, 5, (20, 2))
    ahead, behind = (tag_to_base(tag_m, yaw_rad + step, 0.3, -0.2) for step in (1e-6, -1e-6))
    slope = (ahead - behind) / 2e-6
    wanted = std_rad[:, None, None] ** 2 * slope[:, :, None] * slope[:, None, :]
    np.testing.assert_allclose(base_covariance(np.zeros((20, 2, 2)), yaw_rad, std_rad, 0.3, -0.2), wanted, atol=1e-9)


def test_covariance_of_base_is_the_scatter_of_many_draws():
    rng = np.random.default_rng(2)
    tag_covariance = np.array([[0.02, 0.01], [0.01, 0.03]])
    tag_m = rng.multivariate_normal([1.0, 2.0], tag_covariance, 200_000)
    base_m = tag_to_base(tag_m, 0.7 + 0.1 * rng.standard_normal(len(tag_m)), 0.8, 1.1)
    got = base_covariance(tag_covariance[None], np.array([0.7]), np.array([0.1]), 0.8, 1.1)[0]
    np.testing.assert_allclose(got, np.cov(base_m.T), rtol=0.02)


def test_a_tag_at_the_origin_of_base_gains_nothing_from_yaw():
    covariance = np.tile(0.01 * np.eye(2), (3, 1, 1))
    np.testing.assert_array_equal(base_covariance(covariance, np.zeros(3), np.full(3, 2.0), 0.0, 0.0), covariance)
