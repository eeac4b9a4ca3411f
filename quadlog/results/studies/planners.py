"""A comparison of planners: its tables, every format they are printed in, its folder, and its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from quadlog.errors import NotARun, printable
from quadlog.metrics.intervals import Interval
from quadlog.metrics.planner_verdict import verdict_lines
from quadlog.metrics.planning import Comparison, Ratio
from quadlog.results.find_runs import refuse_existing
from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Sentence, Table
from quadlog.results.page.pack import Pack
from quadlog.results.tables import read_parquet, table_schema, write_table
from quadlog.results.text import State, TitledTable, ends_text, percent, print_table, print_tables, sig, terminal_width
from quadlog.results.view import Panel, Series, Spread, forest, look
from quadlog.storage.atomic_write import uninterrupted, write_whole, writing

REPLANS = table_schema(
    "source:text episode:int replan:int t_ns:int planner:text found:bool why_not:text expanded:int generated:int "
    "touched:int cost optimal_cost from_scratch:bool reused_cells:int start_col:int start_row:int goal_col:int "
    "goal_row:int goal_projected:bool length_m turn_rad us"
)
"""One row per planner and replan; cells are those of the lattice, costs in the units of --costs."""

PLANNERS = table_schema(
    "source:text planner:text episodes:int replans:int success_rate expanded_total:int generated_total:int "
    "touched_total:int expanded_mean ratio_expanded ratio_low ratio_high suboptimality_mean suboptimality_p95 "
    "fallback_share us_median us_p95 length_m_total turn_rad_total baseline:text counted:text"
)
"""One row per planner and source; older ones lack the last two columns: what the ratio is to, and of."""

SCENARIOS = table_schema(
    "map:text planner:text start_col:int start_row:int goal_col:int goal_row:int listed_cost cost expanded:int us "
    "found:bool"
)
"""One row per query of a .scen file and planner; costs in cells, straight 1, diagonal √2."""


Row = Mapping[str, Any]
"""The columns of planners.parquet with plain values; None where there is none."""
_HEADER = ("planner", "found %", "cells", "ratio", "95 %", "excess %", "time us", "p95 us")
_KEY = (
    "cells: expanded per replan; ratio: {} by {} / by this planner, above 1 is better; excess: of the path's cost over "
    "the optimal one; all columns: --format csv"
)


def format_rows(rows: Sequence[Row], to: str, notes: Sequence[str] = ()) -> str:
    """The rows of any number of sources as the format `to`, with a line end.

    json and csv have all columns in full precision. notes: sentences on how to read the figures; left out there.
    """
    if to in ("json", "csv"):
        return print_table(PLANNERS.names, [[row[name] for name in PLANNERS.names] for row in rows], to)
    tables: dict[str, list[list[Any]]] = {}
    for row in rows:
        ends, excess = (row["ratio_low"], row["ratio_high"]), row["suboptimality_mean"]
        cells = [row["planner"], 100 * row["success_rate"], row["expanded_mean"], row["ratio_expanded"]]
        cells += ["" if None in ends else ends_text(ends), None if excess is None else 100 * excess]
        counts = (f"{row[name]} {name if row[name] != 1 else name[:-1]}" for name in ("episodes", "replans"))
        title = f"{row['source']}: {', '.join(counts)}"
        tables.setdefault(title, []).append([*cells, row["us_median"], row["us_p95"]])
    titled = [TitledTable(title, _HEADER, lines) for title, lines in tables.items()]
    key = _KEY.format(_what(rows[0]["counted"]), rows[0]["baseline"])
    return print_tables(titled, to, [key, *notes], terminal_width())


MOST_DRAWN = 8
"""Sources with charts, the first ones; the others have their verdict and their table."""
Columns = Mapping[str, NDArray[Any]]
PAGE = "report.html"
TABLES = ("planners.parquet", "replans.parquet", "scenarios.parquet")


class ComparedSource(NamedTuple):
    """A source's comparison, and its columns of replans.parquet and scenarios.parquet."""

    comparison: Comparison
    replans: Columns
    scenarios: Columns | None = None


def earlier_files(folder: Path, force: bool) -> list[Path]:
    """The files of an earlier comparison, report.html first. Raises AlreadyExists unless `force`, CannotWrite."""
    found = [path for name in (PAGE, *TABLES) if (path := folder / name).exists()]
    for path in found:
        refuse_existing(path, force, own=TABLES)
    return found


def write_comparison(
    folder: Path, sources: Sequence[ComparedSource], rows: Sequence[Row], about: Sequence[str], losses: Sequence[str]
) -> None:
    """All files in place of an earlier comparison's, report.html last; signals are delayed until then.

    rows: of planners.parquet; about, losses: as of planners_page. Raises CannotWrite.
    """
    page = blocks.render(planners_page(sources, about, losses))
    scenarios = [source.scenarios for source in sources if source.scenarios is not None]
    with uninterrupted(), writing(folder):
        for path in earlier_files(folder, force=True):
            path.unlink()
        write_table(folder / TABLES[0], PLANNERS, {name: [row[name] for row in rows] for name in PLANNERS.names})
        write_table(folder / TABLES[1], REPLANS, _joined([source.replans for source in sources]))
        if scenarios:
            write_table(folder / TABLES[2], SCENARIOS, _joined(scenarios))
        write_whole(folder / PAGE, page)


def _joined(parts: Sequence[Columns]) -> dict[str, NDArray[Any]]:
    return {name: np.concatenate([columns[name] for columns in parts]) for name in parts[0]}


def planners_page(sources: Sequence[ComparedSource], about: Sequence[str], losses: Sequence[str] = ()) -> blocks.Page:
    """The page. about: how to read it; losses: what of recordings was lost."""
    pack, names = Pack(), [printable(source.comparison.source) for source in sources]
    more = f" and {sig(len(names) - 3)} more" if len(names) > 3 else ""
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
    files = [(name, f"./{name}") for name in TABLES[:2]]
    sections = [blocks.Section("", first), *sections, blocks.Section("How to read this", notes, pack.thinned)]
    return blocks.Page(f"Planners on {', '.join(names[:3])}{more}", sections, facts, links=files, pack=pack)


def _verdict(comparison: Comparison) -> list[Sentence]:
    """Up to three sentences: cells, time, and what they rest on."""
    states: dict[str, State] = {"Cells": "good"} if "good" in _judged(comparison).values() else {}
    return [Sentence(subject, text, states.get(subject, "")) for subject, text in verdict_lines(comparison)]


def _drawn(source: ComparedSource, number: int, pack: Pack) -> list[Any]:
    """The ratios, what each replan took, and the table."""
    charts = []
    for name, panels in figures_of(source).items() if number < MOST_DRAWN else ():
        pack.add(f"{name}-{number}", panels, f"source-{number}")
        charts.append(blocks.Drawn(f"{name}-{number}", *CAPTIONS[name]))
    return [*charts, planner_table(source.comparison, number)]


CAPTIONS = {
    "ratios": (
        "Ratios",
        "Dot: the median over episodes; bar: its 95 % interval; small dots: episodes. Right of the line is better.",
    ),
    "replans": ("Each replan", "Replans in their order; 0 cells lie below the axis."),
}


def figures_of(source: ComparedSource) -> dict[str, list[Panel]]:
    """The ratios and what each replan took, as far as there is something to draw."""
    ratios = ratio_panel(source.comparison)
    made = {"ratios": [ratios] if ratios else [], "replans": answer_panels(source)}
    return {name: panels for name, panels in made.items() if panels}


def ratio_panel(comparison: Comparison) -> Panel | None:
    """The forest plot of ratios to the baseline, best first; None without a ratio."""
    spreads = {}
    for number, row in enumerate(comparison.rows):
        if row["ratio_expanded"] is not None and row["planner"] != comparison.baseline:
            ratios = comparison.ratios[row["planner"]].of_episodes
            spreads[row["planner"]] = Spread(row["ratio_expanded"], _interval(row), ratios, look(number)["color"])
    spreads = dict(sorted(spreads.items(), key=lambda item: -item[1].value))
    what = f"times fewer {_what(comparison.counted)} than {comparison.baseline}"
    x, marks = f"{comparison.baseline} / planner", {comparison.baseline: 1.0}
    return forest(what, spreads, x, marks, log=True) if spreads else None


def _what(counted: str) -> str:
    return "neighbours tested" if counted == "touched" else f"cells {counted}"


def answer_panels(source: ComparedSource) -> list[Panel]:
    """Cells and time of each replan, a curve for each planner; points of queries, which stand alone."""
    counted, table = source.comparison.counted, source.replans
    names = list(dict.fromkeys(table["planner"].tolist()))
    style: Any = "line" if source.scenarios is None else "points"
    panels = []
    for column, what in ((counted, _what(counted)), ("us", "time (µs)")):
        values = [table[column][table["planner"] == name].astype(float) for name in names]
        series = [
            Series(name, x=np.arange(1.0, len(of) + 1), y=of, style=style, **look(number))
            for number, (name, of) in enumerate(zip(names, values, strict=True))
        ]
        panels.append(Panel(what, series, "replan", log=True))  # planners differ by powers of ten
    return panels if len(values[0]) > 1 else []


def saved_figures(folder: Path) -> dict[str, list[Panel]]:
    """By name, the figures of each source of a saved comparison. Raises NotARun for damaged tables, TooLarge."""
    rows, replans = (_whole(folder / name, schema) for name, schema in zip(TABLES, (PLANNERS, REPLANS), strict=False))
    listed, figures = rows.to_pylist(), dict[str, list[Panel]]()
    columns = {name: column.to_numpy() for name, column in zip(replans.column_names, replans.columns, strict=True)}
    for number, source in enumerate(dict.fromkeys(row["source"] for row in listed), 1):
        own = [row for row in listed if row["source"] == source]
        guess = next((row["planner"] for row in own if row["ratio_expanded"] == 1.0), "astar")
        baseline, counted = own[0].get("baseline", guess), own[0].get("counted", "expanded")
        ratios = dict.fromkeys((row["planner"] for row in own), Ratio(1.0, np.empty(0), None))
        comparison = Comparison(source, own, baseline, counted, {}, ratios)
        table = {name: values[columns["source"] == source] for name, values in columns.items()}
        drawn = figures_of(ComparedSource(comparison, table))
        figures |= {f"source-{number}-{name}": panels for name, panels in drawn.items()}
    return figures


def _whole(path: Path, schema: pa.Schema) -> pa.Table:
    """A table with the columns of its schema, but for those that older ones lack. Raises NotARun, TooLarge."""
    table = read_parquet(path)
    for of in schema:
        there = table.column(of.name) if of.name in table.column_names else None
        if there is None and of.name in ("baseline", "counted"):
            continue
        if there is None or there.type != of.type or (there.null_count and of.type != pa.float64()):
            raise NotARun(path, f"is damaged: no column {of.name} of type {of.type} without gaps")
    return table


def planner_table(comparison: Comparison, number: int) -> Table:
    """A row for each planner, coloured where an interval separates it from the baseline."""
    columns = [
        Column("planner"), Column(f"times fewer than {comparison.baseline}", True), Column("time (µs)", True),
        Column("solved", True), Column("extra cost", True, help="above the cheapest path, mean"),
        Column(_what(comparison.counted), True, True), Column("per replan", True, True, help="cells, mean"),
        Column("p95 (µs)", True, True), Column("length", True, True),
        Column("from scratch", True, True, help="replans that an incremental planner could not build on the last"),
    ]  # fmt: skip
    rows, states = [], _judged(comparison)
    for row in comparison.rows:
        total = row[f"{comparison.counted}_total"]
        cells = [Cell(sig(of), of) for of in (row["ratio_expanded"], row["us_median"])]
        cells += [Cell(percent(of), of) for of in (row["success_rate"], row["suboptimality_mean"])]
        cells += [Cell(sig(total), total)]
        cells += [Cell(sig(of), of) for of in (total / row["replans"], row["us_p95"], row["length_m_total"])]
        cells[0] = cells[0]._replace(below=ends_text(_interval(row)), state=states[row["planner"]])
        cells[2] = cells[2]._replace(state="" if row["success_rate"] == 1 else "warn")
        rows.append([Cell(row["planner"]), *cells, Cell(percent(row["fallback_share"]), row["fallback_share"])])
    note = "Below a ratio: its 95 % interval. Those of the verdict are wider, since it names the best of several."
    return Table(columns, rows, f"planners-{number}", note, sortable=True)


def _interval(row: Row) -> Interval | None:
    """Of the ratio to the baseline."""
    return None if row["ratio_low"] is None else (row["ratio_low"], row["ratio_high"])


def _judged(comparison: Comparison) -> dict[str, State]:
    """Good or bad, of the planners whose interval of the ratio says so."""
    others = {
        row["planner"]: _interval(row) if row["planner"] != comparison.baseline else None for row in comparison.rows
    }
    ends = {name: interval or (1.0, 1.0) for name, interval in others.items()}
    return {name: "good" if low > 1 else "bad" if high < 1 else "" for name, (low, high) in ends.items()}
