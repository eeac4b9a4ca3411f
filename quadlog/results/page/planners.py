"""The folder of a comparison of planners, and its page: what came out, ratios, paths question by question, a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import CannotWrite, printable
from quadlog.metrics.intervals import Interval
from quadlog.metrics.planner_verdict import verdict_lines
from quadlog.metrics.planning import Comparison, PlannerRow
from quadlog.results.arrays import MapSequence
from quadlog.results.find_runs import refuse_existing
from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Sentence, Table
from quadlog.results.page.pack import Pack
from quadlog.results.studies.planners import PLANNERS, REPLANS, SCENARIOS, QuestionSample, format_rows
from quadlog.results.tables import write_table
from quadlog.results.text import State, count, ends_text, percent, sig
from quadlog.results.view import Layer, Lines, Panel, Scene, Series, Spread, Track, Windows, extent_of, forest, look
from quadlog.storage.atomic_write import uninterrupted, write_whole

if TYPE_CHECKING:
    from pandas import DataFrame

MOST_DRAWN = 8
"""Sources with paths and charts, the first ones; the others have their verdict and their table."""
LOG_FROM = 20
"""Values of a larger ratio than this get a logarithmic axis."""
Columns = Mapping[str, NDArray[Any]]
PAGE = "report.html"
TEXTS = {"planners.csv": "csv", "planners.json": "json", "planners.tex": "latex"}
TABLES = ("planners.parquet", "replans.parquet", "scenarios.parquet")


class ComparedSource(NamedTuple):
    """A source's comparison, its columns of replans.parquet and scenarios.parquet, and the questions to show."""

    comparison: Comparison
    replans: Columns
    scenarios: Columns | None = None
    sample: QuestionSample | None = None


def earlier_files(folder: Path, force: bool) -> list[Path]:
    """The files of an earlier comparison, report.html first. Raises AlreadyExists unless `force`, CannotWrite."""
    named = (folder / name for name in (PAGE, *TEXTS, *TABLES))
    found = [*(path for path in named if path.exists()), *sorted((folder / "plots").glob("source-[0-9]*-*.png"))]
    for path in found:
        refuse_existing(path, force)
    return found


def write_comparison(
    folder: Path,
    sources: Sequence[ComparedSource],
    rows: Sequence[Mapping[str, Any]],
    about: Sequence[str],
    losses: Sequence[str] = (),
) -> None:
    """All files in place of an earlier comparison's, report.html last; signals are delayed until then.

    planners and replans as Parquet, scenarios.parquet with a .scen file, planners.csv, .json and .tex,
    plots/source-N-ratios.png, report.html. rows: of planners.parquet; about, losses: as of planners_page.
    Raises CannotWrite.
    """
    from quadlog.results import mpl  # slow to import, and not needed where nothing is written

    panels = [ratio_panel(source.comparison) for source in sources]
    files = {f"plots/source-{n}-ratios.png": mpl.render([panel]) for n, panel in enumerate(panels, 1) if panel}
    files |= {name: format_rows(rows, to, about).encode() for name, to in TEXTS.items()}
    files[PAGE] = blocks.render(planners_page(sources, about, losses))
    scenarios = [source.scenarios for source in sources if source.scenarios is not None]
    with uninterrupted():
        try:
            (folder / "plots").mkdir(exist_ok=True)
            for path in earlier_files(folder, force=True):
                path.unlink()
        except OSError as error:
            raise CannotWrite(folder, error.strerror or str(error)) from error
        write_table(folder / TABLES[0], PLANNERS, {name: [row[name] for row in rows] for name in PLANNERS.names})
        write_table(folder / TABLES[1], REPLANS, _joined([source.replans for source in sources]))
        if scenarios:
            write_table(folder / TABLES[2], SCENARIOS, _joined(scenarios))
        for name, content in files.items():
            write_whole(folder / name, content)


def _joined(parts: Sequence[Columns]) -> dict[str, NDArray[Any]]:
    return {name: np.concatenate([columns[name] for columns in parts]) for name in parts[0]}


def planners_page(sources: Sequence[ComparedSource], about: Sequence[str], losses: Sequence[str] = ()) -> blocks.Page:
    """The page. about: how to read it; losses: what of recordings was lost."""
    pack, names = Pack(), [printable(source.comparison.source) for source in sources]
    more = f" and {count(len(names) - 3)} more" if len(names) > 3 else ""
    sections, lines = [], []
    for number, (name, source) in enumerate(zip(names, sources, strict=True)):
        own = _verdict(source.comparison)
        sections.append(blocks.Section(name, [blocks.Verdict(own[1:]), *_drawn(source, number, pack)]))
        lines.append(Sentence(name, own[0].text, own[0].state))
    if len(sources) == 1:
        lines = _verdict(sources[0].comparison)
    first: list[Any] = [blocks.Verdict(lines)]
    if losses:
        first.append(blocks.Notes("Lost from the recordings (exit code 3)", list(map(printable, losses)), "bad"))
    if len(sources) == 1:
        first += sections.pop().blocks[1:]
    notes = [blocks.Details("Rules, counts and intervals", [blocks.Text(printable(line)) for line in about])]
    facts = [f"{len(sources[0].comparison.rows)} planners", "the same problems for all"]
    files = [(name, f"./{name}") for name in ("planners.csv", "planners.parquet", "replans.parquet")]
    sections = [blocks.Section("", first), *sections, blocks.Section("How to read this", notes, pack.thinned)]
    return blocks.Page(f"Planners on {', '.join(names[:3])}{more}", sections, facts, links=files, pack=pack)


def _verdict(comparison: Comparison) -> list[Sentence]:
    """Up to four sentences: cells, cells with optimal paths, time, and what they rest on."""
    states: dict[str, State] = {"Cells": "good"} if "good" in _judged(comparison).values() else {}
    return [Sentence(subject, text, states.get(subject, "")) for subject, text in verdict_lines(comparison)]


def _drawn(source: ComparedSource, number: int, pack: Pack) -> list[Any]:
    """The map beside the ratios and the charts of each question, on one clock of the source's own; the table."""
    group, sample, comparison = f"source-{number}", source.sample, source.comparison
    charts, view = [], list[Any]()
    if number < MOST_DRAWN and (panel := ratio_panel(comparison)) is not None:
        pack.add(f"ratios-{number}", [panel], group)
        charts.append(blocks.Drawn(f"ratios-{number}", "Ratios", RATIO_CAPTION))
    if sample is not None and sample.kept:
        names = [row.planner for row in comparison.rows]
        pack.add(f"paths-{number}", question_scene(sample, names), group)
        answers = _answers(source.replans, sample, comparison.counted)
        caption = f"Every {sample.step} in the order of asking."
        if sample.stride > 1:
            caption = f"Every {sample.stride}th {sample.step} of {count(sample.asked)}; replans.parquet has all."
        if len(sample.kept) > 1:
            panels = [question_panel(what, of, sample.step, zero="%" in what) for what, of in answers.items()]
            pack.add(f"answers-{number}", panels, group)
            charts.append(blocks.Drawn(f"answers-{number}", f"Each {sample.step}", caption))
        hardest = int(np.nanargmax(next(iter(answers.values()))[names[0]])) + 1
        scene = blocks.Drawn(f"paths-{number}", "paths of all planners", start=float(hardest))
        view = [blocks.Beside(scene, charts) if charts else scene]
        view += [blocks.Text(caption)] if sample.stride > 1 else []
    return [*(view or charts), planner_table(comparison, number)]


RATIO_CAPTION = (
    "Dot: the median over episodes; bar: its 95 % interval; small dots: episodes. Right of the line is better."
)


def ratio_panel(comparison: Comparison) -> Panel | None:
    """The forest plot of ratios to the baseline, best first; None without a ratio."""
    spreads = {}
    for number, row in enumerate(comparison.rows):
        if row.ratio_expanded is not None and row.planner != comparison.baseline:
            ratios = comparison.ratios[row.planner].of_episodes
            spreads[row.planner] = Spread(row.ratio_expanded, _interval(row), ratios, look(number)["color"])
    spreads = dict(sorted(spreads.items(), key=lambda item: -item[1].value))
    what = f"times fewer {_what(comparison)} than {comparison.baseline}"
    log = all(spread.value > 0 for spread in spreads.values())
    return forest(what, spreads, f"{comparison.baseline} / planner", log, [1.0]) if spreads else None


def _what(comparison: Comparison) -> str:
    return "neighbours tested" if comparison.counted == "touched" else f"cells {comparison.counted}"


def question_scene(sample: QuestionSample, names: Sequence[str]) -> Scene:
    """Start, goal, map and every planner's path of each question, from step 1."""
    shown = list(sample.kept.values())
    steps = np.arange(1.0, len(shown) + 1)
    new = [k for k, of in enumerate(shown) if k == 0 or of.bits is not shown[k - 1].bits]
    maps = [shown[k] for k in new]
    origin, cell, columns = np.array([of.origin for of in maps]), maps[0].cell, maps[0].columns
    layers: list[Layer] = []
    for label, color, layer in (("kept clear of", "wall", -1), ("obstacle", "cell", 0)):
        if layer == 0 or any(len(of.bits) > 1 for of in maps):
            grids = MapSequence.of(origin, cell, np.stack([of.bits[layer] for of in maps]), columns)
            layers.append(Windows(label, color, steps[new], grids))
    for number, name in enumerate(names):  # a line for each question, without points where the planner found none
        paths = [of.paths.get(name, np.empty((0, 2))) for of in shown]
        x, y = np.concatenate(paths).T
        layers.append(Lines(name, first=np.cumsum([0, *map(len, paths)]), x=x, y=y, seconds=steps, **look(number)))
    goals, starts = np.array([of.goal for of in shown]), np.array([of.start for of in shown])
    layers.append(Track("goal", "target", steps, goals[:, 0], goals[:, 1], shape="star", trail=False))
    layers.append(Track("start", "text", steps, starts[:, 0], starts[:, 1], shape="dot", trail=False))
    size = cell * np.array([columns, maps[0].bits.shape[1]])
    far = origin + size
    extent = extent_of((origin[:, 0], origin[:, 1]), (far[:, 0], far[:, 1]))
    unit, window = sample.unit, float(size.max())
    near = 1.1 * window if max(extent[1] - extent[0], extent[3] - extent[2]) > 3 * window else 0.0
    return Scene(layers, extent, unit, (f"x ({unit})", f"y ({unit})"), step=sample.step, near=near)


def _answers(replans: Columns, sample: QuestionSample, counted: str) -> dict[str, DataFrame]:
    """Cells, time and extra cost at each question shown, a column for each planner."""
    from pandas import DataFrame

    table = DataFrame(dict(replans))
    excess = 100 * (table["cost"] / table["optimal_cost"] - 1)
    what = "neighbours" if counted == "touched" else "cells"
    titles = {counted: f"{what} {counted}", "us": "time (µs)", "excess": "cost above the optimum (%)"}
    table["excess"], index = excess.mask(excess.abs() < 1e-6, 0.0), ["episode", "replan"]
    found = {}
    for name, title in titles.items():
        wide = table.pivot(index=index, columns="planner", values=name)[table["planner"].unique()]
        wide = wide.loc[[of.at for of in sample.kept.values()]]
        if name != "excess" or (wide.to_numpy() > 0).any():
            found[title] = wide
    return found


def question_panel(what: str, values: Mapping[str, Any] | DataFrame, step: str, zero: bool = False) -> Panel:
    """A curve for each planner over the questions from 1; on a logarithmic axis 0 is left out."""
    curves = {str(name): np.asarray(of, float) for name, of in values.items()}
    every = np.concatenate([*curves.values()])
    positive = every[np.isfinite(every) & (every > 0)]
    log = not zero and len(positive) > 0 and bool(positive.max() > LOG_FROM * positive.min())
    style: Any = "points" if step == "query" else "line"
    series = []
    for number, (name, of) in enumerate(curves.items()):
        shown = np.where(of > 0, of, np.nan) if log else of
        series.append(Series(name, x=np.arange(1.0, len(shown) + 1), y=shown, style=style, **look(number)))
    return Panel(what, series, step, zero=zero, log=log)


def planner_table(comparison: Comparison, number: int) -> Table:
    """A row for each planner, coloured where an interval separates it from the baseline."""
    columns = [
        Column("planner"), Column(f"times fewer than {comparison.baseline}", True), Column("time (µs)", True),
        Column("solved", True), Column("extra cost", True, help="above the cheapest path, mean"),
        Column(_what(comparison), True, True), Column("per replan", True, True, help="cells, mean"),
        Column("p95 (µs)", True, True), Column("length", True, True),
        Column("from scratch", True, True, help="replans that an incremental planner could not build on the last"),
    ]  # fmt: skip
    rows, states = [], _judged(comparison)
    for row in comparison.rows:
        total = getattr(row, f"{comparison.counted}_total")
        cells = [Cell(sig(of), of) for of in (row.ratio_expanded, row.us_median)]
        cells += [Cell(percent(of), of) for of in (row.success_rate, row.suboptimality_mean)]
        cells += [Cell(count(total), total)]
        cells += [Cell(sig(of), of) for of in (total / row.replans, row.us_p95, row.length_m_total)]
        cells[0] = cells[0]._replace(below=ends_text(_interval(row)), state=states[row.planner])
        cells[2] = cells[2]._replace(state="" if row.success_rate == 1 else "warn")
        rows.append([Cell(row.planner), *cells, Cell(percent(row.fallback_share), row.fallback_share)])
    note = "Below a ratio: its 95 % interval. Those of the verdict are wider, since it names the best of several."
    return Table(columns, rows, f"planners-{number}", note, sortable=True)


def _interval(row: PlannerRow) -> Interval | None:
    """Of the ratio to the baseline."""
    return None if row.ratio_low is None or row.ratio_high is None else (row.ratio_low, row.ratio_high)


def _judged(comparison: Comparison) -> dict[str, State]:
    """Good or bad, of the planners whose interval of the ratio says so."""
    others = {row.planner: _interval(row) if row.planner != comparison.baseline else None for row in comparison.rows}
    ends = {name: interval or (1.0, 1.0) for name, interval in others.items()}
    return {name: "good" if low > 1 else "bad" if high < 1 else "" for name, (low, high) in ends.items()}
