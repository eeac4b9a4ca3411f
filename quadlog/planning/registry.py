"""Every planner by name: a new one is a file of its own, a line here and its name; others come as plug-ins."""

from __future__ import annotations

from typing import cast

from quadlog.errors import UnknownName
from quadlog.planning.ara_star import ARAStar
from quadlog.planning.astar import AStar
from quadlog.planning.astar_paper import AStarPaper
from quadlog.planning.checked import CheckedPlanner, check_planner
from quadlog.planning.clearance_astar import ClearanceAStar
from quadlog.planning.d_star_lite import DStarLite
from quadlog.planning.dijkstra import Dijkstra
from quadlog.planning.ea_star import EAStar
from quadlog.planning.ia_star import IAStar
from quadlog.planning.ia_star_bounded import IAStarBounded
from quadlog.planning.lpa_star import LPAStar
from quadlog.planning.mt_d_star_lite import MTDStarLite
from quadlog.planning.protocol import Planner
from quadlog.planning.rules import USUAL, Rules
from quadlog.plugins import PLANNERS as GROUP
from quadlog.plugins import Plugin, find_plugin, plugin_names

_ALL: tuple[type[Planner], ...] = (
    AStar,
    AStarPaper,
    IAStar,
    IAStarBounded,
    EAStar,
    ClearanceAStar,
    DStarLite,
    MTDStarLite,
    LPAStar,
    ARAStar,
    Dijkstra,
)
PLANNERS: dict[str, type[Planner]] = {each.name: each for each in _ALL}
"""quadlog's own."""
OPTIMAL = ("astar", "d_star_lite", "mt_d_star_lite", "lpa_star", "ara_star", "dijkstra")
"""Planners whose every path is the cheapest there is, by usual rules."""


def planner_names() -> tuple[str, ...]:
    """The planners of quadlog, then those of plug-ins; none of these is imported."""
    return (*PLANNERS, *(name for name in plugin_names(GROUP) if name not in PLANNERS))


def planner_plugin(name: str) -> Plugin | None:
    """The plug-in that plans under a name, None for quadlog's own. Raises UnknownName, PluginNameTaken."""
    plugin = find_plugin(GROUP, name, taken=name in PLANNERS)
    if plugin is None and name not in PLANNERS:
        raise UnknownName("planner", name, planner_names())
    return plugin


def planner_type(name: str) -> type[Planner]:
    """The class of a planner.

    Raises UnknownName, which lists those there are; PluginNameTaken; PluginUnusable for a plug-in that cannot be
    loaded or is no planner.
    """
    plugin = planner_plugin(name)
    return PLANNERS[name] if plugin is None else check_planner(plugin, plugin.load())


def make_planner(name: str, rules: Rules = USUAL) -> Planner:
    """A fresh planner; one of a plug-in is checked with every answer. Raises as planner_type does."""
    plugin = planner_plugin(name)
    if plugin is None:
        return PLANNERS[name](rules)
    return cast(Planner, CheckedPlanner(plugin, planner_type(name), rules))  # whose name is not its class's
