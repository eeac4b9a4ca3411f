"""A grid of occupied cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Grid = NDArray[np.bool_]
"""(rows, cols), true in cells that are occupied."""
