"""`quadlog sweep`: replay one recording with every combination of some settings; what they share is done once."""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from quadlog.config.file import Configured, configure
from quadlog.errors import AlreadyExists, CannotWrite, InvalidConfigValue, RunExists, UsageError, clipped
from quadlog.pipelines.batch.batch import BatchOutcome, replay_all, trim_stores
from quadlog.pipelines.batch.plan import existing_runs
from quadlog.pipelines.evaluation.reports import write_sweep
from quadlog.pipelines.executor.progress import BatchLines
from quadlog.pipelines.replay import planned_keys, refuse_another
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.pipelines.store import Store, log_key
from quadlog.results.find_runs import refuse_existing, run_name
from quadlog.results.studies.sweep import PAGE, TABLE, SweepRow, write_sweep_table
from quadlog.storage.atomic_write import new_folder

MOST_RUNS = 10_000
_SHORTEST_NAME = 100  # characters that a name with a digest keeps
_VALUE = re.compile(r"""(?:"[^"]*"|'[^']*'|\[(?:[^][]|\[[^]]*\])*\]|\{[^}]*\}|[^],"'[{}])+""")


@dataclass(frozen=True, slots=True)
class Combination:
    """values: of the swept keys. seed: of its replay. name: of its run folder."""

    values: Mapping[str, Any]
    seed: int
    name: str
    configured: Configured


def split_values(override: str) -> tuple[str, list[str]]:
    """The key of KEY=VALUE,VALUE,… and its values; commas inside brackets and quotes separate nothing.

    Raises InvalidConfigValue.
    """
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise InvalidConfigValue(override, "expected section.key=value,value,…", "--set")
    values = _VALUE.findall(text)
    if not values or ",".join(values) != text or not all(map(str.strip, values)):
        reason = "a value is empty, or a quote or bracket is not closed"
        raise InvalidConfigValue(key.strip(), reason, f"--set {clipped(override)}")
    return key.strip(), [value.strip() for value in values]


def make_grid(
    config_path: Path | None,
    overrides: Sequence[str],
    seeds: Sequence[int],
    *,
    preset: str | None = None,
) -> list[Combination]:
    """Every combination of the values, in the order given, and each with every seed.

    A key with one value is set in all runs and is not part of their names. With one seed, names have none.

    Raises UsageError for a key given twice, nothing to vary, too many runs and two combinations of one configuration;
    and as `configure` for unknown keys and invalid values.
    """
    given = [split_values(override) for override in overrides]
    keys = [key for key, _ in given]
    if len(set(keys)) < len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise UsageError(f"--set {twice} is given twice; separate its values by commas: --set {twice}=a,b")
    runs = math.prod(len(values) for _, values in given) * len(seeds)
    if runs == 1:
        raise UsageError("nothing varies: give a key several values, as in --set planner.name=astar,ia_star")
    if runs > MOST_RUNS:
        raise UsageError(f"{runs} runs, at most {MOST_RUNS}: give fewer values or seeds")
    combinations = []
    taken: set[str] = set()
    before: dict[str, str] = {}
    for texts in product(*(values for _, values in given)):
        settings = [f"{key}={text}" for key, text in zip(keys, texts, strict=True)]
        configured = configure(config_path, settings, preset=preset)
        values = {key: _plain(text) for (key, many), text in zip(given, texts, strict=True) if len(many) > 1}
        # Text without quotes, all else as JSON.
        shown = {
            key: value if isinstance(value, str) else json.dumps(value, separators=(",", ":"), default=str)
            for key, value in values.items()
        }
        label, content = ",".join(map("=".join, shown.items())), configured.config.model_dump_json(exclude_none=True)
        if content in before:
            raise UsageError(f"{before[content]} and {label} are the same configuration; leave one of them out")
        before[content] = label
        for seed in seeds:
            name = _folder_name(",".join(filter(None, [label, f"seed={seed:03d}" if len(seeds) > 1 else ""])), taken)
            combinations.append(Combination(values, seed, name, configured))
    return combinations


def _plain(text: str) -> Any:
    """The value as TOML has it, else the text, as `configure` reads it."""
    try:
        return tomllib.loads(f"value = {text}")["value"] if "\n" not in text else text
    except (ValueError, RecursionError):  # ValueError also for an integer of too many digits
        return text


def _folder_name(label: str, taken: set[str]) -> str:
    """The label where it can name a folder; else what is left of it, with a digest of all of it. Case is ignored."""
    name = run_name(label)
    if name != label or name.casefold() in taken:
        digest = hashlib.sha256(label.encode("utf-8", "surrogatepass")).hexdigest()[:8]
        kept = re.sub(r"[^\w=,.-]", "_", name).encode()[:_SHORTEST_NAME].decode("utf-8", "ignore")
        name = f"{kept}-{digest}"
    taken.add(name.casefold())
    return name


_FLAGS = "--force to replace it or --resume to continue"


@dataclass(frozen=True, slots=True)
class SweepRequest:
    """A recording, the grid of its replays and the folder of their runs. options: of all, but for the seed."""

    recording: Path
    output: Path
    grid: Sequence[Combination]
    options: ReplayOptions
    existing: Existing
    command: tuple[str, ...]


def sweep(
    request: SweepRequest, jobs: int, scheduler: str | None, progress: BatchLines
) -> tuple[list[SweepRow], BatchOutcome]:
    """Replay every combination and write the table and the page of all; returns the rows of the table and the outcome.

    The first run that needs a result makes it; others that need it meanwhile wait. An error is the outcome of a run.
    Raises, before anything is written, RecordingNotFound, AlreadyExists, CannotWrite and RunOfAnother; QuadlogError
    and VersionsDiffer.
    """
    batch = [_request_of(request, each) for each in request.grid]
    _check_output(request, batch)
    log_key(request.recording, request.options)  # raises RecordingNotFound
    if request.existing is Existing.FORCE:
        Store(request.output).forget(key for each in batch for key in planned_keys(each).values())
        batch = [replace(each, existing=Existing.REPLACE) for each in batch]
    import pandas  # noqa: F401  # for the page: while workers start, there is time for it

    outcomes = replay_all(batch, jobs, scheduler, progress)
    rows = []
    for each, outcome in zip(request.grid, outcomes, strict=True):
        metrics = {name: float(metric["value"]) for name, metric in outcome.metrics.items()}
        exit_code, reason = int(outcome.exit_code), outcome.reason
        rows.append(SweepRow(each.values, each.seed, each.name, exit_code, reason, metrics))
    trim_stores(batch)
    with new_folder(request.output):  # not there where every run failed before its folder
        write_sweep_table(request.output, rows)
        write_sweep(request.output)
    named = zip(request.grid, outcomes, strict=True)
    return rows, BatchOutcome(tuple(replace(outcome, recording=Path(each.name)) for each, outcome in named))


def _request_of(request: SweepRequest, each: Combination) -> ReplayRequest:
    (config, notes), options = each.configured, replace(request.options, seed=each.seed)
    how = request.existing, request.command, notes
    return ReplayRequest(request.recording, request.output / each.name, config, options, *how, draws=False)


def _check_output(request: SweepRequest, batch: Sequence[ReplayRequest]) -> None:
    """Raises AlreadyExists, CannotWrite and RunOfAnother where the sweep would replace what it must not."""
    output = request.output
    if output.exists() and not output.is_dir():
        raise CannotWrite(output, "is no folder")
    if (output / PAGE).exists() and not (output / TABLE).exists():
        raise CannotWrite(output / PAGE, f"is no page of a sweep, and {TABLE} is missing; choose another folder by -o")
    there = existing_runs(batch)
    if request.existing is Existing.REFUSE:
        if (output / TABLE).exists():
            raise AlreadyExists(output / TABLE, _FLAGS)
        if there:
            raise RunExists(min(there))
    for name in (TABLE, PAGE):
        refuse_existing(output / name, True, [request.recording], own=[TABLE])
    if request.existing is Existing.RESUME:
        for each in batch:
            if each.run in there:
                refuse_another(each)
