"""Which tag and anchor the ranges of a topic are between, where its messages do not say it."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import NamedTuple

from quadlog.errors import clipped

UWB_WORDS = ("uwb", "anchor", "dwm", "decawave", "linktrack", "tof")
LARGEST_ID = 0xFFFF
NUMBERED = re.compile(r"(?:(tag|anchor)s?[_/-]?(?:id)?[_/-]?)?([0-9]+)")


HEX = re.compile(r"0x[0-9a-f]+|[0-9a-f]{2}(?:[:-][0-9a-f]{2}){3,7}")
NAME_THEM = "give their ids as names in [[uwb.range_topics]]"


def id_of(text: str, names: Mapping[str, int] = {}) -> int:
    """The id of an end that messages name by a text: that of names, else its number.

    As in `7`, `A1`, `0x1A2B` and `d4:22:cd:00:0f:9b`. Raises ValueError for a text that has none.
    """
    if text in names:
        return names[text]
    plain = text.strip().lower()
    if HEX.fullmatch(plain):
        return int(re.sub("0x|[:-]", "", plain), 16) % (1 << 63)
    if (number := re.fullmatch("[^0-9]*([0-9]{1,18})", plain)) is None:
        raise ValueError(f"its end {clipped(text)!r} has no number: {NAME_THEM}")
    return int(number[1])


class Ends(NamedTuple):
    """The two ends of a range, by id; assumed: what nothing says of them, "tag" or "order", or nothing."""

    tag: int
    anchor: int
    assumed: str = ""


def ends_of_topic(
    topic: str, mapped: Mapping[str, tuple[int, int]] | None = None, anchor_ids: Collection[int] = ()
) -> Ends | None:
    """Tag and anchor of a topic, or None where they are unknown.

    mapped (``[[uwb.range_topics]]``) decides. Otherwise two numbers in the name
    (``/uwb/tof/n_3/n_7/distance``) are tag and anchor, in this order unless the
    word before one of them says otherwise (``/uwb/anchor_3/tag_7``) or, without
    such words, only the first is a known anchor; one number in a name that
    refers to UWB is the anchor of tag 0, unless it is named a tag's.
    """
    if mapped and topic in mapped:
        return Ends(*mapped[topic])
    found = [(word, int(digits)) for word, digits in NUMBERED.findall(topic.lower()) if len(digits) <= 5]
    words = [word for word, number in found if number <= LARGEST_ID]
    numbers = [number for _, number in found if number <= LARGEST_ID]
    if len(numbers) == 2:
        first, second = numbers
        if words[0] != words[1] and any(words):
            return Ends(second, first) if words[0] == "anchor" or words[1] == "tag" else Ends(first, second)
        if first in anchor_ids and second not in anchor_ids:
            return Ends(second, first)
        known = first not in anchor_ids and second in anchor_ids
        return Ends(first, second, "" if known else "order")
    if len(numbers) == 1 and words != ["tag"] and any(word in topic.lower() for word in UWB_WORDS):
        return Ends(0, numbers[0], "tag")
    return None
