"""Run every planner on every problem of a source; the answers are the rows of replans.parquet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.pipelines.comparison.problems import ProblemSource, Question
from quadlog.pipelines.executor.progress import Progress
from quadlog.planning.query import Query
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import Answer, Panel, ReplanSettings
from quadlog.planning.rules import Rules
from quadlog.results.planner_comparison.tables import REPLANS, SCENARIOS
from quadlog.results.plots.planner_comparison import PathScene, around_paths

Columns = dict[str, list[Any]]


@dataclass(slots=True)
class Answers:
    """columns: of replans.parquet, planner by planner at each question; scenarios: of scenarios.parquet.

    scene: the question that took the baseline most cells, of the first episode only where one follows from the other,
    with all paths.
    """

    columns: dict[str, NDArray[Any]]
    scenarios: dict[str, NDArray[Any]]
    scene: PathScene | None


@dataclass(slots=True)
class _Notebook:
    """What has been answered so far."""

    source: ProblemSource
    baseline: str
    replans: Columns = field(default_factory=lambda: {name: [] for name in REPLANS.names})
    scenarios: Columns = field(default_factory=lambda: {name: [] for name in SCENARIOS.names})
    scene_paths: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    scene_question: Question | None = None
    scene_at: tuple[int, int] = (-1, -1)
    most_cells: int = -1

    def add(self, episode: int, replan: int, question: Question, answers: Sequence[Answer]) -> None:
        """The answers to one question."""
        for answer in answers:
            row = _replan_row(self.source.name, episode, replan, question, answer)
            for name, value in row.items():
                self.replans[name].append(value)
            if self.source.queries:
                for name, value in _scenario_row(self.source, episode, answer).items():
                    self.scenarios[name].append(value)
        if episode == 0 or self.source.is_static:
            self._look_at((episode, replan), question, answers)

    def _look_at(self, at: tuple[int, int], question: Question, answers: Sequence[Answer]) -> None:
        """Keep the question for the picture when none before took the baseline more cells, and every answer to it."""
        first = answers[0]
        if first.planner == self.baseline and first.plan.expanded > self.most_cells:
            self.scene_question, self.scene_at, self.most_cells = question, at, first.plan.expanded
            self.scene_paths = {}
        if at == self.scene_at:
            self.scene_paths |= {each.planner: each.plan.cells for each in answers}


def ask_everything(
    source: ProblemSource, names: Sequence[str], rules: Rules, progress: Progress, *, curvatures: bool = True
) -> Answers:
    """Ask the planners of those names, the first of them the baseline, each by the rules it keeps of these.

    curvatures: of smoothed paths, which take longer than the plans; static sources have none.
    """
    book = _Notebook(source, names[0])
    smoothing = ReplanSettings() if curvatures and not source.is_static else None
    for members in [[name] for name in names] if source.is_static else [list(names)]:
        panel = Panel([make_planner(name, rules) for name in members], smoothing)
        for episode, questions in enumerate(source.episodes()):
            panel.begin_episode()
            for replan, question in enumerate(questions):
                book.add(episode, replan, question, panel.ask(question.query))
            if members[0] == names[0]:
                progress.advance()
    return Answers(_arrays(book.replans), _arrays(book.scenarios), _scene(book))


def _replan_row(source: str, episode: int, replan: int, question: Question, answer: Answer) -> dict[str, Any]:
    query, plan = question.query, answer.plan
    ends = (0, 0, 0, 0)
    if isinstance(query, Query):
        col0, row0 = query.window.col0, query.window.row0
        ends = (query.start[0] + col0, query.start[1] + row0, query.goal[0] + col0, query.goal[1] + row0)
    return {
        "source": source,
        "episode": episode,
        "replan": replan,
        "t_ns": question.t_ns,
        "planner": answer.planner,
        "found": plan.found,
        "why_not": answer.why_not,
        "expanded": plan.expanded,
        "generated": plan.generated,
        "touched": plan.touched,
        "cost": plan.cost if plan.found else math.nan,
        "optimal_cost": answer.optimal_cost,
        "from_scratch": plan.from_scratch,
        "reused_cells": plan.reused_cells,
        **dict(zip(("start_col", "start_row", "goal_col", "goal_row"), ends, strict=True)),
        "goal_projected": isinstance(query, Query) and query.goal_projected,
        "length_m": answer.length_m,
        "turn_rad": answer.turn_rad,
        "curvature_max_1pm": answer.curvature_max_1pm,
        "us": answer.us,
    }


def _scenario_row(source: ProblemSource, episode: int, answer: Answer) -> dict[str, Any]:
    listed = source.queries[episode]
    return {
        "map": source.name,
        "planner": answer.planner,
        "start_col": listed.start[0],
        "start_row": listed.start[1],
        "goal_col": listed.goal[0],
        "goal_row": listed.goal[1],
        "listed_cost": listed.listed_cost,
        "cost": answer.length_m,
        "expanded": answer.plan.expanded,
        "us": answer.us,
        "found": answer.plan.found,
    }


def _arrays(columns: Mapping[str, list[Any]]) -> dict[str, NDArray[Any]]:
    return {name: np.array(values) for name, values in columns.items()}


def _scene(book: _Notebook) -> PathScene | None:
    question = book.scene_question
    if question is None or not isinstance(question.query, Query) or question.occupied is None:
        return None
    query, window = question.query, question.query.window
    ends = window.centre_of(np.array([query.start, query.goal]))
    x0_m, y0_m = window.origin_m.tolist()
    whole = PathScene(
        title=f"{book.source.name}, where {book.baseline} expanded most",
        occupied=question.occupied,
        grown=None if query.blocked is question.occupied else query.blocked,
        paths={name: window.centre_of(cells) for name, cells in book.scene_paths.items()},
        start=ends[0],
        goal=ends[1],
        cell=window.cell_m,
        origin=(x0_m, y0_m),
        unit="cells" if book.source.row_zero_on_top else "m",
        y_goes_down=book.source.row_zero_on_top,
    )
    return around_paths(whole)
