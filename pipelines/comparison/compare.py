"""`quadlog compare-planners`: run every planner on every problem of the sources, compare and write."""

from __future__ import annotations

import itertools
import math
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import ExitCode
from quadlog.metrics.intervals import corrected_confidence, fewest_values
from quadlog.metrics.planner_verdict import notes, verdict
from quadlog.metrics.planning import compare_planners
from quadlog.pipelines.comparison.sources import CompareOptions, ProblemSource, Question, open_sources
from quadlog.pipelines.executor.progress import Progress
from quadlog.planning.query import Query
from quadlog.planning.registry import make_planner, planner_plugin, planner_type
from quadlog.planning.replan import Answer, Panel
from quadlog.planning.rules import Rules
from quadlog.results.studies.planners import REPLANS, ComparedSource, earlier_files, write_comparison
from quadlog.storage.atomic_write import new_folder


@dataclass(frozen=True, slots=True)
class CompareOutcome:
    """rows: of planners.parquet, for all sources; findings: a sentence for each source; about: how to read the rows."""

    rows: list[dict[str, Any]]
    findings: list[str]
    about: list[str]
    exit_code: ExitCode


def compare(
    arguments: Sequence[str], options: CompareOptions, folder: Path | None, force: bool, progress: Progress
) -> CompareOutcome:
    """Compare planners on all sources, and write what was found to `folder`, if any.

    Raises what planner_type raises, UsageError, AlreadyExists, CannotWrite, and what opening a source raises, before
    anything is asked; QuadlogError also later.
    """
    names = options.names
    incremental = [name for name in names if planner_type(name).incremental]
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch, ExitStack() as stack:
        if folder is not None:
            earlier_files(folder, force)
            stack.enter_context(new_folder(folder))
        sources, losses = open_sources(arguments, options, Path(scratch), progress)
        outcome = CompareOutcome([], [], rule_lines(names, options), ExitCode.WITH_LOSS if losses else ExitCode.DONE)
        compared = []
        for source in sources:
            progress.begin("compare", source.count)
            repeats = repeats_for(source, len(names))
            table = ask_everything(source, names, options.rules, progress, repeats)
            comparison = compare_planners(table, options.baseline, options.counts, incremental)
            columns = {name: table[name] for name in REPLANS.names}
            outcome.rows.extend(comparison.rows)
            outcome.findings.append(verdict(comparison))
            outcome.about.extend([f"{source.name}: {source.about}.", *notes(comparison), *failures(columns)])
            if folder is not None:
                compared.append(ComparedSource(comparison, columns, scenarios_of(source, columns)))
        if folder is not None:
            write_comparison(folder, compared, outcome.rows, outcome.about, losses)
    return outcome


def rule_lines(names: Sequence[str], options: CompareOptions) -> list[str]:
    """What every planner goes by: one line for all that is alike, one for each group that differs."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(str(make_planner(name, options.rules).rules), []).append(name)
    lines = [f"Rules of {', '.join(members)}: {rules}." for rules, members in groups.items()]
    plugins = [each for name in names if (each := planner_plugin(name)) is not None]
    lines += [f"Planner {each.name} is of {each.distribution} {each.version}." for each in plugins]
    baseline = f"Baseline {options.baseline} (--preset {options.preset})"
    return [f"{baseline}, counting {options.counts} cells, seed {options.seed}.", *lines]


def failures(columns: Mapping[str, NDArray[Any]]) -> list[str]:
    """Why there were replans without a path, from columns of replans.parquet; alike planners share a line."""
    groups: dict[str, list[str]] = {}
    for planner in dict.fromkeys(columns["planner"].tolist()):
        reasons = Counter(columns["why_not"][(columns["planner"] == planner) & ~columns["found"]].tolist())
        if reasons:
            told = ", ".join(f"{reason} in {count}" for reason, count in sorted(reasons.items()))
            groups.setdefault(told, []).append(planner)
    return [f"Replans without a path of {', '.join(members)}: {told}." for told, members in groups.items()]


Columns = dict[str, NDArray[Any]]
FEWEST_REPEATS = 3


def repeats_for(source: ProblemSource, planners: int) -> int:
    """How often to ask everything, so that times have intervals.

    Of a single question the repeats alone distinguish planners.
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
) -> Columns:
    """Ask the planners of those names, the first of them the baseline, each by the rules it keeps of these.

    Returns the columns of replans.parquet, planner by planner at each question, and us_repeats (N, K), the microseconds
    of each time that a row's question was asked, of which column us has the median.

    repeats: how often, for the times; whatever else is answered is of the first time. Planners take turns: at every
    question, or where questions stand alone and planners hold a map's memory one after the other, in every pass.
    curvatures: of smoothed paths, which take longer than the plans; static sources have none.
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
            if turn == 0 and members[0] == names[0]:
                progress.advance()
    columns = {name: np.array([row[name] for row in rows]) for name in REPLANS.names}
    us_repeats = np.array([times or [math.nan] * repeats for times in us.values()])
    timed = np.isfinite(us_repeats).all(axis=1)
    columns["us"][timed] = np.median(us_repeats[timed], axis=1)
    return columns | {"us_repeats": us_repeats}


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
