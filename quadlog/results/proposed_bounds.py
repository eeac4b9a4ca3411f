"""Bounds proposed from saved runs, and added to a TOML file without losing what a person wrote there."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from quadlog.errors import CannotWrite
from quadlog.results.expectations import Bound
from quadlog.results.run_check import SavedRun

HEADER = """\
# quadlog check: bounds on the metrics of runs, both ends included.
# [default] is for every run, [recordings.NAME] for those of one name; {} takes a bound of [default] away.
"""

_MARGIN = Decimal("0.1")
_DIGITS = 3
_LEAST_MARGIN = Decimal("0.0001")  # rounding errors of another machine are not a change for the worse
_SHARE_MARGIN = Decimal("0.01")

_COUNTS = frozenset({"fallen", "collisions"})
_SHARES = frozenset({"success_rate", "fallback_share", "torque_saturation_share", "suboptimality_mean"})
_LARGER_IS_BETTER = frozenset({"success_rate", "clearance_min_m", "ratio_to_astar"})
_NEITHER_IS_BETTER = frozenset({"following_distance_mean_m", "lateral_drift_m", "yaw_rate_degps", "forward_m"})
_OF_THE_MACHINE = frozenset({"realtime_factor"})


def propose(runs: Sequence[SavedRun]) -> dict[str, tuple[Bound, ...]]:
    """Bounds by name, from all runs of that name, of the metrics that each of them has.

    Only the side that is worse is bounded, where one is. The margin beyond the
    worst run is a tenth of its value, at least 0.0001; for a share 0.01, for a
    count nothing. Bounds are rounded outwards to three digits. realtime_factor
    has none, for it depends on the machine.
    """
    by_name: dict[str, list[SavedRun]] = {}
    for run in runs:
        by_name.setdefault(run.names[0], []).append(run)
    return {name: _propose_for(each) for name, each in by_name.items()}


def merge_bounds(text: str, bounds: Mapping[str, Sequence[Bound]], path: Path) -> str:
    """The TOML `text`, which `path` holds, with these bounds set; all else in it, comments too, stays as it is.

    Raises CannotWrite for a file laid out so that this cannot be done.
    """
    expected: dict[str, Any] = tomllib.loads(text)
    for name, each in bounds.items():
        expected.setdefault("recordings", {}).setdefault(name, {}).update({b.metric: b.sides() for b in each})
    try:
        document = tomlkit.parse(text)
        recordings = document.setdefault("recordings", tomlkit.table())
        for name, each in bounds.items():
            section = recordings.setdefault(name, tomlkit.table())
            for bound in each:
                inline = tomlkit.inline_table()
                inline.update(bound.sides())
                section[bound.metric] = inline
        merged = tomlkit.dumps(document)
        if tomllib.loads(merged.encode().decode()) == expected:
            return merged
    except (TOMLKitError, ValueError, TypeError, AttributeError, RecursionError):
        pass  # it was not made for every layout that TOML allows
    raise CannotWrite(path, "no bounds can be added to a file laid out like this; write them to another one")


def _propose_for(runs: Sequence[SavedRun]) -> tuple[Bound, ...]:
    shared = [name for name in runs[0].metrics if all(name in run.metrics for run in runs)]
    return tuple(
        _bound(name, [run.metrics[name] for run in runs]) for name in sorted(shared) if name not in _OF_THE_MACHINE
    )


def _bound(metric: str, values: Sequence[float]) -> Bound:
    least = _outwards(metric, min(values), -1)
    most = _outwards(metric, max(values), +1)
    if metric in _NEITHER_IS_BETTER:
        return Bound(metric, least, most)
    return Bound(metric, least=least) if metric in _LARGER_IS_BETTER else Bound(metric, most=most)


def _outwards(metric: str, value: float, sign: int) -> float:
    if metric in _COUNTS:
        return value
    exact = Decimal(repr(value))
    margin = _SHARE_MARGIN if metric in _SHARES else max(_MARGIN * abs(exact), _LEAST_MARGIN)
    moved = exact + sign * margin
    step = Decimal(1).scaleb(moved.adjusted() - _DIGITS + 1)
    bound = float(moved.quantize(step, rounding=ROUND_CEILING if sign > 0 else ROUND_FLOOR))
    return bound if math.isfinite(bound) else value
