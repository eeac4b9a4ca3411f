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
from quadlog.planning.path import turning
from quadlog.planning.protocol import Bool, Cell, Plan, is_usable
from quadlog.planning.query import NoQuery
from quadlog.planning.registry import make_planner, planner_plugin, planner_type
from quadlog.planning.replan import Panel
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
    source: ProblemSource, names: Sequence[str], rules: Rules, progress: Progress, repeats: int = 1
) -> Columns:
    """Ask the planners of those names, the first of them the baseline, each by the rules it keeps of these.

    Returns the columns of replans.parquet, planner by planner at each question, and us_repeats (N, K), the microseconds
    of each time that a row's question was asked, of which column us has the median.

    repeats: how often, for the times; whatever else is answered is of the first time. Planners take turns: at every
    question, or where questions stand alone and planners hold a map's memory one after the other, in every pass.
    """
    rows: list[dict[str, Any]] = []
    us: dict[tuple[str, int], list[float]] = {}
    passes, rounds = (repeats, 1) if source.is_static else (1, repeats)
    for turn, members in itertools.product(range(passes), [[name] for name in names] if source.is_static else [names]):
        panel = Panel([[make_planner(name, rules) for name in members] for _ in range(rounds)])
        numbers = itertools.count()
        for episode, questions in enumerate(source.episodes()):
            panel.begin_episode()
            for replan, question in enumerate(questions):
                number, (optimum, plans, times_us) = next(numbers), panel.ask(question.query)
                for name, plan, taken_us in zip(members, plans, times_us.tolist(), strict=True):
                    us.setdefault((name, number), []).extend(taken_us)
                    if turn == 0:
                        at = {"source": source.name, "episode": episode, "replan": replan, "planner": name}
                        rows.append(at | _row(question, plan, optimum))
            if turn == 0 and members[0] == names[0]:
                progress.advance()
    us_repeats = np.array(list(us.values())).reshape(len(rows), -1)
    columns = {name: np.array([row[name] for row in rows]) for name in REPLANS.names if name != "us"}
    return columns | {"us": np.median(us_repeats, axis=1), "us_repeats": us_repeats}


def _row(question: Question, plan: Plan, optimum: Plan) -> dict[str, Any]:
    """Columns of replans.parquet; why_not is empty when a path was found, "missed" when only others found one.

    length_m and turn_rad: of the path on the grid; turn_rad is the sum of its changes of heading, left or right alike.
    """
    query, ends, is_projected = question.query, np.zeros((2, 2), int), False
    why_not, length_m, turn_rad = "", math.nan, math.nan
    if isinstance(query, NoQuery):
        why_not = query.why
    else:
        ends = np.add([query.start, query.goal], [query.window.col0, query.window.row0])
        is_projected = query.goal_projected
        if plan.found:
            length_m, turn_rad = turning(plan.cells * query.window.cell_m)
        else:
            why_not = "missed" if optimum.found else _why_no_path(query.blocked, query.start, query.goal)
    counts = ("found", "expanded", "generated", "touched", "from_scratch", "reused_cells")
    return {
        "t_ns": question.t_ns,
        "why_not": why_not,
        **{name: getattr(plan, name) for name in counts},
        "cost": plan.cost if plan.found else math.nan,
        "optimal_cost": optimum.cost if optimum.found else math.nan,
        **dict(zip(("start_col", "start_row", "goal_col", "goal_row"), ends.ravel().tolist(), strict=True)),
        "goal_projected": is_projected,
        "length_m": length_m,
        "turn_rad": turn_rad,
    }


def _why_no_path(blocked: Bool, start: Cell, goal: Cell) -> str:
    """In two words, for a query that has no answer."""
    for name, (col, row) in (("start", start), ("goal", goal)):
        if not (0 <= row < blocked.shape[0] and 0 <= col < blocked.shape[1]):
            return f"{name} outside"
        if not is_usable(blocked, (col, row)):
            return f"{name} blocked"
    return "unreachable"


def scenarios_of(source: ProblemSource, columns: Columns) -> Columns | None:
    """The columns of scenarios.parquet: those of a query and its answers; None without a .scen file."""
    if not source.queries:
        return None
    listed = np.array([query.listed_cost for query in source.queries])[columns["episode"]]
    alike = ("planner", "start_col", "start_row", "goal_col", "goal_row", "expanded", "us", "found")
    named = {"map": columns["source"], "listed_cost": listed, "cost": columns["length_m"]}
    return named | {name: columns[name] for name in alike}
