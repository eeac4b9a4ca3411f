"""Stamps that go back: a clock that was set back stamps a stretch of time that was stamped before."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Int
from quadlog.recordings.clock import AGREEING_STRAYS

REORDERED_NS = 50_000_000
"""Messages may overtake one another by so much without a clock being at fault."""


def backward_steps(t_ns: Int) -> Int:
    """Rows (K,) at which stamps (N,), as logged, go back by more than REORDERED_NS."""
    return np.flatnonzero(np.diff(t_ns) < -REORDERED_NS) + 1


def repeated_rows(t_ns: Int) -> np.ndarray:
    """(N,) bool: the rows to leave out, so that stamps (N,), as logged, go on but for what REORDERED_NS allows.

    After a step back, rows are left out until the stamps pass what was
    covered before: what came first stays, so that all senders on one clock
    lose the same stretch. Only where fewer than AGREEING_STRAYS stamps ran
    ahead, of more that follow, is it they that are left out.
    """
    repeated = np.zeros(len(t_ns), dtype=bool)
    if len(t_ns) == 0:
        return repeated
    covered_ns = int(t_ns.min())
    recent = np.empty(0, dtype=np.int64)
    for run in np.split(np.arange(len(t_ns)), backward_steps(t_ns)):
        ahead = recent[t_ns[recent] > t_ns[run[0]] + REORDERED_NS]
        behind = int((t_ns[run] < covered_ns - REORDERED_NS).sum())
        if len(ahead) < min(AGREEING_STRAYS, behind):
            repeated[ahead] = True
            recent = np.setdiff1d(recent, ahead)
            covered_ns = int(t_ns[recent].max(initial=t_ns.min()))
        if t_ns[run[0]] < covered_ns - REORDERED_NS:
            repeated[run] = t_ns[run] <= covered_ns
        kept = run[~repeated[run]]
        covered_ns = int(t_ns[kept].max(initial=covered_ns))
        recent = np.concatenate([recent, kept])[-AGREEING_STRAYS:]
    return repeated
