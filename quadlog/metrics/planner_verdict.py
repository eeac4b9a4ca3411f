"""What a comparison of planners says, in words: one sentence of findings, and the notes that its figures need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadlog.metrics.intervals import FEWEST_IN_TIME, FEWEST_VALUES, RESAMPLES, SAFE_IN_TIME, block_length
from quadlog.metrics.planning import Comparison, PlannerRow

_SPENT = {"expanded": "expanded", "generated": "generated", "touched": "tested"}
_WHAT = {"expanded": "cells", "generated": "cells", "touched": "neighbours"}


def verdict(comparison: Comparison) -> str:
    """One sentence: who saved most cells against the baseline and at which price, and who was fastest."""
    if not comparison.paired_replans:
        return f"On {comparison.source} no replan was solved by {_all_of(comparison)}: nothing can be compared."
    clauses = [_cells_clause(comparison), _optimal_clause(comparison), _time_clause(comparison)]
    if len(comparison.rows) == 1:
        only = comparison.rows[0]
        clauses = [f"{only.planner} ran alone: there is nothing to compare it with", _time_of(only)]
    return f"On {_what_it_rests_on(comparison)} {'; '.join(filter(None, clauses))}."


def notes(comparison: Comparison) -> list[str]:
    """How many replans the figures are over, what the ratio counts and how its interval was found, what is left out."""
    asked = comparison.rows[0].replans
    solved = f"{_number(comparison.paired_replans)} of {_number(asked)} replans were solved by {_all_of(comparison)}"
    lines = [f"{solved}: ratio, excess cost, times, lengths and turns are over these, everything else is over all."]
    if comparison.baseline not in comparison.episode_ratios:
        return [*lines, f"{comparison.baseline} was not run: there is no ratio to it."]
    if comparison.paired_replans:
        lines.append(f"{_ratio_note(comparison)} {_interval_note(comparison)}")
    for planner, ratios in comparison.episode_ratios.items():
        without = int(np.isnan(ratios).sum())
        if without:
            lines.append(
                f"{planner} {_spent(comparison)} none in {_number(without)} of {_count(len(ratios), 'episode')}, "
                "which have no ratio and are left out of its median."
            )
    return lines


def _what_it_rests_on(comparison: Comparison) -> str:
    counts = (
        f"{_count(comparison.paired_episodes, 'episode')}, {_count(comparison.paired_replans, 'replan')} "
        f"solved by {_all_of(comparison)}"
    )
    return f"{comparison.source} ({counts})"


def _cells_clause(comparison: Comparison) -> str:
    rivals = [row for row in comparison.rows if row.planner != comparison.baseline and row.ratio_expanded is not None]
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
        f"{where} ({_interval_words(best)})" + (paths.pop() if len(paths) == 1 else "")
    )


def _optimal_clause(comparison: Comparison) -> str:
    """The best of those whose every path was optimal, unless it is the best of all anyhow."""
    rivals = [row for row in comparison.rows if row.planner != comparison.baseline and row.ratio_expanded is not None]
    known = [row for row in rivals if row.suboptimality_mean is not None]
    if not known or _ratio(_most_saved(rivals)[0]) <= 1 or not all(map(_is_excessive, _most_saved(rivals))):
        return ""
    optimal = [row for row in known if not _is_excessive(row) and _ratio(row) > 1]
    if not optimal:
        return "none saved any with optimal paths throughout"
    best = _most_saved(optimal)
    who = " and ".join(row.planner for row in best)
    return f"with optimal paths throughout, {who} saved most, {_times(_ratio(best[0]))} times ({_interval_words(best)})"


def _time_clause(comparison: Comparison) -> str:
    fastest = min(comparison.rows, key=lambda row: row.us_median or 0.0)
    base = next((row for row in comparison.rows if row.planner == comparison.baseline), None)
    if base is None or not base.us_median or fastest.us_median is None:
        return f"{fastest.planner} was fastest, {_time_of(fastest)}"
    if fastest.us_median == base.us_median:
        return f"none was faster than {base.planner}, {_time_of(base)}"
    share = _times(fastest.us_median / base.us_median)
    return f"{fastest.planner} was fastest, {_time_of(fastest)}, {share} times that of {base.planner}"


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
        f"consecutive replans of it ({RESAMPLES} resamples): it says nothing of other episodes{narrow}."
    )


def _interval_words(rows: Sequence[PlannerRow]) -> str:
    """The interval that holds those of all rows, and whether it shows a difference."""
    bounds = [(row.ratio_low, row.ratio_high) for row in rows]
    known = [(low, high) for low, high in bounds if low is not None and high is not None]
    if len(known) < len(bounds):
        return "too few for an interval"
    low, high = min(low for low, _ in known), max(high for _, high in known)
    words = f"95 %: {_times(low)} to {_times(high)}"
    if 1 < rows[0].episodes < FEWEST_VALUES:
        words = f"{_times(low)} to {_times(high)} in {rows[0].episodes} episodes, too few for 95 %"
    return f"{words}, no difference shown" if low <= 1 <= high else words


def _paths_clause(row: PlannerRow) -> str:
    if row.suboptimality_mean is None:
        return ""
    if not _is_excessive(row):
        return ", all its paths optimal"
    excess = f"{100 * row.suboptimality_mean:.1f} %" if row.suboptimality_mean >= 0.0005 else "less than 0.1 %"
    return f", its paths {excess} costlier than the optimum on average"


def _time_of(row: PlannerRow) -> str:
    return f"with a median of {_times(row.us_median or 0.0)} us per replan"


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
