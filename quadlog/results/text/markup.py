r"""LaTeX, Markdown and plain-text tables from text that may contain anything.

LaTeX needs \usepackage{booktabs,graphicx} and UTF-8 input. Tables fit a plain one-column article: wider ones are
scaled down, longer ones are continued on the next page.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Container, Sequence
from itertools import accumulate

from quadlog.errors import printable

_ESCAPED = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "`": r"\textasciigrave{}",
    '"': r"\textquotedblright{}",
    **{each: rf"\{each}" for each in "&%$#_{}"},
    # What pdflatex has no glyph for in its text fonts.
    "\u2212": "$-$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "≈": r"$\approx$",
    "→": r"$\rightarrow$",
    "√": r"$\surd$",
    "°": r"$^\circ$",
    "²": "$^2$",
    "³": "$^3$",
    "η": r"$\eta$",
    "σ": r"$\sigma$",
    "μ": r"$\mu$",
    "λ": r"$\lambda$",
    "θ": r"$\theta$",
    "τ": r"$\tau$",
    "χ": r"$\chi$",
    "Δ": r"$\Delta$",
}
_SPECIAL = re.compile("[" + re.escape("".join(_ESCAPED)) + "]")
_NEEDS_T1 = "ÐÞðþĄąĐđĘęĦħĮįĸĿŀŉŊŋŦŧŲųſ"
# Beside ASCII and _ESCAPED, what pdflatex sets in its usual fonts; each was tried.
_SET = frozenset(map(chr, range(0xC0, 0x180))) - set(_NEEDS_T1) | set("¡£§©ª®µ¶º¿‐–—‘’“”†‡•…€™")
_LOST = "?"  # for characters that no font has; LaTeX stops at most of them
_LONG_WORD = re.compile(r"\S{25,}")
_PART = re.compile(r"[^-_./\\:,;=|]{1,12}[-_./\\:,;=|]*|[-_./\\:,;=|]+")
_NUMBER = re.compile(r"(-?)(\d+(?:\.\d+)?)(?:e([+-]\d+))?")

WRAPPED = r"p{0.32\linewidth}"
WIDEST_PT = 455.0
"""A table's own width at which its letters are of 6 pt when it is shrunk to a one-column article's 345 pt."""
LINES_A_PAGE = 46
"""Of \\footnotesize, below a caption of four lines, on a page of an article."""
_LETTER_PT, _BETWEEN_PT = 4.25, 6.0
_WRAPPED_LETTERS, _BELOW_LETTERS = 24, 72  # what a line holds at least


def escape_latex(text: str) -> str:
    """The text in one line, special characters escaped, unprintable ones replaced by question marks."""
    line = unicodedata.normalize("NFC", " ".join(text.split()))
    seen = "".join(each if each.isprintable() and each != "\N{REPLACEMENT CHARACTER}" else _LOST for each in line)
    return _SPECIAL.sub(lambda found: _ESCAPED[found[0]], seen)


def breakable_latex(text: str) -> str:
    """As escape_latex; long words, such as paths, may be broken into lines."""
    return " ".join(
        r"\allowbreak{}".join(map(escape_latex, _PART.findall(word)))
        if _LONG_WORD.fullmatch(word)
        else escape_latex(word)
        for word in text.split()
    )


def latex_document(comments: Sequence[str], tables: Sequence[str]) -> str:
    r"""Tables to \input, after comments: required packages, and `comments`."""
    lines = [r"needs \usepackage{booktabs,graphicx}"]
    if other := sorted({each for table in tables for each in table if not each.isascii()} - _SET):
        lines.append(f"needs XeLaTeX or LuaLaTeX and a font that has {' '.join(other)}, which pdflatex cannot set")
    return "\n".join([*(f"% {printable(line)}" for line in (*lines, *comments)), *tables])


def latex_tables(
    caption: str,
    label: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Sequence[str] = (),
    wrapped: Sequence[str] = (),
    below: Callable[[Sequence[Sequence[str]]], str] = lambda _: "",
) -> list[str]:
    """latex_table for each page that the rows fill, the first row's number in the labels of all but the first.

    below: text under the table with these rows.
    """
    places = [place for place, name in enumerate(header) if name in wrapped]

    def lines(page: Sequence[Sequence[str]]) -> int:
        high = sum(max([1, *(_lines(row[place], _WRAPPED_LETTERS) for place in places)]) for row in page)
        return high + _lines(below(page), _BELOW_LETTERS)

    pages: list[list[Sequence[str]]] = [[]]
    for row in rows:
        if pages[-1] and lines([*pages[-1], row]) > LINES_A_PAGE:
            pages.append([])
        pages[-1].append(row)
    tables, first = [], 0
    for page in pages:
        more = (f"{caption} (continued)", f"{label}-{first}") if first else (caption, label)
        tables.append(latex_table(*more, header, page, right, wrapped, below(page)))
        first += len(page)
    return tables


def latex_table(
    caption: str,
    label: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Sequence[str] = (),
    wrapped: Sequence[str] = (),
    below: str = "",
) -> str:
    """A floating table in booktabs style, cells escaped; numbers are set as mathematics, minus signs and all.

    Columns whose header is in `right` are aligned to the right, those in `wrapped` are broken into lines.
    """
    columns = "".join("r" if name in right else WRAPPED if name in wrapped else "l" for name in header)
    places = {place for place, name in enumerate(header) if name in wrapped}
    body = "\n".join(_line(row, places) for row in rows)
    legend = f"\\par\\smallskip{{\\raggedright {breakable_latex(below)}\\par}}\n" if below else ""
    return (
        # The stretch is for captions and cells with long paths.
        "\\begin{table}\n\\centering\\footnotesize\\setlength{\\tabcolsep}{3pt}\\emergencystretch=\\linewidth\n"
        f"\\caption{{{breakable_latex(caption)}}}\n\\label{{{label}}}\n"
        "\\resizebox{\\ifdim\\width>\\linewidth\\linewidth\\else\\width\\fi}{!}{%\n"
        f"\\begin{{tabular}}{{@{{}}{columns}@{{}}}}\n\\toprule\n{_line(header)}\n\\midrule\n{body}\n\\bottomrule\n"
        f"\\end{{tabular}}}}\n{legend}\\end{{table}}\n"
    )


def width_pt(header: Sequence[str], rows: Sequence[Sequence[str]]) -> float:
    """Approximate width of the columns before scaling."""
    letters = sum(max(map(len, column)) for column in zip(header, *rows, strict=True))
    return letters * _LETTER_PT + (len(header) - 1) * _BETWEEN_PT


def _lines(text: str, letters: int) -> int:
    return -(-len(text) // letters)


def _line(cells: Sequence[str], wrapped: Container[int] = ()) -> str:
    line = " & ".join(("\\raggedright " if at in wrapped else "") + _cell(cell) for at, cell in enumerate(cells))
    # LaTeX would read these as an option of the line end or rule before.
    return ("{}" if line.startswith(("[", "*")) else "") + line + r" \\"


def _cell(text: str) -> str:
    number = _NUMBER.fullmatch(text)
    if number is None:
        return escape_latex(text)
    sign, digits, exponent = number.groups()
    power = rf"\times10^{{{int(exponent)}}}" if exponent else ""
    return f"${sign}{digits}{power}$" if sign or power else digits


def aligned(rows: Sequence[Sequence[str]], left: Container[int] = (), gaps: Sequence[int] | None = None) -> list[str]:
    """Lines of plain text in aligned columns, to the right but for the columns in `left`.

    gaps: spaces before each column, those before the first are left out; two without it.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    ends = list(accumulate(width + gap for width, gap in zip(widths, gaps or [2] * len(widths), strict=True)))
    lines = []
    for row in rows:
        line = ""
        for at, (cell, width, end) in enumerate(zip(row, widths, ends, strict=True)):
            line += (cell.ljust(width) if at in left else cell).rjust(end - len(line))
        lines.append(line[ends[0] - widths[0] :].rstrip())
    return lines


_MARKDOWN_SPECIAL = re.compile(r"([\\`*_\[\]<>|~$&#])")
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")
_LIST_ITEM = re.compile(r"^(\d*)([-+.)])(?=[\s-]|$)")  # what a paragraph must not begin with


def escape_markdown(text: str) -> str:
    """The text in one line, special characters escaped, control characters replaced."""
    line = _MARKDOWN_SPECIAL.sub(r"\\\1", _CONTROL.sub("\N{REPLACEMENT CHARACTER}", " ".join(text.split())))
    return _LIST_ITEM.sub(r"\1\\\2", line)


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str] = ()) -> str:
    """A table as GitHub reads it, cells escaped; columns whose header is in `right` are aligned to the right."""
    lines = [_markdown_line(header), "|" + "|".join("---:" if name in right else "---" for name in header) + "|"]
    lines += [_markdown_line(row) for row in rows]
    return "\n".join(lines) + "\n"


def _markdown_line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(map(escape_markdown, cells)) + " |"
