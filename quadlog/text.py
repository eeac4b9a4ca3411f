"""Text that came from outside, made safe to show on a terminal and to paste into a shell."""

from __future__ import annotations

import csv
import io
import re
import shlex
from collections.abc import Iterable, Sequence

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_NUMBER = re.compile(r"[+-][0-9]+(\.[0-9]+)?(e[+-]?[0-9]+)?")


def printable(text: object) -> str:
    """One line without control characters, which a terminal would obey: white space becomes a space."""
    return "".join(map(_harmless, str(text)))


def clipped(text: object, most: int = 200) -> str:
    """The text, or its beginning and how much longer it is: a name in a damaged file can be megabytes long."""
    words = str(text)
    return words if len(words) <= most else f"{words[:most]}... ({len(words) - most} more characters)"


MAX_LISTED = 20


def some_of(names: Sequence[str]) -> str:
    """The names, or the first of them and how many more there are."""
    more = [f"and {len(names) - MAX_LISTED} more"] if len(names) > MAX_LISTED else []
    return ", ".join([*(clipped(name) for name in names[:MAX_LISTED]), *more])


def set_flag(key: str, values: Sequence[str]) -> str:
    """`--set key=value` to paste into a shell: one value as it is, several as a TOML list.

    What a terminal would obey is written as TOML's escape, so that the flag means the very same name.
    """
    if len(values) == 1 and values[0].startswith("/") and values[0].isprintable() and values[0] == values[0].strip():
        value = values[0]  # no TOML value starts with a slash: it is taken as text
    elif len(values) == 1:
        value = _toml_string(values[0])
    else:
        value = f"[{', '.join(map(_toml_string, values))}]"
    return f"--set {shlex.quote(f'{key}={value}')}"


def csv_table(rows: Iterable[Iterable[object]]) -> str:
    """Rows as CSV, texts so that no spreadsheet takes them for formulas."""
    lines = []
    for row in rows:
        line = io.StringIO(newline="")
        # A carriage return in a text is quoted only where lines end with one.
        csv.writer(line, lineterminator="\r\n").writerow([csv_cell(each) for each in row])
        lines.append(line.getvalue().removesuffix("\r\n"))
    return "".join(f"{line}\n" for line in lines)


def csv_cell(value: object) -> object:
    """A text that begins like a formula behind an apostrophe, as spreadsheets have it; numbers stay what they are."""
    formula = isinstance(value, str) and value.startswith(_FORMULA) and not _NUMBER.fullmatch(value)
    return f"'{value}" if formula else value


def _harmless(each: str) -> str:
    if each.isprintable():
        return each
    return " " if each.isspace() else "\N{REPLACEMENT CHARACTER}"


def _toml_string(text: str) -> str:
    return f'"{"".join(map(_toml_escape, text))}"'


def _toml_escape(each: str) -> str:
    if each in '"\\':
        return f"\\{each}"
    return each if each.isprintable() else f"\\U{ord(each):08X}"
