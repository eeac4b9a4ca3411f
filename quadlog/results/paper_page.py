"""A paper's table as CSV, as LaTeX and as a section of the page that shows them all."""

from __future__ import annotations

from collections.abc import Sequence

from quadlog.results.latex import latex_document, latex_tables
from quadlog.results.markdown import escape_markdown, markdown_table
from quadlog.results.paper_rows import PaperRow, PaperTable, Picture, RowGroup
from quadlog.results.paper_store import picture_file
from quadlog.text import csv_table

COLUMNS = ("quantity", "paper", "ours", "low", "high", "difference", "reproduces", "note")
SHOWN = ("quantity", "paper", "ours", "95 % interval", "difference", "reproduces")
RIGHT = ("paper", "ours", "95 % interval", "difference")
MARKS = {True: "yes", False: "✗ no", None: ""}
"""What the page has for a verdict: what fails is seen without reading."""


def csv_text(table: PaperTable) -> str:
    """All rows with six significant digits, an empty field where there is no value."""
    rows: list[Sequence[str]] = [COLUMNS]
    for row in table.rows:
        numbers = (row.paper, row.ours, row.low, row.high, row.difference)
        cells = [format_value(value, 6) for value in numbers]
        rows.append([row.quantity, *cells, format_verdict(row), row.note])
    return csv_table(rows)


def latex_text(table: PaperTable) -> str:
    """Floating tables of each group, without the notes; a group that fills more than a page is continued."""
    tables = [
        each
        for number, group in enumerate(table.groups, start=1)
        for each in latex_tables(
            f"{table.title}: {group.title}" + (" (fast run)" if table.fast else ""),
            f"tab:{table.name}-{number}",
            SHOWN,
            [shown_cells(row) for row in group.rows],
            RIGHT,
            wrapped=SHOWN[:1],
        )
    ]
    return latex_document([table.command], tables)


def section_text(table: PaperTable) -> str:
    """The table's part of the page, in Markdown."""
    fast = " **A fast run: fewer draws and wider intervals than the full table's.**" if table.fast else ""
    files = f"[{table.name}.csv]({table.name}.csv), [{table.name}.tex]({table.name}.tex)"
    blocks = [
        f"## {escape_markdown(table.title)}",
        escape_markdown(table.caption),
        f"Made by `{table.command}`.{fast} {escape_markdown(table.sizes)} Files: {files}",
        *(_picture_block(table, picture) for picture in table.pictures),
        *(block for group in table.groups for block in _group_blocks(group)),
    ]
    if table.errata:
        blocks += ["### Errata", "\n".join(f"- {escape_markdown(sentence)}" for sentence in table.errata)]
    return "\n\n".join(blocks) + "\n"


def shown_cells(row: PaperRow) -> tuple[str, ...]:
    """A row as people read it, in the order of SHOWN, with four significant digits."""
    interval = ""
    if row.low is not None and row.high is not None:
        interval = f"{format_value(row.low)} to {format_value(row.high)}"
    numbers = format_value(row.paper), format_value(row.ours), interval, format_value(row.difference)
    return row.quantity, *numbers, format_verdict(row)


def _picture_block(table: PaperTable, picture: Picture) -> str:
    image = f"![{escape_markdown(picture.alt)}]({picture_file(table, picture)})"
    return f"{image}\n\n*{escape_markdown(picture.caption)}*"


def _group_blocks(group: RowGroup) -> list[str]:
    rows = [(*shown_cells(row)[:-1], MARKS[row.reproduces], row.note) for row in group.rows]
    body = markdown_table((*SHOWN, "note"), rows, RIGHT).rstrip("\n")
    return [f"### {escape_markdown(group.title)}", escape_markdown(group.text), body]


def format_value(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits, empty for None; zero has no sign."""
    return "" if value is None else f"{value + 0.0:.{digits}g}"


def format_verdict(row: PaperRow) -> str:
    """yes, no or empty."""
    return "" if row.reproduces is None else ("yes" if row.reproduces else "no")
