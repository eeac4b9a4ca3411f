"""Run every planner on every problem of a source; the answers are the rows of replans.parquet."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.metrics.intervals import corrected_confidence, fewest_values
from quadlog.pipelines.comparison.problems import ProblemSource, Question
from quadlog.pipelines.executor.progress import Progress
from quadlog.planning.query import Query
from quadlog.planning.registry import make_planner
from quadlog.planning.replan import Answer, Panel
from quadlog.planning.rules import Rules
from quadlog.results.studies.planners import REPLANS, QuestionSample

Columns = dict[str, NDArray[Any]]
FEWEST_REPEATS = 3


class Answers(NamedTuple):
    """columns: of replans.parquet, planner by planner at each question.

    us_repeats (N, K): microseconds of each time that a row's question was asked, of which column us has the median.
    """

    columns: Columns
    us_repeats: NDArray[np.float64]


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
    rows: list[dict[str, Any]] = []
    us: dict[tuple[str, int], list[float]] = {}
    smoothing = source.smoothing if curvatures and not source.is_static else None
    passes, rounds = (repeats, 1) if source.is_static else (1, repeats)
    for turn, members in itertools.product(range(passes), [[name] for name in names] if source.is_static else [names]):
        planners, *doubles = ([make_planner(name, rules) for name in members] for _ in range(rounds))
        panel, numbers = Panel(planners, smoothing, doubles), itertools.count()
        for episode, questions in enumerate(source.episodes()):
            panel.begin_episode()
            for replan, question in enumerate(questions):
                number, answers = next(numbers), panel.ask(question.query)
                for answer in answers:
                    us.setdefault((answer.planner, number), []).extend(answer.us_repeats)
                if turn == 0:
                    at = {"source": source.name, "episode": episode, "replan": replan}
                    rows += [at | _row(question, answer) for answer in answers]
                    # There is no map of what could not be asked.
                    if sample is not None and isinstance(question.query, Query):
                        paths = {each.planner: each.plan.cells for each in answers}
                        sample.add(number, (episode, replan), question.query, question.occupied, paths)
            if turn == 0 and members[0] == names[0]:
                progress.advance()
    columns = {name: np.array([row[name] for row in rows]) for name in REPLANS.names}
    us_repeats = np.array([times or [math.nan] * repeats for times in us.values()])
    timed = np.isfinite(us_repeats).all(axis=1)
    columns["us"][timed] = np.median(us_repeats[timed], axis=1)
    return Answers(columns, us_repeats)


def _row(question: Question, answer: Answer) -> dict[str, Any]:
    query, plan = question.query, answer.plan
    ends, is_projected = np.zeros((2, 2), int), False
    if isinstance(query, Query):
        ends = np.add([query.start, query.goal], [query.window.col0, query.window.row0])
        is_projected = query.goal_projected
    same = ("planner", "why_not", "optimal_cost", "length_m", "turn_rad", "curvature_max_1pm", "us")
    counts = ("found", "expanded", "generated", "touched", "from_scratch", "reused_cells")
    return {
        "t_ns": question.t_ns,
        **{name: getattr(answer, name) for name in same},
        **{name: getattr(plan, name) for name in counts},
        "cost": plan.cost if plan.found else math.nan,
        **dict(zip(("start_col", "start_row", "goal_col", "goal_row"), ends.ravel().tolist(), strict=True)),
        "goal_projected": is_projected,
    }


def scenarios_of(source: ProblemSource, columns: Columns) -> Columns | None:
    """The columns of scenarios.parquet: those of a query and its answers; None without a .scen file."""
    if not source.queries:
        return None
    listed = np.array([query.listed_cost for query in source.queries])[columns["episode"]]
    alike = ("planner", "start_col", "start_row", "goal_col", "goal_row", "expanded", "us", "found")
    named = {"map": columns["source"], "listed_cost": listed, "cost": columns["length_m"]}
    return named | {name: columns[name] for name in alike}
