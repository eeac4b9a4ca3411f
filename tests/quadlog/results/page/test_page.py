import base64
import hashlib
import html
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.page.html import format_bytes, format_metres, format_number, format_share, render_page


def _folder(title: str) -> str:
    values = {"title": title, "one": "recording", "many": "recordings", "rows": [], "metrics": [], "tiles": []}
    return render_page("folder.html.jinja", scripts=["sort.js"], **values).decode()


def test_style_and_script_are_the_only_ones_the_policy_admits() -> None:
    page = _folder("runs")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    words = policy[1].replace("&#39;", "'").split("; ")
    assert "default-src 'none'" in words
    assert "base-uri 'none'" in words
    assert "form-action 'none'" in words
    assert not any("unsafe" in word or "http" in word or "*" in word for word in words)
    assert " style=" not in page  # a hash admits no style attribute


def test_the_policy_has_the_hash_of_every_style_and_script() -> None:
    scripts, styles = ["sort.js", "vendor/uPlot.iife.min.js"], ["vendor/uPlot.min.css"]
    values = {"title": "runs", "one": "", "many": "", "rows": [], "metrics": [], "tiles": []}
    page = render_page("folder.html.jinja", scripts=scripts, styles=styles, **values).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    rules = [rule.split() for rule in html.unescape(policy[1]).split("; ")]
    admitted = {kind: sources for kind, *sources in rules}
    for kind, tag, count in (("script-src", "script", 2), ("style-src", "style", 2)):
        inside = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in inside]
        assert admitted[kind] == [f"'sha256-{digest}'" for digest in digests]
        assert len(inside) == count


@given(st.text())
def test_any_text_in_a_title_stays_text(title: str) -> None:
    tags = re.compile(r"<[^>]*>")
    assert len(tags.findall(_folder(title))) == len(tags.findall(_folder("runs")))


def test_half_a_character_does_not_stop_a_page() -> None:
    assert "runs ?" in _folder("runs \ud800")


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0345678, "0.03457"), (-0.5, "−0.5"), (123456, "123\u2009456"), (2.0, "2"), (0, "0"), (-1200, "−1\u2009200")],
)
def test_numbers_have_four_digits_or_are_whole(value: float, shown: str) -> None:
    assert format_number(value) == shown


@pytest.mark.parametrize(("value", "shown"), [(0.12345, "0.123"), (-0.0004, "0.000"), (-0.1, "−0.100"), (None, "–")])
def test_metres_go_to_the_millimetre(value: float | None, shown: str) -> None:
    assert format_metres(value) == shown


@pytest.mark.parametrize(("share", "shown"), [(0.0253, "2.5\u202f%"), (0.0, "0.0\u202f%"), (None, "–")])
def test_shares_are_percentages(share: float | None, shown: str) -> None:
    assert format_share(share) == shown


@pytest.mark.parametrize(
    ("size", "shown"), [(0, "0 bytes"), (184_223_101, "184 MB"), (1500, "1.5 kB"), (2**50, "1.13e+03 TB")]
)
def test_sizes_have_a_unit(size: int, shown: str) -> None:
    assert format_bytes(size) == shown
