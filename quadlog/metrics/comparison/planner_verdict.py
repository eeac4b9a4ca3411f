"""What a comparison of planners says, in words: one sentence of findings, and the notes that its figures need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadlog.metrics.comparison.planner_lead import lead_of
from quadlog.metrics.intervals import FEWEST_IN_TIME, FEWEST_VALUES, RESAMPLES, SAFE_IN_TIME, block_length
from quadlog.metrics.planning import Comparison, PlannerRow

_SPENT = {"expanded": "expanded", "generated": "generated", "touched": "tested"}
_WHAT = {"expanded": "cells", "generated": "cells", "touched": "neighbours"}


def verdict(comparison: Comparison) -> str:
    """One sentence: who saved most cells against the baseline and at which price, and who was fastest.

    Whom it calls best is the best by an interval that allows for the choice among several, or it says that none is.
    """
    if not comparison.paired_replans:
        return f"On {comparison.source} no replan was solved by {_all_of(comparison)}: nothing can be compared."
    clauses = [clause for _, clause in _clauses(comparison)]
    return f"On {comparison.source} ({_counts(comparison)}) {'; '.join(clauses)}."


def verdict_lines(comparison: Comparison) -> list[tuple[str, str]]:
    """The same by subject: what it is about, and a sentence."""
    if not comparison.paired_replans:
        return [("Verdict", f"No replan was solved by {_all_of(comparison)}: nothing can be compared.")]
    lines: dict[str, list[str]] = {}
    for subject, clause in _clauses(comparison):
        lines.setdefault(subject, []).append(clause)
    names = tuple(row.planner for row in comparison.rows)
    sentences = [(subject, _sentence("; ".join(clauses), names)) for subject, clauses in lines.items()]
    return [*sentences, ("Rests on", f"{_counts(comparison)}.")]


def _clauses(comparison: Comparison) -> list[tuple[str, str]]:
    """Subject and clause, in order."""
    if len(comparison.rows) == 1:
        only = comparison.rows[0]
        return [
            ("Cells", f"{only.planner} ran alone: there is nothing to compare it with"),
            ("Time", _time_of(only)),
        ]
    of = (("Cells", _cells_clause), ("Cells", _optimal_clause), ("Time", _time_clause))
    clauses = ((subject, clause(comparison)) for subject, clause in of)
    return [(subject, clause) for subject, clause in clauses if clause]


def _sentence(clause: str, names: tuple[str, ...]) -> str:
    """With a capital letter, unless a planner's name comes first, which has none."""
    first = clause if clause.startswith(names) else clause[0].upper() + clause[1:]
    return f"{first}."


def notes(comparison: Comparison) -> list[str]:
    """How many replans the figures are over, what the ratio counts and how its interval was found, what is left out."""
    asked = comparison.rows[0].replans
    solved = f"{_number(comparison.paired_replans)} of {_number(asked)} replans were solved by {_all_of(comparison)}"
    lines = [f"{solved}: ratio, excess cost, times, lengths and turns are over these, everything else is over all."]
    if comparison.baseline not in comparison.episode_ratios:
        return [*lines, f"{comparison.baseline} was not run: there is no ratio to it."]
    if comparison.paired_replans:
        lines.append(f"{_ratio_note(comparison)} {_interval_note(comparison)}")
        if next(iter(comparison.us.of.values())).ndim == 2:
            lines.append(_time_note(comparison))
    for planner, ratios in comparison.episode_ratios.items():
        without = int(np.isnan(ratios).sum())
        if without:
            lines.append(
                f"{planner} {_spent(comparison)} none in {_number(without)} of {_count(len(ratios), 'episode')}, "
                "which have no ratio and are left out of its median."
            )
    return lines


def _counts(comparison: Comparison) -> str:
    """What the verdict rests on."""
    return (
        f"{_count(comparison.paired_episodes, 'episode')}, {_count(comparison.paired_replans, 'replan')} "
        f"solved by {_all_of(comparison)}"
    )


def _cells_clause(comparison: Comparison) -> str:
    rivals = _rivals(comparison)
    base = comparison.baseline
    if not rivals:
        return f"no planner has a ratio of cells to {base}"
    where = _median_episode(comparison)
    best = _most_saved(rivals)
    if _ratio(best[0]) <= 1:
        return f"no planner {_spent(comparison)} fewer {_what(comparison)} than {base}{where}"
    who = " and ".join(row.planner for row in best)
    paths = {_paths_clause(row) for row in best}
    return (
        f"{who} saved most: {_times(_ratio(best[0]))} times fewer {_what(comparison)} {_spent(comparison)} than {base}"
        f"{where} ({_lead_words(comparison, best, rivals)})" + (paths.pop() if len(paths) == 1 else "")
    )


def _optimal_clause(comparison: Comparison) -> str:
    """The best of those whose every path was optimal, unless it is the best of all anyhow."""
    rivals = _rivals(comparison)
    known = [row for row in rivals if row.suboptimality_mean is not None]
    if not known or _ratio(_most_saved(rivals)[0]) <= 1 or not all(map(_is_excessive, _most_saved(rivals))):
        return ""
    optimal = [row for row in known if not _is_excessive(row) and _ratio(row) > 1]
    if not optimal:
        return "none saved any with optimal paths throughout"
    best = _most_saved(optimal)
    who = " and ".join(row.planner for row in best)
    words = _lead_words(comparison, best, [row for row in known if not _is_excessive(row)])
    return f"with optimal paths throughout, {who} saved most, {_times(_ratio(best[0]))} times ({words})"


def _rivals(comparison: Comparison) -> list[PlannerRow]:
    return [row for row in comparison.rows if row.planner != comparison.baseline and row.ratio_expanded is not None]


def _time_clause(comparison: Comparison) -> str:
    """Who was fastest, if an interval says so that allows for the choice."""
    names = [row.planner for row in comparison.rows]
    median = {row.planner: row.us_median or 0.0 for row in comparison.rows}
    fastest = min(names, key=median.__getitem__)
    baseline = comparison.baseline if comparison.baseline in names else names[0]
    lead = lead_of(comparison.us, fastest, [name for name in names if name != fastest], baseline)
    if lead is None or len(lead.unbeaten) == lead.choices - 1:
        slowest = max(names, key=median.__getitem__)
        medians = f"medians of {_times(median[fastest])} ({fastest}) to {_times(median[slowest])} µs ({slowest})"
        return f"times do not show which planner is quickest, with {medians} per replan"
    who = " and ".join([fastest, *lead.unbeaten])
    told = (
        f"{who} were fastest, with no significant difference, {fastest}" if lead.unbeaten else f"{fastest} was fastest,"
    )
    words = f"{told} with a median of {_times(median[fastest])} µs per replan{_interval_of(comparison, fastest)}"
    if fastest == baseline or lead.low is None or lead.high is None:
        return words
    bounds = f"{_bounds(1 / lead.high, 1 / lead.low)}, as the best of {lead.choices}"
    return f"{words}, {_times(1 / lead.gain)} times that of {baseline} ({bounds})"


def _time_note(comparison: Comparison) -> str:
    """How times were taken, and the interval of each."""
    repeats = next(iter(comparison.us.of.values())).shape[1]
    bounds = [f"{row.planner}{_interval_of(comparison, row.planner)}" for row in comparison.rows]
    known = f" Of their medians: {'; '.join(bounds)}." if all(each.endswith(")") for each in bounds) else ""
    return f"Every replan was timed {repeats} times, the planners in turns; its time is the median.{known}"


def _interval_of(comparison: Comparison, planner: str) -> str:
    interval = comparison.us.median_interval(planner)
    return "" if interval is None else f" ({_bounds(*interval)})"


def _ratio_note(comparison: Comparison) -> str:
    what, spent = _what(comparison), _spent(comparison)
    over = "" if comparison.paired_episodes == 1 else ", the median over episodes"
    return f"The ratio is {what} {spent} by {comparison.baseline} / {what} {spent} by the planner{over}."


def _interval_note(comparison: Comparison) -> str:
    episodes, replans = comparison.paired_episodes, comparison.paired_replans
    if episodes > 1:
        few = f"; fewer than {FEWEST_VALUES} episodes are too few for 95 %" if episodes < FEWEST_VALUES else ""
        return f"Its interval is a 95 % bootstrap over {episodes} episodes ({RESAMPLES} resamples){few}."
    if replans < FEWEST_IN_TIME:
        return f"One episode of fewer than {FEWEST_IN_TIME} such replans has no interval."
    narrow = f", and is too narrow with fewer than {SAFE_IN_TIME} replans" if replans < SAFE_IN_TIME else ""
    return (
        f"There is one episode only, so its interval is a 95 % bootstrap over blocks of {block_length(replans)} "
        f"consecutive replans of it ({RESAMPLES} resamples): it does not hold for other episodes{narrow}."
    )


def _lead_words(comparison: Comparison, best: Sequence[PlannerRow], rivals: Sequence[PlannerRow]) -> str:
    """The interval of the best of several, which allows for the choice, and whom it is not shown to beat."""
    names = [row.planner for row in best]
    others = [row.planner for row in rivals if row.planner not in names]
    leads = [lead_of(comparison.cells, name, others, comparison.baseline) for name in names]
    known = [(each.low, each.high) for each in leads if each is not None and each.low is not None]
    unbeaten = sorted({name for each in leads if each is not None for name in each.unbeaten})
    if len(known) < len(best):
        return _few_words(comparison, best)
    low, high = min(low for low, _ in known), max(high for _, high in known if high is not None)
    words = f"{_bounds(low, high)}" + (f", as the best of {len(rivals)}" if len(rivals) > 1 else "")
    words = f"{words}, no difference shown" if low <= 1 <= high else words
    return f"{words}; no significant difference from {' and '.join(unbeaten)}" if unbeaten else words


def _few_words(comparison: Comparison, rows: Sequence[PlannerRow]) -> str:
    """Where the episodes are too few for an interval that allows for the choice: where they all lie."""
    bounds = [(row.ratio_low, row.ratio_high) for row in rows]
    known = [(low, high) for low, high in bounds if low is not None and high is not None]
    if len(known) < len(bounds) or comparison.paired_episodes == 1:
        return "too few for an interval"
    low, high = min(low for low, _ in known), max(high for _, high in known)
    few = "for 95 %" if rows[0].episodes < FEWEST_VALUES else "to choose the best"
    words = f"{_times(low)} to {_times(high)} in {rows[0].episodes} episodes, too few {few}"
    return f"{words}, no difference shown" if low <= 1 <= high else words


def _bounds(low: float | None, high: float | None) -> str:
    assert low is not None
    assert high is not None
    return f"95 %: {_times(low)} to {_times(high)}"


def _paths_clause(row: PlannerRow) -> str:
    if row.suboptimality_mean is None:
        return ""
    if not _is_excessive(row):
        return ", all its paths optimal"
    excess = f"{100 * row.suboptimality_mean:.1f} %" if row.suboptimality_mean >= 0.0005 else "less than 0.1 %"
    return f", its paths {excess} costlier than the optimum on average"


def _time_of(row: PlannerRow) -> str:
    return f"with a median of {_times(row.us_median or 0.0)} µs per replan"


def _is_excessive(row: PlannerRow) -> bool:
    return row.suboptimality_mean is None or row.suboptimality_mean > 0


def _most_saved(rows: Sequence[PlannerRow]) -> list[PlannerRow]:
    """The row of the largest ratio; several where it is the same."""
    most = max(map(_ratio, rows))
    return [row for row in rows if _ratio(row) == most]


def _ratio(row: PlannerRow) -> float:
    assert row.ratio_expanded is not None, row.planner
    return row.ratio_expanded


def _median_episode(comparison: Comparison) -> str:
    return "" if comparison.paired_episodes == 1 else " in the median episode"


def _spent(comparison: Comparison) -> str:
    return _SPENT[comparison.counted]


def _what(comparison: Comparison) -> str:
    return _WHAT[comparison.counted]


def _all_of(comparison: Comparison) -> str:
    planners = len(comparison.rows)
    return {1: "the only planner", 2: "both planners"}.get(planners, f"all {planners} planners")


def _count(number: int, noun: str) -> str:
    return f"{_number(number)} {noun}" + ("" if number == 1 else "s")


def _number(number: float) -> str:
    return f"{number:,.0f}".replace(",", " ")


def _times(value: float) -> str:
    """Three significant digits, more where they would say 1 of what is not; never an exponent for what is large."""
    if value >= 1000:
        return _number(value)
    texts = (f"{value:#.{digits}g}".rstrip(".") for digits in range(3, 17))
    return next((text for text in texts if value == 1 or float(text) != 1), "1.00")
