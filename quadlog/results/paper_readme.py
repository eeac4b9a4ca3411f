"""The page of the papers' tables: what reproduces, the tables, and what stands behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from quadlog.results.markdown import escape_markdown, markdown_table
from quadlog.results.paper_page import section_text
from quadlog.results.paper_store import SavedTable

PREFACE = """# The papers' tables, measured again

Each table has what a paper prints beside what quadlog finds: below, as `TABLE.csv`, as `TABLE.tex` (booktabs,
graphicx), and unrounded as `TABLE.json`.

- **paper** is empty where the paper prints no such number.
- **95 % interval** is that of ours; it is empty where ours is computed without any random draw.
- **reproduces** is *yes* where ours, rounded to the digits that the paper prints, is the printed number, or where the
  interval holds it; **✗ no** otherwise, with a note why; empty where there is nothing to reproduce. A claim in words,
  as "more than 5 times", has its own rule, which stands above its rows.

A second `quadlog tables` into this folder measures nothing again that was measured by the same quadlog and the same
packages with the same seed. Another folder, or one without a table's JSON file, starts afresh.
"""
HEADER = ("table", "of", "printed numbers that reproduce", "quantities in all", "made by")
JUDGED = "printed numbers and claims that can be judged; one that is measured in several settings counts in each."
FAST = "Tables made with `--fast` have fewer draws and wider intervals than the full ones."
OLD = "**Measured by another quadlog, or with other packages, than the last table here:**"


@dataclass(frozen=True, slots=True)
class Appendix:
    """What the page says beside its tables: a title, and Markdown under it."""

    title: str
    text: str


def readme_text(saved: Sequence[SavedTable], code: str, appendices: Sequence[Appendix]) -> str:
    """The whole page. code: that of the last command's tables; what another one measured is said."""
    sections = [f'<a id="{each.table.name}"></a>\n\n{section_text(each.table)}' for each in saved]
    ends = [f"## {escape_markdown(each.title)}\n\n{each.text}" for each in appendices]
    return "\n".join([PREFACE, _summary_text(saved, code), *sections, *ends])


def _summary_text(saved: Sequence[SavedTable], code: str) -> str:
    tables = [each.table for each in saved]
    verdicts = [[row.reproduces is True for row in table.judged] for table in tables]
    lines = markdown_table(
        HEADER,
        [
            (table.name, table.title, _share(mine), str(len(table.rows)), table.command)
            for table, mine in zip(tables, verdicts, strict=True)
        ],
        HEADER[2:4],
    )
    for table in tables:
        name = escape_markdown(table.name)
        lines = lines.replace(f"\n| {name} |", f"\n| [{name}](#{table.name}) |", 1)
    everything = [verdict for mine in verdicts for verdict in mine]
    blocks = [
        "## What reproduces",
        f"{sum(everything)} of {len(everything)} {JUDGED}",
        lines.rstrip("\n"),
    ]
    if any(table.fast for table in tables):
        blocks.append(FAST)
    old = [each.table.name for each in saved if each.origin.code != code]
    if old:
        blocks.append(f"{OLD} {', '.join(old)}.")
    return "\n\n".join(blocks) + "\n"


def _share(verdicts: Sequence[bool]) -> str:
    return f"{sum(verdicts)} of {len(verdicts)}" if verdicts else "none printed"
