"""report.html of the papers' tables: printed values beside measured ones, verdicts in colours and words, pictures."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from quadlog.results.page.html import render_page
from quadlog.results.papers.page import (
    JUDGED,
    RIGHT,
    SHOWN,
    Appendix,
    saved_tables,
    shown_cells,
    write_page,
)
from quadlog.results.papers.page import (
    REPORT as PAGE,
)
from quadlog.results.papers.table import PaperRow, PaperTable, SavedTable, TablePicture, Verdict, picture_file
from quadlog.version import __version__

MAX_PICTURE_BYTES = 3_000_000
"""Of all pictures inside the page; of more, the later ones are linked."""
_LOOKS = {
    Verdict.YES: ("✓", "good"),
    Verdict.NO: ("✗", "bad"),
    Verdict.UNDECIDED: ("?", "warn"),
    Verdict.NOT_COMPARABLE: ("–", ""),
}
"""Sign and colour of each verdict; its word is always there as well."""


class RelatedPage(NamedTuple):
    """A page about the same data as a table: what it has, the command that makes it here, its folder here."""

    what: str
    command: str
    folder: str


def write_report(
    folder: Path,
    names: Sequence[str],
    code: str,
    appendices: Sequence[Appendix],
    related: Mapping[str, RelatedPage],
    force: bool,
) -> Path:
    """The page of all tables in the folder, those of earlier commands included, in the order of names.

    code: digest of the current quadlog. related: by table. Raises AlreadyExists for another page, unless `force`.
    """
    saved = saved_tables(folder, names)
    linked = {name: each for name, each in related.items() if (folder / each.folder / PAGE).is_file()}
    write_page(folder / PAGE, render_tables(saved, code, appendices, related, linked), force)
    return folder / PAGE


def render_tables(
    saved: Sequence[SavedTable],
    code: str,
    appendices: Sequence[Appendix],
    related: Mapping[str, RelatedPage],
    linked: Mapping[str, RelatedPage],
) -> bytes:
    """The page. linked: those related pages that are there."""
    tables = [each.table for each in saved]
    room = MAX_PICTURE_BYTES
    sections = []
    for table in tables:
        inside = [picture for picture in table.pictures if (room := room - len(picture.png)) >= 0]
        sections.append(_section(table, inside) | {"related": related.get(table.name), "linked": table.name in linked})
    return render_page(
        "papers/page.html.jinja",
        styles=("papers/papers.css",),
        version=__version__,
        title="The papers' tables, measured again",
        totals=[_verdict_count(verdict, sum(table.count(verdict) for table in tables)) for verdict in Verdict],
        reproduced=sum(table.count(Verdict.YES) for table in tables),
        comparable=sum(table.comparable for table in tables),
        judged=JUDGED,
        fast=[table.name for table in tables if table.fast],
        old=[each.table.name for each in saved if each.origin.code != code],
        sections=sections,
        columns=[(name, name in RIGHT) for name in SHOWN],
        appendices=appendices,
    )


def _verdict_count(verdict: Verdict, number: int) -> dict[str, Any]:
    sign, kind = _LOOKS[verdict]
    return {"word": str(verdict), "sign": sign, "kind": kind, "number": number}


def _section(table: PaperTable, inside: Sequence[TablePicture]) -> dict[str, Any]:
    return {
        "table": table,
        "counts": [_verdict_count(verdict, table.count(verdict)) for verdict in Verdict],
        "groups": [(group.title, group.text, [_row(row) for row in group.rows]) for group in table.groups],
        "pictures": [_picture(table, picture, picture in inside) for picture in table.pictures],
        "files": [f"{table.name}.{suffix}" for suffix in ("csv", "tex", "json")],
    }


def _row(row: PaperRow) -> dict[str, Any]:
    """Cells in the order of SHOWN without the verdict, the numbers as they are saved, and the verdict's look."""
    sign, kind = _LOOKS[row.reproduces] if row.reproduces is not None else ("", "")
    *cells, word = shown_cells(row)
    return {
        "cells": [each.replace("-", "\N{MINUS SIGN}") if at else each for at, each in enumerate(cells)],
        "paper": row.paper,
        "ours": row.ours,
        "word": word,
        "sign": sign,
        "kind": kind,
        "note": row.note,
    }


def _picture(table: PaperTable, picture: TablePicture, inside: bool) -> dict[str, Any]:
    """Template values; width and height of a PNG stand at bytes 16 to 24 of it."""
    width, height = (int.from_bytes(picture.png[at : at + 4], "big") for at in (16, 20))
    return {
        "alt": picture.alt,
        "caption": picture.caption,
        "png": base64.b64encode(picture.png).decode() if inside else "",
        "width": width,
        "height": height,
        "link": f"./{quote(picture_file(table, picture))}",
    }
