"""`quadlog compare-planners`: open the sources, run every planner on every problem, compare, write."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from quadlog.errors import ExitCode
from quadlog.metrics.comparison.planner_verdict import notes, verdict
from quadlog.metrics.planning import compare_planners
from quadlog.pipelines.comparison.problems import CompareOptions, counted
from quadlog.pipelines.comparison.run_planners import ask_everything, repeats_for, scenarios_of
from quadlog.pipelines.comparison.sources import open_sources
from quadlog.pipelines.executor.progress import Progress
from quadlog.planning.registry import make_planner, planner_plugin, planner_type
from quadlog.results.page.planners import MOST_DRAWN, ComparedSource, earlier_files, write_comparison
from quadlog.results.studies.planners import QuestionSample
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
    anything is asked; PluginUnusable also later.
    """
    names = options.names
    incremental = [name for name in names if planner_type(name).incremental]
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch, ExitStack() as stack:
        if folder is not None:
            earlier_files(folder, force)
            stack.enter_context(new_folder(folder))
        sources, losses = open_sources(arguments, options, Path(scratch), progress)
        outcome = CompareOutcome([], [], rule_lines(names, options), ExitCode.WITH_LOSS if losses else ExitCode.DONE)
        compared, drawn = [], min(len(sources), MOST_DRAWN) if folder is not None else 0
        for number, source in enumerate(sources):
            progress.begin("compare", source.count)
            step = "query" if source.is_static else "replan"
            sample = QuestionSample(step, source.row_zero_on_top, drawn) if number < drawn else None
            repeats = repeats_for(source, len(names))
            columns, us_repeats = ask_everything(source, names, options.rules, progress, repeats, sample=sample)
            table = columns | {"us_repeats": us_repeats}
            comparison = compare_planners(table, options.baseline, counted(options), incremental)
            outcome.rows.extend(map(asdict, comparison.rows))
            outcome.findings.append(verdict(comparison))
            outcome.about.extend([f"{source.name}: {source.about}.", *notes(comparison), *failures(columns)])
            if folder is not None:
                compared.append(ComparedSource(comparison, columns, scenarios_of(source, columns), sample))
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
