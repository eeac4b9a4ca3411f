"""One promise about the pages of all kinds: one file that opens offline, in which names are only text."""

from __future__ import annotations

import itertools
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results import view
from quadlog.results.page.blocks import Drawn, Page, Section, render
from quadlog.results.page.pack import Pack
from quadlog.results.page.run_page import write_run_page
from quadlog.results.page.side_by_side import compared_metrics, short_names
from quadlog.results.record import SavedMetric
from quadlog.results.run import Run
from quadlog.results.view import Panel, Series
from tests.lab.pages import PAGES
from tests.lab.runs import change, change_json

HOSTILE = "/</script><script>alert(1)</script>\"><img src=x onerror=alert(2)>'{{ 7 * 7 }}&amp;\u2028<!--"
FIXTURE_MB, MINUTE_MB = 0.7, 1.2


class Parsed(HTMLParser):
    """Elements with their attributes, and the text outside of style and script."""

    def __init__(self, content: bytes) -> None:
        super().__init__(convert_charrefs=True)
        self.source = content.decode()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(self.source)
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in {"meta", "img", "input", "br"}:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self._open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


def assert_offline_and_in_order(content: bytes) -> None:
    page = Parsed(content)
    assert not {"link", "iframe", "object", "embed", "base", "form"} & {tag for tag, _ in page.elements}
    for tag, attributes in page.elements:
        assert not any(name.startswith("on") or name == "style" for name in attributes), (tag, attributes)
        assert not {"src", "srcset", "data", "action", "poster"} & set(attributes)
    for link in page.all("a"):
        assert re.match(r"#|\.\.?/[^/]", link["href"]), link
    policy = page.all("meta")[1]["content"]
    assert policy.startswith("default-src 'none'; style-src 'sha256-")
    assert "unsafe" not in policy
    assert "url(" not in "".join(re.findall(r"<style>(.*?)</style>", page.source, re.DOTALL))
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h\d", tag)]
    assert (levels[0], levels.count(1)) == (1, 1)
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels)), levels
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    anchors = {link["href"][1:] for link in page.all("a") if re.match(r"#(?!t=)", link["href"])}
    assert anchors <= set(ids)
    assert page.all("html")[0]["lang"] == "en"


@pytest.mark.parametrize("kind", PAGES)
def test_a_page_of_any_kind_is_one_file_that_needs_nothing_else(tiny_run: Path, kind: str) -> None:
    page = PAGES[kind](tiny_run)
    content = page.read_bytes()
    assert_offline_and_in_order(content)
    assert len(content) < FIXTURE_MB * 1e6
    if kind != "planners":  # which measures time
        assert PAGES["whole" if page.parent == tiny_run else kind](tiny_run).read_bytes() == content


def test_names_from_recordings_change_no_tag(tiny_run: Path) -> None:
    def shape(name: str) -> list[tuple[str, list[str]]]:
        change(tiny_run, "contacts", cause=name)
        topic = {"role": name, "topic": name, "type": name, "messages": 4, "why": name}
        losses = [{"cause": name, "detail": name, "topic": name, "count": 5}]
        stage = {"name": name, "seconds": 0.5, "peak_memory_mb": 1.0}
        path = f"/logs/{name.replace('/', '')}.mcap"
        record = {"command": ["quadlog", name], "input__path": path, "input__sha256": name, "notes": [name]}
        record |= {"topics": [topic], "losses": losses, "stages": [stage], "warnings": [name]}
        change_json(tiny_run / "run.json", **record, host={name: name}, packages={name: name})
        (tiny_run / "config.toml").write_text(name)
        change_json(tiny_run / "metrics.json", eta_m={"value": 1.0, "n": 2, "unit": name})
        pages.append(Parsed(write_run_page(Run(tiny_run)).read_bytes()))
        return [(tag, sorted(attributes)) for tag, attributes in pages[-1].elements]

    pages: list[Parsed] = []
    assert shape("/points") == shape(HOSTILE)
    assert pages[1].text.count("<script>alert(1)</script>") > 10
    assert pages[1].text.count("{{ 7 * 7 }}&amp;") > 10


def test_a_page_shows_what_a_reader_looks_for(tiny_run: Path) -> None:
    page = Parsed(write_run_page(Run(tiny_run)).read_bytes())
    for words in (
        *("walk.mcap", "2 things to look at", "crc on /points, 5 ×: one chunk is damaged, from 1.0 s to 1.5 s"),
        *("no heading source: yaw is the course", "distance to the path", "sensor_msgs/msg/PointCloud2", "ab" * 32),
        *("ingest 0.5 62.5", "quadlog replay walk.mcap", 'name = "ia_star"', "known to 0.09 m only"),
        "1.8 0.42 2.15 0.35 −0.031 the robot cut a corner of its plan yes",
    ):
        assert words in page.text, words
    moments = {link["href"] for link in page.all("a") if link["href"].startswith("#t=")}
    assert {"#t=0.800", "#t=1.800"} <= moments


def test_runs_are_compared_in_every_value_that_both_have() -> None:
    """The best value is bold; of two runs a column has the difference, of several a second line of the cell."""
    values = {"cost_of_transport": (0.5, 0.4, 0.7), "ratio_to_astar": (3.0, 5.0, 4.0)}
    values["torque_max_nm"] = (9.0, 9.0, 9.5)
    runs = [{name: SavedMetric(of[at], 9, CATALOGUE[name].unit) for name, of in values.items()} for at in range(3)]
    two, three = (compared_metrics(dict(zip("abc", some, strict=False)), {}) for some in (runs[:2], runs))
    found = {row[0].below: row[1:] for row in two.rows}
    assert [found[name][-1].text for name in values] == ["\u22120.1", "+2 ×", "the same"]
    assert [[cell.best for cell in found[name][:2]] for name in values] == [
        [False, True],
        [False, True],
        [False, False],
    ]
    assert [column.name for column in three.columns] == ["metric", "a", "b", "c"]
    assert [cell.below for cell in three.rows[0][1:]] == ["", "+2 ×", "+1 ×"]
    assert short_names(["runs/walk", "wide/walk"]) == ["runs", "wide"]
    assert short_names(names := ["a/walk", "a/run"]) == names


def test_a_minute_of_all_curves_weighs_little() -> None:
    """40 columns of control and the noise of 12 links at 50 Hz, of which no digit that a screen shows is lost."""
    rng, seconds = np.random.default_rng(1), np.arange(3000) / 50
    walks = np.cumsum(rng.normal(0, 0.01, (40, 3000)), axis=1)
    curves = [*walks, *rng.normal(0, 0.1, (12, 3000))]
    panels = [Panel(str(number), [Series("a", "robot", seconds, y)]) for number, y in enumerate(curves)]
    pack = Pack()
    pack.add("all", panels)
    page = render(Page("a minute", [Section("", [Drawn("all")])], pack=pack))
    assert len(page) < MINUTE_MB * 1e6 * 0.5  # beside as much for maps and paths


def test_a_track_is_drawn_as_closely_around_a_gap_of_a_day() -> None:
    """What is thinned is what was recorded, however long the gap is."""
    seconds, rows = np.arange(200) / 10, []
    for gap_s in (2, 86400):
        track = view.break_gaps(seconds + gap_s * (seconds > 10), np.cos(seconds), np.sin(seconds))
        pack = Pack()
        pack.add("walk", view.Scene([view.Track("robot", "robot", *track)], (-1.0, 1.0, -1.0, 1.0)))
        rows.append(pack.finish()["columns"][pack.scenes["walk"]["layers"][0]["x"]][0])
    assert rows == [201, 201]
