"""The charts in a real browser: drawn, read off, zoomed by mouse and keys, and pictures in their place on paper."""

import html
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from quadlog.results.chart_panels import to_script_json
from quadlog.results.report import write_report

Browse = Callable[..., tuple[str, list[str]]]
HOSTILE = "</script><script>document.title = 'owned'</script><img src=x onerror=\"document.title = 'owned'\">"

# Asks a finished page about itself; the answers go into its title.
PROBE = """
const say = {};
const place = (name) => document.querySelector(`[data-chart="${name}"]`);
const drawn = (canvas) => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some(Boolean);
const point = (name, share, kind = "mousemove") => {
  const over = place(name).querySelector(".u-over");
  const box = over.getBoundingClientRect();
  const at = { clientX: box.left + share * box.width, clientY: box.top + box.height / 2, bubbles: true };
  over.dispatchEvent(new MouseEvent(kind, at));
};
const read = (name) => [...place(name).querySelectorAll(".u-value")].map((each) => each.textContent);
const press = (name, key) => place(name).dispatchEvent(new KeyboardEvent("keydown", { key }));
const ask = async () => {
  const pause = () => new Promise((resolve) => setTimeout(resolve, 50));
  say.charts = [...document.querySelectorAll(".chart")].map((each) => each.dataset.chart);
  say.canvases = [...document.querySelectorAll(".chart canvas")].map(drawn);
  say.pictures = [...document.querySelectorAll("figure img")].map((each) => each.checkVisibility());
  point("tracking_error", 0.5);
  say.hover = read("tracking_error");
  say.follows = read("commands");
  say.dots = [...document.querySelectorAll(".dot")].filter((each) => !each.hidden).length;
  press("tracking_error", "+");
  await pause();
  point("commands", 0);
  say.zoomed = read("commands");
  press("commands", "0");
  await pause();
  point("commands", 0);
  say.all = read("commands");
  press("lookahead", "ArrowRight");
  press("lookahead", "ArrowRight");
  say.said = place("lookahead").querySelector("output").textContent;
  place("lookahead").querySelector(".bar button:last-child").click();
  say.swapped = place("lookahead").closest("figure").querySelector("img").checkVisibility();
  say.walks = [...place("trajectory").querySelectorAll(".names button")].map((each) => each.textContent);
  document.title = JSON.stringify(say);
};
setTimeout(ask, 200);
"""


def _ask(page: Path, browse: Browse) -> tuple[dict[str, Any], list[str]]:
    """A copy without the policy, with the probe in it; its answers and complaints."""
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
    probed = page.with_name("probed.html")
    probed.write_text(text.replace("</body>", f"<script>{PROBE}</script></body>"))
    dom, complaints = browse(probed, "--dump-dom", "--window-size=900,900", "--virtual-time-budget=4000")
    title = re.search(r"<title>(.*?)</title>", dom, re.DOTALL)
    assert title is not None
    return json.loads(html.unescape(title[1])), complaints


def test_charts_are_drawn_read_off_and_zoomed(tiny_run: Path, browse: Browse) -> None:
    say, complaints = _ask(write_report(tiny_run), browse)
    assert complaints == []
    assert len(say["charts"]) == 8
    assert len(say["canvases"]) >= 11
    assert all(say["canvases"])
    # A picture is shown where there is no chart, and only there.
    assert sum(say["pictures"]) == len(say["pictures"]) - len(say["charts"])
    seconds, timed_m, path_m = (float(value) for value in say["hover"][:3])
    assert seconds == pytest.approx(2.0, abs=0.05)
    assert 0 < path_m <= 0.1
    assert timed_m == pytest.approx(2 * path_m, abs=1e-3)
    assert float(say["follows"][0]) == seconds
    assert say["dots"] == 3
    assert float(say["zoomed"][0]) == pytest.approx(1.0, abs=0.05)
    assert float(say["all"][0]) == pytest.approx(0.0, abs=0.02)
    assert re.fullmatch(r"0\.0\d s: l 2", say["said"])
    assert say["swapped"]
    assert say["walks"] == ["robot", "target", "re-simulated walk"]


def test_the_policy_admits_the_charts_and_nothing_is_fetched(tiny_run: Path, browse: Browse) -> None:
    def asked(page: Path) -> set[str]:
        """Addresses asked for, but for what the browser asks of its maker on its own."""
        log = page.with_suffix(".net.json")
        browse(page, "--dump-dom", f"--log-net-log={log}", "--virtual-time-budget=2000")
        found: set[str] = set(re.findall(r'"url":"([^"]*)"', log.read_text()))
        return {url for url in found if not re.match(r"https?://[a-z0-9.]*\.google\.com/", url)}

    page = write_report(tiny_run)
    dom, complaints = browse(page, "--dump-dom", "--virtual-time-budget=2000")
    assert complaints == []
    assert dom.count('class="uplot') >= 11
    assert asked(page) == set()
    leaking = page.with_name("leaking.html")
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
    leaking.write_text(text.replace("<h1>", '<img src="http://127.0.0.1:9/leak.png"><h1>'))
    assert asked(leaking) == {"http://127.0.0.1:9/leak.png"}


def test_hostile_names_run_nothing(tiny_run: Path, browse: Browse) -> None:
    record = json.loads((tiny_run / "run.json").read_text())
    record["topics"][0]["topic"] = record["warnings"][0] = record["input"]["path"] = HOSTILE
    (tiny_run / "run.json").write_text(json.dumps(record))
    dom, complaints = browse(write_report(tiny_run), "--dump-dom", "--virtual-time-budget=2000")
    assert complaints == []
    assert "<title>owned" not in dom


def test_hostile_labels_of_a_chart_stay_text(tiny_run: Path, browse: Browse) -> None:
    page = write_report(tiny_run)
    text = page.read_text()
    start = text.index(">", text.index('id="chart-data"')) + 1
    end = text.index("</script>", start)
    charts = json.loads(text[start:end])
    for panel in charts["commands"]["panels"]:
        panel["what"] = HOSTILE
        panel["lines"][0]["label"] = HOSTILE
    charts["trajectory"]["walks"][0]["label"] = HOSTILE
    charts["trajectory"]["anchors"][0]["label"] = HOSTILE
    page.write_text(text[:start] + to_script_json(charts) + text[end:])
    say, complaints = _ask(page, browse)
    assert complaints == []
    assert say["walks"][0] == HOSTILE


def test_paper_has_every_picture_and_no_chart(tiny_run: Path, browse: Browse) -> None:
    page = write_report(tiny_run)
    paper = tiny_run / "paper.pdf"
    _, complaints = browse(page, "--no-pdf-header-footer", f"--print-to-pdf={paper}", "--virtual-time-budget=2000")
    assert complaints == []
    assert paper.read_bytes().count(b"/Subtype /Image") == page.read_text().count("<img ")
