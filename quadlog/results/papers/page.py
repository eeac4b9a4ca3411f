"""The page of the papers' tables: README, a CSV and LaTeX file for each, and the errata."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from quadlog.errors import CannotWrite, csv_table
from quadlog.results.papers.table import (
    Origin,
    PaperRow,
    PaperTable,
    RowGroup,
    SavedTable,
    TablePicture,
    Verdict,
    json_bytes,
    load_saved,
    picture_file,
)
from quadlog.results.run.outputs import refuse_existing
from quadlog.results.text.markup import escape_markdown, latex_document, latex_tables, markdown_table
from quadlog.results.text.numbers import short
from quadlog.storage.atomic_write import write_whole

HEADER = ("where", "printed", "right", "remark")


class Erratum(NamedTuple):
    """place: as the paper numbers it; printed and right: formulas or words; remark: what follows, may be empty."""

    place: str
    printed: str
    right: str
    remark: str = ""


def errata_text(errata: Mapping[str, Sequence[Erratum]], level: int) -> str:
    """A heading of that level and a table for each paper, in the order given."""
    return "\n".join(
        f"{'#' * level} {escape_markdown(paper)}\n\n{markdown_table(HEADER, mine)}" for paper, mine in errata.items()
    )


COLUMNS = ("quantity", "paper", "ours", "low", "high", "difference", "reproduces", "note")
SHOWN = ("quantity", "paper", "ours", "95 % interval", "difference", "reproduces")
RIGHT = ("paper", "ours", "95 % interval", "difference")
MARKS = {verdict: str(verdict) for verdict in Verdict} | {Verdict.NO: "✗ no"}
"""Verdicts as the page shows them."""


def csv_text(table: PaperTable) -> str:
    """All rows with six significant digits, an empty field where there is no value."""
    rows: list[Sequence[str]] = [COLUMNS]
    for row in table.rows:
        numbers = (row.paper, row.ours, row.low, row.high, row.difference)
        cells = [short(value, 6) for value in numbers]
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
        interval = f"{short(row.low)} to {short(row.high)}"
    numbers = short(row.paper), short(row.ours), interval, short(row.difference)
    return row.quantity, *numbers, format_verdict(row)


def _picture_block(table: PaperTable, picture: TablePicture) -> str:
    image = f"![{escape_markdown(picture.alt)}]({picture_file(table, picture)})"
    return f"{image}\n\n*{escape_markdown(picture.caption)}*"


def _group_blocks(group: RowGroup) -> list[str]:
    rows = [(*shown_cells(row)[:-1], _mark(row), row.note) for row in group.rows]
    body = markdown_table((*SHOWN, "note"), rows, RIGHT).rstrip("\n")
    return [f"### {escape_markdown(group.title)}", escape_markdown(group.text), body]


def format_verdict(row: PaperRow) -> str:
    """A Verdict's word, or empty."""
    return "" if row.reproduces is None else str(row.reproduces)


def _mark(row: PaperRow) -> str:
    return "" if row.reproduces is None else MARKS[row.reproduces]


PREFACE = """# The papers' tables, measured again

Each table has what a paper prints beside what quadlog finds: below, as `TABLE.csv`, as `TABLE.tex` (booktabs,
graphicx), and unrounded as `TABLE.json`.

- **paper** is empty where the paper prints no such number.
- **ours** is of all runs, and the **95 % interval** is that of the same statistic over the same runs; it is empty where
  ours is computed without any random draw.
- **reproduces** has one of four verdicts, and is empty where there is nothing to reproduce:
  - *yes*: ours, rounded to the digits that the paper prints, is the printed number. Where runs are drawn, our interval
    holds it and leaves out the contrary (a ratio of 1, a change of 0; without a contrary: all of the interval lies
    within a fifth of the printed number);
  - **✗ no**: our interval leaves out the printed number, or lies on the other side of what is claimed, with a note why.
    Where the paper prints its runs one by one, their scatter counts as well as that of ours;
  - *undecided*: the interval holds both;
  - *not comparable*: the paper does not say how its number came about, or ours rests on that very number.

  A claim in words, as "more than 5 times", is *yes* where all of the interval is on the claimed side. Where the paper
  prints by how much, a tenth of it is the least that counts.

A second `quadlog tables` into this folder measures nothing again that was measured by the same quadlog and the same
packages with the same seed. Another folder, or one without a table's JSON file, starts afresh.
"""
README_HEADER = ("table", "of", "reproduce", "do not", "undecided", "not comparable", "quantities in all", "made by")
JUDGED = "printed numbers and claims that can be compared reproduce; one measured in several settings counts in each."
FAST = "Tables made with `--fast` have fewer draws and wider intervals than the full ones."
OLD = "**Measured by another quadlog, or with other packages, than the last table here:**"


@dataclass(frozen=True, slots=True)
class AppendixTable:
    """A table of an appendix; an empty title is not shown."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    @property
    def markdown(self) -> str:
        """The title as a heading of level 3, and the table."""
        heading = f"### {escape_markdown(self.title)}\n\n" if self.title else ""
        return heading + markdown_table(self.header, self.rows)


@dataclass(frozen=True, slots=True)
class Appendix:
    """A section after the tables: a title, Markdown below it, and tables."""

    title: str
    text: str
    tables: Sequence[AppendixTable] = ()

    @property
    def markdown(self) -> str:
        """All but the title."""
        return "\n".join([self.text, *(each.markdown for each in self.tables)])


def readme_text(saved: Sequence[SavedTable], code: str, appendices: Sequence[Appendix]) -> str:
    """The whole page. code: digest of the current quadlog; tables measured by another one are listed."""
    sections = [f'<a id="{each.table.name}"></a>\n\n{section_text(each.table)}' for each in saved]
    ends = [f"## {escape_markdown(each.title)}\n\n{each.markdown}" for each in appendices]
    return "\n".join([PREFACE, _summary_text(saved, code), *sections, *ends])


def _summary_text(saved: Sequence[SavedTable], code: str) -> str:
    tables = [each.table for each in saved]
    others = (Verdict.NO, Verdict.UNDECIDED, Verdict.NOT_COMPARABLE)
    lines = markdown_table(
        README_HEADER,
        [
            (
                *(table.name, table.title, _share(table)),
                *(str(table.count(each)) for each in others),
                *(str(len(table.rows)), table.command),
            )
            for table in tables
        ],
        README_HEADER[2:7],
    )
    for table in tables:
        name = escape_markdown(table.name)
        lines = lines.replace(f"\n| {name} |", f"\n| [{name}](#{table.name}) |", 1)
    reproduced = sum(table.count(Verdict.YES) for table in tables)
    blocks = [
        "## What reproduces",
        f"{reproduced} of {sum(table.comparable for table in tables)} {JUDGED}",
        lines.rstrip("\n"),
    ]
    if any(table.fast for table in tables):
        blocks.append(FAST)
    old = [each.table.name for each in saved if each.origin.code != code]
    if old:
        blocks.append(f"{OLD} {', '.join(old)}.")
    return "\n\n".join(blocks) + "\n"


def _share(table: PaperTable) -> str:
    return f"{table.count(Verdict.YES)} of {table.comparable}" if table.comparable else "none printed"


README, REPORT = "README.md", "report.html"


def reusable_tables(folder: Path, names: Sequence[str], origin: Origin) -> list[SavedTable]:
    """Those of the named tables that are complete in a folder and have this origin."""
    saved = (load_saved(folder, name) for name in names)
    return [each for each in saved if each is not None and each.origin == origin]


def prepare_folder(folder: Path, names: Sequence[str], reused: Sequence[SavedTable], force: bool) -> None:
    """Make the folder, before the named tables are measured.

    Raises CannotWrite, and unless `force` AlreadyExists for the pages and for a file of theirs,
    and for a file of a reused table that is not as it would be written.
    """
    for path in _in_the_way(folder, names, reused):
        refuse_existing(path, force)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(folder, error.strerror or str(error)) from error


def write_table(folder: Path, saved: SavedTable) -> None:
    """Write the files of a table; its JSON file last, since it marks the others as complete."""
    for name, content in _files(saved).items():
        if not _holds(folder / name, content):
            write_whole(folder / name, content)


def write_readme(folder: Path, names: Sequence[str], code: str, appendices: Sequence[Appendix], force: bool) -> Path:
    """The page of all tables in the folder, those of earlier commands included, in the order of names.

    Raises AlreadyExists for another page, unless `force`.
    """
    page = folder / README
    write_page(page, readme_text(saved_tables(folder, names), code, appendices).encode(), force)
    return page


def saved_tables(folder: Path, names: Sequence[str]) -> list[SavedTable]:
    """The named tables that are complete in the folder."""
    return [each for name in names if (each := load_saved(folder, name)) is not None]


def write_page(page: Path, content: bytes, force: bool) -> None:
    """Write a page unless it is as it should be; raises AlreadyExists for another one, unless `force`."""
    if not _holds(page, content):
        refuse_existing(page, force)
        write_whole(page, content)


def _in_the_way(folder: Path, names: Sequence[str], reused: Sequence[SavedTable]) -> Iterator[Path]:
    if names:
        yield from (folder / README, folder / REPORT)
    for name in names:
        yield from (folder / f"{name}.{suffix}" for suffix in ("csv", "tex", "json"))
        yield from sorted(folder.glob(f"{name}-*.png"))
    for saved in reused:
        yield from (folder / name for name, content in _files(saved).items() if not _holds(folder / name, content))


def _files(saved: SavedTable) -> dict[str, bytes]:
    """Contents of a table's files by name, in the order of writing."""
    table = saved.table
    pictures = {picture_file(table, picture): picture.png for picture in table.pictures}
    texts = {f"{table.name}.csv": csv_text(table).encode(), f"{table.name}.tex": latex_text(table).encode()}
    return {**pictures, **texts, f"{table.name}.json": json_bytes(saved)}


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content
