"""Distances from the times that two UWB radios stamp on each other's frames: two-way ranging.

A polls B, B responds, A closes with a final frame. Each radio counts on its own
clock, which is a little fast or slow (up to 20 ppm). With d the true distance,
e_A and e_B the clocks' relative errors and T_da, T_db the replies, the forms
err by

    double-sided (general)    d (e_A + e_B) / 2: at most 1 mm up to 50 m
    symmetric ("sum over 4")  c (T_db - T_da) (e_A - e_B) / 4 more: 2.1 m for 300 and 1000 us at +-20 ppm
    single-sided              c T_db (e_A - e_B) / 2: 1.8 m for 300 us at +-20 ppm

so the general form is the one to use; the others show what firmware that has
only those is worth. No log that quadlog reads holds such times without the
distance made from them: this is for logs of one's own.

>>> poll, response = ([2**40 - 9], [70]), ([19_169_350], [19_171_403])  # sent, received; A's counter starts again
>>> times = intervals_from_ticks(*poll, *response, final_sent=[83_069_003], final_received=[83_069_082])
>>> double_sided_range(times).range_m.round(2)
array([5.])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from quadlog.messages import Float, Int

SPEED_OF_LIGHT_IN_AIR_MPS = 299_792_458.0 / 1.0003
"""Air slows radio by 0.03 %, which is 15 mm at 50 m; weather moves that by a sixth of it. In space or a cable, pass
the speed there."""
TICK_S = 1 / (128 * 499.2e6)
"""What a DW1000 or DW3000 counts, about 15.65 ps."""
COUNTER_BITS = 40
"""Of these chips' counter, which starts again every 17.2 s. Firmware that keeps the low word only has 32: 67 ms."""


@dataclass(frozen=True, slots=True)
class TwoWayIntervals:
    """N exchanges, each time (N,) in seconds on the clock of the radio that measured it.

    round_a_s: A's poll sent until B's response received. reply_b_s: B's poll received until its response sent.
    round_b_s: B's response sent until A's final received. reply_a_s: A's response received until its final sent.
    """

    round_a_s: Float
    reply_b_s: Float
    round_b_s: Float
    reply_a_s: Float


@dataclass(frozen=True, slots=True)
class TwoWayRanges:
    """N distances, and which of them there are.

    range_m: (N,), NaN where not measured. Radios side by side can come out slightly below zero: noise, left in.
    measured: (N,) bool; the others are counted by cause. not_finite: a time or the result is no number;
    not_positive: a time is zero or below, or stamps are out of order.
    """

    range_m: Float
    measured: np.ndarray
    not_finite: int
    not_positive: int


def intervals_from_ticks(
    poll_sent: ArrayLike,
    poll_received: ArrayLike,
    response_sent: ArrayLike,
    response_received: ArrayLike,
    final_sent: ArrayLike,
    final_received: ArrayLike,
    *,
    tick_s: float = TICK_S,
    counter_bits: int = COUNTER_BITS,
) -> TwoWayIntervals:
    """Intervals from the raw counters (N,) of N exchanges; A sends poll and final, B the response.

    A counter may start again in between. An interval of more than half its
    period is taken for stamps out of order, and comes out negative.

    Raises TypeError for stamps that are no integers: a float64 of seconds since 1970 resolves 70 m.
    """

    def elapsed_s(earlier: ArrayLike, later: ArrayLike) -> Float:
        half = np.int64(1) << (counter_bits - 1)
        # Half a period is added before and taken away after, so that small steps back stay small and negative.
        return tick_s * ((_whole(later) - _whole(earlier) + half) % (2 * half) - half).astype(np.float64)

    return TwoWayIntervals(
        round_a_s=elapsed_s(poll_sent, response_received),
        reply_b_s=elapsed_s(poll_received, response_sent),
        round_b_s=elapsed_s(response_sent, final_received),
        reply_a_s=elapsed_s(response_received, final_sent),
    )


def double_sided_range(times: TwoWayIntervals, speed_mps: float = SPEED_OF_LIGHT_IN_AIR_MPS) -> TwoWayRanges:
    """(T_ra T_rb - T_da T_db) / (T_ra + T_rb + T_da + T_db), for any replies [Following, right form; Neirynck].

    With clocks off by e_A and e_B the distance is scaled by the harmonic mean
    of 1 + e_A and 1 + e_B, whatever the replies are.
    """
    ra, db, rb, da = _columns(times.round_a_s, times.reply_b_s, times.round_b_s, times.reply_a_s)
    with np.errstate(all="ignore"):
        flight_s = (ra * rb - da * db) / (ra + rb + da + db)
    return _ranges(speed_mps * flight_s, ra, db, rb, da)


def symmetric_range(times: TwoWayIntervals, speed_mps: float = SPEED_OF_LIGHT_IN_AIR_MPS) -> TwoWayRanges:
    """(T_ra - T_da + T_rb - T_db) / 4: good only where both replies last equally long [Neirynck]."""
    ra, db, rb, da = _columns(times.round_a_s, times.reply_b_s, times.round_b_s, times.reply_a_s)
    with np.errstate(all="ignore"):
        flight_s = (ra - da + rb - db) / 4
    return _ranges(speed_mps * flight_s, ra, db, rb, da)


def single_sided_range(
    round_a_s: ArrayLike, reply_b_s: ArrayLike, speed_mps: float = SPEED_OF_LIGHT_IN_AIR_MPS
) -> TwoWayRanges:
    """(T_ra - T_db) / 2 from rounds and replies (N,): two frames instead of three, and no defence against drift."""
    ra, db = _columns(round_a_s, reply_b_s)
    with np.errstate(all="ignore"):
        flight_s = (ra - db) / 2
    return _ranges(speed_mps * flight_s, ra, db)


def _whole(ticks: ArrayLike) -> Int:
    return np.atleast_1d(np.asarray(ticks)).astype(np.int64, casting="same_kind")


def _columns(*times: ArrayLike) -> tuple[Float, ...]:
    """The times as columns (N,) of equal length."""
    return tuple(np.broadcast_arrays(*(np.atleast_1d(np.asarray(each, np.float64)) for each in times)))


def _ranges(range_m: Float, *times: Float) -> TwoWayRanges:
    """Every exchange once: measured, or under the first cause why not."""
    finite = np.isfinite(range_m) & np.isfinite(times).all(axis=0)
    positive = np.min(times, axis=0, initial=np.inf) > 0
    measured = finite & positive
    return TwoWayRanges(
        range_m=np.where(measured, range_m, np.nan),
        measured=measured,
        not_finite=int((~finite).sum()),
        not_positive=int((finite & ~positive).sum()),
    )
