"""Writes the pages that say what the code says: of the config's models and the metrics' catalogue."""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import tomli_w

from quadlog.config.file import PRESETS
from quadlog.config.schema import Config
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.intervals import COVERAGE

HERE = Path(__file__).parent

# By what a key ends in, the longer endings first.
UNITS = {
    "_s2_per_m": "s²/m",
    "_s_per_m": "s/m",
    "_radps": "rad/s",
    "_mps2": "m/s²",
    "_cells": "cells",
    "_per_m": "1/m",
    "_mps": "m/s",
    "_deg": "°",
    "_rad": "rad",
    "_hz": "Hz",
    "_kg": "kg",
    "_m": "m",
    "_n": "N",
    "_s": "s",
}

CONFIGURATION = """# Configuration

Every key of `quadlog.toml`. `make docs` writes this page from the models in `quadlog/config/schema.py` and
`quadlog/config/control.py`; a test fails when it is out of date. `quadlog init RECORDING` writes a file with all of
them, explained: what was detected in the recording is filled in, and defaults are comments.

What counts more stands further right: defaults < file < `--preset` < environment < `--set` and options for single keys
such as `--planner`; an option and a `--set` of one key that differ are a usage error. A run says on stderr and in
`run.json` which keys of the file the preset replaced. An unknown key is refused by name, with the nearest valid one.

```sh
QUADLOG_GRID__CELL_M=0.2 quadlog replay yesterday.bag -c quadlog.toml -o runs/coarse --set planner.name=astar
```

- A key's unit is what its name ends in, in SI; angles in files are degrees. **unset** is a key that is left out.
- **allowed** are the bounds of the value, or its choices; [ ] take their ends in, ( ) do not.
- A meaning names its source in brackets, as [references.md](references.md) lists them. **ours** is quadlog's own, and
  so is what names no source, unless its section does.
- `config.toml` in a run folder holds what was in force: `-c` on it gives the same run.
"""

METRIC_KEYS = """Keys are the names of [metrics.md](metrics.md), values are tables with `min`, `max` or both.

```toml
[expect]
collisions = { max = 0 }
success_rate = { min = 0.99 }
following_distance_mean_m = { min = 1.5, max = 2.5 }
```"""

METRICS = """# Metrics

Every metric of `metrics.json` and `quadlog metrics`. `make docs` writes this page from `quadlog/metrics/catalogue.py`;
a test fails when it is out of date. A metric that does not apply to a run is absent, never 0.

```sh
quadlog metrics runs/yesterday                          # with n and 95 % intervals
quadlog metrics --explain eta_m                         # what it means
quadlog metrics runs/yesterday --explain success_rate   # and when the run was at its worst
```

`x_i` is sample i of N; **n** is what the number beside the value counts. Sources are keys of
[references.md](references.md).
"""


def main() -> None:
    """Write every page there is a writer for."""
    for name, write in PAGES.items():
        (HERE / name).write_text(write(), encoding="utf-8")
        sys.stdout.write(f"docs/{name}\n")


def configuration_page() -> str:
    """Every table of the file with its keys, then the presets."""
    schema = Config.model_json_schema()
    sections = [_section(name, each, schema["$defs"]) for name, each in schema["properties"].items()]
    presets = [f"## --preset {name}\n\n```toml\n{tomli_w.dumps(keys).strip()}\n```\n" for name, keys in PRESETS.items()]
    return "\n".join([CONFIGURATION, *sections, *presets])


def metrics_page() -> str:
    """One row for each metric, in the order of the contract."""
    rows = [
        (_code(name), each.unit, each.meaning, _code(each.formula), each.source, each.counted)
        for name, each in CATALOGUE.items()
    ]
    coverage = textwrap.fill(f"{COVERAGE} Shorter walks have none for rms and deviations.", 120)
    return f"{METRICS}\n{coverage}\n\n" + _table(("metric", "unit", "meaning", "formula", "source", "n"), rows)


def _section(name: str, property_schema: dict[str, Any], models: dict[str, Any], brackets: str = "[]") -> str:
    """A table of the file, then the tables in it."""
    model = models[property_schema["$ref"].rsplit("/", 1)[-1]]
    rows, inner = [], []
    for key, each in model["properties"].items():
        if "$ref" in each:
            inner.append(_section(f"{name}.{key}", each, models))
            continue
        if "$ref" in each.get("items", {}):
            inner.append(_section(f"{name}.{key}", each["items"], models, "[[]]"))
        required = key in model.get("required", ())
        rows.append((_code(key), _default(each, required), _unit(key), _allowed(each), each["description"]))
    half = len(brackets) // 2
    title = f"## `{brackets[:half]}{name}{brackets[half:]}`"
    table = _table(("key", "default", "unit", "allowed", "meaning"), rows) if rows else f"{METRIC_KEYS}\n"
    return "\n".join([title, "", " ".join(model["description"].split()), "", table, *inner])


def _default(field: dict[str, Any], required: bool) -> str:
    value = field.get("default")
    if required:
        return "required"
    # Of the values there are, JSON's form is TOML's, and stays in one line.
    return "unset" if value is None else _code(json.dumps(value))


def _unit(key: str) -> str:
    return next((unit for ending, unit in UNITS.items() if key.endswith(ending)), "")


def _allowed(field: dict[str, Any]) -> str:
    """The type where it is all there is to say, else choices or bounds."""
    field = next((each for each in field.get("anyOf", ()) if each.get("type") != "null"), field)
    if "enum" in field:
        return ", ".join(_code(choice) for choice in field["enum"])
    if "prefixItems" in field:
        return f"{len(field['prefixItems'])} × {_allowed(field['prefixItems'][0])}"
    if "$ref" in field.get("items", {}):
        return "tables, below"
    words = {"string": "text", "boolean": "true, false", "integer": "whole", "array": "list of texts"}
    return " ".join(filter(None, [words.get(field["type"], ""), _bounds(field)]))


def _bounds(field: dict[str, Any]) -> str:
    if field["type"] not in ("integer", "number"):
        return ""
    low, high = (field.get(f"exclusive{end}", field.get(end.lower())) for end in ("Minimum", "Maximum"))
    left = "(" if low is None or "exclusiveMinimum" in field else "["
    right = ")" if high is None or "exclusiveMaximum" in field else "]"
    return f"{left}{'−∞' if low is None else f'{low:.10g}'}, {'∞' if high is None else f'{high:.10g}'}{right}"


def _code(text: str) -> str:
    return f"`{text}`"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(_lines(header, rows)) + "\n"


def _lines(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    for row in (header, ["---"] * len(header), *rows):
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"


PAGES = {"configuration.md": configuration_page, "metrics.md": metrics_page}

if __name__ == "__main__":
    main()
