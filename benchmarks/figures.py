"""A measured figure, its limit and its floor."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Figure(NamedTuple):
    """limit: what it must not exceed, or fall short of when at_least; floor: what no code could beat here."""

    name: str
    value: float
    unit: str
    limit: float | None = None
    at_least: bool = False
    floor: str = ""

    @property
    def verdict(self) -> str:
        """Whether the limit was kept in this run."""
        if self.limit is None:
            return ""
        kept = self.value >= self.limit if self.at_least else self.value <= self.limit
        return "ok" if kept else "SHORT"


def print_figures(title: str, figures: Iterable[Figure]) -> None:
    """One line each, under the part's name."""
    print(f"\n{title.splitlines()[0]}", flush=True)
    for each in figures:
        limit = "" if each.limit is None else f"{'>=' if each.at_least else '<='} {each.limit:g}"
        line = f"  {each.name:<52} {each.value:>10.3f} {each.unit:<10} {limit:<10} {each.verdict:<6} {each.floor}"
        print(line.rstrip(), flush=True)
