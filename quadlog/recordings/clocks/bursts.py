"""When messages were sent whose stamps come in bursts, as over a relay: by the device's own clock, else by its rate."""

from __future__ import annotations

import numpy as np

from quadlog.messages import TICKS, Float, Int
from quadlog.recordings.formatting import several

SHORT, MOST_SHORT = 0.25, 0.05
"""More steps than the second share that are shorter than the first part of the usual step are bursts."""
AT_RATE = 0.9
"""Of the usual step, by which a burst is spread: an even stretch stays as it is."""
SILENCE_S, PAUSE_S, DELAY_S = 0.1, 1.0, 10.0
"""A silence is longer, a pause of the log too; the shortest delay within so long counts, for clocks drift apart."""
UNITS_S = {"ms": 1e-3, "us": 1e-6}
MOST_UNFIT, UNIT_OFF = 0.01, 0.1
"""Ticks of more messages that stand still or leap, or of another unit, are no clock."""


def spread(t_ns: Int, tick: Float) -> tuple[Int, str]:
    """Times (N,) of messages stamped in bursts (N,), and words for how they are known; "" where stamps are even.

    Stamps are in the order of messages. tick: (N,) of the device's clock, modulo TICKS, NaN without one. Time in which
    a message waited is taken back; where messages are missing, a silence stays.
    """
    t_s = (t_ns - t_ns[:1]) * 1e-9
    step_s = np.diff(t_s)
    heard_s = np.minimum(step_s, PAUSE_S).sum()
    if heard_s <= 0 or (step_s < 0).any():
        return t_ns, ""
    rows = min(max(round(len(step_s) / heard_s), 1), len(step_s))
    usual_s = float(np.median(t_s[rows:] - t_s[:-rows])) / rows
    share = float((step_s < SHORT * usual_s).mean())
    if share <= MOST_SHORT:
        return t_ns, ""
    how, sent_s = _by_tick(t_s, tick, usual_s)
    if not how:
        how, sent_s = f"at their usual rate, {1e3 * usual_s:.1f} ms apart", _at_rate(t_s, usual_s)
    silent_s = step_s[step_s > SILENCE_S]
    silences = f"{several(len(silent_s), 'silence')} above {SILENCE_S:g} s, {silent_s.sum():.1f} s in all"
    text = f"{share:.0%} of the steps below a quarter of the usual one; {silences}, "
    text += f"{silent_s.sum() / t_s[-1]:.0%} of the log) and are placed {how}"
    return t_ns[0] + np.rint(sent_s * 1e9).astype(np.int64), text


def _at_rate(t_s: Float, usual_s: float) -> Float:
    """Times (N,) no closer than AT_RATE of the usual step, none later than it was, and smooth between silences."""
    from scipy.ndimage import uniform_filter1d  # slow to import

    longest_s, even_s = float(np.diff(t_s).max()), usual_s * np.arange(len(t_s))
    soon_s = AT_RATE * even_s
    sent_s = np.maximum(np.minimum.accumulate((t_s - soon_s)[::-1])[::-1] + soon_s, t_s - longest_s)
    around = round(min(longest_s, PAUSE_S) / usual_s) | 1
    for part in np.split(np.arange(len(t_s)), np.flatnonzero(np.diff(sent_s) > SILENCE_S) + 1):
        sent_s[part] = even_s[part] + uniform_filter1d((sent_s - even_s)[part], around, mode="nearest")
    return sent_s


def _by_tick(t_s: Float, tick: Float, usual_s: float) -> tuple[str, Float]:
    """Times (N,) by a clock of one of UNITS_S, which may wrap and be reset; "" in front where it is none."""
    from scipy.ndimage import minimum_filter1d, uniform_filter1d

    step_s, ticks, around = np.diff(t_s), np.diff(tick) % TICKS, round(DELAY_S / usual_s) | 1
    for unit, unit_s in UNITS_S.items():
        fits = (ticks > 0) & (np.abs(ticks * unit_s - step_s) < PAUSE_S)
        off_s, lasted_s = abs((ticks * unit_s - step_s)[fits].sum()), step_s[fits].sum()
        if (~fits).sum() <= max(MOST_UNFIT * len(fits), 1) and off_s < UNIT_OFF * lasted_s:
            sent_s = np.append(0.0, np.cumsum(np.where(fits, ticks * unit_s, step_s)))
            for part in np.split(np.arange(len(t_s)), np.flatnonzero(~fits) + 1):
                delay_s = minimum_filter1d(t_s[part] - sent_s[part], around)
                sent_s[part] += uniform_filter1d(delay_s, around, mode="nearest")
            return f"by the device's tick, in {unit}", sent_s
    return "", t_s
