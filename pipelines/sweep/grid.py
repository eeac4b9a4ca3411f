"""The grid of a sweep: every combination of the values of some keys, with its configuration and folder name."""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from quadlog.config.file import Configured, Flag, configure
from quadlog.errors import InvalidConfigValue, UsageError
from quadlog.results.find_runs import run_name

MOST_RUNS = 10_000
_SHORTEST_NAME = 100  # characters that a name with a digest keeps
_CLOSING = {"[": "]", "{": "}"}


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
    values = [value.strip() for value in _split(override, text)]
    if not all(values):
        raise InvalidConfigValue(key.strip(), "a value is empty", f"--set {override}")
    return key.strip(), values


def _split(override: str, text: str) -> Iterator[str]:
    """Parts of a text between commas at its top level."""
    closing: list[str] = []
    quote, first = "", 0
    for at, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character in _CLOSING:
            closing.append(_CLOSING[character])
        elif closing and character == closing[-1]:
            closing.pop()
        elif character == "," and not closing:
            yield text[first:at]
            first = at + 1
    if quote or closing:
        raise InvalidConfigValue(override, f"{quote or closing[-1]} is missing", "--set")
    yield text[first:]


def make_grid(
    config_path: Path | None,
    overrides: Sequence[str],
    seeds: Sequence[int],
    *,
    preset: str | None = None,
    flags: Sequence[Flag] = (),
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
        configured = configure(config_path, settings, preset=preset, flags=flags)
        values = {key: _plain(text) for (key, many), text in zip(given, texts, strict=True) if len(many) > 1}
        label = ",".join(f"{key}={_shown(value)}" for key, value in values.items())
        content = _content(configured)
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
    except (tomllib.TOMLDecodeError, RecursionError):
        return text


def _shown(value: Any) -> str:
    """A value in a folder's name: text without quotes, all else as JSON."""
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"), default=str)


def _content(configured: Configured) -> str:
    content = configured.config.model_dump_json(exclude_none=True)
    return hashlib.sha256(content.encode("utf-8", "surrogatepass")).hexdigest()


def _folder_name(label: str, taken: set[str]) -> str:
    """The label where it can name a folder; else what is left of it, with a digest of all of it. Case is ignored."""
    name = run_name(label)
    if name != label or name.casefold() in taken:
        digest = hashlib.sha256(label.encode("utf-8", "surrogatepass")).hexdigest()[:8]
        kept = re.sub(r"[^\w=,.-]", "_", name).encode()[:_SHORTEST_NAME].decode("utf-8", "ignore")
        name = f"{kept}-{digest}"
    taken.add(name.casefold())
    return name
