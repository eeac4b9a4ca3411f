"""When a run was at its worst."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float, Int

APART_NS = 1_000_000_000


def worst_instants(t_ns: Int, badness: Float, most: int = 3) -> list[int]:
    """Indices into N samples, the worst first, none of them within a second of a worse one; at most `most`.

    badness: (N,), larger is worse; what is not above 0 is not bad. Of equals the earlier counts as worse.
    """
    chosen: list[int] = []
    open_ = badness > 0
    while open_.any() and len(chosen) < most:
        worst = int(np.argmax(np.where(open_, badness, -np.inf)))
        chosen.append(worst)
        open_ &= np.abs(t_ns - t_ns[worst]) >= APART_NS
    return chosen
