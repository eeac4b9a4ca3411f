"""Double-sided two-way ranging: the distance between two radios from four intervals, each by its own clock.

A sends, B replies, A replies: A measures its round and its reply, B its own reply and its round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
LIGHT_MPS = 299_792_458.0


@dataclass(frozen=True, slots=True)
class TwoWayTimes:
    """Seconds, scalars or (N,): from sending to hearing the other (round), from hearing to sending (reply)."""

    round_a_s: ArrayLike
    reply_a_s: ArrayLike
    round_b_s: ArrayLike
    reply_b_s: ArrayLike

    @property
    def _arrays(self) -> tuple[Floats, Floats, Floats, Floats]:
        times = (self.round_a_s, self.reply_a_s, self.round_b_s, self.reply_b_s)
        round_a, reply_a, round_b, reply_b = (np.asarray(each, dtype=np.float64) for each in times)
        return round_a, reply_a, round_b, reply_b


def measured_times(
    distance_m: ArrayLike, replies_s: tuple[float, float], clock_errors: tuple[float, float]
) -> TwoWayTimes:
    """What A and B measure; replies_s: the true ones of A and B; clock_errors: shares, 2e-5 for 20 ppm."""
    there_and_back_s = 2 * np.asarray(distance_m, dtype=np.float64) / LIGHT_MPS
    (reply_a_s, reply_b_s), (fast_a, fast_b) = replies_s, (1 + clock_errors[0], 1 + clock_errors[1])
    return TwoWayTimes(
        (there_and_back_s + reply_b_s) * fast_a,
        reply_a_s * fast_a,
        (there_and_back_s + reply_a_s) * fast_b,
        reply_b_s * fast_b,
    )


def general_range_m(times: TwoWayTimes) -> Floats:
    """The range for replies of any length [Neirynck et al. 2016]; errs by half of the clocks' errors, times itself."""
    round_a, reply_a, round_b, reply_b = times._arrays
    return LIGHT_MPS * (round_a * round_b - reply_a * reply_b) / (round_a + reply_a + round_b + reply_b)


def averaged_range_m(times: TwoWayTimes) -> Floats:
    """The mean of both sides' times of flight [Following]; errs by the replies' difference, times that of the clocks.

    By c |reply_a - reply_b| |error_a - error_b| / 4, whatever the distance.
    """
    round_a, reply_a, round_b, reply_b = times._arrays
    return LIGHT_MPS * (round_a - reply_a + round_b - reply_b) / 4
