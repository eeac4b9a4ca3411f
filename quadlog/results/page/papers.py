"""The page of the papers' tables: which claims reproduce, and each table with printed values beside measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from quadlog.results.numbers import count, sig
from quadlog.results.page.blocks import (
    Cell,
    Column,
    Details,
    Notes,
    Page,
    Picture,
    Section,
    Sentence,
    Table,
    Text,
)
from quadlog.results.page.blocks import Verdict as Findings
from quadlog.results.papers.picture import table_picture
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, SavedTable, Verdict
from quadlog.results.words import State

LOOKS: dict[Verdict, tuple[str, State, str]] = {
    Verdict.NO: ("Do not", "bad", "print and ours are not of one kind, or ours is beyond the claim; a note says why"),
    Verdict.UNDECIDED: (
        "Undecided",
        "warn",
        "our interval holds it and its contrary, or settings contradict each other",
    ),
    Verdict.YES: ("Reproduce", "good", "our interval holds the number and not its contrary, or is on the claim's side"),
    Verdict.NOT_COMPARABLE: (
        "Not comparable",
        "",
        "its origin is not given, our value depends on it, or it holds by construction",
    ),
}
"""Word, colour and rule of each verdict, worst first."""


def papers_page(saved: Sequence[SavedTable], code: str) -> Page:
    """The page of all tables in a folder. code: digest of the current quadlog; tables of another one are named."""
    tables = [of.table for of in saved]
    verdicts = [verdict for table in tables for verdict in table.claims.values()]
    findings = [
        Sentence(word, f"{number} of {len(verdicts)} claims: {rule}.", state)
        for verdict, (word, state, rule) in LOOKS.items()
        if (number := verdicts.count(verdict))
    ]
    first: list[Any] = [Findings(findings)]
    fast, old = [t.name for t in tables if t.fast], [of.table.name for of in saved if of.origin.code != code]
    notes = []
    if fast:
        notes.append(f"Fast runs, with fewer draws and wider intervals than the full tables: {', '.join(fast)}.")
    if old:
        notes.append(f"Measured by another quadlog, or with other packages, than the last table: {', '.join(old)}.")
    if notes:
        first.append(Notes("Not all alike", notes))
    first.append(_overview(tables))
    facts = [
        f"{count(len(tables))} table{'s' * (len(tables) != 1)}",
        f"{count(len(verdicts))} printed numbers and claims, counted once for all settings",
    ]
    sections = [Section("", first), *map(_section, tables)]
    return Page("The papers' tables, measured again", sections, [*facts, "errata: docs/errata.md"])


def _overview(tables: Sequence[PaperTable]) -> Table:
    columns = [Column("table"), Column("of", wide=True), *(Column(str(verdict), True) for verdict in LOOKS)]
    rows = []
    for table in tables:
        verdicts = [*table.claims.values()]
        counts = [(verdicts.count(verdict), state) for verdict, (_, state, _) in LOOKS.items()]
        cells = [Cell(str(number) if number else "", number, state=state) for number, state in counts]
        rows.append([Cell(table.name, href=f"#{table.name}"), Cell(table.title), *cells, Cell(str(len(table.rows)))])
    return Table([*columns, Column("quantities", True)], rows, "tables")


LEGEND = "Ours with 95 % intervals, in the colour of the verdict; 0 is the printed value or claim, ±10 the edge."


def _section(table: PaperTable) -> Section:
    files = f"{table.name}.csv, {table.name}.tex and {table.name}.json"
    fast = " (a fast run)" if table.fast else ""
    blocks: list[Any] = [Text(f"{table.reproduced}. {table.sizes} Made by {table.command}{fast}; also as {files}.")]
    for number, group in enumerate(table.groups):
        blocks.append(_group(group, f"{table.name}-{number}"))
    picture = table_picture(table)
    if picture is not None:
        blocks.append(Picture(picture, f"{table.title}: our numbers beside the printed ones.", LEGEND))
    return Section(table.name, blocks, f"{table.title}. {table.caption}".replace("`", ""))


def _group(group: RowGroup, name: str) -> Table | Details:
    """What the paper has first; other quantities on demand."""
    judged = [row for row in group.rows if row.paper is not None or row.reproduces is not None]
    others = [row for row in group.rows if row not in judged]
    columns = [Column("quantity"), Column("paper", True), Column("ours", True), Column("95 % interval", True),
               Column("reproduces"), Column("note", wide=True)]  # fmt: skip
    rows = [_row(row) for row in (*judged, *others)]
    if judged:
        return Table(columns, rows, name, group.text, folded=len(judged) if others else None, title=group.title)
    own = [Column("quantity"), Column("ours", True), Column("95 % interval", True), Column("note", wide=True)]
    cells = [[row[0], row[2], row[3], row[5]] for row in rows]
    summary = f"{group.title}: {len(rows)} quantities that the paper does not print"
    return Details(summary, [Table(own, cells, name, group.text)])


def _row(row: PaperRow) -> list[Cell]:
    interval = "" if row.low is None or row.high is None else f"{sig(row.low, 4)} to {sig(row.high, 4)}"
    state: State = "" if row.reproduces is None else LOOKS[row.reproduces][1]
    paper = row.claim or ("" if row.paper is None else sig(row.paper, 4))
    return [
        Cell(row.quantity),
        Cell(paper, row.paper),
        Cell(sig(row.ours, 4), row.ours),
        Cell(interval),
        Cell("" if row.reproduces is None else str(row.reproduces), state=state),
        Cell(row.note),
    ]
