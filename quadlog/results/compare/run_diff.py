"""Comparison of two run folders: how they were made, then their saved results stage by stage."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from quadlog.results.compare.differences import (
    FirstDifference,
    ResultDifference,
    RunDifference,
    Tolerance,
    ValueDifference,
    compare_values,
    flatten,
)
from quadlog.results.compare.file_diff import compare_files
from quadlog.results.run.run_folder import read_run_json
from quadlog.results.run.stages import STAGE_FILES

_NEVER = 1 << 63


def diff_runs(a: Path, b: Path, tolerance: Tolerance) -> RunDifference:
    """Compare two finished runs. Raises NotARun, TooLarge and UnreadableFile for what cannot be read of either."""
    one, other = read_run_json(a), read_run_json(b)
    read = compare_values(_what_was_read(one), _what_was_read(other), tolerance)
    stages = {stage: tuple(_compare_stage(files, a, b, tolerance)) for stage, files in STAGE_FILES.items()}
    stages["ingest"] = (ResultDifference("run.json", values=read), *stages["ingest"])
    starts = [each.start_ns for results in stages.values() for each in results if each.start_ns is not None]
    return RunDifference(
        a=str(a),
        b=str(b),
        origins=compare_origins(one, other),
        stages=stages,
        start_ns=min(starts, default=0),
    )


def compare_origins(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, tuple[ValueDifference, ...]]:
    """How two runs were made, from their run.json: the differences by kind (config, input, seed, options, versions)."""
    return {name: compare_values(flatten(made), flatten(_origins(b)[name])) for name, made in _origins(a).items()}


def first_difference(runs: RunDifference) -> FirstDifference | None:
    """The first difference of two runs, None if there is none: that of the first stage that differs."""
    return next((first for each in runs.stages.items() if (first := first_of_results(*each)) is not None), None)


def first_of_results(stage: str, results: Iterable[ResultDifference]) -> FirstDifference | None:
    """The first difference in some results of a stage, None if there is none.

    Missing results come first, then the earliest time stamp, then values without a time stamp.
    """
    candidates = [each for result in results for each in _candidates(stage, result)]
    return min(candidates, key=lambda each: each[0])[1] if candidates else None


def _compare_stage(files: tuple[str, ...], a: Path, b: Path, tolerance: Tolerance) -> Iterator[ResultDifference]:
    for name in files:
        in_a, in_b = (a / name).is_file(), (b / name).is_file()
        # Every run has metrics; reading them raises NotARun if they are missing.
        if (in_a and in_b) or name == "metrics.json":
            yield compare_files(name, a, b, tolerance)
        elif in_a or in_b:
            yield ResultDifference(name.removesuffix(".parquet"), only_in="A" if in_a else "B")


def _origins(record: Mapping[str, Any]) -> dict[str, Any]:
    """How a run was made, by kind; without command, paths and host name."""
    host = _table(record, "host")
    versions = {"quadlog": record.get("quadlog_version"), **{key: host.get(key) for key in ("python", "system")}}
    recording = _table(record, "input")
    # As InputRecord.fingerprint: a date is compared only if there is no ETag.
    fingerprint = [key for key in ("sha256", "etag", "last_modified") if recording.get(key) is not None][:1]
    return {
        "config": record.get("config"),
        "input": {key: recording.get(key) for key in (*fingerprint, "size_bytes")},
        "seed": {"seed": record.get("seed")},
        "options": {key: value for key, value in _table(record, "options").items() if key != "seed"},
        "versions": versions | _table(record, "packages"),
    }


def _what_was_read(record: Mapping[str, Any]) -> dict[str, Any]:
    """Roles of topics with their numbers of messages, and losses."""
    topics = record.get("topics")
    entries = [each for each in topics if isinstance(each, dict)] if isinstance(topics, list) else []
    used = {f"{each.get('role')} {each.get('topic')}": each.get("messages") for each in entries}
    return used | flatten({"losses": record.get("losses")})


def _table(record: Mapping[str, Any], name: str) -> dict[str, Any]:
    value = record.get(name)
    return value if isinstance(value, dict) else {}


def _candidates(stage: str, result: ResultDifference) -> Iterator[tuple[int, FirstDifference]]:
    """Each kind of difference, and how early it is."""
    if result.only_in is not None:
        yield -_NEVER, FirstDifference(stage, result.name, only_in=result.only_in)
    for letter, only in result.lone_rows:
        yield _when(only.first.t_ns), FirstDifference(stage, result.name, only.first, only_in=letter)
    for each in result.columns:
        first = FirstDifference(stage, result.name, each.first, each.column, each.a, each.b, each.apart)
        yield _when(each.first.t_ns), first
    for value in result.values:
        first = FirstDifference(stage, result.name, None, value.key, value.a, value.b, value.apart)
        yield _NEVER, first


def _when(t_ns: int | None) -> int:
    return _NEVER if t_ns is None else t_ns
