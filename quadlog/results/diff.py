"""Whether two runs have the same results, and where they differ first: one merge of columns for each result."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from string import ascii_uppercase
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.errors import clipped, printable, some_of
from quadlog.metrics.catalogue import THEMES
from quadlog.results import STAGE_FILES
from quadlog.results.record import RunRecord
from quadlog.results.run import Run
from quadlog.results.tables import read_table
from quadlog.results.text import ASCII, print_table, table_rows, terminal_width
from quadlog.results.view import Moment

if TYPE_CHECKING:
    from pandas import DataFrame

_KEYS = ("t_ns", "tag", "anchor", "i", "body", "joint", "phase")
"""Columns that identify a row, where a result has them."""
COLUMNS = ("stage", "result", "column", "rows", "t_ns", "a", "b", "apart", "largest")
MADE = "made"
"""The stage of how the runs were made, which is no difference of results."""
TIMINGS = frozenset({"ms", "us"})
"""Not compared: they differ from machine to machine."""

WORDS = {
    "poses": "positions", "pose_uncertainty": "bounds of positions", "links": "biases",
    "other_poses": "other positions", "target": "tracks of the person", "uwb_errors": "errors of UWB",
    "cloud_samples": "points", "fixes": "single fixes", "ground": "ground heights", "plans": "replans",
    "paths": "planned paths", "astar": "replans by A*", "resim_plans": "replans of the simulated walk",
    "resim_paths": "paths of the simulated walk", "control": "simulated walks",
    "clearances": "distances to obstacles", "body": "bodies", "gait": "gaits", "reference": "references",
}  # fmt: skip
"""Results in words; others are called by their names."""


def diff_runs(a: Run, b: Run, absolute: float = 0.0, relative: float = 0.0) -> DataFrame:
    """A row for each column that differs, with the columns COLUMNS.

    rows: number of rows that differ. t_ns, a, b, apart: of the first of them. largest: largest difference. column:
    empty for a result that only one run has. Rows of the stage MADE, how the runs were made, come first; then stages
    in their order, in each the results that only one run has and then the earliest difference. Numbers are equal if
    they are nearer than absolute, or than relative times the larger one. Raises NotARun, TooLarge, UnreadableFile.
    """
    from pandas import DataFrame

    def recorded(what: Callable[[Run], dict[str, Any]]) -> Iterator[dict[str, Any]]:
        one, other = (DataFrame([what(run)], dtype=object) for run in (a, b))
        return merge_frames("run.json", one, other)

    found = [{"stage": MADE, **row} for row in recorded(_origins)]
    for stage, files in STAGE_FILES.items():
        rows = [row for name in files for row in _result(name, a, b, absolute, relative)]
        rows += [*recorded(_read)] if stage == "ingest" else []
        rows.sort(key=lambda row: (row["column"] != "", row["t_ns"] is None, row["t_ns"] or 0))
        found += [{"stage": stage, **row} for row in rows]
    return DataFrame(found, columns=list(COLUMNS), dtype=object)


def of_results(differences: DataFrame) -> DataFrame:
    """The differences of results, without how the runs were made; empty where the results are the same."""
    return differences[differences["stage"] != MADE]


def first_moments(differences: DataFrame, run: Run) -> list[Moment]:
    """The first instant at which each result of two runs differs."""
    timed = differences[differences["t_ns"].notna()].drop_duplicates("result")
    seconds = run.seconds(timed["t_ns"].to_numpy(np.int64)).tolist()
    moments = []
    row: Any
    for at, row in zip(seconds, timed.itertuples(), strict=True):
        values = row.column if row.a is row.b is None else f"{row.column}: {_text(row.a)}, {_text(row.b)}"
        moments.append(Moment(at, f"{WORDS.get(row.result, row.result)} differ first", values))
    return moments


def diff_text(differences: DataFrame, start_ns: int) -> str:
    """The first difference in a sentence, how the runs were made, and a table of all differences of results.

    start_ns: 0 s of the instants.
    """
    at_s = ["" if t_ns is None else f"{(t_ns - start_ns) / 1e9:.3f}" for t_ns in differences["t_ns"]]
    shown = differences.assign(at_s=at_s, **{side: differences[side].map(partial(_text, digits=5)) for side in "ab"})
    made, found = shown[shown["stage"] == MADE], of_results(shown)
    blocks = ["" if len(found) else "results: the same\n"]
    row: Any
    for row, when in zip(of_results(differences).head(1).itertuples(), found["at_s"], strict=False):
        at = f" at {when} s (t_ns {row.t_ns})" if when else ""
        by = "" if row.apart is None else f" (by {_text(row.apart)})"
        values = "" if row.a is row.b is None else f": {_text(row.a)} | {_text(row.b)}{by}"
        what = ", ".join(filter(None, [row.result, row.column]))
        blocks = [printable(f"results: differ, first in stage {row.stage}: {what}{at}{values}") + "\n"]
    if len(made):
        rows = made[["column", "a", "b"]].to_numpy().tolist()
        blocks.append(print_table(("made with", "A", "B"), rows, width=terminal_width()))
    if len(found):
        names = [", ".join(filter(None, name)) for name in zip(found["result"], found["column"], strict=True)]
        rows = found.assign(name=names)[["name", "rows", "a", "b", "at_s", "largest"]].to_numpy().tolist()
        head, *laid = table_rows(("result", "rows", "A", "B", "first s", "largest"), rows, terminal_width())
        stages = ["", *found["stage"], ""]
        for stage, before, lines in zip(stages[1:], stages, laid, strict=False):
            head += [f"{stage}:"] * (stage not in (before, "")) + lines
        blocks.append("".join(f"{line}\n" for line in head).translate(ASCII))
    return "\n".join(blocks)


def _text(value: Any, digits: int = 9) -> str:
    return "none" if value is None else f"{value:.{digits}g}" if isinstance(value, float) else clipped(value, 60)


_OF_THE_SAMPLE = ("topics", "uwb.anchors", "uwb.tags", "uwb.range_topics", "lidar.mount",
                  "seed", "start_s", "duration_s", "until", "msg_path")  # fmt: skip
"""Facts about a recording and its robot, and what chooses the part that is read: runs made alike may differ in them."""


def differing_settings(records: Sequence[RunRecord]) -> list[str]:
    """A line `key: value, value` for each setting in which the runs differ: only runs made alike are averaged."""
    lines = unlike_settings(records).items()
    return [
        printable(f"{key}: {some_of([*dict.fromkeys(of)])}") for key, of in lines if not key.startswith(_OF_THE_SAMPLE)
    ]


def unlike_settings(records: Sequence[RunRecord], missing: str = "not set") -> dict[str, list[str]]:
    """The keys of configuration and options in which runs differ, each with the value of each run.

    A list of tables is compared as a whole: the number of its entries, and a letter where equal numbers differ.
    """
    runs = [_flat(of.config.model_dump(mode="json")) | _flat(of.options) | {"seed": of.seed} for of in records]
    columns = {key: [run.get(key, missing) for run in runs] for of in runs for key in of}
    return {key: [_whole(value, of) for value in of] for key, of in columns.items() if any(it != of[0] for it in of)}


def _whole(value: Any, among: Sequence[Any]) -> str:
    """A setting as text; a list of tables by its length, with a letter for each kind among those of one length."""
    lists = [of for of in among if _is_tables(of)]
    if not lists or not _is_tables(value):
        return "none" if lists else str(value)
    kinds = [of for at, of in enumerate(lists) if len(of) == len(value) and of not in lists[:at]]
    return f"{len(value)}" + f" ({ascii_uppercase[kinds.index(value) % 26]})" * (len(kinds) > 1)


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], Mapping)


def _origins(run: Run) -> dict[str, Any]:
    """How a run was made, without command, paths and name of the host."""
    record = run.record
    kind, mark = record.input.fingerprint or ("input", None)
    options = {key: value for key, value in record.options.items() if key != "seed"}
    versions = {"quadlog": record.quadlog_version, **record.packages}
    config = _flat(record.config.model_dump(mode="json", exclude_none=True), "config.", lists=True)
    return config | {kind: mark, "seed": record.seed} | _flat(options, "options.") | versions


def _read(run: Run) -> dict[str, Any]:
    """Topics by role with their number of messages, and losses."""
    topics = {f"{of.role} {of.topic}": of.messages for of in run.record.topics}
    return topics | {f"loss {number}": of.detail for number, of in enumerate(run.record.losses)}


def _flat(values: Mapping[Any, Any], prefix: str = "", lists: bool = False) -> dict[str, Any]:
    """The values of nested tables by dotted key. lists: also those of lists of tables, by number."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        table = dict(enumerate(value)) if lists and _is_tables(value) else value
        found |= _flat(table, f"{prefix}{key}.", lists) if isinstance(table, Mapping) else {f"{prefix}{key}": value}
    return found


def _row(*values: Any) -> dict[str, Any]:
    """The first of COLUMNS after the stage, in their order."""
    return {**dict.fromkeys(COLUMNS[1:]), **dict(zip(COLUMNS[1:], values, strict=False))}


def _result(name: str, a: Run, b: Run, absolute: float, relative: float) -> Iterator[dict[str, Any]]:
    saved = ["saved" if run.has(name) else "missing" for run in (a, b)]
    if saved == ["saved", "saved"]:
        yield from merge_frames(name.partition(".")[0], _frame(a, name), _frame(b, name), absolute, relative)
    elif "saved" in saved:
        yield _row(name, "", 1, None, *saved)


def _frame(run: Run, name: str) -> DataFrame:
    """Any saved result as columns: one row for a file of names and values, the bytes of an unknown kind."""
    from pandas import DataFrame, Series

    stem, _, suffix = name.partition(".")
    if suffix == "parquet":
        return DataFrame(read_table(run.path, stem, largest=math.inf))
    if suffix == "tum" and (poses := run.trajectory(stem)) is not None:
        seven = np.column_stack([poses.position_m, poses.quat_xyzw])
        return DataFrame(seven, columns=[*"xyz", "qx", "qy", "qz", "qw"]).assign(t_ns=poses.t_ns)
    if stem == "maps" and (maps := run.maps) is not None:
        places = DataFrame(maps.origin_m, columns=["origin_x_m", "origin_y_m"]).assign(t_ns=maps.t_ns)
        seen = [(of.sum(), hashlib.blake2b(np.packbits(of).tobytes(), digest_size=8).hexdigest()) for *_, of in maps]
        same: dict[str, Any] = {"cell_m": maps.cell_m, "shape": f"{maps.shape[0]} by {maps.shape[1]}"}
        return places.assign(occupied=[int(n) for n, _ in seen], cells=[digest for _, digest in seen], **same)
    if name == "metrics.json":
        kept = ((f"{key}.{part}", getattr(of, part)) for key, of in run.metrics.items() for part in ("value", "n")
                if key not in THEMES["Computing"])  # fmt: skip
        return DataFrame([dict(kept)])
    if suffix == "npz":
        arrays = {key: Series(array.ravel()) for key, array in (run.arrays(stem) or {}).items()}
        return DataFrame(arrays).rename(columns={"t_ns": "at_ns"})
    return DataFrame({"byte": np.frombuffer((run.path / name).read_bytes(), np.uint8)})


def merge_frames(
    name: str, a: DataFrame, b: DataFrame, absolute: float = 0.0, relative: float = 0.0
) -> Iterator[dict[str, Any]]:
    """The differences of two tables, whose rows are matched by key, and by their order within a key."""
    if a.equals(b):
        return
    columns = list(dict.fromkeys((*a.columns, *b.columns)))
    keys = [key for key in _KEYS if key in a] + (["source"] if name == "uwb_errors" else [])
    a, b = (of.reindex(columns=columns).assign(_nth=of.groupby(keys).cumcount() if keys else of.index) for of in (a, b))
    both = a.merge(b, "outer", on=[*keys, "_nth"], suffixes=("_a", "_b"), indicator="_in").sort_values([*keys, "_nth"])
    for letter, side in (("A", "left_only"), ("B", "right_only")):
        alone = both[both["_in"] == side]
        if len(alone):
            yield _row(name, f"rows only in {letter}", len(alone), _instant(alone))
    both = both[both["_in"] == "both"]
    for column in columns:
        if column in keys or column in TIMINGS or column.startswith("us_"):
            continue
        one, other = both[f"{column}_a"], both[f"{column}_b"]
        differ, apart = (one != other) & ~(one.isna() & other.isna()), None
        if {one.dtype.kind, other.dtype.kind} <= set("iuf"):
            with np.errstate(invalid="ignore"):  # infinity less infinity, and by a tolerance of 0
                # Unsigned numbers would wrap around, and large integers lose digits.
                kind = np.float64 if "f" in one.dtype.kind + other.dtype.kind else np.int64
                apart = (one.astype(kind) - other.astype(kind)).abs()
                if column.endswith("_rad"):  # the shorter way around
                    apart = apart.where(apart <= np.pi, (2 * np.pi - apart).abs())
                allowed = np.maximum(absolute, relative * np.maximum(one.abs(), other.abs()))
            differ &= (apart > allowed) | ~np.isfinite(apart)
        if differ.any():
            found = [one[differ].iloc[0], other[differ].iloc[0]]
            found += [] if apart is None else [apart[differ].iloc[0], apart[differ].max()]
            # As Python has them, None for NaN.
            values = [None if of != of else of.item() if hasattr(of, "item") else of for of in found]
            yield _row(name, column, int(differ.sum()), _instant(both[differ]), *values)


def _instant(rows: DataFrame) -> int | None:
    return int(rows.iloc[0]["t_ns"]) if "t_ns" in rows else None
