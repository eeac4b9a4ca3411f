from __future__ import annotations

import re
import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.latex import escape_latex, latex_table


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
    ],
)
def test_known_text(text, escaped):
    assert escape_latex(text) == escaped


def test_a_table_is_booktabs_with_caption_label_and_numbers_in_mathematics():
    got = latex_table("A & B", "tab:x-1", ("name", "ours"), [("a_b", "-0.5"), ("c", "1.2e-05"), ("d", "")], ("ours",))
    assert got.splitlines() == [
        r"\begin{table}",
        r"\centering\footnotesize\setlength{\tabcolsep}{4pt}",
        r"\caption{A \& B}",
        r"\label{tab:x-1}",
        r"\begin{tabular}{lr}",
        r"\toprule",
        r"name & ours \\",
        r"\midrule",
        r"a\_b & $-0.5$ \\",
        r"c & $1.2\times10^{-5}$ \\",
        r"d &  \\",
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX is installed, so nothing is typeset")
def test_latex_typesets_any_name_and_a_table_of_seven_columns_fits_the_page(tmp_path):
    nasty = "a_b%c&d#e$f^g~h{i}\\ <|>`\"' é ±×·≤≥≈→√°²³ησμλθτχΔ−"
    header = ("quantity", "paper", "ours", "95 % interval", "difference", "reproduces")
    names = [nasty, *["as many words as a quantity of one of the papers has (m)"] * 19]
    rows = [(name, "-0.5", "1.2e-05", "0.1 to 0.2", "", "no") for name in names]
    table = latex_table(nasty, "tab:x-1", header, rows, header[1:5], wrapped=header[:1])
    (tmp_path / "t.tex").write_text(
        "\\documentclass{article}\\usepackage[margin=1in]{geometry}\\usepackage{booktabs}\n"
        f"\\begin{{document}}\n{table}\\end{{document}}\n"
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    log = done.stdout.decode("utf-8", "replace")
    assert done.returncode == 0, log
    assert "Overfull" not in log
    assert "Float too large" not in log
    assert (tmp_path / "t.pdf").read_bytes().startswith(b"%PDF")
