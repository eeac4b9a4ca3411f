"""Run every planner on every problem of a source; the answers are the rows of replans.parquet."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.metrics.intervals import corrected_confidence, fewest_values
from quadlog.pipelines.comparison.problems import ProblemSource, Question
from quadlog.pipelines.executor.progress import Progress
from quadlog.planning.query import Query
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import Answer, Panel
from quadlog.planning.rules import Rules
from quadlog.results.planner_comparison.shown_questions import QuestionSample
from quadlog.results.planner_comparison.tables import REPLANS, SCENARIOS

Columns = dict[str, list[Any]]


@dataclass(slots=True)
class Answers:
    """columns: of replans.parquet, planner by planner at each question; scenarios: of scenarios.parquet.

    us_repeats (N, K): microseconds of each time that a row's question was asked, of which column us has the median.
    sample: questions for the page, None where none were to be kept.
    """

    columns: dict[str, NDArray[Any]]
    scenarios: dict[str, NDArray[Any]]
    us_repeats: NDArray[np.float64]
    sample: QuestionSample | None = None


@dataclass(slots=True)
class _Notebook:
    """What has been answered so far. at: the row of replans.parquet that comes next; a later pass adds times alone."""

    source: ProblemSource
    sample: QuestionSample | None = None
    replans: Columns = field(default_factory=lambda: {name: [] for name in REPLANS.names})
    scenarios: Columns = field(default_factory=lambda: {name: [] for name in SCENARIOS.names})
    us_repeats: list[list[float]] = field(default_factory=list)
    at: int = 0

    def add(self, number: int, at: tuple[int, int], question: Question, answers: Sequence[Answer]) -> None:
        """The answers to the number-th question, at an episode and replan."""
        is_first_pass = self.at == len(self.us_repeats)
        for answer in answers:
            if not is_first_pass:
                self.us_repeats[self.at] += answer.us_repeats
            else:
                self._add_row(*at, question, answer)
            self.at += 1
        if is_first_pass and self.sample is not None:
            _keep(self.sample, number, at, question, answers)

    def _add_row(self, episode: int, replan: int, question: Question, answer: Answer) -> None:
        self.us_repeats.append(list(answer.us_repeats))
        for name, value in _replan_row(self.source.name, episode, replan, question, answer).items():
            self.replans[name].append(value)
        if self.source.queries:
            for name, value in _scenario_row(self.source, episode, answer).items():
                self.scenarios[name].append(value)


FEWEST_REPEATS = 3


def repeats_for(source: ProblemSource, planners: int) -> int:
    """How often to ask everything, so that times have intervals.

    Of a single question the repeats are all there is to tell planners apart by.
    """
    is_single = source.is_static and source.count == 1
    return max(FEWEST_REPEATS, fewest_values(corrected_confidence(planners - 1)) if is_single else 0)


def ask_everything(
    source: ProblemSource,
    names: Sequence[str],
    rules: Rules,
    progress: Progress,
    repeats: int = 1,
    *,
    curvatures: bool = True,
    sample: QuestionSample | None = None,
) -> Answers:
    """Ask the planners of those names, the first of them the baseline, each by the rules it keeps of these.

    repeats: how often, for the times; whatever else is answered is of the first time. Planners take turns: at every
    question, or where questions stand alone and planners hold a map's memory one after the other, in every pass.
    curvatures: of smoothed paths, which take longer than the plans; static sources have none. sample: keeps questions
    for the page.
    """
    book = _Notebook(source, sample)
    smoothing = source.smoothing if curvatures and not source.is_static else None
    passes, rounds = (repeats, 1) if source.is_static else (1, repeats)
    for number in range(passes):
        book.at = 0
        for members in [[name] for name in names] if source.is_static else [list(names)]:
            planners, *doubles = ([make_planner(name, rules) for name in members] for _ in range(rounds))
            panel, asked = Panel(planners, smoothing, doubles), itertools.count()
            for episode, questions in enumerate(source.episodes()):
                panel.begin_episode()
                for replan, question in enumerate(questions):
                    book.add(next(asked), (episode, replan), question, panel.ask(question.query))
                if number == 0 and members[0] == names[0]:
                    progress.advance()
    columns, us_repeats = _arrays(book.replans), _repeats(book.us_repeats, repeats)
    timed = np.isfinite(us_repeats).all(axis=1)
    columns["us"][timed] = np.median(us_repeats[timed], axis=1)
    return Answers(columns, _arrays(book.scenarios), us_repeats, sample)


def _keep(
    sample: QuestionSample, number: int, at: tuple[int, int], question: Question, answers: Sequence[Answer]
) -> None:
    """What there was to plan, with every path; there is no map of what could not be asked."""
    query = question.query
    if isinstance(query, Query) and question.occupied is not None:
        layers, ends = (question.occupied, query.blocked), (query.start, query.goal)
        sample.add(number, at, query.window, layers, ends, {each.planner: each.plan.cells for each in answers})


def _repeats(us: list[list[float]], repeats: int) -> NDArray[np.float64]:
    """(N, repeats), NaN where nobody was asked."""
    table = np.full((len(us), repeats), np.nan)
    for row, mine in zip(table, us, strict=True):
        row[: len(mine)] = mine
    return table


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
