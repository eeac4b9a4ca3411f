from __future__ import annotations

from markdown_it import MarkdownIt

from quadlog.results.papers.page import Erratum, errata_text


def test_every_erratum_is_a_row_under_its_paper():
    errata = {"[A]": [Erratum("eq. 1", "|x| * y_i", "x", "Why.")], "[B]": [Erratum("eq. 2", "1", "2")]}
    page = MarkdownIt("commonmark").enable("table").render(errata_text(errata, 3))
    assert page.count("<h3>") == page.count("<table>") == 2
    assert "<td>|x| * y_i</td>\n<td>x</td>\n<td>Why.</td>" in page
    assert page.index("<h3>[A]</h3>") < page.index("eq. 1") < page.index("<h3>[B]</h3>") < page.index("eq. 2")
