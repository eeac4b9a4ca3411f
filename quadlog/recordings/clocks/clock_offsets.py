"""Topics and transforms that carry another clock than those they are compared with.

An offset is header stamp minus log time, 0 without a stamp. Offsets are compared at equal log times: neither log times
nor a clock that all share need to run evenly.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quadlog.errors import some_of
from quadlog.messages import Int

FAR_APART_NS = 3_600_000_000_000
LATE_NS = 1_000_000_000
"""Messages may overtake one another by so much, or be late by it."""
APART_NS = 200_000_000
"""Transport usually takes less."""
FEWEST = 9  # offsets by which a stream is judged
BY_LOG = "log times are used for them, and for all with  --stamp log"


class Offsets(NamedTuple):
    """Offsets (N,) of a stream, which is a topic or a transform, by log times (N,)."""

    log_ns: Int
    offset_ns: Int
    stamped: bool

    @classmethod
    def of(cls, parts: list[tuple[Int, Int]]) -> Offsets:
        """Of log times and header stamps (N,), 0 without."""
        log_ns, stamp_ns = (np.concatenate(each) for each in zip(*parts, strict=True))
        rows = np.argsort(log_ns, kind="stable")
        offset_ns = np.where(stamp_ns > 0, stamp_ns - log_ns, 0)
        return cls(log_ns[rows], offset_ns[rows], bool(stamp_ns.any()))

    def ahead_ns(self, of: Offsets, begin_ns: int) -> tuple[int, int]:
        """How far stamps lie ahead of others since begin_ns: the median, and the width of the middle three quarters."""
        first_ns, base_ns, rows = of.log_ns[0], of.offset_ns[0], self.log_ns >= begin_ns
        others_ns = np.interp(self.log_ns[rows] - first_ns, of.log_ns - first_ns, of.offset_ns - base_ns)
        low, median, high = np.percentile(self.offset_ns[rows] - base_ns - others_ns, (12.5, 50, 87.5))
        return round(median), round(high - low)


def stream_name(topic: str, frame_id: str, child_frame_id: str) -> str:
    """The name of a transform as a stream; topics have their own."""
    return f"{frame_id} -> {child_frame_id} of {topic}"


@dataclass(frozen=True)
class OneClock:
    """The clock to which the stamps of compared streams are brought: its offsets (K,) at log times (K,).

    within_ns: where stamps of the log lie on it. shift_ns: what is subtracted from those of a stream, None: its log
    times count. outside: topic -> stamps that cannot be of the log, so far.
    """

    log_ns: Int = field(default_factory=lambda: np.zeros(1, np.int64))
    offset_ns: Int = field(default_factory=lambda: np.zeros(1, np.int64))
    within_ns: tuple[int, int] = (-(1 << 62), 1 << 62)
    shift_ns: Mapping[str, int | None] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    outside: dict[str, set[int]] = field(default_factory=dict)

    def placed_ns(self, topic: str, stream: str, stamp_ns: Int, log_ns: Int) -> Int:
        """Stamps (N,) of a topic, or of the transform `stream` on it; those from outside of the log are log times.

        Those that are an hour away are left to be judged by Clock.
        """
        shift_ns, (low_ns, high_ns) = self.shift_ns.get(stream, self.shift_ns.get(topic, 0)), self.within_ns
        t_ns = None if shift_ns is None else stamp_ns - shift_ns
        if t_ns is not None and not ((t_ns < low_ns) | (t_ns > high_ns)).any():
            return t_ns
        since_ns, offset_ns = self.log_ns - self.log_ns[0], self.offset_ns - self.offset_ns[0]
        more_ns = np.interp(log_ns - self.log_ns[0], since_ns, offset_ns).astype(np.int64)
        logged_ns = log_ns + self.offset_ns[0] + more_ns
        t_ns = logged_ns if t_ns is None else t_ns
        away_ns = abs(t_ns - np.clip(t_ns, low_ns, high_ns))
        outside = (stamp_ns > 0) & (away_ns > 0) & (away_ns <= FAR_APART_NS)
        if outside.any():
            self.outside.setdefault(topic, set()).update(stamp_ns[outside].tolist())
        return np.where(outside, logged_ns, t_ns)


def one_clock(
    streams: Mapping[str, Offsets],
    span_ns: tuple[int, int],
    compared: Collection[str],
    reported: Collection[str],
    moves: bool,
) -> OneClock:
    """Find streams on another clock than those that are compared. span_ns: log times of the recording.

    reported: topics that are compared, but not moved; what is neither is a transform that no position depends on. The
    right clock is log time where a compared stream has no stamps, else the one nearest to it. moves: whether stamps are
    moved to it that lie farther from it than any delay, by a constant.
    """
    begin_ns = span_ns[0] + LATE_NS  # before it are latched messages
    streams = {name: each for name, each in sorted(streams.items()) if (each.log_ns >= begin_ns).sum() >= FEWEST}
    names = [name for name in streams if name in compared]
    if not names:
        return OneClock()
    best = min(names, key=lambda name: (streams[name].stamped, abs(np.median(streams[name].offset_ns))))
    base = streams[best]
    ahead = {name: each.ahead_ns(base, begin_ns) for name, each in streams.items()}
    shift_ns, slack_ns, groups = dict[str, int | None](), LATE_NS, dict[tuple[int, str], list[str]]()
    for name, (ahead_ns, spread_ns) in ahead.items():
        is_mere, far_ns = name not in compared and name not in reported, abs(ahead_ns)
        steady = is_mere or spread_ns <= APART_NS
        if (steady and far_ns <= APART_NS + is_mere * LATE_NS) or (far_ns > FAR_APART_NS and not is_mere):
            continue
        # What is off together is moved together, and keeps its delays.
        near_ns = [each for each, _ in ahead.values() if abs(each - ahead_ns) <= APART_NS < abs(each)]
        group_ns, way = max(near_ns, default=ahead_ns), "take log times with  --stamp log"
        if steady and far_ns > LATE_NS and moves and name not in reported:
            moved = "they are moved by so much; keep them with  --stamp header"
            shift_ns[name], way = (None, BY_LOG) if is_mere else (group_ns, moved)
        else:
            slack_ns = max(slack_ns, LATE_NS + far_ns)
            unless = "if that is not transport delay, " if far_ns <= LATE_NS else ""
            way = f"{unless}{way}" if steady else f"they drift or jump by {spread_ns * 1e-9:.2f} s; {way}"
        groups.setdefault((group_ns, way), []).append(name)
    those = f"those of {best}" if base.stamped else f"the log times of {best}, which has no stamps"
    sides = {key: f"{abs(key[0]) * 1e-9:.2f} s {'behind' if key[0] < 0 else 'ahead of'}" for key in groups}
    warnings = [f"header stamps of {some_of(groups[key])} lie {sides[key]} {those}; {key[1]}" for key in groups]
    # A stray is outvoted in its block.
    width, longer = divmod(len(base.log_ns), len(base.log_ns) // FEWEST)
    parts = zip(np.split(np.array(base[:2]), [longer * (width + 1)], axis=1), (width + 1, width), strict=True)
    medians_ns = [np.median(part.reshape(2, -1, each), axis=2) for part, each in parts]
    log_ns, offset_ns = np.concatenate(medians_ns, axis=1).astype(np.int64)
    reads_ns = np.concatenate([span_ns[:1] + offset_ns[:1], log_ns + offset_ns, span_ns[1:] + offset_ns[-1:]])
    within_ns = int(reads_ns.min()) - slack_ns, int(reads_ns.max()) + slack_ns
    return OneClock(log_ns, offset_ns, within_ns, shift_ns, tuple(warnings))
