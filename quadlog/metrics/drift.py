"""How far a robot that is sent straight on goes aside, and how it sways meanwhile [Foot, Figs 5-6]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.metric import Metric, Metrics
from quadlog.planning.protocol import Bool


@dataclass(frozen=True, slots=True)
class TrottedWalk:
    """T samples of a walk along x, evenly spaced: x_m, y_m (T,), rpy_rad (T, 3), fallen (T,).

    rest: how many samples the robot rests before it trots; period: samples of one gait cycle, which the trot's number
    of samples after the first is a multiple of.
    """

    x_m: Float
    y_m: Float
    rpy_rad: Float
    fallen: Bool
    rest: int
    period: int


def drift_metrics(walk: TrottedWalk, period_s: float) -> Metrics:
    """forward_m, lateral_drift_m (left positive), yaw_rate_degps, the ranges of roll, pitch and yaw, and fallen.

    From the trot's first sample to its last, which are at the same instant of a cycle, so that swaying does not count.
    The yaw rate is the slope of the line that fits best the mean yaw of each cycle: fitted to single samples, what
    swings within a cycle would tilt it. A walk with a fall has its metrics like any other.
    """
    x_m, y_m = walk.x_m[walk.rest :], walk.y_m[walk.rest :]
    angles_deg = np.degrees(np.unwrap(walk.rpy_rad[walk.rest :], axis=0))
    cycles = (len(x_m) - 1) // walk.period
    if cycles < 2 or cycles * walk.period != len(x_m) - 1:
        raise ValueError(f"{len(x_m)} samples are no two or more whole cycles of {walk.period}, and one")
    means_deg = angles_deg[:-1, 2].reshape(cycles, walk.period).mean(axis=1)
    slope = np.polyfit(np.arange(cycles) * period_s, means_deg, 1)[0]
    metrics = {
        "lateral_drift_m": Metric(float(y_m[-1] - y_m[0]), len(y_m), "m"),
        "yaw_rate_degps": Metric(float(slope), cycles, "deg/s"),
        "forward_m": Metric(float(x_m[-1] - x_m[0]), len(x_m), "m"),
        "fallen": Metric(float(walk.fallen.any()), len(walk.fallen), ""),
    }
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        metrics[f"{name}_range_deg"] = Metric(float(np.ptp(angles_deg[:, axis])), len(angles_deg), "deg")
    return metrics
