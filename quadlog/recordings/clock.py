"""The clock of a recording: header stamps or log times, and never the two mixed unseen."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from quadlog.errors import ClocksDiffer

Stamp = Literal["header", "log"]

FAR_APART_NS = 3_600_000_000_000


@dataclass
class Clock:
    """Chooses t_ns of each message and watches how far the two clocks lie apart.

    offset_ns: per topic with stamps, header minus log time at its first message.
    unstamped: topics that had to use log time. zero_stamps: messages per topic whose stamp was 0.
    """

    path: Path
    stamp: Stamp
    offset_ns: dict[str, int] = field(default_factory=dict)
    unstamped: set[str] = field(default_factory=set)
    zero_stamps: dict[str, int] = field(default_factory=dict)

    def time_ns(self, topic: str, stamp_ns: int | None, log_time_ns: int) -> int:
        """When a message happened. Raises ClocksDiffer before times of distant clocks could be compared."""
        if self.stamp == "log":
            return log_time_ns
        if not stamp_ns:
            if stamp_ns == 0:
                self.zero_stamps[topic] = self.zero_stamps.get(topic, 0) + 1
            if topic not in self.unstamped:
                self.unstamped.add(topic)
                self._check()
            return log_time_ns
        if topic not in self.offset_ns:
            self.offset_ns[topic] = stamp_ns - log_time_ns
            self._check()
        return stamp_ns

    def _check(self) -> None:
        far = {topic: offset for topic, offset in self.offset_ns.items() if abs(offset) > FAR_APART_NS}
        if far and self.unstamped:
            with_header, offset = next(iter(far.items()))
            without = min(self.unstamped)
            raise ClocksDiffer(self.path, offset * 1e-9, with_header, without)

    def warnings(self) -> list[str]:
        """One line per oddity met so far."""
        lines = [
            f"{topic}: {count} messages have the stamp 0; their log time is used"
            for topic, count in sorted(self.zero_stamps.items())
        ]
        if self.offset_ns:
            low = min(self.offset_ns, key=lambda topic: self.offset_ns[topic])
            high = max(self.offset_ns, key=lambda topic: self.offset_ns[topic])
            apart_ns = self.offset_ns[high] - self.offset_ns[low]
            if apart_ns > FAR_APART_NS:
                lines.append(
                    f"header stamps of {low} and {high} come from clocks {apart_ns * 1e-9:.0f} s apart; "
                    "use  --stamp log  to take log times for all"
                )
        return lines
