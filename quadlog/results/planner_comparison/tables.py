"""The tables of `quadlog compare-planners`: columns with their types, and every format they are printed in."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadlog.errors import UnknownName, csv_table, printable
from quadlog.results.run.tables import TableWriter, table_schema
from quadlog.results.text.markup import aligned, escape_markdown, latex_document, latex_tables, markdown_table
from quadlog.results.text.numbers import significant

REPLANS = table_schema(
    "source:text episode:int replan:int t_ns:int planner:text found:bool why_not:text expanded:int generated:int "
    "touched:int cost optimal_cost from_scratch:bool reused_cells:int start_col:int start_row:int goal_col:int "
    "goal_row:int goal_projected:bool length_m turn_rad curvature_max_1pm us"
)
"""One row per planner and replan; cells are those of the lattice, costs in the units of --costs."""

PLANNERS = table_schema(
    "source:text planner:text episodes:int replans:int success_rate expanded_total:int generated_total:int "
    "touched_total:int expanded_mean ratio_expanded ratio_low ratio_high suboptimality_mean suboptimality_p95 "
    "fallback_share us_median us_p95 length_m_total turn_rad_total"
)
"""One row per planner and source."""

SCENARIOS = table_schema(
    "map:text planner:text start_col:int start_row:int goal_col:int goal_row:int listed_cost cost expanded:int us "
    "found:bool"
)
"""One row per query of a .scen file and planner; costs in cells, straight 1, diagonal √2."""


def write_planners(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """planners.parquet from its rows, each with every column; None is no value. Raises CannotWrite."""
    with TableWriter(path, PLANNERS) as table:
        for row in rows:
            table.add_row(row)


Row = Mapping[str, Any]
"""The columns of planners.parquet with plain values; None or NaN where there is none."""


@dataclass(frozen=True, slots=True)
class _Shown:
    """A column as people read it: its heading in two lines for a terminal, in one elsewhere, and its cells."""

    group: str
    short: str
    heading: str
    cell: Callable[[Row], str]


def format_rows(rows: Sequence[Row], to: str, notes: Sequence[str] = ()) -> str:
    """The rows of any number of sources as the format `to`, with a line end; raises UnknownName.

    notes: sentences on how to read the figures; left out in json and csv.
    """
    if to not in FORMATS:
        raise UnknownName("format", to, FORMATS)
    return FORMATS[to](rows, notes)


def table_text(rows: Sequence[Row], notes: Sequence[str] = ()) -> str:
    """Aligned plain text, a block per source, at most 120 columns wide unless numbers are huge."""
    blocks = ["\n".join([title, *_aligned(mine)]) for title, mine in _by_source(rows)]
    return "\n\n".join([*blocks, *(["\n".join(map(printable, notes))] if notes else [])]) + "\n"


def json_text(rows: Sequence[Row], _notes: Sequence[str] = ()) -> str:
    """A list of flat objects in full precision; what does not apply is absent."""
    objects = [{name: row[name] for name in PLANNERS.names if _exists(row[name])} for row in rows]
    return json.dumps(objects, indent=2, allow_nan=False) + "\n"


def csv_text(rows: Sequence[Row], _notes: Sequence[str] = ()) -> str:
    """All columns in full precision, an empty field where there is no value."""
    cells = ([row[name] if _exists(row[name]) else "" for name in PLANNERS.names] for row in rows)
    text = csv_table([PLANNERS.names, *cells])
    return text.encode("utf-8", "replace").decode()  # a file name may hold what is no text


def markdown_text(rows: Sequence[Row], notes: Sequence[str] = ()) -> str:
    """A table per source, under a line that names it."""
    header = [each.heading for each in _SHOWN]
    blocks = [
        f"{escape_markdown(title)}\n\n{markdown_table(header, _cells(mine), header[1:])}"
        for title, mine in _by_source(rows)
    ]
    return "\n".join([*blocks, *(f"{escape_markdown(printable(note))}\n" for note in notes)])


def latex_text(rows: Sequence[Row], notes: Sequence[str] = ()) -> str:
    """Two floating tables per source, since no page is wide enough for one; the notes as comments."""
    search = [each.short for each in _SHOWN].index("95 %") + 1
    tables: list[str] = []
    for number, (title, mine) in enumerate(_by_source(rows), start=1):
        for label, what, places in (
            ("search", "search", range(search)),
            ("paths", "paths and time", (0, *range(search, len(_SHOWN)))),
        ):
            header = [_SHOWN[place].heading for place in places]
            cells = [[line[place] for place in places] for line in _cells(mine)]
            name = f"tab:planners-{number}-{label}"
            tables += latex_tables(f"Planners on {title}: {what}", name, header, cells, header[1:])
    return latex_document(notes, tables)


Format = Callable[[Sequence[Row], Sequence[str]], str]

FORMATS: dict[str, Format] = {
    "table": table_text,
    "json": json_text,
    "csv": csv_text,
    "markdown": markdown_text,
    "latex": latex_text,
}


def _by_source(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """The rows of each source under its title, which has the numbers of episodes and replans."""
    sources: dict[str, list[Row]] = {}
    for row in rows:
        sources.setdefault(row["source"], []).append(row)
    return [(_title(source, mine[0]), mine) for source, mine in sources.items()]


def _title(source: str, row: Row) -> str:
    counts = (f"{row[name]} {name if row[name] != 1 else name[:-1]}" for name in ("episodes", "replans"))
    return f"{printable(source)}: {', '.join(counts)}"


def _aligned(rows: Sequence[Row]) -> list[str]:
    """Lines of a table: two of headings, then a row each; groups of columns are set apart."""
    cells = [[each.short for each in _SHOWN], *_cells(rows)]
    gaps = [2 if each.group else 1 for each in _SHOWN]
    groups, end = "", -gaps[0]
    for each, gap, column in zip(_SHOWN, gaps, zip(*cells, strict=True), strict=True):
        groups = groups.ljust(end + gap) + each.group if each.group else groups
        end += gap + max(map(len, column))
    return [groups, *aligned(cells, left=(0,), gaps=gaps)]


def _cells(rows: Sequence[Row]) -> list[list[str]]:
    return [[each.cell(row) for each in _SHOWN] for row in rows]


def _exists(value: Any) -> bool:
    return value is not None and not (isinstance(value, float) and not math.isfinite(value))


def _whole(name: str) -> Callable[[Row], str]:
    """A total with four significant digits and an SI prefix."""

    def cell(row: Row) -> str:
        value, letters = float(row[name]), " kMGT"
        if value < 10_000:
            return str(row[name])
        power = min(int(math.log10(value) / 3), len(letters) - 1)
        return significant(value / 1000**power) + letters[power]

    return cell


def _number(name: str, times: float = 1.0) -> Callable[[Row], str]:
    """Three significant digits, or all before the point."""
    return lambda row: "" if row[name] is None else significant(row[name] * times, 3)


def _interval(row: Row) -> str:
    low, high = (_number(name)(row) for name in ("ratio_low", "ratio_high"))
    return f"{low}..{high}" if low else ""


_SHOWN = (
    _Shown("", "planner", "planner", lambda row: printable(row["planner"])),
    _Shown("share %", "solved", "solved %", _number("success_rate", 100)),
    _Shown("", "scratch", "from scratch %", _number("fallback_share", 100)),
    _Shown("cells in all", "expand", "expanded", _whole("expanded_total")),
    _Shown("", "gener.", "generated", _whole("generated_total")),
    _Shown("", "touch", "touched", _whole("touched_total")),
    _Shown("", "/replan", "expanded/replan", _number("expanded_mean")),
    _Shown("ratio", "median", "ratio", _number("ratio_expanded")),
    _Shown("", "95 %", "95 % interval", _interval),
    _Shown("excess %", "mean", "excess cost %", _number("suboptimality_mean", 100)),
    _Shown("", "p95", "excess cost %, p95", _number("suboptimality_p95", 100)),
    _Shown("time us", "median", "time us", _number("us_median")),
    _Shown("", "p95", "time us, p95", _number("us_p95")),
    _Shown("paths in all", "m", "length m", _number("length_m_total")),
    _Shown("", "rad", "turn rad", _number("turn_rad_total")),
)
