"""What the workers of a batch need, loaded once: they are copied from a process that has imported this module."""

from __future__ import annotations

import numpy as np
import pandas  # noqa: F401  pyarrow loads it for the first table

import quadlog.pipelines.batch.batch
import quadlog.pipelines.stages.control
import quadlog.pipelines.stages.maps
import quadlog.pipelines.stages.positions.position
import quadlog.pipelines.stages.report  # noqa: F401
from quadlog.mapping.goal_projection import reachable_cells

# The first call of any compiled function loads numba's compiler.
reachable_cells(np.zeros((1, 1), dtype=np.bool_), (0, 0))
