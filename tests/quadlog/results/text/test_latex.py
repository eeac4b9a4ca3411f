from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import printable
from quadlog.metrics.summary import Measured, MeasuredRun, SampleSummary, spread
from quadlog.results.papers.page import latex_text
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup
from quadlog.results.planner_comparison.tables import PLANNERS, format_rows
from quadlog.results.run.tables import METRIC_NAMES
from quadlog.results.text.markup import (
    LINES_A_PAGE,
    breakable_latex,
    escape_latex,
    latex_document,
    latex_table,
    latex_tables,
)
from quadlog.results.text.metrics import format_metrics

HIDDEN = "\x1b\x00\u202e\u200f\udcff\ufffd"
LONG_NAMES = [
    "2024-05-01-a-recording-of-a-walk-through-the-yard",
    "x" * 120,
    "/data/" + "ab_c/" * 30,
    f"[{HIDDEN}é「日本」😀",
]
needs_pdflatex = pytest.mark.skipif(
    shutil.which("pdflatex") is None, reason="no LaTeX is installed: nothing is typeset"
)


def typeset(folder: Path, *tables: str) -> str:
    """The log of pdflatex for a plain one-column article that has these tables."""
    head = r"\documentclass{article}\usepackage{booktabs,graphicx}"
    (folder / "t.tex").write_text("\n".join([head, r"\begin{document}", *tables, r"\end{document}"]))
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, check=False)
    log = done.stdout.decode("utf-8", "replace")
    assert done.returncode == 0, log
    assert (folder / "t.pdf").read_bytes().startswith(b"%PDF")
    return log


def metrics_of(labels: list[str]) -> str:
    """Every metric of the catalogue, with values as wide as they get."""
    summary = SampleSummary(-0.0012345, 23520, 0.0012345, 0.0012345, 0.0012345, 0.012345, (-0.0012345, 0.0012345))
    measured = {name: Measured(-0.0012345, 23520, "N·m", summary) for name in METRIC_NAMES}
    runs = [MeasuredRun(Path(label), label, measured) for label in labels]
    found = spread([-0.0012345 * (1 + number % 3) for number in range(len(runs))])
    return format_metrics(runs, {name: found for name in METRIC_NAMES if found}, "latex")


def _is_balanced(text: str) -> bool:
    depth = 0
    for brace in re.findall(r"(?<!\\)[{}]", text):
        depth += 1 if brace == "{" else -1
        if depth < 0:
            return False
    return depth == 0


@given(st.text('abc&%$#_{}~^\\<>|`" \n', max_size=30))
def test_no_character_keeps_a_meaning_that_was_not_meant(text):
    escaped = escape_latex(text)
    assert _is_balanced(escaped)
    assert "\n" not in escaped
    # What is left without escapes and commands of ours is plain.
    plain = re.sub(r"\\[&%$#_{}]|\\text[a-z]+\{\}", "", escaped)
    assert not re.search(r"[&%$#_{}~^\\<>|`\"]", plain)


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("gauss_newton", r"gauss\_newton"),
        ("95 % of R&D", r"95 \% of R\&D"),
        ("C:\\x", r"C:\textbackslash{}x"),
        ("σ ≤ 3°, −1", r"$\sigma$ $\leq$ 3$^\circ$, $-$1"),
        ("Cramér–Rao", "Cramér–Rao"),
        ("Crame\u0301r", "Cramér"),
        (f"a{HIDDEN}b", "a??????b"),
        (printable(f"a{HIDDEN}b"), "a??????b"),
    ],
)
def test_known_text(text, escaped):
    assert escape_latex(text) == escaped


def test_a_table_is_booktabs_with_caption_label_and_numbers_in_mathematics():
    got = latex_table("A & B", "tab:x-1", ("name", "ours"), [("a_b", "-0.5"), ("c", "1.2e-05"), ("d", "")], ("ours",))
    assert got.splitlines() == [
        r"\begin{table}",
        r"\centering\footnotesize\setlength{\tabcolsep}{3pt}\emergencystretch=\linewidth",
        r"\caption{A \& B}",
        r"\label{tab:x-1}",
        r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
        r"\begin{tabular}{@{}lr@{}}",
        r"\toprule",
        r"name & ours \\",
        r"\midrule",
        r"a\_b & $-0.5$ \\",
        r"c & $1.2\times10^{-5}$ \\",
        r"d &  \\",
        r"\bottomrule",
        r"\end{tabular}}",
        r"\end{table}",
    ]


@pytest.mark.parametrize("name", LONG_NAMES)
def test_a_long_word_may_be_broken_and_loses_nothing(name):
    broken = breakable_latex(name)
    assert broken.replace(r"\allowbreak{}", "") == escape_latex(name)
    assert (r"\allowbreak{}" in broken) == (len(name) > 24)
    assert (
        breakable_latex("as many words as you like, well-known or not")
        == "as many words as you like, well-known or not"
    )


def test_a_document_says_what_it_needs():
    table = latex_table("τ ≤ é–", "tab:x", ("a",), [("°",)])
    assert latex_document(["one\x1b", "two"], [table]).splitlines()[:4] == [
        r"% needs \usepackage{booktabs,graphicx}",
        "% one\ufffd",
        "% two",
        r"\begin{table}",
    ]
    other = latex_table("日本 😀 ą", "tab:x", ("a",), [])
    assert latex_document([], [table, other]).splitlines()[1] == (
        "% needs XeLaTeX or LuaLaTeX and a font that has ą 日 本 😀, which pdflatex cannot set"
    )


def test_rows_that_fill_a_page_go_on_in_a_table_of_their_own():
    rows = [(f"row {number}",) for number in range(LINES_A_PAGE + 1)]
    first, second = latex_tables("A", "tab:x", ("a",), rows)
    assert r"\label{tab:x}" in first
    assert rf"\label{{tab:x-{LINES_A_PAGE}}}" in second
    assert r"\caption{A (continued)}" in second
    assert re.findall(r"row \d+", first + second) == [row for (row,) in rows]
    low = [("word " * 20,)] * 20
    assert len(latex_tables("A", "tab:x", ("a",), low)) == 1
    assert len(latex_tables("A", "tab:x", ("a",), low, wrapped=("a",))) == 3
    told = latex_tables("A", "tab:x", ("a",), rows[:40], below=lambda page: "; ".join("word " * 20 for _ in page))
    assert len(told) == 3


@needs_pdflatex
def test_pdflatex_sets_any_name_and_what_it_cannot_set_is_said(tmp_path):
    nasty = "a_b%c&d#e$f^g~h{i}\\ <|>`\"' é ±×·≤≥≈→√°²³ησμλθτχΔ−" + HIDDEN
    western = "".join(chr(code) for code in range(0xC0, 0x180)) + "¡£§©ª®µ¶º¿‐–—‘’“”†‡•…€™"
    comment = latex_document([], [latex_table(western, "tab:y", ("a",), [])]).splitlines()[1]
    settable = "".join(each for each in western if each not in comment)
    assert len(settable) > 150
    rows = [(name, nasty) for name in ("[x]", "*", r"\input{x}", settable[:100], settable[100:])]
    typeset(tmp_path, latex_table(nasty, "tab:x-1", ("[", "ours"), rows, wrapped=("[",)))


@needs_pdflatex
def test_every_kind_of_table_fits_the_page_of_a_plain_article(tmp_path):
    names = [name.replace("「日本」😀", "") for name in LONG_NAMES]
    many = [f"walk-{number}" for number in range(100)]
    metrics = [metrics_of(labels) for labels in (many[:1], many[:3], many[:6], many, names[1:2], names * 2, names)]
    planners = [
        dict.fromkeys(PLANNERS.names, 123456.7) | {"source": name, "planner": "mt_d_star_lite"} for name in names
    ]
    words = "as many words as a quantity of one of the papers has in astar_paper (m)"
    rows = tuple(PaperRow(f"{words} {number}", -3.746e4, -1.437e4, -1.228e4, -1.646e4, False) for number in range(40))
    paper = PaperTable(
        "x", "As long a title as a table has [Paper, Table 2]", "", "", 0, True, (RowGroup(words, "", rows),)
    )
    log = typeset(tmp_path, *metrics, format_rows(planners, "latex"), latex_text(paper))
    assert "Overfull" not in log
    assert "Float too large" not in log
