"""Writes the pages that say what the code says, and builds all pages as a site; `make docs` does both."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import chdir
from pathlib import Path
from typing import Any

import tomli_w
from messages import troubleshooting_page
from samples import update_samples

from quadlog.config.file import PRESETS, SCHEMA
from quadlog.config.schema import Config
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.intervals import COVERAGE

HERE = Path(__file__).parent
ROOT = HERE.parent
SAMPLES = ROOT / "build" / "samples"  # conf.py has this folder copied into the site

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

Every key of `quadlog.toml`. `make docs` writes this page from the models that `quadlog/config/schema.py` puts together;
a test fails when it is out of date. `quadlog init RECORDING` writes a file with the keys that a recording can use: what
was detected is filled in, defaults are comments.

Precedence, lowest to highest: defaults, file, `--preset`, `--set` and options for single keys such as
`--planner`. An option and a `--set` of the same key that differ are a usage error. An unknown key is refused by name,
with the nearest valid one; keys of the file that the preset replaced are listed on stderr and in `run.json`.

```sh
quadlog replay yesterday.bag -c quadlog.toml -o runs/coarse --set grid.cell_m=0.2 --set planner.name=astar --until plan
```

- A key's unit is the end of its name, in SI; angles are degrees. **unset**: no value.
- **allowed**: bounds or choices; [ ] inclusive, ( ) exclusive.
- Sources are in brackets, as listed in [Methods and papers](references.md); **ours**, or no source: chosen by quadlog.
- The first line that `quadlog init` writes, `#:schema`, names the JSON schema of the installed version: editors with
  Even Better TOML or taplo complete and check keys by it.
- `config.toml` in a run folder is the effective configuration: `-c` on it gives the same run.
"""

METRIC_KEYS = """Keys are the names of [Metrics](metrics.md), values are tables with `min`, `max` or both.

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

Intervals allow for the correlation of neighbouring samples. Counts, extremes and logs below 30 s have none, nor have
position errors against a truth: biases last a whole log, and one log is one draw of them. 95 % ellipses
(`uwb_coverage_95`) contained 0.98 to 1.00 of the true positions on two real logs: [Limits](limits.md).

`x_i` is sample i of N; **n** is what the number of samples counts. Sources are keys of
[Methods and papers](references.md); without one, the definition is quadlog's own.
"""

OWN = "quadlog's own definition"


def main() -> int:
    """Write every page there is a writer for, and the schema; with a folder as argument, printed samples and the site.

    Returns its exit code.
    """
    for name, write in PAGES.items():
        (HERE / name).write_text(write(), encoding="utf-8")
        sys.stdout.write(f"docs/{name}\n")
    SCHEMA.write_text(schema_text(), encoding="utf-8")
    if len(sys.argv) == 1:
        return 0
    update_samples()
    return build_site(Path(sys.argv[1]))


def build_site(site: Path) -> int:
    """Replay the committed recording for the samples, then run Sphinx with warnings as errors; its exit code."""
    from sphinx.cmd.build import build_main

    from quadlog.cli.main import run

    site, follow = site.resolve(), os.path.relpath(ROOT / "fixtures" / "follow", SAMPLES)
    few = [word for name in ("astar", "ia_star", "d_star_lite") for word in ("--planner", name)]
    SAMPLES.mkdir(parents=True, exist_ok=True)
    with chdir(SAMPLES):  # so that pages name no folder of this machine
        for words in (
            ["replay", f"{follow}.mcap", "-c", f"{follow}.toml", "--force", "--no-plots"],
            ["compare-planners", "runs/follow", *few, "-o", "planners", "--force"],
        ):
            if code := run(words):
                return code
        for name in ("runs", "planners"):
            shutil.copytree(name, f"site/samples/{name}", ignore=shutil.ignore_patterns(".*"), dirs_exist_ok=True)
    return build_main(
        ["-W", "--keep-going", "-q", "-j", "auto", "-d", f"{ROOT / 'build' / 'doctrees'}", f"{HERE}", f"{site}"]
    )


def schema_text() -> str:
    """The JSON schema of quadlog.toml, for editors."""
    return json.dumps(Config.model_json_schema(), separators=(",", ":")) + "\n"


def configuration_page() -> str:
    """Every table of the file with its keys, then the presets."""
    schema = Config.model_json_schema()
    sections = [_section(name, each, schema["$defs"]) for name, each in schema["properties"].items()]
    presets = [f"## --preset {name}\n\n```toml\n{tomli_w.dumps(keys).strip()}\n```\n" for name, keys in PRESETS.items()]
    return "\n".join([CONFIGURATION, *sections, *presets])


def metrics_page() -> str:
    """One row for each metric, in the order of the contract."""
    rows = [
        (_code(name), each.unit, each.meaning, _code(each.formula), each.source.replace(OWN, ""), each.counted)
        for name, each in CATALOGUE.items()
    ]
    text = f"{METRICS}\n{textwrap.fill(COVERAGE, 120)}\n\n"
    return text + _table(("metric", "unit", "meaning", "formula", "source", "n"), rows)


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


PAGES = {
    "configuration.md": configuration_page,
    "metrics.md": metrics_page,
    "troubleshooting.md": troubleshooting_page,
}

if __name__ == "__main__":
    sys.exit(main())
