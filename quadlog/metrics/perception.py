"""How well points and cells of scans were classified, counted so that scans can be pooled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.classified_scan import PointClass

Bool = NDArray[np.bool_]
Labels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Detection:
    """How one kind of thing was detected among n_all: n_true are of it, n_called were taken for it, n_found both."""

    n_all: int
    n_true: int
    n_called: int
    n_found: int

    def __add__(self, other: Detection) -> Detection:
        return Detection(
            self.n_all + other.n_all,
            self.n_true + other.n_true,
            self.n_called + other.n_called,
            self.n_found + other.n_found,
        )

    @property
    def n_false(self) -> int:
        """Taken for it, and not of it."""
        return self.n_called - self.n_found

    @property
    def recall(self) -> float:
        """Share of the true ones that were found; NaN without any."""
        return self.n_found / self.n_true if self.n_true else np.nan

    @property
    def precision(self) -> float:
        """Share of the called ones that are true; NaN without any."""
        return self.n_found / self.n_called if self.n_called else np.nan

    @property
    def lost(self) -> float:
        """Share of the others that were taken for it; NaN without any."""
        return self.n_false / (self.n_all - self.n_true) if self.n_all > self.n_true else np.nan


def detect(is_true: Bool, is_called: Bool) -> Detection:
    """The detection of one kind of points (N,) or cells (rows, cols), all of which count. Shapes must be equal."""
    if is_true.shape != is_called.shape:
        raise ValueError(f"truth {is_true.shape} and calls {is_called.shape} differ in shape")
    return Detection(
        n_all=is_true.size,
        n_true=int(np.count_nonzero(is_true)),
        n_called=int(np.count_nonzero(is_called)),
        n_found=int(np.count_nonzero(is_true & is_called)),
    )


def ground_detection(truth: Labels, label: Labels) -> Detection:
    """Detection of the ground among points (N,) of PointClass."""
    return detect(truth == PointClass.GROUND, label == PointClass.GROUND)
