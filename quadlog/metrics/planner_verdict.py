"""What a comparison of planners says, in words: findings by subject, and the notes that its figures need."""

from __future__ import annotations

import numpy as np

from quadlog.metrics.intervals import Interval, corrected_confidence, fewest_values
from quadlog.metrics.planning import Comparison, PlannerRow

_SPENT = {"expanded": "expanded", "generated": "generated", "touched": "tested"}
_WHAT = {"expanded": "cells", "generated": "cells", "touched": "neighbours"}


def verdict(comparison: Comparison) -> str:
    """All findings as one sentence."""
    return f"On {comparison.source}: {'; '.join(clause for _, clause in _clauses(comparison))}."


def verdict_lines(comparison: Comparison) -> list[tuple[str, str]]:
    """The findings by subject: the subject, and a sentence."""
    names = tuple(row.planner for row in comparison.rows)
    # A planner's name that comes first keeps its small letter.
    clauses = [
        (subject, of if of.startswith(names) else of[0].upper() + of[1:]) for subject, of in _clauses(comparison)
    ]
    return [(subject, f"{clause}.") for subject, clause in clauses]


def _clauses(comparison: Comparison) -> list[tuple[str, str]]:
    rows, n = comparison.rows, comparison.paired_replans
    solvers = {1: "the only planner", 2: "both planners"}.get(len(rows), f"all {len(rows)} planners")
    if not n:
        return [("Verdict", f"no replan was solved by {solvers}: nothing can be compared")]
    episodes = _count(comparison.paired_episodes, "episode")
    rests_on = "Rests on", f"{episodes}, {_count(n, 'replan')} solved by {solvers}"
    if len(rows) == 1:
        alone = f"{rows[0].planner} ran alone: there is nothing to compare it with"
        return [("Cells", alone), ("Time", f"a median of {times(rows[0].us_median or 0)} µs per replan"), rests_on]
    return [("Cells", _cells_clause(comparison)), ("Time", _time_clause(comparison)), rests_on]


def _cells_clause(comparison: Comparison) -> str:
    """Who saved most against the baseline, and at which price in cost; of several the first named."""
    base, spent, what = comparison.baseline, _SPENT[comparison.counted], _WHAT[comparison.counted]
    rivals = [row for row in comparison.rows if row.planner != base and row.ratio_expanded is not None]
    if not rivals:
        return f"no planner has a ratio of {what} to {base}"
    best = max(rivals, key=_ratio)
    where = "" if comparison.paired_episodes == 1 else " in the median episode"
    if _ratio(best) <= 1:
        return f"no planner {spent} fewer {what} than {base}{where}"
    bounds = _bounds_of_best(comparison, best, len(rivals))
    clause = (
        f"{best.planner} saved most: {times(_ratio(best))} times fewer {what} {spent} than {base}{where} ({bounds})"
    )
    if best.suboptimality_mean is None:
        return clause
    if best.suboptimality_mean <= 0:
        return f"{clause}, all its paths optimal"
    clause += f", its paths {100 * best.suboptimality_mean:.2g} % costlier than the optimum on average"
    optimal = [row for row in rivals if row.suboptimality_mean is not None and row.suboptimality_mean <= 0]
    if not optimal or _ratio(best := max(optimal, key=_ratio)) <= 1:
        return f"{clause}; none saved any with optimal paths throughout"
    bounds = _bounds_of_best(comparison, best, len(optimal))
    return f"{clause}; with optimal paths throughout, {best.planner} saved most, {times(_ratio(best))} times ({bounds})"


def _bounds_of_best(comparison: Comparison, best: PlannerRow, choices: int) -> str:
    """The interval of the best of several, which allows for the choice."""
    ratio = comparison.cells.ratio(comparison.baseline, best.planner, corrected_confidence(choices))
    if ratio is None or ratio.interval is None:
        return "too few for an interval"
    choice = f", as the best of {choices}" if choices > 1 else ""
    return _bounds(ratio.interval) + choice + (", no difference shown" if ratio.interval[0] <= 1 else "")


def _time_clause(comparison: Comparison) -> str:
    """Who was fastest, if intervals that allow for the choice say so."""
    median = {row.planner: row.us_median or 0.0 for row in comparison.rows}
    fastest, slowest = min(median, key=median.__getitem__), max(median, key=median.__getitem__)
    if not comparison.us.beats_all(fastest):
        medians = f"medians of {times(median[fastest])} ({fastest}) to {times(median[slowest])} µs ({slowest})"
        return f"times do not show which planner is quickest, with {medians} per replan"
    return f"{fastest} was fastest, with a median of {times(median[fastest])} µs per replan"


def notes(comparison: Comparison) -> list[str]:
    """How many replans the figures are over, what the ratio counts and how its interval was found, what is left out."""
    paired, base = comparison.paired_replans, comparison.baseline
    of_all = f"{_number(paired)} of {_number(comparison.rows[0].replans)} replans were solved by all"
    lines = [f"{of_all}: ratio, excess cost, times, lengths and turns are over these, everything else is over all."]
    if base not in comparison.cells.of:
        return [*lines, f"{base} was not run: there is no ratio to it."]
    if not paired:
        return lines
    what, episodes = f"{_WHAT[comparison.counted]} {_SPENT[comparison.counted]}", comparison.paired_episodes
    if episodes > 1:
        few = f"; fewer than {fewest} have none" if episodes < (fewest := fewest_values(0.95)) else ""
        how = f"the median over {episodes} episodes, with the exact 95 % interval of a median{few}"
    else:
        how = "with a 95 % interval of replans that follow one another, which does not hold for other episodes"
    lines.append(f"The ratio is {what} by {base} / {what} by the planner: {how}.")
    repeats = next(iter(comparison.us.of.values()))
    if repeats.ndim == 2:
        known = [
            f"{row.planner} {times(ratio.value)} ({_bounds(ratio.interval)})"
            for row in comparison.rows
            if row.planner != base and (ratio := comparison.us.ratio(row.planner, base)) and ratio.interval
        ]
        asked = f"Every replan was timed {repeats.shape[1]} times, the planners in turns; its time is the median."
        lines.append(f"{asked} Times over those of {base}: {'; '.join(known)}." if known else asked)
    for planner, ratio in comparison.ratios.items():
        if without := int(np.isnan(ratio.of_episodes).sum()):
            lines.append(f"{planner} spent none in {_count(without, 'episode')}, left out of its median.")
    return lines


def _ratio(row: PlannerRow) -> float:
    return row.ratio_expanded or 0.0


def _bounds(interval: Interval) -> str:
    return f"95 %: {times(interval[0])} to {times(interval[1])}"


def _count(number: int, noun: str) -> str:
    return f"{_number(number)} {noun}" + ("" if number == 1 else "s")


def _number(number: float) -> str:
    return f"{number:,.0f}".replace(",", " ")


def times(value: float) -> str:
    """Three significant digits, more where they would say 1 of what is not; never an exponent for what is large."""
    if value >= 1000:
        return _number(value)
    texts = (f"{value:#.{digits}g}".rstrip(".") for digits in range(3, 17))
    return next((text for text in texts if value == 1 or float(text) != 1), "1.00")
