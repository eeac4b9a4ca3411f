"""report.html of a comparison: verdicts, the map with all paths and a slider over replans, charts, and tables."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup
from numpy.typing import NDArray

from quadlog.errors import printable
from quadlog.metrics.comparison.planner_verdict import verdict_lines
from quadlog.metrics.intervals import FEWEST_VALUES
from quadlog.metrics.planning import Comparison, PlannerRow
from quadlog.results.page.charts import to_script_json
from quadlog.results.page.html import render_page
from quadlog.results.planner_comparison.map_view import (
    Asked,
    map_data,
    planner_hues,
    replan_chart,
    word_for,
)
from quadlog.results.planner_comparison.shown_questions import ShownQuestions
from quadlog.results.text.numbers import count
from quadlog.version import __version__

MAX_MAPS = 8
"""Sources with a map, charts and pictures, the first ones; others have their verdict and their table."""
MAX_SOURCES = 200
MAX_TITLE_SOURCES = 3
_SCRIPTS = (
    "vendor/uPlot.iife.min.js",
    "charts.js",
    "time_charts.js",
    "player_scene.js",
    "player_view.js",
    "planners/map.js",
)
_STYLES = ("vendor/uPlot.min.css", "sweep.css", "planners/planners.css")
_PICTURES = {
    "paths": ("Paths", "Paths of all planners on"),
    "cells-per-replan": ("Cells per replan", "Cells of every planner in each replan on"),
    "ratios": ("Ratios", "Ratios of cells of all planners on"),
}


@dataclass(frozen=True, slots=True)
class PageSection:
    """One source on the page: what the template shows of it, and what its scripts draw."""

    values: dict[str, Any]
    map: dict[str, Any] | None
    chart: dict[str, Any] | None


def page_section(
    number: int,
    comparison: Comparison,
    replans: Mapping[str, NDArray[Any]],
    shown: ShownQuestions | None,
    pictures: Mapping[str, bytes],
) -> PageSection:
    """The section of source `number`, from 1. pictures: PNGs by the name of what they show."""
    names = [row.planner for row in comparison.rows]
    drawn, chart, asked = None, None, None
    if shown is not None:
        asked = Asked(replans, names)
        drawn = map_data(shown, asked, comparison.counted)
        chart = replan_chart(shown, asked, comparison.counted, str(number))
    what = "neighbours" if comparison.counted == "touched" else "cells"
    named = dict.fromkeys(_PICTURES) | (dict(pictures) if number <= MAX_MAPS else {})
    values = {
        "number": number,
        "name": printable(comparison.source),
        "verdict": verdict_lines(comparison),
        "word": "replan" if shown is None else word_for(shown),
        "unit": "m" if shown is None else shown.unit,
        "what": what,
        "counted": f"{what} {comparison.counted}",
        "baseline": comparison.baseline,
        "planners": [
            _planner(comparison, row) | {"hue": hue["hue"], "dashed": hue["dashed"]}
            for row, hue in zip(comparison.rows, planner_hues(names), strict=True)
        ],
        "pictures": {name: png and _picture(name, png) for name, png in named.items()},
        "picture_caption": f"Where {comparison.rows[0].planner} expanded most cells.",
        "map": drawn is not None,
        "chart": chart is not None,
        "chart_note": _chart_note(asked, chart),
        "growth": drawn is not None and drawn["grown"] is not None,
        "shown": 0 if shown is None else len(shown.questions),
        "note": "" if shown is None or asked is None else _note(shown, asked),
    }
    return PageSection(values, drawn, chart)


def render_comparison(
    sections: Sequence[PageSection], about: Sequence[str], losses: Sequence[str], queries: bool
) -> bytes:
    """The page. about: how to read it; losses: what of recordings was lost; queries: there is a scenarios.parquet."""
    names = [each.values["name"] for each in sections]
    more = len(names) - MAX_TITLE_SOURCES
    shown = ", ".join(names[:MAX_TITLE_SOURCES]) + (f" and {more} more" if more > 0 else "")
    left_out = []
    if len(sections) > MAX_MAPS:
        left_out.append(f"The first {MAX_MAPS} of {count(len(sections))} sources have a map, charts and pictures here.")
    if len(sections) > MAX_SOURCES:
        left_out.append(f"The first {MAX_SOURCES} stand here at all; planners.csv has the others.")
    return render_page(
        "planners/page.html.jinja",
        scripts=_SCRIPTS,
        styles=_STYLES,
        version=__version__,
        title=f"Planners compared on {shown}",
        sections=[each.values for each in sections[:MAX_SOURCES]],
        paper=any(line.startswith("Preset paper") for line in about),
        about=[printable(line) for line in about],
        losses=[printable(line) for line in losses],
        left_out=" ".join(left_out),
        queries=queries,
        chart_data=_script({f"replans-{each.values['number']}": each.chart for each in sections if each.chart}),
        map_data=_script({str(each.values["number"]): each.map for each in sections if each.map}),
    )


def _script(content: dict[str, Any]) -> Markup:
    return Markup(to_script_json(content))  # noqa: S704


def _planner(comparison: Comparison, row: PlannerRow) -> dict[str, Any]:
    """A line of the table."""
    total = {"expanded": row.expanded_total, "generated": row.generated_total, "touched": row.touched_total}
    interval = comparison.us.median_interval(row.planner) if comparison.paired_replans else None
    us_low, us_high = interval or (None, None)
    word, state = _word(comparison, row)
    return {
        "planner": row.planner,
        "success_rate": row.success_rate,
        "total": total[comparison.counted],
        "per_question": total[comparison.counted] / row.replans,
        "ratio": row.ratio_expanded,
        "low": row.ratio_low,
        "high": row.ratio_high,
        "word": word,
        "state": state,
        "us": row.us_median,
        "us_low": us_low,
        "us_high": us_high,
        "us_p95": row.us_p95,
        "excess": row.suboptimality_mean,
        "length": row.length_m_total,
        "scratch": row.fallback_share,
    }


def _word(comparison: Comparison, row: PlannerRow) -> tuple[str, str]:
    """What a ratio's interval says, in a word, and the word's colour."""
    if row.planner == comparison.baseline:
        return "baseline", ""
    if row.ratio_low is None or row.ratio_high is None or 1 < comparison.paired_episodes < FEWEST_VALUES:
        return "too few to tell", ""
    if row.ratio_low > 1:
        return "fewer", "good"
    return ("more", "bad") if row.ratio_high < 1 else ("no difference shown", "")


def _note(shown: ShownQuestions, asked: Asked) -> str:
    """What of the source the slider shows, where that is not all."""
    word, total = word_for(shown), len(asked.episode)
    if len(shown.questions) == total:
        return ""
    here = f"{count(len(shown.questions))} of {count(total)} {'queries' if shown.is_static else 'replans'} are shown"
    episodes, all_of = shown.questions[-1].episode + 1, len(set(asked.episode.tolist()))
    if shown.stride > 1:
        alone = f" of the first of {all_of} episodes" if all_of > 1 and not shown.is_static else ""
        return f"Thinned for this page: {here}, one {word} in {shown.stride}{alone}."
    whole = f"those of the first {episodes} of {all_of} episodes" if episodes < all_of and not shown.is_static else ""
    return f"On this map {here}{', ' if whole else ''}{whole}; what could not be asked has no map."


def _chart_note(asked: Asked | None, chart: Mapping[str, Any] | None) -> str:
    if asked is None or chart is None or not chart["panels"]:
        return ""
    drawn, last = len(chart["panels"][0]["seconds"]), int(chart["panels"][0]["seconds"][-1])
    return f"Thinned to {count(drawn)} of {count(last)}, with the extremes of every line." if drawn < last else ""


def _picture(name: str, png: bytes) -> dict[str, Any]:
    """Template values of a PNG; its header holds width and height at bytes 16 to 24."""
    title, alt = _PICTURES[name]
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    return {"title": title, "alt": alt, "png": base64.b64encode(png).decode(), "width": width, "height": height}
