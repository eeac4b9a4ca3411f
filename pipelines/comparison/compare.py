"""`quadlog compare-planners`: open the sources, run every planner on every problem, compare, write."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import ExitCode
from quadlog.metrics.comparison.planner_verdict import notes, verdict
from quadlog.metrics.planning import Comparison, compare_planners
from quadlog.pipelines.comparison.problems import CompareOptions, ProblemSource, counted
from quadlog.pipelines.comparison.run_planners import Answers, ask_everything, repeats_for
from quadlog.pipelines.comparison.sources import open_sources
from quadlog.pipelines.executor.progress import Progress
from quadlog.planning.registry import make_planner, planner_plugin, planner_type
from quadlog.results.page.planners import MOST_DRAWN
from quadlog.results.planner_comparison.folder import ComparisonFiles
from quadlog.results.planner_comparison.shown_questions import QuestionSample


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
    anything is asked; PluginUnusable also later.
    """
    names = options.names
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch, ExitStack() as stack:
        files = None
        if folder is not None:
            files = stack.enter_context(ComparisonFiles(folder, force, has_queries=options.scen is not None))
        sources, losses = open_sources(arguments, options, Path(scratch), progress)
        outcome = CompareOutcome([], [], [*rule_lines(names, options)], ExitCode.WITH_LOSS if losses else ExitCode.DONE)
        kept = min(len(sources), MOST_DRAWN) if files is not None else 0
        for source, comparison, answers in _compared(sources, names, options, progress, kept):
            outcome.rows.extend(_plain(comparison))
            outcome.findings.append(verdict(comparison))
            outcome.about.extend([f"{source.name}: {source.about}.", *notes(comparison), *failures(answers.columns)])
            if files is not None:
                files.add(comparison, answers.columns, answers.scenarios, answers.sample)
        if files is not None:
            files.finish(outcome.rows, outcome.about, losses)
    return outcome


def _compared(
    sources: Sequence[ProblemSource], names: Sequence[str], options: CompareOptions, progress: Progress, kept: int
) -> Iterator[tuple[ProblemSource, Comparison, Answers]]:
    """kept: of how many sources questions are kept for the page, the first ones."""
    incremental = [name for name in names if planner_type(name).incremental]
    for number, source in enumerate(sources):
        progress.begin("compare", source.count)
        step = "query" if source.is_static else "replan"
        sample = QuestionSample(step, source.row_zero_on_top, kept) if number < kept else None
        repeats = repeats_for(source, len(names))
        answers = ask_everything(source, names, options.rules, progress, repeats, sample=sample)
        rng = np.random.default_rng([options.seed, number, *b"intervals"])
        table = answers.columns | {"us_repeats": answers.us_repeats}
        yield source, compare_planners(table, rng, options.baseline, counted(options), incremental), answers


def rule_lines(names: Sequence[str], options: CompareOptions) -> list[str]:
    """What every planner goes by: one line for all that is alike, one for each group that differs."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(str(make_planner(name, options.rules).rules), []).append(name)
    lines = [f"Rules of {', '.join(members)}: {rules}." for rules, members in groups.items()]
    plugins = [each for name in names if (each := planner_plugin(name)) is not None]
    lines += [f"Planner {each.name} is of {each.distribution} {each.version}." for each in plugins]
    return [f"Preset {options.preset}, counting {counted(options)} cells, seed {options.seed}.", *lines]


def failures(columns: Mapping[str, NDArray[Any]]) -> list[str]:
    """Why there were replans without a path, from columns of replans.parquet; alike planners share a line."""
    groups: dict[str, list[str]] = {}
    for planner in dict.fromkeys(columns["planner"].tolist()):
        reasons = Counter(columns["why_not"][(columns["planner"] == planner) & ~columns["found"]].tolist())
        if reasons:
            told = ", ".join(f"{reason} in {count}" for reason, count in sorted(reasons.items()))
            groups.setdefault(told, []).append(planner)
    return [f"Replans without a path of {', '.join(members)}: {told}." for told, members in groups.items()]


def _plain(comparison: Comparison) -> list[dict[str, Any]]:
    return [asdict(row) for row in comparison.rows]
