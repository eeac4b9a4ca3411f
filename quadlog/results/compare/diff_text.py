"""The differences of two runs as text and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from quadlog.errors import printable
from quadlog.results.compare.differences import (
    FirstDifference,
    ResultDifference,
    RowLocation,
    RunDifference,
    ValueDifference,
)
from quadlog.results.compare.run_diff import first_difference
from quadlog.results.text.numbers import short

_MOST_CHARS = 60
_NS = 1_000_000_000


def diff_text(runs: RunDifference) -> str:
    """The verdict, how the runs were made, then every stage; values are those of A | B."""
    return "\n".join(map(printable_line, _lines(runs))) + "\n"


def diff_json(runs: RunDifference) -> dict[str, Any]:
    """One object: `same, first, origins, stages`, as the dataclasses of `differences` have it; instants also as `s`."""
    first = first_difference(runs)
    content = {
        "a": runs.a,
        "b": runs.b,
        "same": runs.same,
        "start_ns": runs.start_ns,
        "first": None if first is None else asdict(first),
        "origins": {name: [asdict(each) for each in found] for name, found in runs.origins.items()},
        "stages": {
            stage: [asdict(result) | {"same": result.same} for result in results]
            for stage, results in runs.stages.items()
        },
    }
    found: dict[str, Any] = _plain(content, runs.start_ns)
    return found


def printable_line(line: str) -> str:
    """The line without control characters, with its indentation."""
    text = line.lstrip(" ")
    return " " * (len(line) - len(text)) + printable(text)


def _lines(runs: RunDifference) -> Iterator[str]:
    yield f"A  {runs.a}"
    yield f"B  {runs.b}"
    first = first_difference(runs)
    yield "results: the same" if first is None else f"results: differ, first in {first_line(first, runs.start_ns)}"
    for name, found in runs.origins.items():
        yield f"{name}: {'differs' if found else 'the same'}"
        yield from _value_lines("    ", found)
    for stage, results in runs.stages.items():
        differing = [each for each in results if not each.same]
        yield f"{stage}: {'differs' if differing else 'the same' if results else 'nothing saved'}"
        for result in differing:
            yield from _result_lines(result, runs.start_ns)


def first_line(first: FirstDifference, start_ns: int, with_stamp: bool = True) -> str:
    """Stage, result, column and instant of a first difference, and both values."""
    at = f" {_place(first.place, start_ns, with_stamp)}" if first.place is not None else ""
    if first.column is None:
        return f"stage {first.stage}: {first.result}{at} is only in {first.only_in}"
    return f"stage {first.stage}: {first.result}, {first.column}{at}: {_both(first.a, first.b, first.apart)}"


def _result_lines(result: ResultDifference, start_ns: int) -> Iterator[str]:
    if result.only_in is not None:
        yield f"    {result.name}: only in {result.only_in}"
        return
    rows = f" {result.rows_a} | {result.rows_b} rows" if result.rows_a != result.rows_b else ""
    yield f"    {result.name}:{rows}"
    for letter, only in result.lone_rows:
        yield f"        {_rows(only.rows)} only in {letter}, the first {_place(only.first, start_ns)}"
    names = max((len(each.column) for each in result.columns), default=0)
    counts = max((len(_rows(each.rows)) for each in result.columns), default=0)
    for each in result.columns:
        most = f", at most {short(each.largest)}" if each.largest is not None and each.rows > 1 else ""
        values = _both(each.a, each.b, each.apart)
        where = f"{each.column:{names}}  {_rows(each.rows):>{counts}}, the first {_place(each.first, start_ns)}"
        yield f"        {where}: {values}{most}"
    yield from _value_lines("        ", result.values)


def _value_lines(indent: str, values: Sequence[ValueDifference]) -> Iterator[str]:
    width = max((len(each.key) for each in values), default=0)
    for each in values:
        yield f"{indent}{each.key:{width}}  {_both(each.a, each.b, each.apart)}"


def _rows(count: int) -> str:
    return f"{count} row{'s' if count != 1 else ''}"


def _place(place: RowLocation, start_ns: int, with_stamp: bool = True) -> str:
    keys = [f"{name} {value}" for name, value in place.keys]
    if place.t_ns is None:
        return f"at {', '.join(keys)}"
    inside = ", ".join([f"t_ns {place.t_ns}"] * with_stamp + keys)
    return f"at {(place.t_ns - start_ns) / _NS:.3f} s{f' ({inside})' if inside else ''}"


def _both(a: Any, b: Any, apart: float | None) -> str:
    by = f" (by {short(apart)})" if apart is not None else ""
    return f"{value_text(a)} | {value_text(b)}{by}"


def value_text(value: Any) -> str:
    """A value, shortened to fit a line."""
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:.9g}"
    text = value if isinstance(value, str) and value else json.dumps(value, default=str)
    return text if len(text) <= _MOST_CHARS else f"{text[: _MOST_CHARS - 3]}..."


def _plain(content: Any, start_ns: int) -> Any:
    """The content as JSON allows it: NaN becomes null, infinity text; rows also get their time in seconds."""
    if isinstance(content, dict):
        plain = {key: _plain(value, start_ns) for key, value in content.items()}
        if isinstance(plain.get("t_ns"), int) and "keys" in plain:
            plain["keys"] = dict(content["keys"])
            plain["s"] = (plain["t_ns"] - start_ns) / _NS
        return plain
    if isinstance(content, list | tuple):
        return [_plain(value, start_ns) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None if math.isnan(content) else str(content)
    return content
