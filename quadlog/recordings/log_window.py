"""Between which log times a window of header stamps lies, found by a look at its edges instead of reading it all.

An index knows log times alone. How far stamps lag behind them is first taken
from the recording's beginning, then from what is logged at the edge itself,
since clocks drift; so much is read on either side, and a margin for jitter.
What a stall held back counts too: a topic that has not come past the end yet is
looked at further on, alone, so that chunks without it stay untouched.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

from quadlog.recordings.container import Container, RawMessage

MARGIN_NS = 500_000_000
FARTHEST_NS = 10_000_000_000
"""How far beyond an edge a topic is looked for that is silent at the edge itself."""
_LOOK_NS = 1_000_000_000
_ROUNDS = 8


class Seen(NamedTuple):
    """A message at an edge: when it was logged, and its stamp, or the log time where it has none."""

    topic: str
    log_time_ns: int
    t_ns: int


Look = Callable[[Iterator[RawMessage]], Iterator[Seen]]


def log_begin(container: Container, topics: Collection[str], start_ns: int, lag_ns: int, look: Look) -> int:
    """Log time before which nothing lies that is stamped start_ns or later; lag_ns: the smallest lag known so far."""
    begin_ns = start_ns + lag_ns - MARGIN_NS
    seen: list[Seen] = []
    for _ in range(_ROUNDS):
        seen = list(look(container.messages(topics, begin_ns, begin_ns + _LOOK_NS)))
        farther_ns = start_ns + min((each.log_time_ns - each.t_ns for each in seen), default=lag_ns) - MARGIN_NS
        if farther_ns >= begin_ns:
            break
        begin_ns = farther_ns
    first_ns = {each.topic: each.t_ns for each in reversed(seen)}
    late = {topic for topic in topics if first_ns.get(topic, start_ns) >= start_ns}
    high_ns, step_ns, earliest_ns = begin_ns, _LOOK_NS, begin_ns
    while late and high_ns > begin_ns - FARTHEST_NS:
        low_ns = max(high_ns - step_ns, begin_ns - FARTHEST_NS)
        earlier, within = _until(start_ns, look(container.messages(sorted(late), low_ns, high_ns)), late)
        late -= earlier
        earliest_ns = min([earliest_ns, *within])
        high_ns, step_ns = low_ns, 2 * step_ns
    return earliest_ns


def log_end(container: Container, topics: Collection[str], end_ns: int, lag_ns: int, look: Look) -> int:
    """Log time from which on nothing lies that is stamped before end_ns; lag_ns: the largest lag known so far."""
    until_ns = end_ns + lag_ns + MARGIN_NS
    seen: list[Seen] = []
    for _ in range(_ROUNDS):
        seen = list(look(container.messages(topics, until_ns - _LOOK_NS, until_ns)))
        farther_ns = end_ns + max((each.log_time_ns - each.t_ns for each in seen), default=lag_ns) + MARGIN_NS
        if farther_ns <= until_ns:
            break
        until_ns = farther_ns
    behind = set(topics) - {each.topic for each in seen if each.t_ns >= end_ns}
    latest_ns = until_ns
    if behind:
        for each in look(container.messages(sorted(behind), until_ns, until_ns + FARTHEST_NS)):
            if each.t_ns >= end_ns:
                behind.discard(each.topic)
            elif each.topic in behind:
                latest_ns = each.log_time_ns + 1
            if not behind:
                break
    return latest_ns


def _until(start_ns: int, seen: Iterator[Seen], topics: Collection[str]) -> tuple[set[str], list[int]]:
    """Topics that begin before start_ns, and when each topic's first message from then on was logged.

    Nothing is read beyond the last of these.
    """
    waiting, earlier, within = set(topics), set[str](), []
    while waiting and (each := next(seen, None)) is not None:
        if each.topic not in waiting:
            continue
        if each.t_ns < start_ns:
            earlier.add(each.topic)
        else:
            waiting.discard(each.topic)
            within.append(each.log_time_ns)
    return earlier, within
