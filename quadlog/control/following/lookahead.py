"""How far ahead on its path a robot looks: always as far, or by the fuzzy rules [Tracking, eqs 17, 18]."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from quadlog.control.settings import PursuitSettings
from quadlog.messages import Int

Centroid = Literal["points", "continuous"]
SETS = ("NB", "NM", "NS", "ZO", "PS", "PM", "PB")
# The universe is [-LIMIT, LIMIT]; what lies outside counts as its border.
LIMIT = 3.0


def _sets(names: str) -> Int:
    """The numbers of sets, NB = 0."""
    return np.array([SETS.index(name) for name in names.split()], dtype=np.int64)


# Which set each pair of input sets gives: (2, 7, 7), of delta k_v and delta k_w; [:, e, ec].
# Tables 1 and 2, rows e and columns ec from NB to PB. Table 1's (NS, PM), PS between ZO and NS,
# is its only break of monotony. Table 2's centre, NS, shortens the look-ahead by lambda_w v without any error.
PRINTED: Int = _sets("""
    PB PB PB PB PM PS ZO
    PB PB PB PB PM ZO ZO
    PM PM PM PM ZO PS NS
    PM PM PS ZO NS NS NM
    PS PS ZO NS NM NM NM
    PS ZO NS NM NM NM NB
    ZO ZO NM NM NM NB NB

    PS PS ZO ZO ZO PB PB
    NS NS NS NS ZO NS PM
    NB NB NM NM NS PS PM
    NB NM NM NS NS NS PM
    NB NM NS NS ZO PS PS
    NM NS NS NS ZO PS PS
    NS ZO ZO ZO ZO PB PB
""").reshape(2, 7, 7)
# Table 1 with (NS, PM) = NS, which leaves no break. Table 2 is the textbook's fuzzy-PID table of delta K_d
# with rows and columns exchanged, but for five cells: these are the textbook's here, (NS, ZO) = NS, (NS, PS) = ZO,
# (ZO, PS) = ZO, (ZO, PM) = PS, (PB, NB) = PS, so that the rows NS .. PS rise throughout; and its centre is ZO,
# so that l_0 is the look-ahead of a robot without error. The exchange stays: nothing says which was tuned.
CORRECTED = PRINTED.copy()
CORRECTED[0][_sets("NS"), _sets("PM")] = _sets("NS")
CORRECTED[1][_sets("NS NS ZO ZO ZO PB"), _sets("ZO PS ZO PS PM NB")] = _sets("NS ZO ZO ZO PS PS")
TABLES = {"printed": PRINTED, "corrected": CORRECTED}


def infer(e: float, ec: float, tables: Int, centroid: Centroid = "points") -> tuple[float, float]:
    """(delta k_v, delta k_w) of an error and its rate, in units of the universe and clipped to it; exact.

    centroid: "points" is eq. 21 as printed, the mean of the seven centres by how far their sets hold; "continuous" is
    the centre of the area under the clipped sets on [-3, 3]. There NB and PB are half triangles: it stays within
    +-2.67. Raises ValueError for NaN.
    """
    if math.isnan(e) or math.isnan(ec):
        raise ValueError("fuzzy inference has no answer for NaN")
    # The sets i and i + 1 hold of e as far as 1 - f and f; j, g likewise of ec. So four rules fire.
    row, col = min(max(e, -LIMIT), LIMIT) + LIMIT, min(max(ec, -LIMIT), LIMIT) + LIMIT
    i, j = min(int(row), 5), min(int(col), 5)
    f, g = row - i, col - j
    fires = min(1 - f, 1 - g), min(1 - f, g), min(f, 1 - g), min(f, g)
    deltas = []
    for consequents in tables[:, i : i + 2, j : j + 2].reshape(2, 4).tolist():
        heights = [0.0] * 7
        for which, how_far in zip(consequents, fires, strict=True):
            heights[which] = max(heights[which], how_far)
        deltas.append(_area_centre(heights) if centroid == "continuous" else _mean_centre(heights))
    return deltas[0], deltas[1]


def _mean_centre(heights: list[float]) -> float:
    """Mean of the sets' centres, weighted by how far each of the seven holds."""
    return sum((k - LIMIT) * height for k, height in enumerate(heights)) / sum(heights)


def _area_centre(heights: list[float]) -> float:
    """Centre of the area under the seven sets, each clipped at its height.

    Between two centres, t from 0 to 1, the left set falls as min(a, 1 - t) and the right one rises as min(b, t); the
    upper of them is the left up to where they cross.
    """
    total = moment = 0.0
    for k, (a, b) in enumerate(pairwise(heights)):
        lower = min(a, b, 0.5)
        crossing = lower if a <= b else 1 - lower
        left_area, left_moment = _below_falling(a, crossing)
        right_area, right_moment = _below_falling(b, 1 - crossing)
        total += left_area + right_area
        moment += (k - LIMIT) * left_area + left_moment + (k + 1 - LIMIT) * right_area - right_moment
    return moment / total


def _below_falling(height: float, end: float) -> tuple[float, float]:
    """Area and first moment of min(height, 1 - t) over t from 0 to end."""
    flat = min(1 - height, end)
    area = height * flat + (end - flat) - (end * end - flat * flat) / 2
    moment = height * flat * flat / 2 + (end * end - flat * flat) / 2 - (end**3 - flat**3) / 3
    return area, moment


class Lookahead(NamedTuple):
    """The look-ahead distance, and the coefficients it came from: NaN when it is fixed."""

    l_m: float
    k_v: float
    k_w: float


class FixedLookahead:
    """The same distance at every tick: the baseline of every comparison."""

    def __init__(self, l_m: float) -> None:
        if not (l_m > 0 and math.isfinite(l_m)):
            raise ValueError(f"look-ahead must be a positive distance, not {l_m}")
        self._lookahead = Lookahead(l_m, math.nan, math.nan)

    def step(self, cross_track_m: float, dt_s: float, speed_mps: float) -> Lookahead:
        """The same, whatever the error."""
        return self._lookahead

    def reset(self) -> None:
        """There is nothing to forget."""


class FuzzyLookahead:
    """The Mamdani look-ahead: shorter or longer by the tracking error and its rate.

    l = l0 + lambda_v k_v v^2 + lambda_w k_w v, within l_min_m .. l_max_m: k_v and k_w by the rules, whose coefficients
    without error are 0 [eq. 18], of e, gain_e_per_m times the distance to the path, or with `signed` the cross-track
    error, and of ec, gain_ec_s_per_m times its derivative, smoothed by a first-order filter of ec_filter_s (0: none).
    """

    def __init__(self, settings: PursuitSettings) -> None:
        self.l0_m, self.settings = settings.lookahead_m, settings.fuzzy
        self.reset()

    def reset(self) -> None:
        """Forgets the last error, so that a new path's first one is no sudden change."""
        self._last_m = math.nan
        self._rate_mps = 0.0

    def step(self, cross_track_m: float, dt_s: float, speed_mps: float) -> Lookahead:
        """For a robot cross_track_m left of its path, dt_s after the last step, walking at speed_mps.

        Raises ValueError for an error or a speed that is not finite, or a dt_s that is not positive.
        """
        if not (dt_s > 0 and math.isfinite(cross_track_m) and math.isfinite(speed_mps)):
            raise ValueError(f"no look-ahead for an error of {cross_track_m} m, {dt_s} s later, at {speed_mps} m/s")
        settings = self.settings
        error_m = cross_track_m if settings.signed else abs(cross_track_m)
        self._differentiate(error_m, dt_s)
        e, ec = settings.gain_e_per_m * error_m, settings.gain_ec_s_per_m * self._rate_mps
        k_v, k_w = infer(e, ec, TABLES[settings.tables], settings.centroid)
        l_m = self.l0_m + settings.lambda_v_s2_per_m * k_v * speed_mps**2 + settings.lambda_w_s * k_w * speed_mps
        return Lookahead(min(max(l_m, settings.l_min_m), settings.l_max_m), k_v, k_w)

    def _differentiate(self, error_m: float, dt_s: float) -> None:
        """The filtered rate, exact for an error whose slope is constant between the ticks; 0 at the first."""
        if not math.isnan(self._last_m):
            slope_mps = (error_m - self._last_m) / dt_s
            kept = math.exp(-dt_s / self.settings.ec_filter_s) if self.settings.ec_filter_s > 0 else 0.0
            self._rate_mps = kept * self._rate_mps + (1 - kept) * slope_mps
        self._last_m = error_m


LookaheadControl = FixedLookahead | FuzzyLookahead
