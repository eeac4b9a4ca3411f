"""Planning problems, their sources, and the options of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from quadlog.config.schema import Config
from quadlog.planning.protocol import Bool, Cell
from quadlog.planning.query import NoQuery, Query
from quadlog.planning.registry import planner_names, planner_type
from quadlog.planning.replan import ReplanSettings
from quadlog.planning.rules import Rules
from quadlog.storage.formats.movingai import ScenQuery


class Question(NamedTuple):
    """A query at an instant, and occupied (rows, cols), the map it stands on before obstacles were grown."""

    t_ns: int
    query: Query | NoQuery
    occupied: Bool


Episode = Iterable[Question]
Ends = tuple[Cell, Cell]


@dataclass(frozen=True, slots=True)
class ProblemSource:
    """Episodes of planning problems; within an episode they follow one another in time.

    name: as the column `source` has it; about: one sentence on what is asked.
    episodes: gives all of them on every call; count: their number.
    is_static: every question stands alone, so planners can be run one after the other, each in its own memory.
    queries: the lines of a .scen file, one episode each. row_zero_on_top: as MovingAI counts rows.
    smoothing: how paths are smoothed before their curvature is measured.
    """

    name: str
    about: str
    episodes: Callable[[], Iterator[Episode]]
    count: int
    is_static: bool = False
    queries: tuple[ScenQuery, ...] = ()
    row_zero_on_top: bool = False
    smoothing: ReplanSettings = field(default_factory=ReplanSettings)


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """What decides a comparison beside its sources.

    planners: none are all. costs: None is exact with a .scen file, else integer. counted, leader: None is the preset's.
    scen, start_cell, goal_cell: for maps in files. config: of a run folder it replaces what is given here.
    """

    planners: tuple[str, ...] = ()
    preset: str = "honest"
    costs: str | None = None
    ties: str = "larger_g"
    counted: str | None = None
    leader: str | None = None
    corner_cutting: bool = False
    scen: Path | None = None
    start_cell: tuple[int, int] | None = None
    goal_cell: tuple[int, int] | None = None
    episodes: int = 40
    seed: int = 0
    config: Config = field(default_factory=Config)

    @property
    def ends(self) -> Ends | None:
        """Start and goal, where both are given."""
        return None if self.start_cell is None or self.goal_cell is None else (self.start_cell, self.goal_cell)

    @property
    def rules(self) -> Rules:
        """What planners are made with: each keeps the rule it is defined by."""
        heuristic = "manhattan" if self.preset == "paper" else "octile"
        costs = self.costs or ("exact" if self.scen is not None else "integer")
        return Rules(costs, heuristic, self.ties, self.corner_cutting)

    @property
    def baseline(self) -> str:
        """What every planner's cells are compared with."""
        return "astar_paper" if self.preset == "paper" else "astar"

    @property
    def walked_by(self) -> str:
        """Whose plans are walked through forests; the paper's robot follows IA*'s. Raises as planner_type does."""
        leader = self.leader or ("ia_star" if self.preset == "paper" else "astar")
        planner_type(leader)
        return leader

    @property
    def names(self) -> tuple[str, ...]:
        """The planners to run, the baseline first. Raises as planner_type does."""
        names = tuple(dict.fromkeys([self.baseline, *(self.planners or planner_names())]))
        for name in names:
            planner_type(name)
        return names


def counted(options: CompareOptions) -> str:
    """What counts as a searched cell in the ratio."""
    return options.counted or ("generated" if options.preset == "paper" else "expanded")
