from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from markdown_it.token import Token

from quadlog.results.text.markup import escape_markdown, markdown_table

READER = MarkdownIt("commonmark").enable("table")
ONE_LINE = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Zs", "Zl", "Zp")), min_size=1)


def _shown(inline: Token) -> str:
    """What a reader sees; anything but plain text would be markup that slipped through."""
    children = inline.children or []
    assert {child.type for child in children} <= {"text"}, children
    return "".join(child.content for child in children)


@given(ONE_LINE | st.text("#-+*_=.)>~`1 \\[]()!<&;:|$", min_size=1))
def test_a_paragraph_reads_as_it_was_meant(text):
    tokens = READER.parse(escape_markdown(text))
    wanted = " ".join(text.split())
    if not wanted:
        assert tokens == []
        return
    assert [token.type for token in tokens] == ["paragraph_open", "inline", "paragraph_close"]
    assert _shown(tokens[1]) == wanted


@given(st.lists(st.tuples(ONE_LINE, st.text("|\\`*_ \n-1.e")), min_size=1, max_size=4))
def test_a_table_has_the_cells_that_went_in(rows):
    tokens = READER.parse(markdown_table(("name", "value"), rows, right=("value",)))
    cells = [_shown(token) for token in tokens if token.type == "inline"]
    assert cells[:2] == ["name", "value"]
    assert cells[2:] == [" ".join(cell.split()) for row in rows for cell in row]
    assert {str(token.attrs.get("style")) for token in tokens if token.type == "td_open"} == {
        "None",
        "text-align:right",
    }


def test_dollars_are_escaped_for_readers_that_typeset_mathematics():
    assert escape_markdown("$x$") == r"\$x\$"


def test_what_a_terminal_would_obey_is_replaced():
    assert (
        escape_markdown("a\x1b[31m\x9b2J\x00b")
        == "a\N{REPLACEMENT CHARACTER}\\[31m\N{REPLACEMENT CHARACTER}2J\N{REPLACEMENT CHARACTER}b"
    )
