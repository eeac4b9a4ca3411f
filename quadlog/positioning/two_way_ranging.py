"""Double-sided two-way ranging: the distance between two radios from four intervals, each by its own clock.

A sends, B replies, A replies: A measures its round and its reply, then B its own, (4,) or (4, N) in s.
"""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float

LIGHT_MPS = 299_792_458.0


def measured_times(away_m: Float | float, replies_s: tuple[float, float], clock_errors: tuple[float, float]) -> Float:
    """What A and B measure; replies_s: the true ones of A and B; clock_errors: shares, 2e-5 for 20 ppm."""
    flights_s, (fast_a, fast_b) = 2 * away_m / LIGHT_MPS, np.add(clock_errors, 1)
    by_a = [(flights_s + replies_s[1]) * fast_a, flights_s * 0 + replies_s[0] * fast_a]
    return np.array([*by_a, (flights_s + replies_s[0]) * fast_b, flights_s * 0 + replies_s[1] * fast_b])


def general_range_m(times_s: Float) -> Float:
    """The range for replies of any length [Neirynck et al. 2016]; errs by half of the clocks' errors, times itself."""
    round_a, reply_a, round_b, reply_b = times_s
    return LIGHT_MPS * (round_a * round_b - reply_a * reply_b) / times_s.sum(axis=0)


def averaged_range_m(times_s: Float) -> Float:
    """The mean of both sides' times of flight [Following]; errs by c |Δreply| |Δerror| / 4, whatever the distance."""
    return LIGHT_MPS * (times_s[0] - times_s[1] + times_s[2] - times_s[3]) / 4
