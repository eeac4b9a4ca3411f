"""Several runs over each other: tracks and curves, what differs in their metrics and settings, what a sweep changed.

What is alike in all runs is drawn once, in grey, or left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.metrics.differences import PairedDifference
from quadlog.results.diff import unlike_settings
from quadlog.results.figures import FIGURES, merged_drawings
from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Sentence, Table, metric_cell
from quadlog.results.page.pack import Pack
from quadlog.results.page.verdict import status
from quadlog.results.record import SavedMetric
from quadlog.results.run import Run
from quadlog.results.studies.sweep import SweepSummary
from quadlog.results.text import NONE, State, interval_text, label_of, unit_of, value_text
from quadlog.results.view import Moment, Panel, Scene, Series, Spread, farthest_apart, forest

Paired = Mapping[str, Mapping[str, PairedDifference]]
"""By run: each metric less that of the first run, on the instants that both have."""


def side_by_side_page(
    runs: Mapping[str, Run], paired: Paired, differences: Sequence[Moment], notes: Sequence[str]
) -> blocks.Page:
    """The page of runs side by side: their metrics with differences to the first, paths, curves and settings.

    differences: instants at which results part. notes: why runs are not paired.
    """
    pack, first = Pack(), next(iter(runs))
    drawn = tracks_and_curves(runs, pack, differences)
    said = {name: (run.title, *status(run)) for name, run in runs.items()}
    statuses = [Sentence(name, f"{of}: {words}.", state) for name, (of, words, state) in said.items()]
    verdict = blocks.Verdict([*_better(first, paired), *statuses])
    sections = [
        blocks.Section("", [verdict, *([blocks.Notes("Not comparable", notes)] if notes else [])]),
        blocks.Section("Paths and curves", drawn, pack.thinned),
        blocks.Section("Metrics", [compared_metrics({name: run.metrics for name, run in runs.items()}, paired)]),
        blocks.Section("Settings that differ", settings_table(runs)),
    ]
    has_one_clock = not notes and len(paired) == len(runs) - 1
    facts = [f"{len(runs)} runs", "one clock" if has_one_clock else "each from its own start"]
    return blocks.Page(" and ".join(dict.fromkeys(run.title for run in runs.values())), sections, facts, pack=pack)


def tracks_and_curves(runs: Mapping[str, Run], pack: Pack, moments: Sequence[Moment]) -> list[Any]:
    """The tracks of the runs in one player, which starts where they are farthest apart, beside their curves."""
    drawn, charts = merged_drawings(dict(zip(short_names([*runs]), runs.values(), strict=True))), []
    scene = drawn.pop("trajectory", None)
    for figure in (figure for figure in FIGURES if figure.name in drawn):
        pack.add(figure.name, drawn[figure.name])
        charts.append(blocks.Drawn(figure.name, figure.title, figure.caption))
    if not isinstance(scene, Scene):
        return charts
    moments = [*filter(None, [farthest_apart(scene)]), *moments]
    pack.add("paths", replace(scene, moments=moments))
    start = moments[0].seconds if moments else None
    return [blocks.Drawn("paths", "paths", moments=moments, start=start, charts=charts)]


def short_names(names: Sequence[str]) -> Sequence[str]:
    """Names of runs in legends: of a sweep the values alone, and without a last part that all have."""
    if len(names) > 1 and all("/" in name for name in names) and len({name.rpartition("/")[2] for name in names}) == 1:
        names = [name.rpartition("/")[0] for name in names]
    short = [re.sub(r"[^,/=]+=", "", name) for name in names]
    return short if len(set(short)) == len(short) else names


def compared_metrics(runs: Mapping[str, Mapping[str, SavedMetric]], paired: Paired) -> Table:
    """A row for each metric that a run has, with differences to the first run, coloured where they are beyond chance.

    Of two runs they are a column, of more they stand below the values.
    """
    first, *others = runs
    rows, same = list[list[Cell]](), list[list[Cell]]()
    for metric in (metric for labels in THEMES.values() for metric in labels):
        found = {name: of[metric] for name, of in runs.items() if metric in of}
        values, cells = {name: of.value for name, of in found.items()}, [Cell(label_of(metric), below=metric)]
        ends = {"lower": min, "higher": max} if len({*values.values()}) > 1 else {}
        best = ends[better](values.values()) if (better := CATALOGUE[metric].better) in ends else None
        apart = [_difference(metric, _less(values, first, name, paired.get(name, {}).get(metric))) for name in others]
        for name, less in zip(runs, [Cell(""), *apart], strict=True):
            value = metric_cell(metric, found.get(name))._replace(best=best is not None and values.get(name) == best)
            if len(others) > 1 and less.value:
                lines = [value.below, f"{less.text} ({less.below})" if less.below else less.text]
                value = value._replace(below="\n".join(filter(None, lines)), state=less.state or value.state)
            cells.append(value)
        cells += apart[: len(others) == 1]
        alike = len(found) == len(runs) and len({of.value for of in found.values()}) == 1
        if found:
            (same if alike else rows).append(cells)
    where = "Below a value: its 95 % interval" + (f", its difference to {first}" if len(others) > 1 else "")
    note = f"{where}. Bold: the best value, be it by chance. Differences to {first} are of what both have, "
    note += "coloured where they are beyond chance (all differences together, Bonferroni)."
    columns = [Column("metric"), *(Column(name, True) for name in runs)]
    columns += [Column("difference", True)] if len(others) == 1 else []
    return Table(columns, [*rows, *same], "metrics-of-runs", note, folded=len(rows) if same and rows else None)


def _less(
    values: Mapping[str, float], first: str, name: str, paired: PairedDifference | None
) -> PairedDifference | None:
    """The paired difference, or without one that of the values, which has no interval."""
    if paired is not None or not {first, name} <= values.keys():
        return paired
    return PairedDifference(difference := values[name] - values[first], None, False, difference == 0)


def _difference(name: str, paired: PairedDifference | None) -> Cell:
    """The difference over its interval, with a bar from 0 in the middle, coloured where it is beyond chance."""
    if paired is None or paired.same:
        return Cell(NONE if paired is None else "the same")
    unit, better, (low, high) = CATALOGUE[name].unit, CATALOGUE[name].better, paired.interval or (0.0, 0.0)
    largest = max(abs(paired.difference), abs(low), abs(high)) or 1.0
    at, low, high = (round(50 + 50 * of / largest, 1) for of in (paired.difference, low, high))
    bar = None if paired.interval is None else (min(at, 50.0), max(at, 50.0), low, high)
    judged: State = "good" if (paired.difference > 0) == (better == "higher") else "bad"
    text = "+" * (paired.difference > 0) + value_text(name, paired.difference, unit, 2)
    below = interval_text(name, paired.interval, unit)
    return Cell(text, paired.difference, below, state=judged if paired.clear and better else "", bar=bar)


def _better(first: str, paired: Paired) -> list[Sentence]:
    """In what the other runs are better or worse than the first, beyond chance."""
    found, looks = list[Sentence](), dict[State, tuple[str, State]](good=("better", "good"), bad=("worse", "warn"))
    for name, of_run in paired.items():
        cells = {metric: _difference(metric, of) for metric, of in of_run.items()}
        for judged, (word, state) in looks.items():
            clear = [(metric, cell) for metric, cell in cells.items() if cell.state == judged]
            shown = [f"{label_of(metric)} ({cell.text} [{cell.below}])" for metric, cell in clear[:3]]
            more = f" and {len(clear) - 3} more" if len(clear) > 3 else ""
            if clear:
                found.append(Sentence(name, f"{word} than {first} beyond chance in {', '.join(shown)}{more}.", state))
    return found or [Sentence("Metrics", f"No difference to {first} is beyond chance.")] * bool(paired)


def settings_table(runs: Mapping[str, Run]) -> list[Table]:
    """Keys of configuration and options in which the runs differ, if there are any."""
    unlike = unlike_settings([run.record for run in runs.values()], NONE)
    rows = [[Cell(key, code=True), *(Cell(value[:80]) for value in of)] for key, of in unlike.items()]
    return [Table([Column("key"), *map(Column, runs)], rows, "settings")] if rows else []


DECADES = 30.0
"""A key whose values lie farther apart than this factor has a logarithmic axis."""


def sweep_blocks(summary: SweepSummary, paired: Paired, pack: Pack) -> list[Any]:
    """Each metric that varies over the swept key, as panels, and with its difference to the first value, as a table."""
    means, differences = dict[str, dict[str, SavedMetric]](), dict[str, dict[str, PairedDifference]]()
    names = short_names([setting.label for setting in summary.settings])
    for number, (label, setting) in enumerate(zip(names, summary.settings, strict=True)):
        over, above = ({name: of[name][number] for name in summary.varying} for of in (summary.over, summary.above))
        means[label] = {
            name: SavedMetric(of.mean, of.runs, CATALOGUE[name].unit, *(of.interval or (None, None)))
            for name, of in over.items() if of.runs
        }  # fmt: skip
        own = paired.get(setting.rows[0].run, {}) if summary.seeds == 1 else {}
        differences[label] = {
            name: own.get(name) or PairedDifference(of.mean, of.interval, False, of.mean == 0)
            for name, of in above.items() if of.runs
        }  # fmt: skip
    table = compared_metrics(means, differences)
    if panels := sweep_panels(summary):
        pack.add("swept", panels, "swept")
    drawn = [blocks.Drawn("swept", "Metrics over the values of the sweep")] if panels else []
    return [*drawn, table, *map(blocks.Text, summary.notes())]


def sweep_panels(summary: SweepSummary) -> list[Panel]:
    """A panel for each metric that varies: over the numbers of one key, else a row for each combination."""
    values = [next(iter(setting.values.values()), None) for setting in summary.settings]
    numeric = len(summary.keys) == 1 and all(isinstance(of, int | float) and not isinstance(of, bool) for of in values)
    panels = []
    for name in summary.varying:
        factor, unit = unit_of(name, CATALOGUE[name].unit)
        over, what = summary.over[name], f"{label_of(name)}{f' ({unit})' if unit else ''}"
        if not numeric:
            ends = (None if of.interval is None else (factor * of.interval[0], factor * of.interval[1]) for of in over)
            spreads = [Spread(factor * of.mean, end) for of, end in zip(over, ends, strict=True)]
            rows = {of.label: row for of, row in zip(summary.settings, spreads, strict=True) if np.isfinite(row.value)}
            panels.append(forest(what, rows, what))
            continue
        order = np.argsort(np.array(values, float), kind="stable")
        x, y = np.array(values, float)[order], factor * np.array([of.mean for of in over])[order]
        low, high = factor * np.array([of.interval or (np.nan, np.nan) for of in over]).T[:, order]
        series = [Series("mean" if summary.seeds > 1 else "value", "robot", x, y)]
        series += [Series("value", "robot", x, y, "points")] if summary.seeds == 1 else []
        if np.isfinite(low).any():
            series.append(Series("95 % interval", "robot", x, low, "band", upper=high))
        spans = x[0] > 0 and x[-1] > DECADES * x[0]
        panels.append(Panel(what, series, summary.keys[0], log_x=bool(spans)))
    return panels
