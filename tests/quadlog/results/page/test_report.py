import base64
import dataclasses
import itertools
import json
import math
import re
import warnings
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.errors import CannotWrite, NotARun
from quadlog.results.page.report import write_page, write_plots, write_report
from quadlog.results.plots.figures import PLOTS
from quadlog.results.run.record import InputRecord, LossRecord, RunRecord, StageRecord, TopicRecord
from quadlog.results.run.run_folder import RunFolder
from quadlog.results.run.stages import STAGES
from quadlog.results.run.tables import TABLES, UNBOUNDED, has_table, read_table, write_table

HOSTILE = "/</script><script>alert(1)</script>\"><img src=x onerror=alert(2)>'{{ 7 * 7 }}&amp;"


class Page(HTMLParser):
    """Elements with their attributes, and the text outside style and script."""

    def __init__(self, path: Path) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in {"meta", "img", "input"}:
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


def _bare(path: Path, record: RunRecord) -> Path:
    """A run that stopped before anything could be drawn."""
    folder = RunFolder.create(path)
    folder.write_config(record.config)
    folder.write_metrics({})
    folder.write_run_json(record)
    return path


def test_the_page_holds_everything_a_reader_looks_for(reported: Path, tiny_record: RunRecord) -> None:
    page = Page(reported / "report.html")
    assert page.all("title")
    for words in (
        "walk.mcap",
        "recorded 4 s",
        "real-time factor 5 ×",
        "done, with loss",
        "Lost from the recording (exit code 3)",
        "crc on /points , 5 ×: one chunk is damaged, from 1.0 s to 1.5 s",
        "no heading source: yaw is the course",
        "eta_m 0.123 m 200",
        "lidar /points sensor_msgs/msg/PointCloud2 40 the only point cloud",
        "scans_without_pose 0",
        "ingest 0.50 62 % 120",
        "quadlog replay walk.mcap",
        "ab" * 32,
        'name = "ia_star"',
        f"numpy {tiny_record.packages['numpy']}",
    ):
        assert words in page.text, words


@pytest.mark.parametrize(
    ("of", "said"),
    [
        ({"etag": '"5d-3"', "last_modified": "May"}, 'ETag of the input: "5d-3"'),
        ({"last_modified": "May"}, "Last-Modified of the input: May"),
        ({}, "Nothing identifies the input's content"),
    ],
)
def test_an_input_behind_a_url_is_told_by_what_its_server_tells(
    tmp_path: Path, tiny_record: RunRecord, of: dict[str, str], said: str
) -> None:
    run = _bare(tmp_path / "run", dataclasses.replace(tiny_record, input=InputRecord("s3://lab/walk.mcap", 1, **of)))
    write_report(run)
    assert said in Page(run / "report.html").text


@pytest.mark.parametrize("value", [1e13, -1e300, math.inf])
def test_numbers_that_cannot_be_drawn_are_left_out_and_told(tiny_run: Path, value: float) -> None:
    """With no warning of numpy or matplotlib: pytest makes errors of them."""
    kinds = "fi" if value == 1e13 else "f"
    told = []
    for name in TABLES:
        if has_table(tiny_run, name):
            columns = read_table(tiny_run, name)
            set_ones = [each for each, values in columns.items() if values.dtype.kind in kinds and each != "t_ns"]
            for each in set_ones:
                columns[each][-1] = value
            write_table(tiny_run / f"{name}.parquet", TABLES[name], columns)
            told += [name] if not UNBOUNDED.issuperset(set_ones) or (set_ones and math.isfinite(value)) else []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_report(tiny_run)
    page = Page(tiny_run / "report.html").text
    assert [name for name in told if f"1 of the rows of {name}.parquet" not in page] == [], page[:3000]
    for name in told:
        if abs(value) >= 1e300:
            held = re.escape(f"{value:.3g}")
            with pytest.raises(NotARun, match=rf"{name}\.parquet: is damaged: \w+ holds {held}"):
                read_table(tiny_run, name)


def test_two_bodies_are_listed_beside_each_other_and_unknown_numbers_are_dashes(tiny_run: Path) -> None:
    gait = {name: np.array([0.5, math.nan]) for name in TABLES["gait"].names}
    gait |= {"body": np.array(["logged", "resimulated"], object), "speeds": "all", "n": 9, "pitch_mean_rad": -0.25}
    write_table(tiny_run / "gait.parquet", TABLES["gait"], gait)
    legs = np.array(["FL hip", "FL hip", "RR calf"], object)
    torques = {"joint": legs, "phase": np.array(["stance", "swing", "stance"], object), "n": 9, "n_unknown": 0}
    torques |= {"body": "logged", "speeds": "all", "torque_rms_nm": [1.5, 2.5, 3.5], "torque_peak_nm": [4.0, 5.0, 6.0]}
    write_table(tiny_run / "body.parquet", TABLES["body"], torques)
    text = Page(write_page(tiny_run, {})).text
    assert "gait logged re-simulated speed (m/s) 0.500 –" in text
    assert "pitch, mean (rad) −0.250 −0.250" in text
    assert "stance, logged swing, logged rms peak rms peak FL hip 1.500 4.000 2.500 5.000" in text
    assert "RR calf 3.500 6.000 – –" in text


def test_every_picture_is_inside_and_beside_the_page(reported: Path) -> None:
    page = Page(reported / "report.html")
    images = page.all("img")
    expected = [
        plot
        for plot in PLOTS
        if plot.name not in ("posture", "torques", "body_torques", "displacement", "euler_angles")
    ]
    assert [image["alt"] for image in images] == [plot.alt for plot in expected]
    for image, plot in zip(images, expected, strict=True):
        kind, content = image["src"].split(",", 1)
        assert kind == "data:image/png;base64"
        png = base64.b64decode(content, validate=True)
        assert png == (reported / "plots" / f"{plot.name}.png").read_bytes()
        assert image["width"] == str(int.from_bytes(png[16:20], "big")) == "1200"
        assert plot.caption in page.text


def test_the_page_asks_for_nothing_from_outside(reported: Path) -> None:
    page = Page(reported / "report.html")
    assert not {"link", "iframe", "object", "embed", "base", "form"} & {tag for tag, _ in page.elements}
    for tag, attributes in page.elements:
        for name, value in attributes.items():
            if name in {"src", "href", "srcset", "data", "action", "poster"}:
                assert value.startswith(("data:image/png;base64,", "#")), (tag, name, value[:60])
            assert not name.startswith("on")
    css = re.findall(r"<style>(.*?)</style>", (reported / "report.html").read_text(), re.DOTALL)
    assert len(css) == 2
    assert not any("url(" in text or "@import" in text for text in css)


def test_headings_are_in_order_and_links_lead_somewhere(reported: Path) -> None:
    page = Page(reported / "report.html")
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h\d", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {link["href"][1:] for link in page.all("a")} <= set(ids)
    assert page.all("html")[0]["lang"] == "en"


def test_the_same_run_gives_the_same_bytes(reported: Path) -> None:
    def everything() -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in [reported / "report.html", *(reported / "plots").iterdir()]}

    before = everything()
    write_report(reported)
    assert everything() == before


def test_hostile_names_change_no_tag(tmp_path: Path, tiny_record: RunRecord) -> None:
    def record(name: str) -> RunRecord:
        return dataclasses.replace(
            tiny_record,
            command=["quadlog", "replay", name],
            config={"topics": {"lidar": name}},
            input=dataclasses.replace(tiny_record.input, path=f"/logs/{name.replace('/', '')}.mcap", sha256=name),
            topics=[TopicRecord(name, name, name, 4, name)],
            counts={name: 3},
            losses=[LossRecord(name, name, name, 5)],
            warnings=[name],
            stages=[StageRecord(name, 0.5, 120.0)],
            host={name: name},
            packages={name: name},
        )

    def shape(run: Path) -> list[tuple[str, list[str]]]:
        write_report(run)
        return [(tag, sorted(attributes)) for tag, attributes in Page(run / "report.html").elements]

    hostile, harmless = _bare(tmp_path / "a", record(HOSTILE)), _bare(tmp_path / "b", record("/points"))
    assert shape(hostile) == shape(harmless)
    assert Page(hostile / "report.html").text.count("<script>alert(1)</script>") >= 8
    assert Page(hostile / "report.html").text.count("{{ 7 * 7 }}&amp;") >= 8


def test_every_link_is_in_the_table_and_says_why_its_bias_is_left_in(reported: Path) -> None:
    page = Page(reported / "report.html")
    assert {"href": "#uwb"} in page.all("a")
    for words in (
        "UWB links tag anchor ranges residual (m) median (m) bias ± std (m) bias subtracted NLOS 0 0 40 0.100 0.000 "
        "−0.100 ± 0.020 yes 2.5\u202f%".replace("\u202f", " "),
        "1 0 40 0.100 0.000 0.200 ± 0.090 no: known to 0.09 m only 2.5 %",
    ):
        assert words in page.text, words
    assert "weak first path" not in page.text.lower()


def test_every_contact_is_in_the_table_with_its_time_and_cause(reported: Path) -> None:
    page = (reported / "report.html").read_text()
    (table,) = re.findall(r'<h2 id="contacts">.*?</table>', page, re.DOTALL)
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr><td.*?</tr>", table)]
    assert rows == [
        ["0.80", "0.10", "1.050", "0.350", "−0.050", "appeared inside the body", "no"],
        ["1.80", "0.42", "2.150", "0.350", "−0.031", "the robot cut a corner of its plan", "yes"],
    ]
    assert 'href="#contacts"' in page


def test_first_paths_have_a_column_where_a_radio_tells(tiny_run: Path) -> None:
    links = read_table(tiny_run, "links") | {"weak_first_path_share": np.array([0.31, *[np.nan] * 5])}
    write_table(tiny_run / "links.parquet", TABLES["links"], links)
    write_report(tiny_run)
    text = Page(tiny_run / "report.html").text
    assert "NLOS weak first path" in text
    assert "2.5 % 31.0 %" in text
    assert "2.5 % –" in text


def test_a_run_that_stopped_early_shows_what_there_is(tmp_path: Path, tiny_record: RunRecord) -> None:
    stages = [StageRecord("ingest", 0.0, 100.0)]
    record = dataclasses.replace(
        tiny_record, stages=stages, losses=[], warnings=[], topics=[], counts={}, recorded_s=0.0, realtime_factor=None
    )
    run = _bare(tmp_path / "walk", record)
    write_report(run)
    page = Page(run / "report.html")
    assert "2 of 7" in page.text
    for stage in STAGES:
        done = stage in {"ingest", "report"}
        assert (f"✓ {stage}" in page.text) == done
        assert (f"– {stage} (not run)" in page.text) != done
    for words in ("real-time factor –", "nothing to draw", "give no metrics", "Nothing was lost", "state done"):
        assert words in page.text, words
    assert "UWB links" not in page.text
    assert not page.all("img")
    assert not page.all("script")


def test_a_run_that_is_not_finished_yet_brings_its_record(tmp_path: Path, tiny_record: RunRecord) -> None:
    run = _bare(tmp_path / "walk", tiny_record)
    finished = write_report(run).read_bytes()
    (run / "run.json").unlink()
    with pytest.raises(NotARun, match=r"no run\.json"):
        write_report(run)
    assert write_page(run, write_plots(run, tiny_record), tiny_record).read_bytes() == finished


def test_pictures_of_an_earlier_report_vanish_with_their_data(tmp_path: Path, tiny_record: RunRecord) -> None:
    run = _bare(tmp_path / "walk", tiny_record)
    (run / "plots").mkdir()
    (run / "plots" / "terrain.png").write_bytes(b"old")
    (run / "plots" / "mine.png").write_bytes(b"the user's own")
    write_report(run)
    assert [path.name for path in (run / "plots").iterdir()] == ["mine.png"]


def test_pictures_are_not_written_through_a_link(tmp_path: Path, tiny_record: RunRecord) -> None:
    run = _bare(tmp_path / "walk", tiny_record)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "terrain.png").write_bytes(b"not ours")
    (run / "plots").symlink_to(elsewhere)
    with pytest.raises(CannotWrite, match="link"):
        write_report(run)
    assert (elsewhere / "terrain.png").read_bytes() == b"not ours"


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"stages": [{"name": "map", "seconds": "long", "peak_memory_mb": 1}]}, r"stages\.0\.seconds"),
        ({"losses": [{"cause": "crc"}]}, r"losses\.0\.detail"),
        ({"input": None}, "input"),
        ({"config": {"uwb": {"anchors": [{"id": 0}]}}}, r"config\.uwb\.anchors"),
    ],
)
def test_a_record_of_another_making_is_refused_in_one_line(tiny_run: Path, change: dict[str, Any], where: str) -> None:
    path = tiny_run / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(NotARun, match=rf"run\.json: is damaged: {where}") as caught:
        write_report(tiny_run)
    assert "\n" not in str(caught.value)
