"""The page of the papers' tables: which claims reproduce, and each table with printed values beside measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Sentence, Table
from quadlog.results.page.pack import Pack
from quadlog.results.studies.papers import PaperRow, PaperTable, RowGroup, Verdict, shown_cells, table_panel
from quadlog.results.text import State, count

LOOKS: dict[Verdict, tuple[str, State, str]] = {
    Verdict.NO: ("Do not", "bad", "print and ours are not of one kind, or ours is beyond the claim; a note says why"),
    Verdict.UNDECIDED: ("Undecided", "warn", "our interval holds it and its contrary, or settings disagree"),
    Verdict.YES: ("Reproduce", "good", "our interval holds the number and not its contrary, or is on the claim's side"),
    Verdict.NOT_COMPARABLE: ("Not comparable", "", "of unknown origin, ours rests on it, or it holds by construction"),
}  # fmt: skip
"""Word, colour and rule of each verdict, worst first."""


def papers_page(tables: Sequence[PaperTable]) -> blocks.Page:
    """The page of these tables."""
    verdicts, pack = [verdict for table in tables for verdict in table.claims.values()], Pack()
    findings = [
        Sentence(word, f"{number} of {len(verdicts)} claims: {rule}.", state)
        for verdict, (word, state, rule) in LOOKS.items()
        if (number := verdicts.count(verdict))
    ]
    first: list[Any] = [blocks.Verdict(findings)]
    if fast := [table.name for table in tables if table.fast]:
        words = f"Fast runs, with fewer draws and wider intervals than the full tables: {', '.join(fast)}."
        first.append(blocks.Notes("Fewer draws", [words]))
    facts = [
        f"{count(len(tables))} table{'s' * (len(tables) != 1)}",
        f"{count(len(verdicts))} printed numbers and claims, counted once for all settings",
        "errata: docs/errata.md",
    ]
    sections = [blocks.Section("", [*first, _overview(tables)]), *(_section(table, pack) for table in tables)]
    return blocks.Page("The papers' tables, measured again", sections, facts, pack=pack)


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


def _section(table: PaperTable, pack: Pack) -> blocks.Section:
    files = f"{table.name}.csv, {table.name}.tex and {table.name}.json"
    fast = " (a fast run)" if table.fast else ""
    words = f"{table.reproduced}. {table.sizes} Made by {table.command}{fast}; also as {files}."
    shown: list[Any] = [blocks.Text(words)]
    shown += [_group(group, f"{table.name}-{number}") for number, group in enumerate(table.groups)]
    if (panel := table_panel(table)) is not None:
        pack.add(f"{table.name}-picture", [panel])
        shown.append(blocks.Drawn(f"{table.name}-picture", "Beside the printed numbers", LEGEND))
    return blocks.Section(table.name, shown, f"{table.title}. {table.caption}".replace("`", ""))


def _group(group: RowGroup, name: str) -> Table | blocks.Details:
    """What the paper has first; other quantities on demand."""
    judged = [row for row in group.rows if row.paper is not None or row.reproduces is not None]
    others = [row for row in group.rows if row not in judged]
    columns = [Column("quantity"), Column("paper", True), Column("ours", True), Column("95 % interval", True),
               Column("reproduces"), Column("note", wide=True)]  # fmt: skip
    rows = [_row(row) for row in (*judged, *others)]
    if judged:
        return Table(columns, rows, name, group.text, folded=len(judged) if others else None, title=group.title)
    summary = f"{group.title}: not printed in the paper ({len(rows)})"
    shown = (0, 2, 3, 5)  # no print, nothing to reproduce
    own = Table([columns[at] for at in shown], [[row[at] for at in shown] for row in rows], name, group.text)
    return blocks.Details(summary, [own])


def _row(row: PaperRow) -> list[Cell]:
    quantity, paper, ours, interval, _, reproduces = shown_cells(row)
    state: State = "" if row.reproduces is None else LOOKS[row.reproduces][1]
    numbers = [Cell(paper, row.paper), Cell(ours, row.ours), Cell(interval)]
    return [Cell(quantity), *numbers, Cell(str(reproduces), state=state), Cell(row.note)]
