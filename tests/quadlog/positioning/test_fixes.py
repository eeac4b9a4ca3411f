from __future__ import annotations

import numpy as np
import pytest

from quadlog.errors import AnchorsCollinear, MissingInput
from quadlog.positioning.fixes import require_spread


def test_anchors_on_a_line_are_named():
    line_m = np.array([[0.0, 0.0, 1.0], [3.0, 3.01, 2.0], [9.0, 9.0, 1.0]])
    with pytest.raises(AnchorsCollinear, match="4, 7, 9 lie within") as caught:
        require_spread(np.array([4, 7, 9]), line_m, 0.1)
    assert caught.value.anchors == [4, 7, 9]
    line_m[1, 1] += 2
    require_spread(np.array([4, 7, 9]), line_m, 0.1)


def test_two_anchors_are_too_few(lab):
    with pytest.raises(MissingInput, match="2 UWB anchors are known, a fix needs three"):
        require_spread(np.array([0, 1]), lab.SQUARE_M[:2], 0.1)
