"""Rows of the table foot-drift: means over seeds, and what a curve changes on the same seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from quadlog.messages import Float
from quadlog.pipelines.tables.drift_walks import BASELINE, Curve, Drifts, Task
from quadlog.pipelines.tables.judging import Interval
from quadlog.results.paper_rows import PaperRow


@dataclass(frozen=True, slots=True)
class Figure:
    """A metric, what a row calls it, its factor to the row's unit, and whether its size alone counts."""

    key: str
    called: str
    unit: str
    factor: float = 1.0
    size: bool = False

    def of(self, drifts: Drifts, robot: str, curve: Curve, seeds: Sequence[int]) -> Float:
        """(N,) by seed."""
        values = np.array([drifts[Task(robot, curve, seed)].figures[self.key] for seed in seeds])
        return self.factor * (np.abs(values) if self.size else values)


DRIFT = Figure("lateral_drift_m", "drift", "mm", 1e3, size=True)
TURN = Figure("yaw_rate_degps", "yaw rate", "°/s", size=True)
SIGNED_DRIFT = Figure("lateral_drift_m", "drift to the left", "mm", 1e3)
SIGNED_TURN = Figure("yaw_rate_degps", "yaw rate to the left", "°/s")
FORWARD = Figure("forward_m", "way forward", "m")
ROLL = Figure("roll_range_deg", "roll, peak to peak", "°")
PITCH = Figure("pitch_range_deg", "pitch, peak to peak", "°")
CLAIMED = {DRIFT: 40.0 - 280.0, TURN: 0.03 - 0.25}
"""What the paper's curve changes of sizes."""


def mean_interval(values: Float) -> tuple[float, Interval]:
    """Mean of N > 1 values and its 95 % interval after Student."""
    mean = float(np.mean(values))
    half = float(student.ppf(0.975, len(values) - 1)) * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return mean, (mean - half, mean + half)


def mean_row(drifts: Drifts, robot: str, curve: Curve, seeds: Sequence[int], figure: Figure, where: str) -> PaperRow:
    """The mean of a figure; where: how the row begins."""
    mean, interval = mean_interval(figure.of(drifts, robot, curve, seeds))
    return PaperRow(f"{where}: {figure.called} ({figure.unit})", mean, None, *interval)


def changes(drifts: Drifts, robot: str, curve: Curve, seeds: Sequence[int], figure: Figure) -> Float:
    """(N,) a figure with the curve less that of the baseline, by seed."""
    return figure.of(drifts, robot, curve, seeds) - figure.of(drifts, robot, BASELINE, seeds)


def change_row(
    drifts: Drifts, robot: str, curve: Curve, seeds: Sequence[int], figure: Figure, where: str, note: str = ""
) -> PaperRow:
    """What a curve changes. It reproduces where the interval lies wholly on the claimed side of 0.

    That the drift is smaller and the way longer is claimed; how much is in the columns.
    """
    mean, interval = mean_interval(changes(drifts, robot, curve, seeds, figure))
    verdict = side(interval)
    wanted = 1 if figure is FORWARD else -1
    paper = CLAIMED.get(figure)
    sentence = {0: "Our interval holds 0.", -wanted: "The other way round."}.get(verdict, "")
    quantity = f"{where}: change of {figure.called} ({figure.unit})"
    if paper is None and figure is not FORWARD:
        return PaperRow(quantity, mean, None, *interval, note=note)
    return PaperRow(
        quantity,
        mean,
        0.0 if paper is None else paper,
        *interval,
        verdict == wanted,
        " ".join(filter(None, ["Claimed: more than 0." if paper is None else "", note, sentence])),
    )


def side(interval: Interval) -> int:
    """-1 or 1 where the interval lies on one side of 0, else 0."""
    low, high = interval
    return -1 if high < 0 else int(low > 0)
