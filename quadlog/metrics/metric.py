"""One number of metrics.json."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float


@dataclass(frozen=True, slots=True)
class Metric:
    """A value, the number of samples it is made of, and its unit ("" for counts and shares)."""

    value: float
    n: int
    unit: str


Metrics = dict[str, Metric]


def finite(values: NDArray) -> Float:
    """The samples (M,) that exist: NaN and infinity mean that there was nothing to measure."""
    values = np.asarray(values, dtype=np.float64)
    return values[np.isfinite(values)]


def add_mean(metrics: Metrics, name: str, values: NDArray, unit: str) -> None:
    """The mean of the finite samples; nothing when there are none."""
    samples = finite(values)
    if len(samples):
        metrics[name] = Metric(float(np.mean(samples)), len(samples), unit)


def add_rmse(metrics: Metrics, name: str, values: NDArray, unit: str) -> None:
    """The root of the mean square of the finite samples; nothing when there are none."""
    samples = finite(values)
    if len(samples):
        metrics[name] = Metric(float(np.sqrt(np.mean(samples**2))), len(samples), unit)


def add_sample_std(metrics: Metrics, name: str, values: NDArray, unit: str) -> None:
    """The sample standard deviation (N - 1) of the finite samples; nothing with fewer than two."""
    samples = finite(values)
    if len(samples) > 1:
        metrics[name] = Metric(float(np.std(samples, ddof=1)), len(samples), unit)
