"""Every planner by name: a new one is a file of its own and a line here."""

from __future__ import annotations

from quadlog.errors import UnknownName
from quadlog.planning.ara_star import ARAStar
from quadlog.planning.astar import AStar
from quadlog.planning.astar_paper import AStarPaper
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
OPTIMAL = ("astar", "d_star_lite", "mt_d_star_lite", "lpa_star", "ara_star", "dijkstra")
"""Planners whose every path is the cheapest there is, by usual rules."""


def make_planner(name: str, rules: Rules = USUAL) -> Planner:
    """A fresh planner. Raises UnknownName, which lists those there are."""
    if name not in PLANNERS:
        raise UnknownName("planner", name, PLANNERS)
    return PLANNERS[name](rules)
