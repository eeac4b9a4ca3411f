"""UWB ranges of every driver's messages: distances (N,) or (N, T); ids and signal strengths in the same arrays or in
those around them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from quadlog.messages import NO_ID, UNITS_M, Float, UwbRanges
from quadlog.positioning.two_way_ranging import general_range_m
from quadlog.recordings.decoders.fields import ENDS, Columns
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.range_ends import NAME_THEM, id_of
from quadlog.recordings.decoders.rows import HEADER, OWN_HEADER, Part, Type, part


def ranges(
    columns: Columns,
    _: JointOrder,
    *,
    unit: str = "m",
    zero_is_none: bool = False,
    ids: Mapping[str, int] = {},
    names: Mapping[str, int] = {},
    unmeasured: Callable[[Columns], Mapping[str, np.ndarray]] = lambda _: {},
) -> Iterator[Part]:
    """Tags and anchors by ids or columns; without either, an anchor is the place in its array, or unknown.

    names: text -> id, as for `id_of`; two texts of one id are refused with ValueError.
    unmeasured: why -> (N,) or (N, T) which ranges were not measured, as their messages say.
    """
    distance = columns["range"].reshape(columns.n, -1)
    for end in ENDS:
        if isinstance(texts := columns.get(end, None), tuple):
            numbers = [id_of(text, names) for text in texts]
            for number, text in zip(numbers, texts, strict=True):
                if (other := columns.memory.setdefault(f"{end} {number}", text)) != text:
                    raise ValueError(f"{other!r} and {text!r} would both be {end} {number}: {NAME_THEM}")
            columns[end] = np.tile(numbers, (columns.n, 1))
    values: dict[str, Any] = {"tag": NO_ID, "anchor": columns.places("range") if columns.arrays["range"] else NO_ID}
    values |= {name: columns.beside(name, "range") for name in values if name in columns} | dict(ids)
    values["range_m"] = distance / round(1 / UNITS_M[unit])
    there = distance != 0 if zero_is_none else np.ones(distance.shape, dtype=bool)
    for why, mask in unmeasured(columns).items():
        absent = there & mask.reshape(columns.n, -1)
        if absent.any():
            yield _measured(absent, why, **values)
            there &= ~absent
    if "place" in columns:
        values["anchor_position_m"] = columns["place"][:, None]
    yield _measured(there, **values)


def _measured(there: np.ndarray, unmeasured: str = "", **values: Any) -> Part:
    """Ranges with these values where they are there (N, T)."""
    of, at = np.nonzero(there)
    for name, value in values.items():
        value = np.asarray(value)
        values[name] = np.broadcast_to(value, there.shape + value.shape[2:])[of, at]
    return part(UwbRanges, len(of), of=of, unmeasured=unmeasured, **{"first_path_gap_db": np.nan} | values)


def node_ranges(columns: Columns, _: JointOrder) -> Iterator[Part]:
    """A tag's frame lists its anchors, an anchor's frame lists tags; plain nodes have no roles and count as tags."""
    other, other_role, range_m = columns["other"], columns["other_role"], columns["range"]
    of_anchor = columns["role"][:, None] == ROLE_ANCHOR
    there = (range_m != 0) & (other_role != np.where(of_anchor, ROLE_ANCHOR, ROLE_TAG))
    own = columns.beside("id", "range")
    tag, anchor = np.where(of_anchor, other, own), np.where(of_anchor, own, other)
    yield _measured(there, tag=tag, anchor=anchor, range_m=range_m, first_path_gap_db=columns["rx"] - columns["fp"])


def outside_limits(columns: Columns) -> dict[str, np.ndarray]:
    """Of a sensor_msgs/Range; drivers may leave both limits at zero."""
    range_m, low_m, high_m = (columns[name] for name in ("range", "low", "high"))
    outside = (low_m >= 0) & (low_m < high_m) & ((range_m < low_m) | (range_m > high_m))
    return _infinite(columns) | {"they are outside min_range to max_range of their own messages": outside}


def failed(columns: Columns) -> dict[str, np.ndarray]:
    """Of a uwb_driver/UwbRange: values of range_status, and bits of the even ones; others are remarks on a range."""
    status = columns.get("status", np.zeros(columns.n, np.int64))
    failed = np.isin(status, (1, 3)) | ((status % 2 == 0) & (status & 0b100110 != 0))
    return {"their range_status says that the ranging failed": failed}


def no_error(columns: Columns) -> dict[str, np.ndarray]:
    """Of a gtec_msgs/Ranging; its errorEstimation is a standard deviation."""
    error = columns.get("error", np.zeros(columns.n))
    return {"their errorEstimation is negative or not finite": ~((error >= 0) & (error < np.inf))}


ROLE_ANCHOR, ROLE_TAG = 1, 2
_NODE = {"id": "id", "role": "role", "other": "nodes[].id", "other_role": "nodes[].role", "range": "nodes[].dis"}
NODES = Type((UwbRanges,), HEADER | _NODE | {"rx": "nodes[].rx_rssi", "fp": "nodes[].fp_rssi"}, node_ranges)
UWB_DRIVER = {"tag": "requester_id ?", "anchor": "responder_id", "range": "distance", "status": "range_status ?"}
UWB_DRIVER |= {"place": "responder_location:xyz ?"}


def type_of_ranges(unmeasured: Any = lambda _: {}, **fields: Any) -> Type:
    """fields: columns by their paths, and what `ranges` takes."""
    wanted = {name: fields.pop(name) for name in list(fields) if name not in ("unit", "zero_is_none", "ids")}
    unit = fields.get("unit", "m")
    return Type((UwbRanges,), HEADER | wanted, partial(ranges, unmeasured=unmeasured, **fields), unit)


TWO_WAY = ("poll_tx", "poll_rx", "response_tx", "response_rx", "final_tx", "final_rx")
INTERVALS = ("round_a", "reply_a", "round_b", "reply_b")
WRAP = 1 << 40  # of the counters of DW1000 and DW3000; others have 32 bits


def own_ranges(
    *,
    field: str | None = None,
    unit: str | None = None,
    tag: int | str | None = None,
    anchor: int | str | None = None,
    times: Sequence[str] | None = None,
    tick_s: float | None = None,
    names: Mapping[str, int] = {},
) -> Type:
    """Ranges of any message, by `[[uwb.range_topics]]`; times: of TWO_WAY or INTERVALS."""
    ends = {"tag": tag, "anchor": anchor}
    ids = {name: end for name, end in ends.items() if isinstance(end, int)}
    columns_of = {4: INTERVALS, 6: TWO_WAY}[len(times)] if times else ("range",)
    wanted = {name: end for name, end in ends.items() if isinstance(end, str)}
    wanted |= dict(zip(columns_of, times or (str(field),), strict=True))

    def rows(columns: Columns, order: JointOrder) -> Iterator[Part]:
        if times:
            given = [columns[name].astype(np.float64) for name in columns_of]
            columns.arrays["range"] = columns.arrays[columns_of[0]]
            columns["range"] = general_range_m(np.array(_intervals(*given) if len(given) > 4 else given) * tick_s)
        return ranges(columns, order, unit=unit or "m", ids=ids, names=names, unmeasured=_infinite)

    return Type((UwbRanges,), OWN_HEADER | wanted, rows)


def _intervals(*times: Float) -> list[Float]:
    """INTERVALS of TWO_WAY, in ticks; a negative one has begun before the counter began again."""
    poll_tx, poll_rx, response_tx, response_rx, final_tx, final_rx = times
    apart = [response_rx - poll_tx, final_tx - response_rx, final_rx - response_tx, response_tx - poll_rx]
    wrap = np.where(np.max(times, axis=0) < 1 << 32, 1 << 32, WRAP)
    return [np.where(each < 0, each + wrap, each) for each in apart]


def _infinite(columns: Columns) -> dict[str, np.ndarray]:
    return {"they are infinite: too near or too far [REP 117]": np.isinf(columns["range"])}
