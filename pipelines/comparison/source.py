"""What every source of questions gives, whatever it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from quadlog.map_files.movingai import ScenQuery
from quadlog.planning.protocol import Bool
from quadlog.planning.query import NoQuery, Query


class Question(NamedTuple):
    """A query at an instant, and occupied (rows, cols), the map it stands on before obstacles were grown."""

    t_ns: int
    query: Query | NoQuery
    occupied: Bool | None = None


Episode = Iterable[Question]


@dataclass(frozen=True, slots=True)
class Source:
    """Episodes of questions; within one, what is asked next follows from what was before.

    name: as the column `source` has it; about: one sentence on what is asked.
    episodes: gives them anew on every call; count: how many there are.
    is_static: every question stands alone, so planners can be run one after the other, each in its own memory.
    queries: the lines of a .scen file, one episode each. row_zero_on_top: as MovingAI counts rows.
    """

    name: str
    about: str
    episodes: Callable[[], Iterator[Episode]]
    count: int
    is_static: bool = False
    queries: tuple[ScenQuery, ...] = ()
    row_zero_on_top: bool = False
