"""Every planner by name: a new one is a file and a line in quadlog/planning/planners; others come as plug-ins."""

from __future__ import annotations

import math
import operator
from pkgutil import resolve_name
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import UnknownName
from quadlog.planning.planners import PLANNER_CLASSES
from quadlog.planning.protocol import Bool, Cell, Plan, Planner
from quadlog.planning.rules import USUAL, Rules
from quadlog.plugins import PLANNERS as GROUP
from quadlog.plugins import Plugin, find_plugin, plugin_names

_MEMBERS = ("name", "incremental", "plan", "reset")
_COUNTS = ("expanded", "generated", "touched", "reused_cells")


def check_planner(plugin: Plugin, found: Any) -> type[Planner]:
    """What an entry point names, as the class it has to be. Raises QuadlogError, which says what it lacks."""
    if not isinstance(found, type):
        raise plugin.unusable(f"is no class but {type(found).__name__}")
    if lacks := [name for name in _MEMBERS if not hasattr(found, name)]:
        raise plugin.unusable(f"is no planner: it lacks {', '.join(lacks)}")
    if found.name != plugin.name:  # type: ignore[attr-defined]
        raise plugin.unusable(f"calls itself {found.name!r}; name and entry point must agree")  # type: ignore[attr-defined]
    return found


class CheckedPlanner:
    """See Planner. What the planner raises, and a path that breaks its rules, becomes a QuadlogError."""

    def __init__(self, plugin: Plugin, kind: type[Planner], rules: Rules) -> None:
        self._plugin = plugin
        self.name, self.incremental = kind.name, kind.incremental  # type: ignore[misc]
        with plugin.doing("be made"):
            self._planner = kind(rules)
        self.rules: Rules = getattr(self._planner, "rules", None) or rules
        if not isinstance(self.rules, Rules):
            raise plugin.unusable("its rules are no Rules")

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The plug-in's plan, its cells as int32."""
        return self.checked(self.unchecked(blocked, start, goal, shift), blocked, start, goal)

    def unchecked(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Any:
        """What the plug-in answers, whatever that is: to be timed without the check, which takes some 50 µs."""
        with self._plugin.doing("plan"):
            return self._planner.plan(blocked, start, goal, shift)

    def checked(self, plan: Any, blocked: Bool, start: Cell, goal: Cell) -> Plan:
        """Such an answer as a Plan, its cells as int32."""
        try:
            plan = _in_our_types(plan)
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            raise self._plugin.unusable(f"gives no Plan: {error}") from error
        fault = _fault(plan, blocked, start, goal, self.rules) if plan.found else ""
        if fault:
            raise self._plugin.unusable(f"from {start} to {goal}: {fault}")
        return plan

    def reset(self) -> None:
        """Forget the plan before."""
        with self._plugin.doing("be reset"):
            self._planner.reset()


def _in_our_types(plan: Plan) -> Plan:
    """The same plan with numbers of Python and cells (L, 2) int32. Raises what `plan` catches."""
    cells: NDArray[Any] = np.asarray(plan.cells)
    if plan.found and (cells.ndim != 2 or cells.shape[1] != 2 or cells.dtype.kind not in "iu"):
        raise ValueError(f"its cells are {cells.dtype} {cells.shape}, not integers (L, 2)")
    float(plan.cost)  # raises for what is no real number
    counts = {name: operator.index(getattr(plan, name)) for name in _COUNTS}
    if any(count < 0 for count in counts.values()):
        raise ValueError(f"a count is negative: {counts}")
    cells = cells.astype(np.int32) if plan.found else np.empty((0, 2), np.int32)
    return Plan(bool(plan.found), cells, plan.cost + 0, from_scratch=bool(plan.from_scratch), **counts)


def _fault(plan: Plan, blocked: Bool, start: Cell, goal: Cell, rules: Rules) -> str:
    """What is wrong with a path, empty for nothing: where it begins and ends, its cells, its steps, its cost."""
    cells = plan.cells
    if len(cells) == 0 or tuple(cells[0]) != tuple(start) or tuple(cells[-1]) != tuple(goal):
        return "its path does not lead from start to goal"
    col, row = cells.T
    inside = (col >= 0) & (row >= 0) & (col < blocked.shape[1]) & (row < blocked.shape[0])
    if not inside.all() or blocked[row, col].any():
        return "its path leaves the free cells"
    dcol, drow = np.diff(cells, axis=0).T
    if (np.maximum(abs(dcol), abs(drow)) != 1).any():
        return "its path has steps that are not to a neighbour"
    corner = blocked[row[:-1], col[1:]] | blocked[row[1:], col[:-1]]
    if not rules.corner_cutting and corner.any():
        return "its path cuts a corner"
    diagonals = int(np.count_nonzero(dcol & drow))
    cost = rules.cost_of(len(dcol) - diagonals, diagonals)
    return "" if math.isclose(plan.cost, cost, rel_tol=1e-9) else f"its cost is {plan.cost:g}, its steps cost {cost:g}"


PLANNERS: dict[str, type[Planner]] = {name: resolve_name(place) for name, place in PLANNER_CLASSES.items()}
"""quadlog's own."""


def planner_names() -> tuple[str, ...]:
    """The planners of quadlog, then those of plug-ins; nothing is imported."""
    return (*PLANNERS, *(name for name in plugin_names(GROUP) if name not in PLANNERS))


def planner_plugin(name: str) -> Plugin | None:
    """The plug-in that plans under a name, None for quadlog's own. Raises UnknownName, QuadlogError."""
    plugin = find_plugin(GROUP, name, taken=name in PLANNERS)
    if plugin is None and name not in PLANNERS:
        raise UnknownName("planner", name, planner_names())
    return plugin


def planner_type(name: str) -> type[Planner]:
    """The class of a planner.

    Raises UnknownName, which lists those there are; QuadlogError for a name that several have, and for a
    plug-in that cannot be loaded or is no planner.
    """
    plugin = planner_plugin(name)
    return PLANNERS[name] if plugin is None else check_planner(plugin, plugin.load())


def make_planner(name: str, rules: Rules = USUAL) -> Planner:
    """A fresh planner; one of a plug-in is checked with every answer. Raises as planner_type does."""
    plugin = planner_plugin(name)
    if plugin is None:
        return PLANNERS[name](rules)
    return cast(Planner, CheckedPlanner(plugin, planner_type(name), rules))  # whose name is not its class's
