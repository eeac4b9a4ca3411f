"""Rows of the tracking tables: means over seeds, ratios of walks on the same seeds, and how either is judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from quadlog.messages import Float
from quadlog.metrics.bootstrap import FEWEST_VALUES
from quadlog.pipelines.tables.judging import Interval, compare, share_interval
from quadlog.pipelines.tables.tracked_walks import Tracked
from quadlog.results.paper_rows import PaperRow


@dataclass(frozen=True, slots=True)
class Figure:
    """One of the figures of Tracked, what a row calls it, and by what it is multiplied to have the row's unit."""

    key: str
    called: str
    unit: str
    factor: float = 1.0

    def of(self, walks: Sequence[Tracked]) -> Float:
        """(N,) of the walks that have it."""
        values = self.factor * np.array([walk.of(self.key) for walk in walks])
        return values[np.isfinite(values)]


ETA = Figure("eta_m", "η", "m")
SIGMA = Figure("sigma_m", "σ", "m")
ETA_TIME = Figure("eta_time_m", "η beside the place in time", "m")
SIGMA_TIME = Figure("sigma_time_m", "σ beside the place in time", "m")
TIME = Figure("completion_time_s", "completion time", "s")
PITCH = Figure("pitch_rms_rad", "pitch rms", "°", math.degrees(1.0))
HEIGHT = Figure("height_rms_m", "height rms", "mm", 1e3)
YAW_ERROR = Figure("heading_rmse_rad", "yaw error, rms", "rad")
TORQUE = Figure("torque_max_nm", "largest joint torque", "N m")
SATURATED = Figure("torque_saturation_share", "share of torques at their limit", "1")
LOOKAHEAD = Figure("lookahead_mean_m", "mean look-ahead", "m")
LOOKAHEAD_RANGE = Figure("lookahead_range_m", "range of look-ahead", "m")


def mean_interval(values: Float) -> tuple[float, Interval | None]:
    """Mean over N seeds and its 95 % interval after Student, which starts no lower than 0; None for one seed."""
    mean = float(np.mean(values))
    if len(values) < 2:
        return mean, None
    half = _quantile(len(values)) * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return mean, (max(mean - half, 0.0), mean + half)


def ratio_interval(parts: Float, wholes: Float) -> tuple[float, Interval | None]:
    """Geometric mean of N paired ratios of positive figures and its 95 % interval, Student's of their logarithms."""
    logs = np.log(parts / wholes)
    middle = float(np.mean(logs))
    if len(logs) < 2:
        return math.exp(middle), None
    half = _quantile(len(logs)) * float(np.std(logs, ddof=1)) / math.sqrt(len(logs))
    return math.exp(middle), (math.exp(middle - half), math.exp(min(middle + half, 700.0)))


def _quantile(count: int) -> float:
    return float(student.ppf(0.975, count - 1))


def mean_row(
    where: str,
    figure: Figure,
    walks: Sequence[Tracked],
    paper: float | None = None,
    printed_step: float = 1.0,
    note: str = "",
    why_not: str = "",
) -> list[PaperRow]:
    """The mean of a figure over the walks that have it, judged where the paper prints it; no row when none has.

    Of fewer than FEWEST_VALUES walks the interval is so wide that it would hold almost any number: it does not judge.
    """
    values = figure.of(walks)
    if len(values) == 0:
        return []
    if len(values) < len(walks):
        note = " ".join(filter(None, [note, f"Of {len(values)} of {len(walks)} walks."]))
    quantity = f"{where}: {figure.called} ({figure.unit})"
    mean, interval = mean_interval(values)
    low, high = interval or (None, None)
    if paper is not None:
        judging = interval if len(values) >= FEWEST_VALUES else None
        row = compare(quantity, paper, printed_step, mean, judging, note, why_not)
        return [replace(row, low=low, high=high)]
    return [PaperRow(quantity, mean, None, low, high, note=note)]


def fall_row(where: str, walks: Sequence[Tracked]) -> PaperRow:
    """The share of walks that fell."""
    fell = sum(walk.of("fallen") == 1 for walk in walks)
    share, interval = share_interval(fell, len(walks))
    return PaperRow(f"{where}: share of walks that fall (1)", share, None, *interval, note=f"{fell} of {len(walks)}.")


def ratio_row(
    quantity: str,
    figure: Figure,
    parts: Sequence[Tracked],
    wholes: Sequence[Tracked],
    paper: float | None = None,
    note: str = "",
) -> list[PaperRow]:
    """A figure of one way of walking over another's, by seeds that have both.

    With a printed ratio above 1 it is judged: it reproduces where ours, and its interval, lie above 1. That holds for
    the order; how much is in the columns.
    """
    pairs = np.array([[a.of(figure.key), b.of(figure.key)] for a, b in zip(parts, wholes, strict=False)])
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    if len(pairs) == 0:
        return []
    ours, interval = ratio_interval(pairs[:, 0], pairs[:, 1])
    low, high = interval or (None, None)
    reproduces = None
    if paper is not None:
        assert paper >= 1
        reproduces = (ours if low is None else low) > 1
        if (ours if high is None else high) < 1:
            note = f"{note} Ours lies below 1."
        elif not reproduces:
            note = f"{note} Our interval holds 1 as well."
    if len(pairs) < len(parts):
        note = f"{note} Of {len(pairs)} seeds."
    return [PaperRow(quantity, ours, paper, low, high, reproduces, note.strip())]
