"""Where a configuration comes from: defaults < file < preset < --set and flags; and how it is written."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from difflib import get_close_matches
from functools import reduce
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import tomli_w
from pydantic import BaseModel, ValidationError

from quadlog.config.robots import without_preset
from quadlog.config.schema import UNKNOWN_METRIC, Config, ExpectedRange
from quadlog.errors import (
    InvalidConfigValue,
    QuadlogError,
    TooLarge,
    UnknownConfigKey,
    UnknownName,
    UnreadableFile,
    UsageError,
    clipped,
)
from quadlog.metrics.catalogue import CATALOGUE

MAX_FILE_BYTES = 1 << 20
MAX_DEPTH = 4

PRESETS: dict[str, dict[str, Any]] = {
    "paper": {
        "uwb": {"method": "paper", "calibrate": False, "smooth": False, "height": "given", "odometry": False},
        "lidar": {"method": "paper", "deskew": False, "level": False},
        "grid": {"memory": "scan", "dilation": "square", "min_points": 1},
        "planner": {"name": "ia_star"},
        "pursuit": {"clear_chord": False, "fuzzy": {"tables": "printed"}},
    }
}
"""What the papers did, where quadlog's own default may differ."""

RETIRED = {
    "results.frames": "now the player shows the walk",
    "grid.decay_s": "now log_odds clears what is seen through, after grid.clear_s",
    "robot.preset": "now robot.model, which brings the body's size",
    "wbc": "now constant, but for friction and force, which are those of [mpc]",
    **dict.fromkeys(
        (
            *("simulation.swing", "simulation.swing_aside_m", "pursuit.rate_hz", "pursuit.fuzzy.k_v0"),
            *("pursuit.fuzzy.k_w0", "mpc.horizon", "mpc.dt_s", "mpc.every_s", "mpc.weight_rpy", "mpc.weight_position"),
            *("mpc.weight_omega", "mpc.weight_velocity", "mpc.turning_share", "mpc.alpha", "mpc.f_min_n"),
            *(f"simulation.trot.{key}" for key in ("height_m", "lateral", "lateral_shape", "first_pair")),
            *(f"simulation.trot.{key}" for key in ("friction_spread", "foot_radius_spread", "posture_spread_deg")),
        ),
        "now constant",
    ),
}
"""Keys and sections of earlier versions, which files may still have, with a note, and what stands for them."""


class Layer(NamedTuple):
    """One source of values: its name, for messages, and a nested table."""

    source: str
    table: dict[str, Any]


class Flag(NamedTuple):
    """An option of the command line that sets one key, as --planner sets planner.name; value None: not given."""

    name: str
    key: str
    value: Any


class Configured(NamedTuple):
    """The effective configuration. notes: a line about the keys of the file that the preset replaced, if any."""

    config: Config
    notes: tuple[str, ...] = ()


def load_config(
    path: Path | None = None,
    overrides: Sequence[str] = (),
    preset: str | None = None,
    settings: Mapping[str, Any] = MappingProxyType({}),
) -> Config:
    """The effective configuration; see `configure`."""
    return configure(path, overrides, preset, settings).config


def configure(
    path: Path | None = None,
    overrides: Sequence[str] = (),
    preset: str | None = None,
    settings: Mapping[str, Any] = MappingProxyType({}),
    flags: Sequence[Flag] = (),
) -> Configured:
    """The effective configuration, and what its preset replaced in the file.

    path: a TOML file; overrides: ``section.key=value`` as ``--set`` takes them; flags: options for single keys, of the
    same rank; settings: values by dotted key or section by section, which outrank everything.
    Raises UnreadableFile, UnknownConfigKey, InvalidConfigValue and UnknownName, each naming its source, and
    UsageError for a flag and a ``--set`` of one key that differ.
    """
    if preset is not None and preset not in PRESETS:
        raise UnknownName("preset", preset, PRESETS)
    table, retired = without_retired({} if path is None else _read_toml(path))
    file, chosen = Layer(str(path), table), Layer(f"preset {preset}", PRESETS[preset] if preset else {})
    typed = [_override_layer(override) for override in overrides]
    given = [flag for flag in flags if flag.value is not None]
    for flag in given:
        _refuse_contradiction(flag, typed)
    later = [
        *typed,
        *(_layer(f"{flag.name} {flag.value}", flag.key, flag.value) for flag in given),
        *(_layer("settings", str(key), value) for key, value in settings.items()),
    ]
    layers = [file, chosen, *later]
    try:
        config = Config.model_validate(_merged(layers))
    except ValidationError as error:
        raise _explain(error, layers) from None
    notes = [f"{path}: {retired}"] if retired else []
    return Configured(config, (*notes, *_replaced(chosen, file, later)))


def read_bounds(path: Path) -> dict[str, dict[str, ExpectedRange | None]]:
    """The bounds in a file of `quadlog check`, by name of the runs and metric; those for every run under "".

    [default] and each [recordings.NAME] are tables like [expect]; in the latter {} is None, no bound whatever [default]
    says. Raises UnreadableFile, TooLarge, UnknownConfigKey and InvalidConfigValue.
    """
    content = _read_toml(path)
    for key in content.keys() - {"default", "recordings"}:
        raise UnknownConfigKey(key, _nearest(key, ("default", "recordings")), str(path))
    recordings = content.get("recordings", {})
    if not isinstance(recordings, dict):
        raise InvalidConfigValue("recordings", "is a table", str(path))
    found = {"": _bounds(content.get("default", {}), "default", path)}
    for name, table in recordings.items():
        if not isinstance(table, dict):
            raise InvalidConfigValue(f"recordings.{name}", "is a table", str(path))
        kept = {metric: {"min": 0.0} if bound == {} else bound for metric, bound in table.items()}
        bounds = _bounds(kept, f"recordings.{name}", path)
        found[name] = {metric: None if table[metric] == {} else bound for metric, bound in bounds.items()}
    return found


def _bounds(table: Any, where: str, path: Path) -> dict[str, ExpectedRange | None]:
    """The bounds of a table, as those of [expect]; where: its name in errors."""
    try:
        return dict(Config.model_validate({"expect": table}).expect.model_extra or {})
    except ValidationError as error:
        raise _explain(error, [Layer(str(path), {"expect": table})], where) from None


def without_retired(table: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """A configuration without the keys and sections of RETIRED, and a line that names those in it, "" for none."""
    kept, found = deepcopy(dict(table)), dict[str, list[str]]()
    robot = kept.get("robot")
    for key, why in RETIRED.items():
        *sections, name = key.split(".")
        of: Any = kept
        for section in sections:
            of = of.get(section) if isinstance(of, dict) else None
        if isinstance(of, dict) and name in of:
            if of is robot:
                kept["robot"] = without_preset(robot)
            found.setdefault(why, []).append(f"[{key}]" if isinstance(of.pop(name), dict) else key)
    gone = "; ".join(f"{', '.join(keys)} ({why})" for why, keys in found.items())
    return kept, f"keys of an earlier version: {gone}" if gone else ""


SCHEMA = Path(__file__).with_name("quadlog.schema.json")
"""The JSON schema of the file, by which editors complete and check keys; docs/make.py writes it."""


def all_keys() -> list[str]:
    """Every key that has a value, dotted."""
    return list(_flat(Config().model_dump()))


def commented_toml(
    config: Config,
    notes: Mapping[str, Sequence[str]] | None = None,
    sections: Collection[str] = tuple(Config.model_fields),
) -> str:
    """The configuration with each key's meaning, as `quadlog init` writes it: keys with default values are comments.

    notes: further comment lines, by dotted key or section name. sections: those that are written.
    """
    notes = notes or {}
    lines = [
        "# quadlog.toml: SI units. Lines like `# key = value` are defaults: remove the # to change one.",
        "",
    ]
    for name in (each for each in type(config).model_fields if each in sections):
        lines.extend(_section_lines(name, getattr(config, name), notes))
    return "\n".join(lines).rstrip() + "\n"


def _section_lines(name: str, section: BaseModel, notes: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """A table: plain keys first, then the tables inside it, as TOML wants them."""
    yield f"[{name}]"
    if section.__doc__ is not None:
        yield f"# {section.__doc__.splitlines()[0]}"
    yield from (f"# {note}" for note in notes.get(name, ()))
    tables, lists = [], []
    for key, field in type(section).model_fields.items():
        value = getattr(section, key)
        if isinstance(value, BaseModel):
            tables.append((key, value))
            continue
        if field.description:
            yield f"# {key}: {field.description}"
        yield from (f"# {note}" for note in notes.get(f"{name}.{key}", ()))
        if isinstance(value, list) and value and isinstance(value[0], BaseModel):
            lists.append((key, value))
        elif value is None:
            yield f"# {key} ="
        elif value != [] or not key.endswith(("anchors", "tags", "range_topics", "poses")):
            # On one line, so that one # makes a comment of it; TOML forbids line breaks within strings.
            line = " ".join(part.strip() for part in tomli_w.dumps({key: value}).split("\n")).strip()
            yield line if key in section.model_fields_set else f"# {line}"
    for key, bounds in (section.model_extra or {}).items():
        sides = ", ".join(f"{side} = {value}" for side, value in bounds.model_dump(exclude_none=True).items())
        yield f"{key} = {{ {sides} }}"
    yield ""
    for key, rows in lists:
        for row in rows:
            yield f"[[{name}.{key}]]"
            yield tomli_w.dumps(row.model_dump(exclude_none=True)).rstrip()
            yield ""
    for key, table in tables:
        yield from _section_lines(f"{name}.{key}", table, notes)


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise TooLarge(f"{path}: config file in bytes", size, MAX_FILE_BYTES)
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnreadableFile(path, error.strerror or "cannot be read") from None
    except (ValueError, RecursionError) as error:  # ValueError also for an integer of too many digits
        raise UnreadableFile(path, f"not TOML: {error}") from None


def _override_layer(override: str) -> Layer:
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise InvalidConfigValue(override, "expected section.key=value", "--set")
    return _layer(f"--set {clipped(override)}", key.strip(), _parse_value(text.strip()))


def _layer(source: str, key: str, value: Any) -> Layer:
    """The layer that sets one dotted key."""
    keys = key.split(".")
    if len(keys) > MAX_DEPTH:
        raise UnknownConfigKey(key, None, source)
    return Layer(source, reduce(lambda nested, part: {part: nested}, reversed(keys), value))


def _parse_value(text: str) -> Any:
    """A TOML value where the text is one, else the text itself: topic names need no quotes."""
    if "\n" in text:
        return text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):  # ValueError also for an integer of too many digits
        return text


def _refuse_contradiction(flag: Flag, typed: Sequence[Layer]) -> None:
    """Raises UsageError when --set gives the flag's key another value."""
    setters = [layer for layer in typed if _has(layer.table, flag.key.split("."))]
    if setters and _flat(_merged(setters)).get(flag.key) != flag.value:
        raise UsageError(f"{flag.name} {flag.value} and {setters[-1].source} differ; use one of them")


def _replaced(preset: Layer, file: Layer, later: Sequence[Layer]) -> Iterator[str]:
    """A line with the keys of the file whose values the preset replaced, where there are any."""
    before, after = _flat(file.table), _flat(_merged(later))
    keys = [
        f"{key} = {_shown(value)} instead of {_shown(before[key])}"
        for key, value in _flat(preset.table).items()
        if key in before and key not in after and before[key] != value
    ]
    if keys:
        yield f"{preset.source} replaces keys of {file.source}: {', '.join(keys)}"


def _shown(value: Any) -> str:
    """A value as TOML has it, cut short."""
    return json.dumps(value, default=str)[:80]


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The values of a nested table by dotted key."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat


def _merged(layers: Sequence[Layer]) -> dict[str, Any]:
    return reduce(_over, (layer.table for layer in layers), {})


def _over(below: Any, table: Mapping[str, Any]) -> dict[str, Any]:
    """A nested table over another, or over a value that it replaces."""
    merged = dict(below) if isinstance(below, Mapping) else {}
    for key, value in table.items():
        merged[key] = _over(merged.get(key), value) if isinstance(value, Mapping) else value
    return merged


def _explain(error: ValidationError, layers: Sequence[Layer], expect: str = "expect") -> QuadlogError:
    """expect: the name of the table of bounds."""
    first = error.errors()[0]
    loc = [str(part) for part in first["loc"]]
    key = ".".join(loc) or "the file"
    source = next((layer.source for layer in reversed(layers) if _has(layer.table, loc)), "configuration")
    if loc[:1] == ["expect"]:
        key = ".".join([expect, *loc[1:]])
    if key in RETIRED and first["type"] == "extra_forbidden":
        return InvalidConfigValue(key, f"is a key of an earlier version: {RETIRED[key]}", source)
    if first["type"] == "extra_forbidden":
        position = next((part for part in loc if part.isdigit()), "0")
        sides = [f"{key.rpartition('.')[0]}.{side}" for side in ExpectedRange.model_fields if loc[0] == "expect"]
        return UnknownConfigKey(key, _nearest(key, sides or sorted(_keys_of(Config, "", position))), source)
    if first["type"] == UNKNOWN_METRIC:
        name = str(first["ctx"]["metric"])
        return UnknownConfigKey(f"{key}.{name}", f"{key}.{_nearest(name, CATALOGUE)}", source)
    reason = first["msg"].removeprefix("Value error, ")
    given = first.get("input")
    if isinstance(given, str | int | float | bool):
        reason += f" (got {str(given)[:80]!r})"
    return InvalidConfigValue(key, reason[0].lower() + reason[1:], source)


def _nearest(key: str, keys: Iterable[str]) -> str:
    return get_close_matches(key, list(keys), 1, 0.0)[0]


def _has(table: Any, loc: Sequence[str]) -> bool:
    """Whether a layer sets this key, or the list or table that holds it."""
    for part in loc:
        if isinstance(table, list):
            return True
        if not isinstance(table, Mapping) or part not in table:
            return False
        table = table[part]
    return True


def _keys_of(model: type[BaseModel], prefix: str, position: str) -> Iterator[str]:
    """Every dotted key of the model, with this position in lists."""
    for key, field in model.model_fields.items():
        dotted = f"{prefix}{key}"
        yield dotted
        inner = field.annotation
        arguments = getattr(inner, "__args__", ())
        if isinstance(inner, type) and not arguments and issubclass(inner, BaseModel):
            yield from _keys_of(inner, f"{dotted}.", position)
        elif arguments and isinstance(arguments[0], type) and issubclass(arguments[0], BaseModel):
            yield from _keys_of(arguments[0], f"{dotted}.{position}.", position)
