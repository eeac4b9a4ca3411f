import base64
import hashlib
import html
import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.page.html import format_bytes, format_metres, format_number, format_share, render_page


def _folder(title: str) -> str:
    values = {"title": title, "one": "recording", "many": "recordings", "rows": [], "metrics": [], "tiles": []}
    return render_page("folder.html.jinja", scripts=["sort.js"], **values).decode()


def test_the_policy_admits_every_style_and_script_of_the_page_and_nothing_else() -> None:
    scripts, styles = ["sort.js", "vendor/uPlot.iife.min.js"], ["vendor/uPlot.min.css"]
    values = {"title": "runs", "one": "", "many": "", "rows": [], "metrics": [], "tiles": []}
    page = render_page("folder.html.jinja", scripts=scripts, styles=styles, **values).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    rules = [rule.split() for rule in html.unescape(policy[1]).split("; ")]
    admitted = {kind: sources for kind, *sources in rules}
    for kind, tag, count in (("script-src", "script", 2), ("style-src", "style", 2)):
        inside = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in inside]
        assert admitted[kind] == [f"'sha256-{digest}'" for digest in digests]
        assert len(inside) == count
    assert admitted.pop("img-src") == ["data:"]
    assert set(admitted) == {"default-src", "style-src", "script-src", "base-uri", "form-action"}
    assert admitted["default-src"] == admitted["base-uri"] == admitted["form-action"] == ["'none'"]
    assert " style=" not in page  # a hash admits no style attribute


@given(st.text())
def test_any_text_in_a_title_stays_text(title: str) -> None:
    tags = re.compile(r"<[^>]*>")
    assert len(tags.findall(_folder(title))) == len(tags.findall(_folder("runs")))


def test_half_a_character_does_not_stop_a_page() -> None:
    assert "runs ?" in _folder("runs \ud800")


@pytest.mark.parametrize(
    ("form", "shown"),
    [
        (format_number, {0.0345678: "0.03457", -0.5: "−0.5", 123456: "123\u2009456", 2.0: "2", -1200: "−1\u2009200"}),
        (format_metres, {0.12345: "0.123", -0.0004: "0.000", -0.1: "−0.100", None: "–"}),
        (format_share, {0.0253: "2.5\u202f%", 0.0: "0.0\u202f%", None: "–"}),
        (format_bytes, {0: "0 bytes", 184_223_101: "184 MB", 1500: "1.5 kB", 2**50: "1.13e+03 TB"}),
    ],
)
def test_numbers_are_short_and_have_a_true_minus(form: Any, shown: dict[float | None, str]) -> None:
    assert {value: form(value) for value in shown} == shown
