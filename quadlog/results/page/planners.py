"""The folder of a comparison of planners, and its page: what came out, ratios, paths question by question, a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import CannotWrite, printable
from quadlog.metrics.comparison.planner_verdict import verdict_lines
from quadlog.metrics.intervals import FEWEST_VALUES
from quadlog.metrics.planning import Comparison, PlannerRow
from quadlog.results.arrays import MapSequence
from quadlog.results.find_runs import refuse_existing
from quadlog.results.numbers import count, percent, sig
from quadlog.results.page.blocks import (
    Beside,
    Cell,
    Column,
    Details,
    Drawn,
    Notes,
    Page,
    Section,
    Sentence,
    Table,
    Text,
    Verdict,
    render,
)
from quadlog.results.page.pack import Pack
from quadlog.results.planners import PLANNERS, REPLANS, SCENARIOS, QuestionSample, ShownQuestion, format_rows
from quadlog.results.tables import write_table
from quadlog.results.view import Layer, Lines, Panel, Scene, Series, Spread, Track, Windows, extent_of, forest, look
from quadlog.results.words import State
from quadlog.storage.atomic_write import uninterrupted, write_whole

if TYPE_CHECKING:
    from pandas import DataFrame

MOST_DRAWN = 8
"""Sources with paths and charts, the first ones; the others have their verdict and their table."""
MOST_SOURCES = 200
LOG_FROM = 20
"""Values of a larger ratio than this get a logarithmic axis."""
Columns = Mapping[str, NDArray[Any]]
PAGE = "report.html"
TEXTS = {"planners.csv": "csv", "planners.json": "json", "planners.tex": "latex"}
TABLES = ("planners.parquet", "replans.parquet", "scenarios.parquet")


@dataclass(frozen=True, slots=True)
class ComparedSource:
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
    files[PAGE] = render(planners_page(sources, about, losses))
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


def planners_page(sources: Sequence[ComparedSource], about: Sequence[str], losses: Sequence[str] = ()) -> Page:
    """The page. about: how to read it; losses: what of recordings was lost."""
    pack, names = Pack(), [printable(source.comparison.source) for source in sources]
    more = len(names) - 3
    title = f"Planners on {', '.join(names[:3])}{f' and {count(more)} more' if more > 0 else ''}"
    sections = []
    for number, (name, source) in enumerate(zip(names[:MOST_SOURCES], sources, strict=False)):
        own = [Verdict(verdict(source.comparison)[1:])] if len(sources) > 1 else []
        sections.append(Section(name, [*own, *_drawn(source, number, pack), planner_table(source.comparison, number)]))
    first: list[Any] = [Verdict(_findings(sources[:MOST_SOURCES], names))]
    if losses:
        first.append(Notes("Lost from the recordings (exit code 3)", list(map(printable, losses)), "bad"))
    if len(names) > MOST_SOURCES:
        first.append(Notes("Left out", [f"The first {MOST_SOURCES} sources stand here; planners.csv has the others."]))
    if len(sections) == 1:
        sections = [Section("", [*first, *sections[0].blocks])]
    else:
        sections.insert(0, Section("", first))
    notes = [Details("Rules, counts and intervals", [Text(printable(line)) for line in about])]
    facts = [f"{len(sources[0].comparison.rows)} planners", "the same questions for each"]
    files = [(name, f"./{name}") for name in ("planners.csv", "planners.parquet", "replans.parquet")]
    return Page(title, [*sections, Section("How to read this", notes, pack.thinned)], facts, links=files, pack=pack)


def verdict(comparison: Comparison) -> list[Sentence]:
    """Up to four sentences: cells, cells with optimal paths, time, and what they rest on."""
    better = any(_judged(comparison, row)[1] == "good" for row in comparison.rows)
    return [
        Sentence(subject, text, "good" if subject == "Cells" and better else "")
        for subject, text in verdict_lines(comparison)
    ]


def _findings(sources: Sequence[ComparedSource], names: Sequence[str]) -> list[Sentence]:
    if len(sources) == 1:
        return verdict(sources[0].comparison)
    firsts = [verdict(source.comparison)[0] for source in sources]
    return [Sentence(name, line.text, line.state) for name, line in zip(names, firsts, strict=False)]


def _drawn(source: ComparedSource, number: int, pack: Pack) -> list[Any]:
    """The map beside the ratios and the charts of each question, on one clock of the source's own."""
    group = f"source-{number}"
    sample = source.sample
    charts = []
    if number < MOST_DRAWN and (panel := ratio_panel(source.comparison)) is not None:
        pack.add(f"ratios-{number}", [panel], group)
        charts.append(Drawn(f"ratios-{number}", "Ratios", RATIO_CAPTION))
    if sample is None or not sample.kept:
        return charts
    names = [row.planner for row in source.comparison.rows]
    pack.add(f"paths-{number}", question_scene(sample, names), group)
    answers = _answers(source.replans, sample, names)
    counted = source.comparison.counted
    if len(sample.kept) > 1:
        pack.add(f"answers-{number}", answer_panels(answers, sample.step, counted), group)
        charts.append(Drawn(f"answers-{number}", f"Each {sample.step}", _thinned(sample)))
    hardest = int(np.nanargmax(answers[names[0]][counted])) + 1
    view = Drawn(f"paths-{number}", "paths of all planners", start=float(hardest))
    return [Beside(view, charts) if charts else view, *([Text(_thinned(sample))] if sample.stride > 1 else [])]


def _thinned(sample: QuestionSample) -> str:
    if sample.stride == 1:
        return f"Every {sample.step} in the order of asking."
    return f"Every {sample.stride}th {sample.step} of {count(sample.asked)}; replans.parquet has all."


RATIO_CAPTION = (
    "Dot: the median over episodes; bar: its 95 % interval; small dots: episodes. Right of the line is better."
)


def ratio_panel(comparison: Comparison) -> Panel | None:
    """The forest plot of ratios to the baseline, best first; None without a ratio."""
    names = [row.planner for row in comparison.rows]
    rows = [row for row in comparison.rows if row.ratio_expanded is not None and row.planner != comparison.baseline]
    rows.sort(key=lambda row: -(row.ratio_expanded or 0.0))
    spreads = {}
    for row in rows:
        interval = None
        if row.ratio_low is not None and row.ratio_high is not None and not _too_few(comparison):
            interval = (row.ratio_low, row.ratio_high)
        color, ratios = look(names.index(row.planner))["color"], comparison.episode_ratios[row.planner]
        spreads[row.planner] = Spread(row.ratio_expanded or 0.0, interval, ratios, color)
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
    layers += [_paths(shown, name, steps, number) for number, name in enumerate(names)]
    for label, color, shape, places in (
        ("goal", "target", "star", np.array([of.goal for of in shown])),
        ("start", "text", "dot", np.array([of.start for of in shown])),
    ):
        layers.append(Track(label, color, steps, places[:, 0], places[:, 1], shape=shape, trail=False))  # type: ignore[arg-type]
    size = cell * np.array([columns, maps[0].bits.shape[1]])
    far = origin + size
    extent = extent_of((origin[:, 0], origin[:, 1]), (far[:, 0], far[:, 1]))
    unit, window = sample.unit, float(size.max())
    near = 1.1 * window if max(extent[1] - extent[0], extent[3] - extent[2]) > 3 * window else 0.0
    return Scene(layers, extent, unit, (f"x ({unit})", f"y ({unit})"), step=sample.step, near=near)


def _paths(shown: Sequence[ShownQuestion], name: str, steps: NDArray[Any], number: int) -> Lines:
    """A line for each question, without points where the planner found none."""
    paths = [of.paths.get(name, np.empty((0, 2))) for of in shown]
    points = np.concatenate([np.empty((0, 2)), *paths])
    return Lines(
        name, first=np.cumsum([0, *map(len, paths)]), x=points[:, 0], y=points[:, 1], seconds=steps, **look(number)
    )


def _answers(replans: Columns, sample: QuestionSample, names: Sequence[str]) -> dict[str, DataFrame]:
    """Rows of replans.parquet by planner, one for each question shown."""
    from pandas import DataFrame, MultiIndex

    table = DataFrame(dict(replans)).set_index(["episode", "replan"])
    shown = MultiIndex.from_tuples([of.at for of in sample.kept.values()])
    return {name: table[table["planner"] == name].loc[shown] for name in names}


def answer_panels(answers: Mapping[str, DataFrame], step: str, counted: str) -> list[Panel]:
    """Cells, time and extra cost of every planner at each question, over its step."""
    excess = {name: 100 * (of["cost"] / of["optimal_cost"] - 1).to_numpy() for name, of in answers.items()}
    excess = {name: np.where(np.abs(values) < 1e-6, 0.0, values) for name, values in excess.items()}
    what = "neighbours" if counted == "touched" else "cells"
    panels = [
        question_panel(f"{what} {counted}", {name: of[counted].to_numpy() for name, of in answers.items()}, step),
        question_panel("time (µs)", {name: of["us"].to_numpy() for name, of in answers.items()}, step),
    ]
    if any((values > 0).any() for values in excess.values()):
        panels.append(question_panel("cost above the optimum (%)", excess, step, zero=True))
    return panels


def question_panel(what: str, values: Mapping[str, NDArray[Any]], step: str, zero: bool = False) -> Panel:
    """A curve for each planner over the questions from 1; on a logarithmic axis 0 is left out."""
    every = np.concatenate([np.asarray(of, float) for of in values.values()])
    positive = every[np.isfinite(every) & (every > 0)]
    log = not zero and len(positive) > 0 and bool(positive.max() > LOG_FROM * positive.min())
    style: Any = "points" if step == "query" else "line"
    series = []
    for number, (name, of) in enumerate(values.items()):
        shown = np.where(np.asarray(of) > 0, of, np.nan) if log else np.asarray(of, float)
        series.append(Series(name, x=np.arange(1.0, len(shown) + 1), y=shown, style=style, **look(number)))
    return Panel(what, series, step, zero=zero, log=log)


def planner_table(comparison: Comparison, number: int) -> Table:
    """A row for each planner, coloured where an interval tells it from the baseline."""
    columns = [
        Column("planner"), Column(f"times fewer than {comparison.baseline}", True), Column("time (µs)", True),
        Column("solved", True), Column("extra cost", True, help="above the cheapest path, mean"),
        Column(_what(comparison), True, True), Column("each", True, True, help="cells of each question"),
        Column("p95 (µs)", True, True), Column("length", True, True),
        Column("from scratch", True, True, help="replans that an incremental planner could not build on the last"),
    ]  # fmt: skip
    rows = [_row(comparison, row) for row in comparison.rows]
    note = "Below a number: its 95 % interval. Those of the verdict are wider, since it names the best of several."
    if _too_few(comparison):
        note = f"{note} Of fewer than {FEWEST_VALUES} episodes: below a ratio the range of their ratios."
    return Table(columns, rows, f"planners-{number}", note, sortable=True)


def _row(comparison: Comparison, row: PlannerRow) -> list[Cell]:
    total = {"expanded": row.expanded_total, "generated": row.generated_total, "touched": row.touched_total}
    cells = total[comparison.counted]
    word, state = _judged(comparison, row)
    us = comparison.us.median_interval(row.planner) if comparison.paired_replans else None
    return [
        Cell(row.planner),
        Cell(sig(row.ratio_expanded), row.ratio_expanded, word, state=state),
        Cell(sig(row.us_median), row.us_median, "" if us is None else f"{sig(us[0])} to {sig(us[1])}"),
        Cell(percent(row.success_rate), row.success_rate, state="" if row.success_rate == 1 else "warn"),
        Cell(percent(row.suboptimality_mean), row.suboptimality_mean),
        Cell(count(cells), cells),
        Cell(sig(cells / row.replans), cells / row.replans),
        Cell(sig(row.us_p95), row.us_p95),
        Cell(sig(row.length_m_total), row.length_m_total),
        Cell(percent(row.fallback_share), row.fallback_share),
    ]


def _too_few(comparison: Comparison) -> bool:
    """Whether the episodes, if there are several, are too few for 95 %."""
    return 1 < comparison.paired_episodes < FEWEST_VALUES


def _judged(comparison: Comparison, row: PlannerRow) -> tuple[str, State]:
    """The interval of a planner's ratio in words, and its colour."""
    if row.planner == comparison.baseline:
        return "baseline", ""
    if row.ratio_expanded is None:
        return "", ""
    if row.ratio_low is None or row.ratio_high is None:
        return "no interval", ""
    words = f"{sig(row.ratio_low)} to {sig(row.ratio_high)}"
    if _too_few(comparison):
        return words, ""
    return words, "good" if row.ratio_low > 1 else "bad" if row.ratio_high < 1 else ""
