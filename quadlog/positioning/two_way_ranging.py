"""Double-sided two-way ranging: the distance between two radios from four intervals, each by its own clock.

A sends, B replies, A replies: A measures its round and its reply, B its own reply and its round. Times are (4,) or
(4, N) in s: round and reply of A, then round and reply of B.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from quadlog.messages import Float

LIGHT_MPS = 299_792_458.0


def measured_times(distance_m: ArrayLike, replies_s: tuple[float, float], clock_errors: tuple[float, float]) -> Float:
    """What A and B measure; replies_s: the true ones of A and B; clock_errors: shares, 2e-5 for 20 ppm."""
    flights_s = 2 * np.asarray(distance_m, dtype=np.float64) / LIGHT_MPS
    (reply_a_s, reply_b_s), (fast_a, fast_b) = replies_s, (1 + clock_errors[0], 1 + clock_errors[1])
    by_a = [(flights_s + reply_b_s) * fast_a, flights_s * 0 + reply_a_s * fast_a]
    return np.array([*by_a, (flights_s + reply_a_s) * fast_b, flights_s * 0 + reply_b_s * fast_b])


def general_range_m(times_s: Float) -> Float:
    """The range for replies of any length [Neirynck et al. 2016]; errs by half of the clocks' errors, times itself."""
    round_a, reply_a, round_b, reply_b = times_s
    range_m: Float = LIGHT_MPS * (round_a * round_b - reply_a * reply_b) / (round_a + reply_a + round_b + reply_b)
    return range_m


def averaged_range_m(times_s: Float) -> Float:
    """The mean of both sides' times of flight [Following].

    Errs by c |reply_a - reply_b| |error_a - error_b| / 4, whatever the distance.
    """
    round_a, reply_a, round_b, reply_b = times_s
    range_m: Float = LIGHT_MPS * (round_a - reply_a + round_b - reply_b) / 4
    return range_m
