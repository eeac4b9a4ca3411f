"""How far ahead on its path a robot looks: always as far, or by the fuzzy rules [Tracking, eqs 17, 18]."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from quadlog.errors import UnknownName
from quadlog.following.fuzzy import CENTROIDS, Centroid, fuzzy_table, rule_tables


class Lookahead(NamedTuple):
    """The look-ahead distance, and the coefficients it came from: NaN when it is fixed."""

    l_m: float
    k_v: float
    k_w: float


class LookaheadControl(Protocol):
    """What gives a look-ahead at every tick."""

    def step(self, cross_track_m: float, dt_s: float, speed_mps: float) -> Lookahead:
        """For a robot cross_track_m left of its path, dt_s after the last step, walking at speed_mps."""

    def reset(self) -> None:
        """Forgets the last error: the path is another one."""


class FixedLookahead:
    """The same distance at every tick: the baseline of every comparison."""

    def __init__(self, l_m: float) -> None:
        if not (l_m > 0 and math.isfinite(l_m)):
            raise ValueError(f"look-ahead must be a positive distance, not {l_m}")
        self._lookahead = Lookahead(l_m, math.nan, math.nan)

    def step(self, cross_track_m: float, dt_s: float, speed_mps: float) -> Lookahead:
        return self._lookahead

    def reset(self) -> None:
        """There is nothing to forget."""


@dataclass(frozen=True, slots=True)
class FuzzySettings:
    """l = l0 + lambda_v k_v v^2 + lambda_w k_w v, with k = k0 + delta k(e, ec), within l_min_m .. l_max_m.

    e = gain_e_per_m times the distance to the path, or with `signed` the cross-track
    error; ec = gain_ec_s_per_m times its derivative, smoothed by a first-order filter
    of ec_filter_s (0: none). Both are clipped to [-3, 3].

    The defaults are the paper's where it prints something (l0 = 2, both tables, seven
    points). It prints no gains, scopes or limits: its universe is taken to be in metres
    and metres per second, and the limits lie outside what its rules reach up to 0.6 m/s.
    """

    l0_m: float = 2.0
    lambda_v: float = 1.0
    lambda_w: float = 1.0
    k_v0: float = 0.0
    k_w0: float = 0.0
    gain_e_per_m: float = 1.0
    gain_ec_s_per_m: float = 1.0
    signed: bool = False
    ec_filter_s: float = 0.0
    l_min_m: float = 0.5
    l_max_m: float = 5.0
    tables: str = "printed"
    centroid: Centroid = "points"

    def __post_init__(self) -> None:
        rule_tables(self.tables)
        if self.centroid not in CENTROIDS:
            raise UnknownName("centroid", self.centroid, CENTROIDS)
        if not 0 < self.l_min_m <= self.l_max_m < math.inf:
            raise ValueError(f"look-ahead limits must be 0 < l_min_m <= l_max_m, not {self.l_min_m}, {self.l_max_m}")
        if not 0 <= self.ec_filter_s < math.inf:
            raise ValueError(f"ec_filter_s must not be negative, and is {self.ec_filter_s}")


PAPER = FuzzySettings()
# What the rules are good for: only k_v acts and hardly the rate, so that a robot far from its path looks less far
# ahead; at 0.5 m/s a delta k_v of -1.5 takes l from l0 to l_min. A unicycle on the s-curve stays within 0.016 m of it
# in the mean, at a mean l of 1.66 m, and within 0.053 m at that l fixed: but a fixed l of 1 m gives 0.012 m, and
# with a noisy, late pose a walking robot's look-ahead chatters.
HONEST = FuzzySettings(
    lambda_v=4.0,
    lambda_w=0.0,
    gain_e_per_m=20.0,
    gain_ec_s_per_m=0.5,
    ec_filter_s=0.2,
    l_max_m=2.0,
    centroid="continuous",
)


class FuzzyLookahead:
    """The Mamdani look-ahead: shorter or longer by the tracking error and its rate."""

    def __init__(self, settings: FuzzySettings = PAPER) -> None:
        self.settings = settings
        self._table = fuzzy_table(settings.tables, settings.centroid)
        self.reset()

    def reset(self) -> None:
        """Forgets the last error, so that a new path's first one is no sudden change."""
        self._last_m = math.nan
        self._rate_mps = 0.0

    def step(self, cross_track_m: float, dt_s: float, speed_mps: float) -> Lookahead:
        """Raises ValueError for an error or a speed that is not finite, or a dt_s that is not positive."""
        if not (dt_s > 0 and math.isfinite(cross_track_m) and math.isfinite(speed_mps)):
            raise ValueError(f"no look-ahead for an error of {cross_track_m} m, {dt_s} s later, at {speed_mps} m/s")
        settings = self.settings
        error_m = cross_track_m if settings.signed else abs(cross_track_m)
        self._differentiate(error_m, dt_s)
        e, ec = settings.gain_e_per_m * error_m, settings.gain_ec_s_per_m * self._rate_mps
        delta_k_v, delta_k_w = self._table.at(e, ec)
        k_v, k_w = settings.k_v0 + delta_k_v, settings.k_w0 + delta_k_w
        l_m = settings.l0_m + settings.lambda_v * k_v * speed_mps**2 + settings.lambda_w * k_w * speed_mps
        return Lookahead(min(max(l_m, settings.l_min_m), settings.l_max_m), k_v, k_w)

    def _differentiate(self, error_m: float, dt_s: float) -> None:
        """The filtered rate, exact for an error whose slope is constant between the ticks; 0 at the first."""
        if not math.isnan(self._last_m):
            slope_mps = (error_m - self._last_m) / dt_s
            kept = math.exp(-dt_s / self.settings.ec_filter_s) if self.settings.ec_filter_s > 0 else 0.0
            self._rate_mps = kept * self._rate_mps + (1 - kept) * slope_mps
        self._last_m = error_m
