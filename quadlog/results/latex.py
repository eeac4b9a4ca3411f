r"""LaTeX from text and tables that may contain anything; needs \usepackage{booktabs} and UTF-8 input."""

from __future__ import annotations

import re
from collections.abc import Sequence

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
# Six columns of figures beside it fit a page of a one-column article.
WRAPPED = r"p{0.32\linewidth}"
_NUMBER = re.compile(r"(-?)(\d+(?:\.\d+)?)(?:e([+-]\d+))?")


def escape_latex(text: str) -> str:
    """The text in one line, every character meant as it stands."""
    return _SPECIAL.sub(lambda found: _ESCAPED[found[0]], " ".join(text.split()))


def latex_table(
    caption: str,
    label: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    right: Sequence[str] = (),
    wrapped: Sequence[str] = (),
) -> str:
    """A floating table in booktabs style, cells escaped; numbers are set as mathematics, minus signs and all.

    Columns whose header is in `right` are aligned to the right, those in `wrapped` are broken into lines.
    """
    columns = "".join("r" if name in right else WRAPPED if name in wrapped else "l" for name in header)
    body = "\n".join(_line(row) for row in rows)
    return (
        "\\begin{table}\n\\centering\\footnotesize\\setlength{\\tabcolsep}{4pt}\n"
        f"\\caption{{{escape_latex(caption)}}}\n\\label{{{label}}}\n"
        f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{_line(header)}\n\\midrule\n{body}\n\\bottomrule\n"
        "\\end{tabular}\n\\end{table}\n"
    )


def _line(cells: Sequence[str]) -> str:
    return " & ".join(map(_cell, cells)) + r" \\"


def _cell(text: str) -> str:
    number = _NUMBER.fullmatch(text)
    if number is None:
        return escape_latex(text)
    sign, digits, exponent = number.groups()
    power = rf"\times10^{{{int(exponent)}}}" if exponent else ""
    return f"${sign}{digits}{power}$" if sign or power else digits
