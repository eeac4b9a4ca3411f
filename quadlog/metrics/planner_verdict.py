"""What a comparison of planners says, in words: findings by subject, and the notes that its figures need."""

from __future__ import annotations

import numpy as np

from quadlog.metrics.intervals import corrected_confidence, fewest_values
from quadlog.metrics.planning import Comparison

_SPENT = {"expanded": "cells expanded", "generated": "cells generated", "touched": "neighbours tested"}


def verdict(comparison: Comparison) -> str:
    """All findings in one line."""
    return f"On {comparison.source}: {' '.join(sentence for _, sentence in verdict_lines(comparison))}"


def verdict_lines(comparison: Comparison) -> list[tuple[str, str]]:
    """The findings by subject: the subject, and a sentence."""
    rows, replans = comparison.rows, len(comparison.episodes)
    solvers = {1: "the only planner", 2: "both planners"}.get(len(rows), f"all {len(rows)} planners")
    if not replans:
        return [("Verdict", f"No replan was solved by {solvers}: nothing can be compared.")]
    episodes = _count(len(np.unique(comparison.episodes)), "episode")
    rests_on = "Rests on", f"{episodes}, {_count(replans, 'replan')} solved by {solvers}."
    if len(rows) == 1:
        time = f"A median of {times(rows[0]['us_median'])} µs per replan."
        return [("Cells", "A planner alone: there is nothing to compare it with."), ("Time", time), rests_on]
    return [("Cells", _cells(comparison)), ("Time", _time(comparison)), rests_on]


def _cells(comparison: Comparison) -> str:
    """Who saved most against the baseline, with an interval that allows for the choice, and at which price in cost."""
    base, what = comparison.baseline, _SPENT[comparison.counted]
    rivals = {name: ratio.value for name, ratio in comparison.ratios.items() if name != base}
    if not rivals:
        return f"No planner has a ratio of {what} to {base}."
    best = max(rivals, key=rivals.__getitem__)
    where = "" if comparison.episodes[0] == comparison.episodes[-1] else " in the median episode"
    if rivals[best] <= 1:
        return f"No planner has fewer {what} than {base}{where}."
    ratio = comparison.ratio(comparison.counted, base, best, corrected_confidence(len(rivals)))
    bounds = "too few for an interval"
    if ratio is not None and ratio.interval is not None:
        bounds = "95 %: " + " to ".join(map(times, ratio.interval))
        bounds += f", as the best of {len(rivals)}" if len(rivals) > 1 else ""
        bounds += ", no difference shown" if ratio.interval[0] <= 1 else ""
    excess = next(row["suboptimality_mean"] for row in comparison.rows if row["planner"] == best)
    cost = "" if excess is None else ", all its paths optimal"
    cost = f", its paths {100 * excess:.2g} % costlier than the optimum on average" if excess else cost
    return f"{best} saved most: {times(rivals[best])} times fewer {what} than {base}{where} ({bounds}){cost}."


def _time(comparison: Comparison) -> str:
    """Who was fastest, if intervals that allow for the choice say so."""
    medians = {row["planner"]: row["us_median"] for row in comparison.rows}
    fastest, *others = sorted(medians, key=medians.__getitem__)
    confidence = corrected_confidence(len(others))
    timed = "us_repeats" if "us_repeats" in comparison.paired[fastest] else "us"
    ratios = [comparison.ratio(timed, name, fastest, confidence) for name in others]
    if all(each is not None and each.interval is not None and each.interval[0] > 1 for each in ratios):
        return f"{fastest} was fastest, with a median of {times(medians[fastest])} µs per replan."
    spread = " to ".join(f"{times(medians[name])} ({name})" for name in (fastest, others[-1]))
    return f"Times do not show which planner is quickest, with medians of {spread} µs per replan."


def notes(comparison: Comparison) -> list[str]:
    """How many replans the figures are over, what the ratio counts and how its interval was found."""
    base, paired, episodes = comparison.baseline, len(comparison.episodes), len(np.unique(comparison.episodes))
    of_all = f"{_number(paired)} of {_number(comparison.rows[0]['replans'])} replans were solved by all"
    lines = [f"{of_all}: ratio, excess cost, times, lengths and turns are over these, everything else is over all."]
    if base not in comparison.paired:
        return [*lines, f"{base} was not run: there is no ratio to it."]
    if not paired:
        return lines
    how = "with a 95 % interval of replans that follow one another, which does not hold for other episodes"
    if episodes > 1:
        few = f"; fewer than {fewest} have none" if episodes < (fewest := fewest_values(0.95)) else ""
        how = f"the median over {episodes} episodes, with the exact 95 % interval of a median{few}"
    what = _SPENT[comparison.counted]
    lines.append(f"The ratio is {what} by {base} / {what} by the planner: {how}.")
    if (repeats := comparison.paired[base].get("us_repeats")) is not None:
        lines.append(f"Every replan was timed {repeats.shape[1]} times, the planners in turns; its time is the median.")
    return lines


def _count(number: int, noun: str) -> str:
    return f"{_number(number)} {noun}" + ("" if number == 1 else "s")


def _number(number: float) -> str:
    return f"{number:,.0f}".replace(",", " ")


def times(value: float) -> str:
    """Three significant digits; never an exponent for what is large."""
    return _number(value) if value >= 1000 else f"{value:#.3g}".rstrip(".")
