"""The rules of a search that decide what it costs and what it counts; their names are printed beside every result."""

from __future__ import annotations

import math
from dataclasses import dataclass

from quadlog.errors import UnknownName

# Costs are whole numbers in every search, so that equal paths have equal costs in whatever order they are added up.
# 2**32 for a cell tells apart all paths whose diagonal steps differ in number by less than 55 000.
EXACT_CELL = 2**32
_STEP_UNITS = {"integer": (10, 14), "exact": (EXACT_CELL, round(EXACT_CELL * math.sqrt(2)))}
COSTS = tuple(_STEP_UNITS)
HEURISTICS = ("octile", "manhattan", "zero")
TIES = ("larger_g", "smaller_g")


@dataclass(frozen=True, slots=True)
class Rules:
    """What a planner goes by. Raises UnknownName, which lists the choices.

    costs: "integer", 10 a straight step and 14 a diagonal one, or "exact", 1 and the root of 2.
    heuristic: "octile" is the cost over free cells; "manhattan" is (|dx| + |dy|) straight steps, which overrates
    diagonal ones [Planning, eq. 3, its unit as the erratum has it]; "zero" knows nothing.
    ties: which of two cells with the same f comes first; published D* Lite keys are "smaller_g".
    corner_cutting: whether a diagonal step may pass a blocked cell beside it.
    """

    costs: str = "integer"
    heuristic: str = "octile"
    ties: str = "larger_g"
    corner_cutting: bool = False

    def __post_init__(self) -> None:
        for kind, choices in (("costs", COSTS), ("heuristic", HEURISTICS), ("ties", TIES)):
            if getattr(self, kind) not in choices:
                raise UnknownName(kind, getattr(self, kind), choices)

    @property
    def step_units(self) -> tuple[int, int]:
        """A straight and a diagonal step, in the whole numbers that searches add up."""
        return _STEP_UNITS[self.costs]

    @property
    def heuristic_units(self) -> tuple[int, int]:
        """(a, b) of h = a max(|dx|, |dy|) + b min(|dx|, |dy|)."""
        straight, diagonal = self.step_units
        units = {"octile": (straight, diagonal - straight), "manhattan": (straight, straight), "zero": (0, 0)}
        return units[self.heuristic]

    def cost_of(self, straights: int, diagonals: int) -> float:
        """What a path of so many steps costs: a whole number, or cells."""
        if self.costs == "integer":
            return 10 * straights + 14 * diagonals
        return straights + diagonals * math.sqrt(2)

    def __str__(self) -> str:
        corners = "cut" if self.corner_cutting else "not cut"
        return f"costs {self.costs}, heuristic {self.heuristic}, ties {self.ties}, corners {corners}"


USUAL = Rules()
