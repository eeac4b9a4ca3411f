"""Messages of a 500 Hz device that a relay hands on in bursts: when they were sent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from quadlog.messages import TICKS
from quadlog.recordings.clocks.bursts import spread

SENT_S = np.arange(6000) * 0.002
RATE, MS = "at their usual rate", 100_000 + 1000 * SENT_S

CLOCKS: dict[str, tuple[Callable[[], np.ndarray], str, float]] = {
    "ms": (lambda: MS, "by the device's tick, in ms", 0.004),
    "us that wraps": (lambda: 1e6 * SENT_S + TICKS - 3e6, "by the device's tick, in us", 0.004),
    "ms, reset": (lambda: np.where(SENT_S < 5.001, MS, MS - MS[2501]), "by the device's tick, in ms", 0.004),
    "none": (lambda: np.full(6000, np.nan), RATE, 0.06),
    "still": (lambda: np.zeros(6000), RATE, 0.06),
    "of log times": (lambda: 1000 * np.ceil(SENT_S / 0.2) * 0.2, RATE, 0.06),
    "another unit": (lambda: 4000 * SENT_S, RATE, 0.06),
    "two devices in turns": (lambda: MS + np.where(np.arange(6000) % 2, 0, 77_777), RATE, 0.06),
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_device_has_its_own_clock_or_its_rate(clock: str) -> None:
    tick, how, most_s = CLOCKS[clock]
    logged_s = np.ceil(SENT_S / 0.2) * 0.2
    lost = (SENT_S > 6.0) & (SENT_S < 6.6)
    t_ns, said = spread(np.rint(1e9 * logged_s[~lost]).astype(np.int64), np.rint(tick()[~lost]) % TICKS)
    assert f"silences above 0.1 s, 12.0 s in all, 100% of the log) and are placed {how}" in said
    assert np.abs(1e-9 * t_ns - SENT_S[~lost])[200:].max() < most_s
    assert (np.diff(t_ns) > 0).all()
    assert (np.diff(t_ns) > 100_000_000)[200:].sum() == 1  # what was lost is no burst


def test_even_stamps_stay_as_they_are() -> None:
    t_ns = np.rint(1e9 * (SENT_S + np.random.default_rng(1).uniform(0, 0.001, 6000))).astype(np.int64)
    assert spread(t_ns, MS % TICKS) == (pytest.approx(t_ns), "")
    assert spread(t_ns[:1], MS[:1])[1] == spread(np.repeat(t_ns[:1], 9), MS[:9])[1] == ""
