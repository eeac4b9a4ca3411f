"""Fields of many ROS payloads as columns: where they lie is learnt from one payload, numpy reads them from the others.

A path is `a.b`; `a.b:xyz`, the numbers a.b.x, a.b.y and a.b.z; `a.b[:3]`, the first three of an array, `a.b[3]`, its
fourth; `a[].b`, b of all messages of an array; `a.b[]`, all numbers of one. `PATH | PATH` is the first that a
definition has, `PATH ?` may be missing.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise, product
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype

from quadlog.errors import DecodeError, some_of
from quadlog.messages import NS_PER_S, Int
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.payload import Payload, PayloadReader, frame_name
from quadlog.recordings.decoders.type_definitions import ARRAYS, BadDefinition, Types

TEXTS = ("frame", "child", "names")
ENDS = ("tag", "anchor")
"""Columns of texts, and those of numbers or texts; all others are of numbers."""
DTYPES = dict.fromkeys(("bool", "byte", "char", "octet"), "u1") | {"float32": "f4", "float64": "f8"}
DTYPES |= {f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)}
KEPT_LAYOUTS, LARGEST_BYTES = 16, 1 << 20
MOST_FIELDS = 1 << 16
"""Fields of a payload; an array of numbers counts as one."""


class Columns:
    """Column -> what N messages hold: (N,), (N, K) for K numbers, (N, T) or (N, T, K) with T in arrays; texts are equal
    in all messages. Numbers are read when they are asked for.

    arrays: column -> the arrays that its path leads through; lengths: of each of these, one by one. memory: what is
    kept from one reading of the channel to the next.
    """

    def __init__(self, payloads: np.ndarray, topic: str, layout: Layout, memory: dict[str, Any]) -> None:
        self._payloads, self._layout, self._known = payloads, layout, dict[str, Any](layout.texts)
        self.n, self.topic, self.memory = len(payloads), topic, memory
        self.arrays, self.lengths = dict(layout.arrays), layout.lengths
        self.sound, self.why = np.ones(self.n, dtype=np.bool_), ""

    def __contains__(self, column: str) -> bool:
        return column in self._known or column in self._layout.strides

    def __getitem__(self, column: str) -> Any:
        if column not in self._known:
            self._known[column] = self._layout.read(column, self._payloads)
        return self._known[column]

    def __setitem__(self, column: str, values: np.ndarray) -> None:
        self._known[column] = values

    def get(self, column: str, default: Any) -> Any:
        """A column, or a default for one that the definition lacks."""
        there = column in self
        return self[column] if there else default

    def refuse(self, unsound: np.ndarray, why: str) -> None:
        """Leave out the messages where unsound (N, ...) holds, and say why of the first."""
        if unsound.any():
            self.sound &= ~unsound.reshape(self.n, -1).any(axis=1)
            self.why = self.why or why

    def stamp_ns(self) -> Int | None:
        """(N,) header stamps, or (N, T); None without."""
        return self["sec"] * NS_PER_S + self["nanosec"] if "sec" in self and "nanosec" in self else None

    def frames(self, index: int = 0) -> tuple[str, str]:
        """Names of frame and child frame, without the leading slash of old ROS 1."""
        frame, child = (self.get(name, ())[index : index + 1] for name in ("frame", "child"))
        return frame_name("".join(frame)), frame_name("".join(child))

    def beside(self, column: str, deeper: str) -> np.ndarray:
        """A column (N, T), repeated for all numbers of one in the same arrays or in arrays within them.

        Raises ValueError where neither is so, nor are they as long as one another.
        """
        values, outer, inner = self[column].reshape(self.n, -1), self.arrays[column], self.arrays[deeper]
        if inner[: len(outer)] == outer:
            for array in inner[len(outer) :]:
                values = np.repeat(values, self.lengths[array], axis=1)
        if values.shape != self[deeper].reshape(self.n, -1).shape:
            raise ValueError(f"the arrays of {column} and {deeper} differ in length")
        return values

    def places(self, column: str) -> Int:
        """(T,) the place of each number in its array."""
        lengths = self.lengths[self.arrays[column][-1]]
        return np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)


class Path(NamedTuple):
    """A path that a definition has: its leaves, side by side, or the `first` numbers of its one leaf, an array.

    at: the one number of these that counts, None for all.
    """

    leaves: tuple[str, ...]
    arrays: tuple[str, ...]
    first: int
    text: bool
    at: int | None


def resolve(types: Types, type_name: str, wanted: Mapping[str, str]) -> dict[str, Path]:
    """Column -> its path in a checked definition (`needed_types`). Raises BadDefinition for a field that it lacks."""
    found = {}
    for column, choices in wanted.items():
        texts = (True,) if column in TEXTS else (False, True) if column in ENDS else (False,)
        each = product(choices.removesuffix("?").split("|"), texts)
        paths = (_at(types, type_name, path.strip(), text) for path, text in each)
        path = next(filter(None, paths), None)
        if path is not None:
            found[column] = path
        elif not choices.endswith("?"):
            names = some_of(_names_near(types, type_name, choices.split(".")))
            raise BadDefinition(f"its definition has no {'text' if column in TEXTS else 'number'} {choices} ({names})")
    return found


def _names_near(types: Types, name: str, steps: Sequence[str]) -> list[str]:
    """The fields where steps from a type lead no farther, as paths."""
    near = {}
    for field, (kind, detail) in types[name][1]:
        many = kind in ARRAYS
        kind, inner = detail[0] if many else (kind, detail)
        near[f"{field}{'[]' * many}"] = inner if kind == Nodetype.NAME else None
    within = near.get(steps[0]) if len(steps) > 1 else None
    return [f"{steps[0]}.{each}" for each in _names_near(types, within, steps[1:])] if within else [*near]


_PATH = re.compile(r"(.*?)(?:\[(:?)([0-9]{1,9})\])?(?::([a-z]+))?", re.DOTALL)


def _at(types: Types, type_name: str, path: str, text: bool) -> Path | None:
    trunk, several, size, parts = _PATH.fullmatch(path).groups("")  # type: ignore[union-attr]
    steps = trunk.split(".")
    arrays = tuple(".".join(steps[: i + 1]) for i, step in enumerate(steps) if step.endswith("[]"))
    trunk, at = trunk + "[]" * bool(size), int(size or 0)
    first = at + bool(size) - bool(several)
    leaves = tuple(f"{trunk}.{part}" for part in parts) or (trunk,)
    if not all(_leads(types, type_name, leaf.split("."), first, text) for leaf in leaves):
        return None
    return Path(leaves, arrays, first, text, None if parts or several else at)


def _leads(types: Types, name: str, steps: Sequence[str], first: int, text: bool) -> bool:
    """Whether steps lead from a type to numbers, or texts; where they are of an array, to at least `first`."""
    kind, detail = dict(types[name][1]).get(steps[0].removesuffix("[]"), (None, None))
    if kind is None or (kind in ARRAYS) != steps[0].endswith("[]"):
        return False
    if kind == Nodetype.ARRAY and len(steps) == 1 and detail[1] < first:
        return False
    kind, detail = detail[0] if kind in ARRAYS else (kind, detail)
    if kind == Nodetype.NAME:
        return len(steps) > 1 and _leads(types, detail, steps[1:], first, text)
    return len(steps) == 1 and (detail[0] == "string") == text


NOTHING = np.zeros(1)


class Walk(PayloadReader):
    """A walk along one payload that notes where wanted fields are; raises DecodeError for one that does not fit.

    left: how many fields it may have, an array of numbers as one. fixed: begin and end of what is the same in all
    payloads of a layout. By path, each time it was met: begin and size of wanted texts; found: offset, dtype and count
    of wanted numbers; lengths of arrays.
    """

    def __init__(
        self, payload: Payload, channel: Channel, leaves: Collection[str] = (), left: int = MOST_FIELDS
    ) -> None:
        super().__init__(bytes(payload), channel.message_encoding, channel.topic)
        self.fixed: list[tuple[int, int]] = [] if self.ros1 else [(0, 2)]
        self.texts: dict[str, list[tuple[int, int]]] = {}
        self.found: dict[str, list[tuple[int, str, int]]] = {}
        self.lengths: dict[str, list[int]] = {}
        self._leaves, self._left = leaves, left

    def message(self, types: Types, type_name: str, prefix: str = "") -> SimpleNamespace:
        """The next message, of a checked type, as an object, whose arrays of numbers are numpy's.

        Numbers are left out where leaves are noted.
        """
        fields: dict[str, Any] = {}
        for name, (kind, detail) in types[type_name][1]:
            path, count, many = prefix + name, 1, kind in ARRAYS
            if many:
                path, count = f"{path}[]", self.length() if kind == Nodetype.SEQUENCE else detail[1]
                self.lengths.setdefault(path, []).append(count)
                kind, detail = detail[0]
            wanted, each = path in self._leaves, list[Any]()
            if kind == Nodetype.NAME:
                self.spend(count)
                each = [self.message(types, detail, f"{path}.") for _ in range(count)]
            elif detail[0] == "string":
                self.spend(count)
                for _ in range(count):
                    size = self.length()
                    self.texts.setdefault(path, []).extend([(self.at, size)] if wanted else ())
                    each.append(self.text(size))
            else:
                self.spend(1)
                numbers = self.array(detail[0], count, path if wanted else "")
                each = numbers if many else numbers.tolist()
            fields[name] = each if many else each[0]
        return SimpleNamespace(**fields)

    def array(self, base: str, count: int, wanted: str) -> Any:
        """The next numbers of a basic type. wanted: their path, empty if they are not."""
        if base not in DTYPES:
            raise self.wrong(f"it has a {base}, which quadlog does not read")
        dtype = self.order + DTYPES[base]
        begin = self.numbers(DTYPES[base], count)
        if wanted:
            self.found.setdefault(wanted, []).append((begin, dtype, count))
        if self._leaves:
            return NOTHING
        return np.frombuffer(self.payload, dtype, count, begin).astype(bool if base == "bool" else DTYPES[base])

    def spend(self, fields: int) -> None:
        """Types within types, and arrays, multiply fields."""
        self._left -= fields
        if self._left < 0:
            raise self.wrong("it has more fields than such a message")

    def length(self) -> int:
        """The next length of a sequence or a string."""
        count = self.whole("u4")
        self.fixed.append((self.at - 4, self.at))
        return count


class Strides(NamedTuple):
    """Where the numbers (T, K) of a leaf lie: runs of rows at even distances."""

    dtype: np.dtype[Any]
    k: int
    runs: list[tuple[int, int, int]]

    @classmethod
    def of(cls, found: Sequence[tuple[int, str, int]], first: int) -> Strides:
        """found: as Walk has it; first: K, 0 for one. Raises ValueError for shorter arrays."""
        dtype = np.dtype(found[0][1] if found else "f8")
        if any(count < first for *_, count in found):
            raise ValueError(f"it has an array of less than {first} numbers")
        runs: list[tuple[int, int, int]] = [(at, 1 if first else count, dtype.itemsize) for at, _, count in found]
        apart = {after[0] - before[0] for before, after in pairwise(runs)}
        if len(apart) == 1 and all(count == 1 for _, count, _ in runs):
            runs = [(runs[0][0], len(runs), apart.pop())]
        return cls(dtype, first or 1, runs)

    @classmethod
    def of_all(cls, strides: list[Strides]) -> list[Strides]:
        """The strides of leaves as one (T, K) where they lie side by side."""
        (dtype, _, runs), size = strides[0], strides[0].dtype.itemsize
        alike = all(
            each == (dtype, 1, [(at + i * size, count, step) for at, count, step in runs])
            for i, each in enumerate(strides)
        )
        return [cls(dtype, len(strides), runs)] if alike else strides

    def read(self, payloads: np.ndarray, dtype: str) -> np.ndarray:
        """(N, T, K) numbers of C-contiguous payloads (N, size) uint8."""
        (n, size), k = payloads.shape, self.k
        runs = [
            np.ndarray((n, count, k), self.dtype, payloads, offset, (size, step, self.dtype.itemsize)).astype(dtype)
            for offset, count, step in self.runs
        ]
        return runs[0] if len(runs) == 1 else np.concatenate([np.empty((n, 0, k), dtype), *runs], axis=1)


class Layout:
    """Payloads of one size with the same lengths and wanted texts. Raises DecodeError, ValueError."""

    def __init__(self, payload: bytes, channel: Channel, types: Types, paths: Mapping[str, Path]) -> None:
        walk = Walk(payload, channel, {leaf for path in paths.values() for leaf in path.leaves})
        walk.message(types, channel.type_name)
        walk.end()
        self._texts = {column: walk.texts.get(each.leaves[0], []) for column, each in paths.items() if each.text}
        wanted = [(at, at + size) for each in self._texts.values() for at, size in each]
        self._places = np.concatenate([np.arange(*each) for each in [*walk.fixed, *wanted, (0, 0)]])
        self._fixed = len(self._places) - sum(end - begin for begin, end in wanted)
        self._take(payload, channel)
        arrays = {array for path in paths.values() for array in path.arrays}
        self.lengths = {array: np.array(walk.lengths.get(array, ()), np.int64) for array in arrays}
        self.arrays = {column: path.arrays for column, path in paths.items()}
        self.strides: dict[str, tuple[Path, str, list[Strides]]] = {}
        for column, path in paths.items():
            if not path.text:
                strides = Strides.of_all([Strides.of(walk.found.get(leaf, []), path.first) for leaf in path.leaves])
                dtype = "f8" if any(each.dtype.kind == "f" for each in strides) else "i8"
                self.strides[column] = path, dtype, strides

    def _take(self, payload: bytes, channel: Channel) -> None:
        reader, texts = PayloadReader(payload, channel.message_encoding, channel.topic), dict[str, tuple[str, ...]]()
        for column, found in self._texts.items():
            texts[column] = tuple(reader.text(size, at) for at, size in found)
        self.texts, self._same = texts, np.frombuffer(payload, np.uint8)[self._places]

    def of(self, payload: bytes, channel: Channel) -> Layout | None:
        """The layout of a payload of the same size and with the same lengths, None for others. Raises DecodeError."""
        fixed = np.frombuffer(payload, np.uint8)[self._places[: self._fixed]]
        if (fixed != self._same[: self._fixed]).any():
            return None
        other = copy(self)
        other._take(payload, channel)
        return other

    def fits(self, payloads: np.ndarray) -> np.ndarray:
        """(N,) which of payloads (N, size) uint8 have this layout."""
        return (payloads[:, self._places] == self._same).all(axis=1)

    def read(self, column: str, payloads: np.ndarray) -> np.ndarray:
        """A column of numbers of payloads (N, size) that fit."""
        path, dtype, strides = self.strides[column]
        each = [one.read(payloads, dtype) for one in strides]
        values = each[0] if len(each) == 1 else np.concatenate(each, axis=2)
        values = values if path.arrays else values[:, 0]
        return values if path.at is None else values[..., path.at]


class Plan(NamedTuple):
    """A definition with the paths of wanted fields, and the layouts of payloads that were met, by their size."""

    types: Types
    paths: dict[str, Path]
    layouts: dict[int, list[Layout]]

    def layout(self, payload: bytes, channel: Channel) -> Layout:
        """The layout of a payload. Raises DecodeError or ValueError for one that does not fit."""
        known = self.layouts.get(len(payload), ())
        found = next(filter(None, (each.of(payload, channel) for each in known)), None)
        if found is None:
            found = Layout(payload, channel, self.types, self.paths)
            keep(self.layouts, found, len(payload))
        return found


def keep(layouts: dict[int, list[Layout]], layout: Layout, size: int) -> None:
    """Keep a layout of payloads of a size; a few at most."""
    if sum(map(len, layouts.values())) >= KEPT_LAYOUTS:
        layouts.clear()
    layouts.setdefault(size, []).append(layout)


@lru_cache(maxsize=256)  # by all topics of one type
def plans_of(
    tables: Callable[[Channel], Iterator[Types]], channel: Channel, wanted: tuple[tuple[str, str], ...]
) -> tuple[Plan, ...]:
    """Every definition that a type may have, with the paths of wanted fields. Raises BadDefinition without one."""
    plans, why = list[Plan](), ""
    for types in tables(channel):
        try:
            plans.append(Plan(types, resolve(types, channel.type_name, dict(wanted)), {}))
        except BadDefinition as error:
            why = f"not the usual {channel.type_name}: {error}"
    if not plans:
        raise BadDefinition(why)
    return tuple(plans)


class ColumnReader:
    """Reads the payloads of one channel as columns, by the first definition that fits one to its last byte.

    tables: gives the checked types of every definition that the type may have. Raises DecodeError where none has the
    wanted fields.
    """

    def __init__(
        self, channel: Channel, wanted: Mapping[str, str], tables: Callable[[Channel], Iterator[Types]]
    ) -> None:
        self._channel, self._memory = channel, dict[str, Any]()
        self._known: dict[int, list[Layout]] = {}
        try:
            self._plans = plans_of(tables, replace(channel, topic="", count=None), tuple(wanted.items()))
        except BadDefinition as error:
            raise DecodeError(channel.topic, f"{channel.type_name}: {error}") from error

    def one(self, payload: bytes) -> Columns:
        """The columns of one payload. Raises DecodeError."""
        ((_, columns),) = self._read_alike(np.zeros(1, np.int64), np.frombuffer(payload, np.uint8)[None])
        if isinstance(columns, DecodeError):
            raise columns
        return columns

    def read(self, payloads: Sequence[bytes]) -> Iterator[tuple[Int, Columns | DecodeError]]:
        """Which payloads (N,), and their columns or why they have none."""
        sizes = list(map(len, payloads))
        for size in sorted(set(sizes)):
            which = np.flatnonzero(np.array(sizes) == size)
            alike = payloads if len(which) == len(payloads) else [payloads[i] for i in which.tolist()]
            yield from self._read_alike(which, np.frombuffer(b"".join(alike), np.uint8).reshape(len(which), size))

    def _read_alike(self, which: Int, payloads: np.ndarray) -> Iterator[tuple[Int, Columns | DecodeError]]:
        known = list(self._known.get(payloads.shape[1], ()))
        while len(which):
            layout = known.pop(0) if known else self._learn(payloads[0].tobytes())
            if isinstance(layout, DecodeError):
                yield which[:1], layout
                which, payloads = which[1:], payloads[1:]
                continue
            fits = layout.fits(payloads)
            if fits.any():
                alike = payloads if fits.all() else np.ascontiguousarray(payloads[fits])
                yield which[fits], Columns(alike, self._channel.topic, layout, self._memory)
                which, payloads = which[~fits], payloads[~fits]

    def _learn(self, payload: bytes) -> Layout | DecodeError:
        """The layout of a payload, kept for others like it, or why it has none."""
        why = f"its payload of {len(payload)} bytes is larger than such a message"
        for plan in self._plans if len(payload) <= LARGEST_BYTES else ():
            try:
                layout = plan.layout(payload, self._channel)
            except (DecodeError, ValueError) as error:
                why = getattr(error, "reason", str(error))
                continue
            self._plans = (plan,)
            keep(self._known, layout, len(payload))
            return layout
        return DecodeError(self._channel.topic, f"not a {self._channel.type_name}: {why}")
