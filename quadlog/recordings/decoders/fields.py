"""Fields of many ROS payloads as columns: where they lie is learnt from one payload, numpy reads them from the others.

A path is `a.b`; `a.b:xyz`, the numbers a.b.x, a.b.y and a.b.z; `a.b[3]`, the first three of an array; `a[].b`, b of all
messages of an array; `a.b[]`, all numbers of one. `PATH | PATH` is the first that a definition has, `PATH ?` may be
missing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
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
"""Columns of texts; all others are of numbers."""
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
        return column in self._known or column in self._layout.numbers

    def __getitem__(self, column: str) -> Any:
        if column not in self._known:
            self._known[column] = self._layout.numbers[column].read(self._payloads)
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
        return places_in(self.lengths[self.arrays[column][-1]])


def places_in(lengths: Int) -> Int:
    """(T,) the place of each element of arrays, one behind the other, in its own."""
    return np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)


class Path(NamedTuple):
    """A path that a definition has: its leaves, side by side, or the `first` numbers of its one leaf, an array."""

    leaves: tuple[str, ...]
    arrays: tuple[str, ...]
    first: int
    text: bool

    @classmethod
    def of(cls, path: str, text: bool) -> Path:
        """As it is written."""
        trunk, _, parts = path.strip().partition(":")
        steps = trunk.split(".")
        arrays = tuple(".".join(steps[: i + 1]) for i, step in enumerate(steps) if step.endswith("[]"))
        trunk, _, first = trunk.partition("[") if trunk[-2:-1].isdigit() else (trunk, "", "")
        trunk = trunk + "[]" * bool(first)
        leaves = tuple(f"{trunk}.{part}" for part in parts) or (trunk,)
        return cls(leaves, arrays, int(first.removesuffix("]") or 0), text)


def leaves_of(types: Types, name: str, prefix: str = "", but: str = "") -> Iterator[tuple[str, str, int]]:
    """Path, basic type and size of each number and text in messages of a checked type (`needed_types`).

    `[]` in a path: of each element; size: of an array of fixed length, 0 for others. but: a type that is left out.
    """
    for field, (kind, detail) in types[name][1]:
        size = detail[1] if kind == Nodetype.ARRAY else 0
        path, (kind, detail) = (f"{field}[]", detail[0]) if kind in ARRAYS else (field, (kind, detail))
        if kind == Nodetype.NAME and detail != but:
            yield from leaves_of(types, detail, f"{prefix}{path}.", but)
        elif kind == Nodetype.BASE:
            yield prefix + path, detail[0], size


def resolve(types: Types, type_name: str, wanted: Mapping[str, str]) -> dict[str, Path]:
    """Column -> its path in a checked definition. Raises BadDefinition for a field that it lacks."""
    leaves, found = {path: (base == "string", size) for path, base, size in leaves_of(types, type_name)}, {}

    def has(path: Path) -> bool:
        given = [leaves.get(leaf, (None, 0)) for leaf in path.leaves]
        return all(text == path.text and (size or path.first) >= path.first for text, size in given)

    for column, choices in wanted.items():
        paths = (Path.of(each, column in TEXTS) for each in choices.removesuffix("?").split("|"))
        path = next(filter(has, paths), None)
        if path is not None:
            found[column] = path
        elif not choices.endswith("?"):
            near = some_of(_names_near(leaves, choices.split(".")))
            raise BadDefinition(f"its definition has no {'text' if column in TEXTS else 'number'} {choices} ({near})")
    return found


def _names_near(leaves: Collection[str], steps: Sequence[str]) -> list[str]:
    """The fields where steps lead no farther, as paths."""
    within = ".".join([*steps[:-1], ""])
    near = dict.fromkeys(within + leaf[len(within) :].split(".")[0] for leaf in leaves if leaf.startswith(within))
    return [*near] if near or not within else _names_near(leaves, steps[:-1])


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


class Numbers:
    """Where the numbers (T, K) of a path lie in payloads. found: as Walk has it, of each leaf.

    Raises ValueError for arrays that are too short.
    """

    def __init__(self, path: Path, found: Sequence[Sequence[tuple[int, str, int]]]) -> None:
        if any(count < path.first for *_, count in found[0]):
            raise ValueError(f"it has an array of less than {path.first} numbers")
        kind, *others = {dtype for leaf in found for _, dtype, _ in leaf} or {"<f8"}
        self._apart = [Numbers(path, [leaf]) for leaf in found] if others else []
        size, k = int(kind[-1]), (path.first or 1) * len(found)
        counts = np.array([path.first or count for *_, count in found[0]], np.int64)
        begins = np.array([[begin for begin, *_ in leaf] for leaf in found], np.int64)
        at = (np.repeat(begins, counts, axis=1) + size * places_in(counts)).T.reshape(-1, k)
        self._dtype, self._wide = np.dtype(kind), "f8" if kind[-2] == "f" else "i8"
        self._shape = at.shape[not path.arrays : 1 + (k > 1 or path.first > 0)]
        steps = [int(np.diff(each).sum()) for each in (at[:2, 0], at[0, :2])] if at.size else [0, 0]
        even = at[:1, :1] + steps[0] * np.arange(len(at))[:, None] + steps[1] * np.arange(k)
        self._strided = (at.shape, int(at[0, 0]), steps) if at.size and (at == even).all() else None
        self._bytes = (at[..., None] + np.arange(size)).ravel()

    def read(self, payloads: np.ndarray) -> np.ndarray:
        """(N, ...) numbers of C-contiguous payloads (N, size) uint8; T only of arrays, K only of several."""
        n, size = payloads.shape
        if self._apart:
            return np.stack([each.read(payloads) for each in self._apart], axis=-1)
        if self._strided is None:
            return payloads.take(self._bytes, axis=1).view(self._dtype).astype(self._wide).reshape(n, *self._shape)
        shape, begin, steps = self._strided
        numbers = np.ndarray((n, *shape), self._dtype, payloads, begin, (size, *steps)).astype(self._wide)
        return numbers.reshape(n, *self._shape)


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
        numbers = {column: path for column, path in paths.items() if not path.text}
        self.numbers = {
            column: Numbers(path, [walk.found.get(leaf, []) for leaf in path.leaves])
            for column, path in numbers.items()
        }

    def _take(self, payload: bytes, channel: Channel) -> None:
        reader, texts = PayloadReader(payload, channel.message_encoding, channel.topic), dict[str, tuple[str, ...]]()
        for column, found in self._texts.items():
            texts[column] = tuple(reader.text(size, at) for at, size in found)
        self.texts, self._same = texts, np.frombuffer(payload, np.uint8)[self._places]

    def of(self, payload: bytes, channel: Channel) -> Layout | None:
        """The layout of a payload of the same size and with the same lengths, None for others. Raises DecodeError."""
        differs = np.frombuffer(payload, np.uint8)[self._places] != self._same
        if differs[: self._fixed].any():
            return None
        if not differs.any():
            return self
        other = copy(self)
        other._take(payload, channel)
        return other

    def fits(self, payloads: np.ndarray) -> np.ndarray:
        """(N,) which of payloads (N, size) uint8 have this layout."""
        return (payloads[:, self._places] == self._same).all(axis=1)


class Plan(NamedTuple):
    """A definition with the paths of wanted fields, and layouts of payloads that were met, by their size."""

    types: Types
    paths: dict[str, Path]
    layouts: dict[int, list[Layout]]

    def layout(self, payload: bytes, channel: Channel) -> Layout:
        """The layout of a payload. Raises DecodeError or ValueError for one that does not fit."""
        known = self.layouts.get(len(payload), ())
        found = next(filter(None, (each.of(payload, channel) for each in known)), None)
        if found is None:
            found = Layout(payload, channel, self.types, self.paths)
            if sum(map(len, self.layouts.values())) >= KEPT_LAYOUTS:
                self.layouts.clear()
            self.layouts.setdefault(len(payload), []).append(found)
        return found


@lru_cache(maxsize=256)  # by all topics of one type
def plans_of(
    tables: Callable[[Channel], Iterator[Types]], channel: Channel, wanted: tuple[tuple[str, str], ...]
) -> tuple[Plan, ...] | str:
    """Every definition that a type may have, with the paths of wanted fields, or why there is none."""
    plans, why = list[Plan](), ""
    try:
        for types in tables(channel):
            try:
                plans.append(Plan(types, resolve(types, channel.type_name, dict(wanted)), {}))
            except BadDefinition as error:
                why = f"not the usual {channel.type_name}: {error}"
    except BadDefinition as error:
        return str(error)
    return tuple(plans) or why


class ColumnReader:
    """Reads the payloads of one channel as columns, by the first definition that fits one to its last byte.

    tables: gives the checked types of every definition that the type may have. Raises DecodeError where none has the
    wanted fields.
    """

    def __init__(
        self, channel: Channel, wanted: Mapping[str, str], tables: Callable[[Channel], Iterator[Types]]
    ) -> None:
        self._channel, self._memory = channel, dict[str, Any]()
        plans = plans_of(tables, replace(channel, topic="", count=0), tuple(wanted.items()))
        if isinstance(plans, str):
            raise DecodeError(channel.topic, f"{channel.type_name}: {plans}")
        self._plans = plans

    def one(self, payload: bytes) -> Columns:
        """The columns of one payload. Raises DecodeError."""
        ((_, columns),) = self._read_alike(np.zeros(1, np.int64), np.frombuffer(payload, np.uint8)[None])
        if isinstance(columns, DecodeError):
            raise columns
        return columns

    def read(self, payloads: Sequence[bytes]) -> Iterator[tuple[Int, Columns | DecodeError]]:
        """Which payloads (N,), and their columns or why they have none."""
        sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
        for size in np.unique(sizes).tolist():
            which = np.flatnonzero(sizes == size)
            alike = payloads if len(which) == len(payloads) else [payloads[i] for i in which.tolist()]
            yield from self._read_alike(which, np.frombuffer(b"".join(alike), np.uint8).reshape(len(which), size))

    def _read_alike(self, which: Int, payloads: np.ndarray) -> Iterator[tuple[Int, Columns | DecodeError]]:
        while len(which):
            layout = self._layout(payloads[0].tobytes())
            fits = np.arange(len(which)) == 0 if isinstance(layout, DecodeError) else layout.fits(payloads)
            if isinstance(layout, DecodeError):
                yield which[:1], layout
            else:
                alike = payloads if fits.all() else np.ascontiguousarray(payloads[fits])
                yield which[fits], Columns(alike, self._channel.topic, layout, self._memory)
            which, payloads = which[~fits], payloads[~fits]

    def _layout(self, payload: bytes) -> Layout | DecodeError:
        """The layout of a payload, or why it has none."""
        why = f"its payload of {len(payload)} bytes is larger than such a message"
        for plan in self._plans if len(payload) <= LARGEST_BYTES else ():
            try:
                layout = plan.layout(payload, self._channel)
            except (DecodeError, ValueError) as error:
                why = getattr(error, "reason", str(error))
                continue
            self._plans = (plan,)
            return layout
        return DecodeError(self._channel.topic, f"not a {self._channel.type_name}: {why}")
