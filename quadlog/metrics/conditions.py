"""Conditions on metrics, as in `eta_m > 0.3`: a name, an operator, a number, and nothing else."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass

from quadlog.errors import BadCondition, UnknownMetric
from quadlog.metrics.catalogue import CATALOGUE

OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_LONGEST = 200
_CONDITION = re.compile(
    rf"\s*([A-Za-z_]\w*)\s*({'|'.join(OPERATORS)})\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*", re.ASCII
)


@dataclass(frozen=True, slots=True)
class Condition:
    """`name` compared with `limit`."""

    name: str
    operator: str
    limit: float

    def holds(self, value: float) -> bool:
        """Whether the condition is true of the value; == and != compare to the last digit."""
        return OPERATORS[self.operator](value, self.limit)

    def __str__(self) -> str:
        """As one would write it."""
        return f"{self.name} {self.operator} {self.limit:.12g}"


def parse_condition(text: str) -> Condition:
    """The condition that the text states: NAME OPERATOR NUMBER, white space between them as one likes.

    Raises BadCondition for anything else, UnknownMetric for a name that no metric has.
    """
    found = _CONDITION.fullmatch(text) if len(text) <= _LONGEST else None
    if found is None:
        raise BadCondition(text[:_LONGEST], OPERATORS)
    name, sign, number = found.groups()
    limit = float(number)
    if not math.isfinite(limit):
        raise BadCondition(text, OPERATORS)
    check_metric(name)
    return Condition(name, sign, limit)


def check_metric(name: str) -> None:
    """Raises UnknownMetric, with the nearest name there is, when no metric has this one."""
    if name not in CATALOGUE:
        nearest = difflib.get_close_matches(name.lower(), CATALOGUE, n=1, cutoff=0.5)
        raise UnknownMetric(name, nearest[0] if nearest else None, CATALOGUE)
