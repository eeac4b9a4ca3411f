from __future__ import annotations

import numpy as np
import pytest

from quadlog.errors import AnchorsCollinear, MissingInput
from quadlog.positioning.fix.least_squares import complete_fixes, require_spread


def test_anchors_on_a_line_are_named():
    line_m = np.array([[0.0, 0.0, 1.0], [3.0, 3.01, 2.0], [9.0, 9.0, 1.0]])
    with pytest.raises(AnchorsCollinear, match="4, 7, 9 lie within") as caught:
        require_spread(np.array([4, 7, 9]), line_m, 0.1)
    assert caught.value.anchors == [4, 7, 9]
    assert "mirror image" in str(caught.value)
    assert "--set 'uwb.mirror=" in str(caught.value)
    line_m[1, 1] += 2
    require_spread(np.array([4, 7, 9]), line_m, 0.1)


def test_two_anchors_are_too_few(lab):
    with pytest.raises(MissingInput, match="2 UWB anchors are known, a fix needs three"):
        require_spread(np.array([0, 1]), lab.SQUARE_M[:2], 0.1)


def test_a_solution_is_judged_by_its_ranges(lab):
    """Residuals and their rms by hand; the dilution in the middle of a square of anchors is 1 on level ground."""
    anchors_m = np.array([[3, 3, 1], [-3, 3, 1], [-3, -3, 1], [3, -3, 1]], dtype=float)
    range_m = np.full((3, 4), np.sqrt(18)) + np.array([0.1, 0.2, np.nan, -0.2])
    position_m = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [np.nan, 0.0, 1.0]])
    covariance_m2 = np.tile(0.01 * np.eye(2), (3, 1, 1))
    covariance_m2[1] = np.nan
    fixes = complete_fixes(anchors_m, range_m, position_m, covariance_m2, 0.15)
    np.testing.assert_array_equal(fixes.solved, [True, False, False])
    np.testing.assert_array_equal(fixes.degenerate, [False, True, True])
    np.testing.assert_array_equal(fixes.outlier, [True, False, False])
    np.testing.assert_allclose(fixes.residual_m[0], [0.1, 0.2, np.nan, -0.2], atol=1e-12)
    assert fixes.residual_rms_m[0] == pytest.approx(np.sqrt(0.03))
    for numbers in (fixes.position_m, fixes.covariance_m2, fixes.z_m, fixes.z_std_m, fixes.hdop, fixes.residual_m):
        assert np.isnan(numbers[1:]).all()
    all_four = complete_fixes(anchors_m, np.full((1, 4), np.sqrt(18)), position_m[:1], covariance_m2[:1], 0.15)
    assert all_four.hdop[0] == pytest.approx(1.0)
    assert all_four.z_std_m[0] == 0


def test_a_solution_far_down_the_line_is_none():
    """From there all anchors lie in one direction: a fix could slide sideways without a residual."""
    anchors_m = np.array([[3, 3, 1], [-3, 3, 1], [0, -3, 1]], dtype=float)
    covariance_m2 = np.full((1, 2, 2), 1.0)
    fixes = complete_fixes(anchors_m, np.full((1, 3), 1e6), np.array([[1e6, 0, 1.0]]), covariance_m2, 0.15)
    assert fixes.degenerate[0]
