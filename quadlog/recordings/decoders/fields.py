"""Fields of many ROS payloads as columns: where they lie is learnt from one payload, numpy reads them from the others.

A path is `a.b`; `a.b:xyz`, the numbers a.b.x, a.b.y and a.b.z; `a.b[3]`, the first three of an array; `a[].b`, b of all
messages of an array; `a.b[]`, all numbers of one. `PATH | PATH` is the first that a definition has, `PATH ?` may be
missing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype

from quadlog.errors import DecodeError
from quadlog.messages import NS_PER_S, Int
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.type_definitions import BadDefinition, Types

TEXTS = ("frame", "child", "names")
"""Columns of texts; all others are of numbers."""
DTYPES = dict.fromkeys(("bool", "byte", "char", "octet"), "u1") | {"float32": "f4", "float64": "f8"}
DTYPES |= {f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)}
ARRAYS = (Nodetype.ARRAY, Nodetype.SEQUENCE)
CDR_ORDER, CDR_SLACK = {b"\0\0": ">", b"\0\1": "<"}, 3  # writers may fill a payload up to four bytes
KEPT_LAYOUTS, LARGEST_BYTES = 16, 1 << 20
MOST_SENT = 1 << 16
"""Fields of a payload, each number in an array apart."""


class Misfit(ValueError):
    """A payload that does not follow its definition, or a definition without a wanted field."""


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
    """Column -> its path in a checked definition (`needed_types`). Raises Misfit for a field that it lacks."""
    found = {}
    for column, choices in wanted.items():
        paths = (_at(types, type_name, each.strip(), column in TEXTS) for each in choices.removesuffix("?").split("|"))
        path = next(filter(None, paths), None)
        if path is not None:
            found[column] = path
        elif not choices.endswith("?"):
            raise Misfit(f"its definition has no field {choices}")
    return found


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


class Step(NamedTuple):
    """A field to walk over: numbers, strings ("s") or messages ("").

    length: None for one that is no array, -1 where the payload gives it; path: empty where nothing of it is wanted.
    """

    dtype: str
    length: int | None
    path: str
    inner: tuple[Step, ...] = ()


def flat_steps(types: Types, type_name: str, leaves: Collection[str]) -> tuple[Step, ...]:
    """All fields of a checked type and of the types within it. Raises Misfit for kinds of fields that are not read."""
    wanted = {leaf[: i + 1] for leaf in leaves for i, sign in enumerate(leaf) if sign == "]"} | {*leaves}

    def of(name: str, prefix: str) -> Iterator[Step]:
        for field_name, (kind, detail) in types[name][1]:
            path, count = prefix + field_name, None
            if kind in ARRAYS:
                path, count = f"{path}[]", detail[1] if kind == Nodetype.ARRAY else -1
                kind, detail = detail[0]
            if kind == Nodetype.NAME and count is None:
                yield from of(detail, f"{path}.")
                continue
            inner = tuple(of(detail, f"{path}.")) if kind == Nodetype.NAME else ()
            dtype = "" if kind == Nodetype.NAME else "s" if detail[0] == "string" else DTYPES.get(detail[0])
            if dtype is None:
                raise Misfit(f"its field {path} is a {detail[0]}")
            yield Step(dtype, count, path if path in wanted else "", inner)

    return tuple(of(type_name, ""))


@dataclass
class Walk:
    """A walk along one payload. Its steps raise Misfit where the payload ends before, or has more than `left` fields.

    fixed: what must be the same in payloads like it; texts, numbers, lengths: what was met where something is wanted.
    """

    payload: bytes
    cdr: bool
    left: int = MOST_SENT
    at: int = 0
    order: str = "<"
    fixed: list[tuple[int, bytes]] = field(default_factory=list)
    texts: dict[str, list[str]] = field(default_factory=dict)
    numbers: dict[str, list[tuple[int, str, int]]] = field(default_factory=dict)
    lengths: dict[str, list[int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.cdr:
            mark = self.skip(4)[:2]
            if mark not in CDR_ORDER:
                raise Misfit(f"not a plain CDR payload (starts with {mark.hex() or 'nothing'})")
            self.order = CDR_ORDER[mark]
            self.fixed.append((0, mark))

    def along(self, steps: Sequence[Step]) -> None:
        """Over the fields of a message."""
        self.spend(len(steps))
        for dtype, given, path, inner in steps:
            count = 1 if given is None else self.length() if given < 0 else given
            if path and given is not None:
                self.lengths.setdefault(path, []).append(count)
            if dtype in ("", "s"):
                self.spend(count)
                for _ in range(count):
                    if inner:
                        self.along(inner)
                    elif dtype and path:
                        self.texts.setdefault(path, []).append(self.text(wanted=True))
                    elif dtype:
                        self.text()
            else:
                begin = self.over_numbers(dtype, count)
                if path:
                    self.numbers.setdefault(path, []).append((begin, self.order + dtype, count))

    def end(self) -> None:
        """Raise Misfit unless the payload ends here."""
        left = len(self.payload) - self.at
        if left > (CDR_SLACK if self.cdr else 0):
            raise Misfit(f"{left} bytes are left over")

    def spend(self, fields: int) -> None:
        self.left -= fields
        if self.left < 0:
            raise Misfit("it has more fields than such a message")

    def text(self, *, wanted: bool = False) -> str:
        size = self.length()
        begin, raw = self.at, self.skip(size)
        if self.cdr and raw[-1:] != b"\0":
            raise Misfit("a string does not end with its zero byte")
        if wanted:
            self.fixed.append((begin, raw))
        try:
            return (raw[:-1] if self.cdr else raw).decode()
        except UnicodeDecodeError:
            raise Misfit("a string is not UTF-8") from None

    def length(self) -> int:
        begin = self.over_numbers("u4", 1)
        raw = self.payload[begin : self.at]
        self.fixed.append((begin, raw))
        return int.from_bytes(raw, "little" if self.order == "<" else "big")

    def over_numbers(self, dtype: str, count: int) -> int:
        """Where numbers begin, having stepped over them."""
        size = int(dtype[1])
        if self.cdr and count:  # counts from behind its first four bytes; an empty sequence is not aligned
            self.skip((4 - self.at) % size)
        begin = self.at
        self.skip(count * size)
        return begin

    def skip(self, size: int) -> bytes:
        begin, self.at = self.at, self.at + size
        if self.at > len(self.payload):
            raise Misfit(f"it ends after {len(self.payload)} bytes, in the middle of a field")
        return self.payload[begin : self.at]


class Grid(NamedTuple):
    """Where the numbers (T, K) of a leaf lie, in blocks of even distances: a shape, an offset, two strides."""

    dtype: np.dtype[Any]
    shape: tuple[int, int]
    blocks: list[tuple[Any, tuple[int, int], int, tuple[int, int]]]

    @classmethod
    def of(cls, found: Sequence[tuple[int, str, int]], first: int) -> Grid:
        """found: offset, dtype and count each time that the leaf was met; first: K, 0 for one. Raises Misfit."""
        dtype = np.dtype(found[0][1] if found else "f8")
        if any(count < first for *_, count in found):
            raise Misfit(f"it has an array of less than {first} numbers")
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
    """Payloads of one size that have the same wanted texts and the same lengths. Raises Misfit."""

    def __init__(self, payload: bytes, cdr: bool, steps: Sequence[Step], paths: Mapping[str, Path]) -> None:
        walk = Walk(payload, cdr)
        walk.along(steps)
        walk.end()
        fixed = [(at + i, byte) for at, raw in walk.fixed for i, byte in enumerate(raw)]
        self._places, self._same = np.array(fixed, np.intp).reshape(-1, 2).T
        arrays = {array for path in paths.values() for array in path.arrays}
        self.lengths = {array: np.array(walk.lengths.get(array, ()), np.int64) for array in arrays}
        self.arrays = {column: path.arrays for column, path in paths.items()}
        self.texts = {column: tuple(walk.texts.get(each.leaves[0], ())) for column, each in paths.items() if each.text}
        self._grids = [
            (column, path, [Grid.of(walk.numbers.get(leaf, []), path.first) for leaf in path.leaves])
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
        self._channel, self._cdr = channel, channel.message_encoding != "ros1"
        self._known: dict[int, list[Layout]] = {}
        self._memory: dict[str, Any] = {}
        self._plans: list[tuple[tuple[Step, ...], dict[str, Path]]] = []
        why = ""
        try:
            for types in tables(channel):
                try:
                    paths = resolve(types, channel.type_name, wanted)
                    leaves = {leaf for path in paths.values() for leaf in path.leaves}
                    self._plans.append((flat_steps(types, channel.type_name, leaves), paths))
                except Misfit as error:
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
                layout = Layout(payload, self._cdr, *plan)
            except Misfit as error:
                why = str(error)
                continue
            self._plans = [plan]
            if sum(map(len, self._known.values())) == KEPT_LAYOUTS:
                self._known.clear()
            self._known.setdefault(len(payload), []).append(layout)
            return layout
        return DecodeError(self._channel.topic, f"not a {self._channel.type_name}: {why}")
