"""Fields of many ROS payloads as columns: where they lie is learnt from one payload, numpy reads them from the others.

A path is `a.b`; `a.b:xyz`, the numbers a.b.x, a.b.y and a.b.z; `a.b[3]`, the first three of an array; `a[].b`, b of all
messages of an array; `a.b[]`, all numbers of one. `PATH | PATH` is the first that a definition has, `PATH ?` may be
missing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype

from quadlog.errors import DecodeError, some_of
from quadlog.messages import NS_PER_S, Int
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.payload import PayloadReader
from quadlog.recordings.decoders.type_definitions import BadDefinition, Types

TEXTS = ("frame", "child", "names")
"""Columns of texts; all others are of numbers."""
DTYPES = dict.fromkeys(("bool", "byte", "char", "octet"), "u1") | {"float32": "f4", "float64": "f8"}
DTYPES |= {f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)}
ARRAYS = (Nodetype.ARRAY, Nodetype.SEQUENCE)
KEPT_LAYOUTS, LARGEST_BYTES = 16, 1 << 20
MOST_SENT = 1 << 16
"""Fields of a payload, each number in an array apart."""


class Columns(dict[str, Any]):
    """Column -> what N messages hold: (N,), (N, K) for K numbers, (N, T) or (N, T, K) with T in arrays; texts are equal
    in all messages. arrays: column -> the arrays that its path leads through; lengths: of each of these, one by one.
    memory: what is kept from one reading of the channel to the next.
    """

    def __init__(self, n: int, topic: str, layout: Layout, memory: dict[str, Any]) -> None:
        super().__init__(layout.texts)
        self.n, self.topic, self.memory = n, topic, memory
        self.arrays, self.lengths = dict(layout.arrays), layout.lengths
        self.sound, self.why = np.ones(n, dtype=np.bool_), ""

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
        frame, child = ((self.get(name) or ("",) * (index + 1))[index] for name in ("frame", "child"))
        return frame.removeprefix("/"), child.removeprefix("/")

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
    """A path that a definition has: its leaves, side by side, or the `first` numbers of its one leaf, an array."""

    leaves: tuple[str, ...]
    arrays: tuple[str, ...]
    first: int
    text: bool


def resolve(types: Types, type_name: str, wanted: Mapping[str, str]) -> dict[str, Path]:
    """Column -> its path in a checked definition (`needed_types`). Raises BadDefinition for a field that it lacks."""
    found = {}
    for column, choices in wanted.items():
        paths = (_at(types, type_name, each.strip(), column in TEXTS) for each in choices.removesuffix("?").split("|"))
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


def _at(types: Types, type_name: str, path: str, text: bool) -> Path | None:
    trunk, _, parts = path.partition(":")
    steps = trunk.split(".")
    arrays = tuple(".".join(steps[: i + 1]) for i, step in enumerate(steps) if step.endswith("[]"))
    trunk, _, first = trunk.partition("[") if trunk[-2:-1].isdigit() else (trunk, "", "")
    trunk, size = trunk + "[]" * bool(first), int(first.removesuffix("]") or 0)
    leaves = tuple(f"{trunk}.{part}" for part in parts) or (trunk,)
    if not all(_leads(types, type_name, leaf.split("."), size, text) for leaf in leaves):
        return None
    return Path(leaves, arrays, size, text)


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


class Walk(PayloadReader):
    """A walk along one payload that notes where wanted fields are; raises DecodeError for one that does not fit.

    fixed: begin and end of what must be the same in payloads like it. By path, each time it was met: wanted texts;
    found: offset, dtype and count of wanted numbers; lengths of arrays.
    """

    def __init__(self, payload: bytes, channel: Channel, leaves: Collection[str] = (), left: int = MOST_SENT) -> None:
        super().__init__(payload, channel.message_encoding, channel.topic)
        self.fixed: list[tuple[int, int]] = [] if self.ros1 else [(0, 2)]
        self.texts: dict[str, list[str]] = {}
        self.found: dict[str, list[tuple[int, str, int]]] = {}
        self.lengths: dict[str, list[int]] = {}
        self._leaves, self._left = leaves, left

    def along(self, types: Types, type_name: str, prefix: str = "") -> None:
        """Over the fields of a message of a checked type."""
        for name, (kind, detail) in types[type_name][1]:
            path, count = prefix + name, 1
            if kind in ARRAYS:
                path, count = f"{path}[]", self.length() if kind == Nodetype.SEQUENCE else detail[1]
                self.lengths.setdefault(path, []).append(count)
                kind, detail = detail[0]
            if kind == Nodetype.NAME:
                self.spend(count)
                for _ in range(count):
                    self.along(types, detail, f"{path}.")
            elif detail[0] == "string":
                self.spend(count)
                for _ in range(count):
                    size, wanted = self.length(), path in self._leaves
                    self.fixed += [(self.at, self.at + size)] if wanted else []
                    text = self.text(size)
                    self.texts.setdefault(path, []).extend([text] if wanted else [])
            else:
                self.spend(1)
                begin = self.numbers(dtype := self.dtype(detail[0]), count)
                if path in self._leaves:
                    self.found.setdefault(path, []).append((begin, self.order + dtype, count))

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

    def dtype(self, base: str) -> str:
        """The dtype of a basic type."""
        if base not in DTYPES:
            raise self.wrong(f"it has a {base}, which quadlog does not read")
        return DTYPES[base]


class Grid(NamedTuple):
    """Where the numbers (T, K) of a leaf lie, in blocks of even distances: a shape, an offset, two strides."""

    dtype: np.dtype[Any]
    shape: tuple[int, int]
    blocks: list[tuple[Any, tuple[int, int], int, tuple[int, int]]]

    @classmethod
    def of(cls, found: Sequence[tuple[int, str, int]], first: int) -> Grid:
        """found: as Walk has it; first: K, 0 for one. Raises ValueError for shorter arrays."""
        dtype = np.dtype(found[0][1] if found else "f8")
        if any(count < first for *_, count in found):
            raise ValueError(f"it has an array of less than {first} numbers")
        ranges = [np.arange(first or count) * dtype.itemsize + at for at, _, count in found]
        offsets = np.concatenate([np.empty(0, np.int64), *ranges]).reshape(-1, first or 1)
        steps = [np.unique(np.diff(offsets, axis=axis)) for axis in (0, 1)]
        if len(offsets) and all(len(each) < 2 for each in steps):
            down, across = (int(each.sum()) for each in steps)
            return cls(dtype, offsets.shape, [(slice(None), offsets.shape, int(offsets[0, 0]), (down, across))])
        rows = [(slice(i, i + 1), (1, first or 1), int(each[0]), (0, dtype.itemsize)) for i, each in enumerate(offsets)]
        return cls(dtype, offsets.shape, rows)

    def read(self, payloads: np.ndarray, values: np.ndarray) -> None:
        """Fill values (N, T, K) from C-contiguous payloads (N, size) uint8."""
        n, size = payloads.shape
        for rows, shape, offset, strides in self.blocks:
            values[:, rows] = np.ndarray((n, *shape), self.dtype, payloads, offset, (size, *strides))


class Layout:
    """Payloads of one size with the same lengths and wanted texts. Raises DecodeError, ValueError."""

    def __init__(self, payload: bytes, channel: Channel, types: Types, paths: Mapping[str, Path]) -> None:
        walk = Walk(payload, channel, {leaf for path in paths.values() for leaf in path.leaves})
        walk.along(types, channel.type_name)
        walk.end()
        self._places = np.concatenate([np.arange(*each) for each in [*walk.fixed, (0, 0)]])
        self._same = np.frombuffer(payload, np.uint8)[self._places]
        arrays = {array for path in paths.values() for array in path.arrays}
        self.lengths = {array: np.array(walk.lengths.get(array, ()), np.int64) for array in arrays}
        self.arrays = {column: path.arrays for column, path in paths.items()}
        self.texts = {column: tuple(walk.texts.get(each.leaves[0], ())) for column, each in paths.items() if each.text}
        self._grids = [
            (column, path, [Grid.of(walk.found.get(leaf, []), path.first) for leaf in path.leaves])
            for column, path in paths.items()
            if not path.text
        ]

    def fits(self, payloads: np.ndarray) -> np.ndarray:
        """(N,) which of payloads (N, size) uint8 have this layout."""
        return (payloads[:, self._places] == self._same).all(axis=1)

    def columns(self, payloads: np.ndarray, topic: str, memory: dict[str, Any]) -> Columns:
        """The wanted columns of payloads (N, size) that fit."""
        columns = Columns(len(payloads), topic, self, memory)
        for column, path, grids in self._grids:
            (t, k), m = grids[0].shape, len(grids)
            values = np.empty(
                (len(payloads), t, k * m), "f8" if any(each.dtype.kind == "f" for each in grids) else "i8"
            )
            with np.errstate(invalid="ignore"):  # signalling NaN of damaged payloads
                for i, grid in enumerate(grids):
                    grid.read(payloads, values[..., i : i + k])
            values = values if path.arrays else values[:, 0]
            columns[column] = values if path.first or m > 1 else values[..., 0]
        return columns


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
        self._plans: list[tuple[Types, dict[str, Path]]] = []
        why = ""
        try:
            for types in tables(channel):
                try:
                    self._plans.append((types, resolve(types, channel.type_name, wanted)))
                except BadDefinition as error:
                    why = f"not the usual {channel.type_name}: {error}"
        except BadDefinition as error:
            why = str(error)
        if not self._plans:
            raise DecodeError(channel.topic, f"{channel.type_name}: {why}")

    def one(self, payload: bytes) -> Columns:
        """The columns of one payload. Raises DecodeError."""
        ((_, columns),) = self.read([payload])
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
                yield which[fits], layout.columns(alike, self._channel.topic, self._memory)
                which, payloads = which[~fits], payloads[~fits]

    def _learn(self, payload: bytes) -> Layout | DecodeError:
        """The layout of a payload, kept for others like it, or why it has none."""
        why = f"its payload of {len(payload)} bytes is larger than such a message"
        for plan in self._plans if len(payload) <= LARGEST_BYTES else ():
            try:
                layout = Layout(payload, self._channel, *plan)
            except (DecodeError, ValueError) as error:
                why = getattr(error, "reason", str(error))
                continue
            self._plans = [plan]
            if sum(map(len, self._known.values())) == KEPT_LAYOUTS:
                self._known.clear()
            self._known.setdefault(len(payload), []).append(layout)
            return layout
        return DecodeError(self._channel.topic, f"not a {self._channel.type_name}: {why}")
