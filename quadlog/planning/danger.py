"""Rings of danger around obstacles, for planners that keep away from them [Planning, section 2.3]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.inflation import inflate_square
from quadlog.planning.protocol import Bool


def danger_levels(blocked: Bool, rings: int) -> NDArray[np.int8]:
    """Dflag (rows, cols) int8: rings beside an obstacle, one less for each ring away, 0 beyond [Planning, eq. 9].

    A ring is made of the cells at one Chebyshev distance, which eq. 10 means and does not say: its `min` gives the
    cell three columns and one row away the distance 1.
    """
    levels = np.zeros(blocked.shape, dtype=np.int8)
    for ring in range(1, rings + 1):
        levels += inflate_square(blocked, ring)
    levels[blocked] = 0
    return levels
