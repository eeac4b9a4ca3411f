import json
import math
from html.parser import HTMLParser

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from quadlog.results.page.charts import PANEL_POINTS, Line, panel, rounded, to_script_json

SERIES = hnp.arrays(np.float64, st.integers(1, 300), elements=st.floats(-1e9, 1e9) | st.just(math.nan))


class Elements(HTMLParser):
    """Every start and end of an element, and the text in between."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.found.append(tag)

    def handle_endtag(self, tag: str) -> None:
        self.found.append("/" + tag)


@given(st.text() | st.sampled_from(["</script><script>alert(1)</script>", "<!-- <script>", "\u2028", "]]>", "&lt;"]))
def test_any_text_survives_inside_a_script_and_ends_nothing(text: str) -> None:
    inside = to_script_json({text: [text]})
    assert json.loads(inside) == {text: [text]}
    assert Elements(f"<script>{inside}</script>").found == ["script", "/script"]
    assert inside.isascii()
    assert not set("<>&") & set(inside)


@given(SERIES)
def test_rounding_is_finer_than_a_pixel_and_leaves_gaps(values: np.ndarray) -> None:
    short = rounded(values)
    span = np.nanmax(values) - np.nanmin(values) if np.isfinite(values).any() else 0.0
    size = span or np.nanmax(np.abs(values), initial=0)
    for value, given_value in zip(short, values, strict=True):
        assert (value is None) == math.isnan(given_value)
        if value is not None:
            assert abs(value - given_value) <= 1e-3 * size + 1e-12
    json.dumps(short, allow_nan=False)


def test_numbers_are_short() -> None:
    assert rounded(np.array([0.123456789, 1.0, -0.0])) == [0.1235, 1.0, 0.0]
    assert rounded(np.array([0.000123456789, 0.0])) == [0.00012346, 0.0]
    assert rounded(np.array([123456.789, 0.0])) == [123457.0, 0.0]


@given(hnp.arrays(np.float64, 10_000, elements=st.floats(-1, 1), fill=st.just(0.0)))
def test_no_peak_is_lost_however_long_the_run(values: np.ndarray) -> None:
    seconds = np.arange(10_000) * 0.01
    drawn = panel("error (m)", [Line("a", "robot", seconds, values), Line("b", "plan", seconds, -values)])
    assert drawn is not None
    assert not drawn["joined"]
    assert len(drawn["seconds"]) <= 2 * (PANEL_POINTS + 2)
    assert drawn["seconds"] == sorted(drawn["seconds"])
    assert abs(max(drawn["values"][0]) - values.max()) <= 1e-3
    assert abs(min(drawn["values"][0]) - values.min()) <= 1e-3
    assert drawn["values"][1] == [-value + 0.0 for value in drawn["values"][0]]


def test_lines_of_other_instants_have_no_value_where_they_have_no_row() -> None:
    odd, even = np.array([1.0, 3.0]), np.array([2.0, 3.0])
    drawn = panel("error (m)", [Line("a", "robot", odd, odd), Line("b", "plan", even, 10 * even, points=True)])
    assert drawn is not None
    assert drawn["joined"]
    assert drawn["seconds"] == [1.0, 2.0, 3.0]
    assert drawn["values"] == [[1.0, None, 3.0], [None, 20.0, 30.0]]
    assert [line["points"] for line in drawn["lines"]] == [False, True]


def test_lines_without_a_value_are_left_out_and_none_is_no_panel() -> None:
    seconds = np.arange(3.0)
    nothing = Line("a", "robot", seconds, np.full(3, np.nan))
    drawn = panel("gain (1)", [nothing, Line("b", "plan", seconds, seconds)])
    assert drawn is not None
    assert [line["label"] for line in drawn["lines"]] == ["b"]
    assert panel("gain (1)", [nothing]) is None
    assert panel("gain (1)", [Line("a", "robot", np.empty(0), np.empty(0))]) is None
