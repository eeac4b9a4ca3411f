"""Bounds on metrics, from the TOML file of `quadlog check`.

[default]                       # for every run
success_rate = { min = 0.99 }

[recordings.follow]             # for the runs of this name; a metric here replaces that of [default]
eta_m = { max = 0.05 }
uwb_rmse_m = {}                 # no bound, whatever [default] says
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from quadlog.errors import InvalidConfigValue, TooLarge, UnknownConfigKey, UnreadableConfig

MAX_FILE_BYTES = 1 << 20
_TABLES = ("default", "recordings")
_SIDES = ("min", "max")


@dataclass(frozen=True, slots=True)
class Bound:
    """An interval from least to most, both included; None for an open side."""

    metric: str
    least: float | None = None
    most: float | None = None

    def holds(self, value: float) -> bool:
        """Whether the value lies within."""
        return (self.least is None or value >= self.least) and (self.most is None or value <= self.most)

    def sides(self) -> dict[str, float]:
        """The sides that are not open, by their keys in the file."""
        return {key: side for key, side in zip(_SIDES, (self.least, self.most), strict=True) if side is not None}


@dataclass(frozen=True, slots=True)
class Expectations:
    """The bounds of a file, by metric: for all runs, and for runs by name."""

    default: Mapping[str, Bound]
    recordings: Mapping[str, Mapping[str, Bound]]

    def bounds_for(self, names: Sequence[str]) -> tuple[Bound, ...]:
        """The bounds for a run with these names; bounds of a later name replace those before."""
        bounds = dict(self.default)
        for name in names:
            bounds |= self.recordings.get(name, {})
        return tuple(bound for bound in bounds.values() if bound.sides())


def read_expectations(path: Path, metrics: Collection[str]) -> Expectations:
    """The bounds in the file; metrics: the names that a bound may be of.

    Raises UnreadableConfig, TooLarge, UnknownConfigKey (with the nearest valid
    one) and InvalidConfigValue, which name the key.
    """
    return parse_expectations(read_text(path), str(path), metrics)


def read_text(path: Path) -> str:
    """A small text file. Raises UnreadableConfig, TooLarge."""
    try:
        if (size := path.stat().st_size) > MAX_FILE_BYTES:
            raise TooLarge(f"{path}: bytes", size, MAX_FILE_BYTES)
        return path.read_bytes().decode("utf-8")
    except OSError as error:
        raise UnreadableConfig(path, error.strerror or "cannot be read") from None
    except UnicodeDecodeError as error:
        raise UnreadableConfig(path, f"not TOML: {error}") from None


def parse_expectations(text: str, source: str, metrics: Collection[str]) -> Expectations:
    """As read_expectations, from text; source: its name in errors."""
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a TOMLDecodeError, or an integer of too many digits
        raise UnreadableConfig(source, f"not TOML: {error}") from None
    reader = _Reader(source, metrics)
    for key in content:
        if key not in _TABLES:
            reader.refuse_key(key, key, _TABLES)
    default = reader.bounds("default", content.get("default", {}))
    for bound in default.values():
        if not bound.sides():
            reader.refuse(f"default.{bound.metric}", "needs min, max or both")
    recordings = reader.table("recordings", content.get("recordings", {}))
    return Expectations(default, {name: reader.bounds(f"recordings.{name}", each) for name, each in recordings.items()})


@dataclass(frozen=True, slots=True)
class _Reader:
    source: str
    metrics: Collection[str]

    def bounds(self, where: str, content: Any) -> dict[str, Bound]:
        return {name: self._bound(where, name, each) for name, each in self.table(where, content).items()}

    def table(self, where: str, content: Any) -> dict[str, Any]:
        if not isinstance(content, dict):
            self.refuse(where, "is a table")
        return content

    def refuse(self, key: str, reason: str) -> NoReturn:
        raise InvalidConfigValue(key, reason, self.source)

    def refuse_key(self, key: str, name: str, valid: Collection[str]) -> NoReturn:
        nearest = difflib.get_close_matches(name, sorted(valid), n=1, cutoff=0.0)
        raise UnknownConfigKey(key, nearest[0] if nearest else None, self.source)

    def _bound(self, where: str, metric: str, content: Any) -> Bound:
        key = f"{where}.{metric}"
        if metric not in self.metrics:
            self.refuse_key(key, metric, self.metrics)
        if not isinstance(content, dict):
            self.refuse(key, "is a table, as in { min = 0.0, max = 1.0 }")
        for side in content:
            if side not in _SIDES:
                self.refuse_key(f"{key}.{side}", side, _SIDES)
        least, most = (self._number(f"{key}.{side}", content.get(side)) for side in _SIDES)
        if least is not None and most is not None and least > most:
            self.refuse(key, f"min {least:g} lies above max {most:g}")
        return Bound(metric, least, most)

    def _number(self, key: str, value: Any) -> float | None:
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(key, "is a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.refuse(key, "is a finite number")
        return number
