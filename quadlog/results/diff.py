"""Whether two runs have the same results, and where they differ first: one merge of columns for each result."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.errors import clipped, printable, some_of
from quadlog.results.arrays import MapSequence
from quadlog.results.record import RunRecord
from quadlog.results.run import Run
from quadlog.results.stages import STAGE_FILES
from quadlog.results.tables import read_table
from quadlog.results.text import print_table, terminal_width
from quadlog.results.view import Moment

if TYPE_CHECKING:
    from pandas import DataFrame, Series

KEYS = {
    "fixes": ["t_ns", "tag"], "ranges": ["t_ns", "tag", "anchor"], "innovations": ["t_ns", "tag"],
    "links": ["tag", "anchor"], "uwb_errors": ["t_ns", "tag", "source"], "paths": ["t_ns", "i"],
    "resim_paths": ["t_ns", "i"], "body": ["body", "speeds", "joint", "phase"], "gait": ["body", "speeds"],
}  # fmt: skip
"""Key columns of the results that t_ns alone does not identify."""
COLUMNS = ("stage", "result", "column", "rows", "t_ns", "a", "b", "apart", "largest")
MADE = "made"
"""The stage of how the runs were made, which is no difference of results."""
TIMINGS = frozenset({"ms", "us", "realtime_factor"})
"""Not compared: they differ from machine to machine."""
COMPARED = frozenset({"run.json", *(name for files in STAGE_FILES.values() for name in files)})
"""The files that are read of each run."""


def diff_runs(a: Run, b: Run, absolute: float = 0.0, relative: float = 0.0) -> DataFrame:
    """A row for each column that differs, with the columns COLUMNS.

    rows: number of rows that differ. t_ns, a, b, apart: of the first of them. largest: largest difference. column:
    empty for a result that only one run has. Rows of the stage MADE, how the runs were made, come first; then stages
    in their order, in each the results that only one run has and then the earliest difference. Numbers are equal if
    they are nearer than absolute, or than relative times the larger one. Raises NotARun, TooLarge, UnreadableFile.
    """
    from pandas import DataFrame

    made = _values(_origins(a), _origins(b), "run.json")
    found = [{"stage": MADE, **row} for row in made]
    for stage, files in STAGE_FILES.items():
        rows = [row for name in files for row in _result(name, a, b, absolute, relative)]
        rows += list(_values(_read(a), _read(b), "run.json")) if stage == "ingest" else []
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
    return [
        Moment(at, f"first difference of {row.result}", f"{row.column}: {_text(row.a)}, {_text(row.b)}")
        for at, row in zip(seconds, timed.itertuples(), strict=True)
    ]


def diff_text(differences: DataFrame, start_ns: int) -> str:
    """The first difference in a sentence, how the runs were made, and a table of all differences of results.

    start_ns: 0 s of the instants.
    """
    made: list[Any] = list(differences[differences["stage"] == MADE].itertuples())
    found: list[Any] = list(of_results(differences).itertuples())
    blocks = [f"results: {printable(_first(found[0], start_ns)) if found else 'the same'}\n"]
    if made:
        origins = [(row.column, _text(row.a, 6), _text(row.b, 6)) for row in made]
        blocks.append(print_table(("made with", "A", "B"), origins, width=terminal_width()))
    if found:
        rows = [
            (
                *(row.stage, row.result, row.column, row.rows, _seconds(row.t_ns, start_ns)),
                *(_text(row.a, 5), _text(row.b, 5), row.largest),
            )
            for row in found
        ]
        header = ("stage", "result", "column", "rows", "first s", "A", "B", "largest")
        blocks.append(print_table(header, rows, width=terminal_width()))
    return "\n".join(blocks)


def _first(row: Any, start_ns: int) -> str:
    at = "" if row.t_ns is None else f" at {_seconds(row.t_ns, start_ns)} s (t_ns {row.t_ns})"
    by = "" if row.apart is None else f" (by {_text(row.apart)})"
    what = f"{row.result}, {row.column}" if row.column else row.result
    values = f": {_text(row.a)} | {_text(row.b)}{by}" if row.a is not None or row.b is not None else ""
    return f"differ, first in stage {row.stage}: {what}{at}{values}"


def _seconds(t_ns: Any, start_ns: int) -> str:
    return "" if t_ns is None else f"{(t_ns - start_ns) / 1e9:.3f}"


def _text(value: Any, digits: int = 9) -> str:
    return "none" if value is None else f"{value:.{digits}g}" if isinstance(value, float) else clipped(value, 60)


_OF_THE_RECORDING = ("topics", "uwb.anchors", "uwb.tags", "uwb.range_topics", "lidar.mount")
"""Facts about a recording and its robot, which may differ between recordings replayed alike."""
_OF_THE_SAMPLE = ("seed", "start_s", "duration_s", "until", "msg_path")
"""Options that choose what is read and drawn, not how."""


def differing_settings(records: Sequence[RunRecord]) -> list[str]:
    """A line `key: value, value` for each setting in which the runs differ: only runs made alike are averaged."""
    runs = []
    for record in records:
        config = _flat(record.config.model_dump(mode="json"))
        options = {key: value for key, value in _flat(record.options).items() if key not in _OF_THE_SAMPLE}
        runs.append({key: value for key, value in config.items() if not key.startswith(_OF_THE_RECORDING)} | options)
    lines = []
    for key in dict.fromkeys(key for run in runs for key in run):
        values = list(dict.fromkeys(str(run.get(key, "not set")) for run in runs))
        if len(values) > 1:
            lines.append(printable(f"{key}: {some_of(values)}"))
    return lines


def _origins(run: Run) -> dict[str, Any]:
    """How a run was made, without command, paths and name of the host."""
    record = run.record
    kind, mark = record.input.fingerprint or ("input", None)
    options = {key: value for key, value in record.options.items() if key != "seed"}
    versions = {"quadlog": record.quadlog_version, **record.packages}
    config = _flat(record.config.model_dump(mode="json", exclude_none=True), "config.")
    return config | {kind: mark, "seed": record.seed} | _flat(options, "options.") | versions


def _read(run: Run) -> dict[str, Any]:
    """Topics by role with their number of messages, and losses."""
    topics = {f"{of.role} {of.topic}": of.messages for of in run.record.topics}
    return topics | {f"loss {number}": of.detail for number, of in enumerate(run.record.losses)}


def _flat(values: Mapping[str, Any] | Sequence[Any], prefix: str = "") -> dict[str, Any]:
    """The values of nested tables and lists of tables by dotted key."""
    found: dict[str, Any] = {}
    for key, value in values.items() if isinstance(values, Mapping) else enumerate(values):
        nested = isinstance(value, Mapping) or (isinstance(value, list) and value and isinstance(value[0], Mapping))
        found |= _flat(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return found


def _values(a: Mapping[str, Any], b: Mapping[str, Any], result: str) -> Iterator[dict[str, Any]]:
    for key in dict.fromkeys((*a, *b)):
        if a.get(key) != b.get(key):
            yield _row(result, key, 1, None, a.get(key), b.get(key))


def _row(
    result: str, column: str, rows: int, t_ns: int | None, a: Any, b: Any, apart: Any = None, largest: Any = None
) -> dict[str, Any]:
    values = (result, column, rows, t_ns, a, b, apart, largest)
    return dict(zip(COLUMNS[1:], values, strict=True))


def _result(name: str, a: Run, b: Run, absolute: float, relative: float) -> Iterator[dict[str, Any]]:
    there = [(run.path / name).is_file() for run in (a, b)]
    if any(there) and not all(there):
        yield _row(name, "", 1, None, *("saved" if saved else "missing" for saved in there))
    elif all(there):
        one, other = _frame(a, name), _frame(b, name)
        stem = name.partition(".")[0]
        keys = KEYS.get(stem, ["t_ns"] if "t_ns" in one else ["index"])
        yield from merge_frames(stem, one, other, keys, absolute, relative)


def _frame(run: Run, name: str) -> DataFrame:
    """Any saved result as columns: one row for a file of names and values, the bytes of an unknown kind."""
    from pandas import DataFrame, Series

    stem, _, suffix = name.partition(".")
    if suffix == "parquet":
        return DataFrame(read_table(run.path, stem, largest=math.inf))
    if suffix == "tum":
        poses = run.trajectory(stem)
        assert poses is not None
        columns = dict(zip("xyz", poses.position_m.T, strict=True))
        columns |= dict(zip(("qx", "qy", "qz", "qw"), poses.quat_xyzw.T, strict=True))
        return DataFrame({"t_ns": poses.t_ns, **columns})
    if name == "metrics.json":
        metrics = {key: of for key, of in run.metrics.items() if key not in TIMINGS}
        return _one_row({f"{key}.{part}": getattr(of, part) for key, of in metrics.items() for part in ("value", "n")})
    if suffix == "yaml":
        return _one_row(
            dict(line.partition(": ")[::2] for line in (run.path / name).read_text("utf-8", "replace").splitlines())
        )
    if name == "maps.npz":
        return _map_frame(run.maps)
    if suffix == "npz":
        arrays = {key: Series(array.ravel()) for key, array in (run.arrays(stem) or {}).items()}
        return DataFrame(arrays).rename(columns={"t_ns": "at_ns"}).rename_axis("index").reset_index()
    content = np.frombuffer((run.path / name).read_bytes(), np.uint8)
    return DataFrame({"index": np.arange(len(content)), "byte": content})


def _one_row(values: dict[str, Any]) -> DataFrame:
    from pandas import DataFrame

    return DataFrame([{"index": 0, **values}])


def _map_frame(maps: MapSequence | None) -> DataFrame:
    """The place and size of each map, the number of its occupied cells, and a digest of them."""
    from pandas import DataFrame

    if maps is None:
        return DataFrame({"t_ns": np.empty(0, np.int64)})
    counts, digests = [], []
    for index in range(len(maps)):
        cells = maps.occupied(index)
        counts.append(int(cells.sum()))
        digests.append(hashlib.blake2b(np.packbits(cells).tobytes(), digest_size=8).hexdigest())
    x_m, y_m = maps.origin_m.T
    size = {"cell_m": maps.cell_m, "shape": f"{maps.shape[0]} by {maps.shape[1]}"}
    columns = {"t_ns": maps.t_ns, "origin_x_m": x_m, "origin_y_m": y_m, "occupied": counts, "cells": digests}
    return DataFrame(columns | size)


def merge_frames(
    name: str, a: DataFrame, b: DataFrame, keys: Sequence[str], absolute: float = 0.0, relative: float = 0.0
) -> Iterator[dict[str, Any]]:
    """The differences of two tables, whose rows are matched by key, and by their order within a key."""
    if a.equals(b):
        return
    columns = list(dict.fromkeys((*a.columns, *b.columns)))
    a, b = (frame.reindex(columns=columns).assign(_nth=frame.groupby(list(keys)).cumcount()) for frame in (a, b))
    both = a.merge(b, "outer", on=[*keys, "_nth"], suffixes=("_a", "_b"), indicator="_in").sort_values(list(keys))
    for letter, side in (("A", "left_only"), ("B", "right_only")):
        alone = both[both["_in"] == side]
        if len(alone):
            yield _row(name, f"rows only in {letter}", len(alone), _instant(alone), None, None)
    both = both[both["_in"] == "both"]
    for column in columns:
        if column in keys or column in TIMINGS or column.startswith("us_"):
            continue
        one, other = both[f"{column}_a"], both[f"{column}_b"]
        apart = _apart(column, one, other)
        differ = (one != other) & ~(one.isna() & other.isna())
        if apart is not None:
            with np.errstate(invalid="ignore"):  # infinity by a tolerance of 0
                allowed = np.maximum(absolute, relative * np.maximum(one.abs(), other.abs()))
            differ &= ~((apart <= allowed) & np.isfinite(apart))
        rows = both[differ]
        if len(rows):
            first = rows.iloc[0]
            distances = (None, None) if apart is None else (apart[differ].iloc[0], apart[differ].max())
            values = (first[f"{column}_a"], first[f"{column}_b"], *distances)
            yield _row(name, column, len(rows), _instant(rows), *map(_plain, values))


def _apart(column: str, one: Series, other: Series) -> Series | None:
    """How far numbers are apart, angles the shorter way around; None of texts and truth values."""
    kinds = {one.dtype.kind, other.dtype.kind}
    if not kinds <= set("iuf"):
        return None
    with np.errstate(invalid="ignore"):  # infinity less infinity
        kind = np.float64 if "f" in kinds else np.int64  # unsigned numbers would wrap around
        apart = (one.astype(kind) - other.astype(kind)).abs()
    return apart.where(apart <= np.pi, (2 * np.pi - apart).abs()) if column.endswith("_rad") else apart


def _instant(rows: DataFrame) -> int | None:
    return int(rows.iloc[0]["t_ns"]) if "t_ns" in rows else None


def _plain(value: Any) -> Any:
    """A Python value, None for NaN."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and np.isnan(value) else value
