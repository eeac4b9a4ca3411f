"""Errata of the papers as a Markdown table each: for the page of the tables, and for docs/errata.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from quadlog.results.markdown import escape_markdown, markdown_table

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
