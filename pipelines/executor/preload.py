"""What the workers of a batch need, loaded once: they are copied from a process that has imported this module."""

from __future__ import annotations

import pandas  # noqa: F401  pyarrow loads it for the first table

import quadlog.pipelines.batch.batch
import quadlog.pipelines.stages.control
import quadlog.pipelines.stages.maps
import quadlog.pipelines.stages.positions.position
import quadlog.pipelines.stages.report  # noqa: F401
from quadlog.pipelines.executor.compilation import load_compiler

load_compiler()
