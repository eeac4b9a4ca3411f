"""Ctrl-C, which comes more than once: from the impatient, from a key held down, from a shell and from its terminal."""

from __future__ import annotations

import signal
import time
from types import FrameType

LAST_WORDS_S = 5.0
"""How long a worker that is stopped may take to clean up before it is killed."""

_taken_s = float("-inf")


def take_one_interrupt() -> None:
    """From now on further ones are ignored while workers clean up: amid that, one would leave them to themselves.

    Not for ever, since libraries exist that lose the first. A process that was started to ignore Ctrl-C still does.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _taken_s
    now_s = time.monotonic()
    if now_s - _taken_s >= LAST_WORDS_S:
        _taken_s = now_s
        signal.default_int_handler(number, frame)
