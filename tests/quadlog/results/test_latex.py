from __future__ import annotations

import re

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
        r"\centering",
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
