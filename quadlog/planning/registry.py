"""Every planner by name: a new one is a file of its own and a line here."""

from __future__ import annotations

from quadlog.errors import UnknownName
from quadlog.planning.astar import AStar
from quadlog.planning.d_star_lite import DStarLite
from quadlog.planning.ia_star import IAStar
from quadlog.planning.lpa_star import LPAStar
from quadlog.planning.mt_d_star_lite import MTDStarLite
from quadlog.planning.protocol import Planner

PLANNERS: dict[str, type[Planner]] = {each.name: each for each in (AStar, IAStar, DStarLite, LPAStar, MTDStarLite)}


def make_planner(name: str, corner_cutting: bool = False) -> Planner:
    """A fresh planner. Raises UnknownName, which lists those there are."""
    if name not in PLANNERS:
        raise UnknownName("planner", name, PLANNERS)
    return PLANNERS[name](corner_cutting)
