from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.stats import chi2

from quadlog.positioning.ellipses import CHI2_95, ellipse_95, radius_95


def test_ellipses_are_those_of_the_eigenvectors_and_radii_end_on_them():
    root = np.random.default_rng(5).normal(0, 0.3, (200, 2, 2))
    covariance_m2 = root @ root.transpose(0, 2, 1) + 1e-4 * np.eye(2)
    values, axes = np.linalg.eigh(covariance_m2)
    for semi_axis_m, k in zip(ellipse_95(covariance_m2), (1, 0), strict=True):
        assert_allclose(semi_axis_m, np.sqrt(chi2.ppf(0.95, 2) * values[:, k]))
        assert_allclose(radius_95(covariance_m2, axes[:, :, k]), semi_axis_m)
    error_m = np.random.default_rng(7).normal(size=(200, 2))
    end_m = error_m / np.hypot(*error_m.T)[:, None] * radius_95(covariance_m2, error_m)[:, None]
    assert_allclose(np.einsum("ni,nij,nj->n", end_m, np.linalg.inv(covariance_m2), end_m), CHI2_95)
    unknown = radius_95(
        np.stack([np.eye(2), np.eye(2), np.full((2, 2), np.nan)]), np.array([[0, 0], [np.nan] * 2, [1, 0]])
    )
    assert_allclose(unknown, [np.sqrt(CHI2_95), np.nan, np.nan])
