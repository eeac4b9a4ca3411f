"""Markdown from text and tables that may contain anything."""

from __future__ import annotations

import re
from collections.abc import Sequence

_SPECIAL = re.compile(r"([\\`*_\[\]<>|~$&#])")
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")
_LIST_ITEM = re.compile(r"^(\d*)([-+.)])(?=[\s-]|$)")  # what a paragraph must not begin with


def escape_markdown(text: str) -> str:
    """The text in one line, every character meant as it stands; control characters are replaced."""
    line = _SPECIAL.sub(r"\\\1", _CONTROL.sub("\N{REPLACEMENT CHARACTER}", " ".join(text.split())))
    return _LIST_ITEM.sub(r"\1\\\2", line)


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str] = ()) -> str:
    """A table as GitHub reads it, cells escaped; columns whose header is in `right` are aligned to the right."""
    lines = [_line(header), "|" + "|".join("---:" if name in right else "---" for name in header) + "|"]
    lines += [_line(row) for row in rows]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(map(escape_markdown, cells)) + " |"
