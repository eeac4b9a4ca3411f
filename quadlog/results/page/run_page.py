"""The page of one run: what came out, the map beside its curves, sensors, metrics, and how the run was made."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.metrics.intervals import COVERAGE
from quadlog.results.figures import FIGURES, drawings_of
from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Table
from quadlog.results.page.pack import Pack
from quadlog.results.page.verdict import matters, status, verdict
from quadlog.results.run import Run
from quadlog.results.scenes import CAUSES
from quadlog.results.text import (
    Bound,
    bounds_of,
    count,
    file_size,
    interval_note,
    interval_text,
    label_of,
    percent,
    sig,
    state_of,
    value_text,
)
from quadlog.results.view import TIME, Drawing, Scene

if TYPE_CHECKING:
    from pandas import DataFrame

_START = ("max_error_m", "eta_m", "ate_rmse_m", "uwb_rmse_m")
_WORST = {
    "Positions": (("bound", "uwb_nees", "uwb_coverage_95", "ate_rmse_m"), ("uwb_error", "ranges")),
    "Simulated walk": (("collisions", "clearance_min_m"), ("clearance", "tracking_error")),
    "Planning": (("success_rate", "suboptimality_mean"), ("expanded",)),
    "Gaps": (("gap",), ("motion",)),
}
"""By subject of the worst sentence: metrics at whose worst instant the page opens, and figures that come first."""
PER_CARD = 3
MOST_ROWS = 200
"""Of a table on the page; the run's files have all rows."""


def write_run_page(run: Run, drawings: Mapping[str, Drawing] | None = None) -> Path:
    """report.html of a run; drawings: those of drawings_of, if made already. Raises NotARun, CannotWrite."""
    page = run_page(run, drawings_of(run) if drawings is None else drawings)
    return blocks.write_page(run.path / "report.html", page)


def run_page(run: Run, drawings: Mapping[str, Drawing]) -> blocks.Page:
    """The page of a run and these drawings."""
    pack, views, sentences = Pack(), dict[str, blocks.Drawn](), verdict(run)
    worst = sentences[0].subject if sentences and sentences[0].state in ("bad", "warn") else ""
    moments_of, first_ones = _WORST.get(worst, ((), ()))
    shown = sorted(FIGURES, key=lambda of: first_ones.index(of.name) if of.name in first_ones else len(first_ones))
    for figure in (figure for figure in shown if figure.name in drawings):
        pack.add(figure.name, drawings[figure.name])
        views[figure.name] = blocks.Drawn(figure.name, figure.title, figure.caption)
    first: list[Any] = [blocks.Verdict(sentences), blocks.Cards(cards(run))]
    torques = [views.pop("torques")] if "torques" in views else []
    scene = drawings.get("trajectory")
    if isinstance(scene, Scene):
        names = (*moments_of, *_START)
        ranked = sorted(scene.moments, key=lambda of: names.index(of.name) if of.name in names else len(names))
        start = ranked[0].seconds if ranked else None
        player = blocks.Drawn("trajectory", moments=scene.moments, start=start)
        timed = [name for name in views if name in pack.charts and pack.charts[name]["panels"][0]["x"] == TIME]
        del views["trajectory"]
        curves = [views.pop(name) for name in timed]
        first.append(blocks.Beside(player, curves) if curves else player)
    help_text = f"Drag in a chart, or turn the wheel with Ctrl, to zoom; double-click to see all. {pack.thinned}"
    sections = [
        blocks.Section("", [*first, *_lost(run)]),
        blocks.Section("Sensors", [*_tables(run, "links"), *views.values()], help_text.strip()),
        blocks.Section("Metrics", [metric_table(run)] if run.metrics else []),
        blocks.Section("Contacts and gait", [*_tables(run, "contacts", "gait"), *_torques(run), *torques]),
        blocks.Section("Topics", list(_topics(run))),
        blocks.Section("How it was made", list(_made(run))),
    ]
    return blocks.Page(run.title, sections, _facts(run), status(run), [("all runs", "../report.html")], pack)


def _facts(run: Run) -> list[str]:
    record = run.record
    speed = [] if record.realtime_factor is None else [f"{sig(record.realtime_factor)} × real time"]
    made = f"{'simulated' if run.simulated else 'replayed'} by quadlog {record.quadlog_version}"
    return [f"{sig(record.recorded_s)} s", *speed, made, ", ".join(stage.name for stage in record.stages)]


def cards(run: Run) -> list[tuple[str, list[blocks.Shown]]]:
    """The metrics that matter of each theme; broken bounds first, and all of them."""
    bounds, found = bounds_of(run), []
    for theme, labels in THEMES.items():
        shown = [_shown(run, name, bounds.get(name)) for name in labels if name in run.metrics or name in bounds]
        shown.sort(key=lambda one: one.state != "bad")
        most = max(PER_CARD, sum(one.state == "bad" for one in shown))
        if shown and (theme != "Computing" or shown[0].state):  # which the page's head has
            found.append((theme, shown[:most]))
    return found


def _shown(run: Run, name: str, bound: Bound | None) -> blocks.Shown:
    metric, meaning = run.metrics.get(name), f"{CATALOGUE[name].meaning} ({name})"
    expected = "" if bound is None else f"expected {bound.words}"
    if metric is None:
        return blocks.Shown(label_of(name), "not measured", expected, meaning, "bad", None)
    small = expected or interval_text(name, metric.interval, metric.unit)
    value = value_text(name, metric.value, metric.unit)
    seconds = None if metric.worst_t_ns is None else float(run.seconds(np.array([metric.worst_t_ns]))[0])
    return blocks.Shown(label_of(name), value, small, meaning, state_of(name, metric, bound), seconds)


def metric_table(run: Run) -> Table:
    """All metrics, by theme."""
    bounds = bounds_of(run)
    known = [name for labels in THEMES.values() for name in labels]
    rows = []
    for name in [*(n for n in known if n in run.metrics or n in bounds), *(n for n in run.metrics if n not in known)]:
        metric, bound = run.metrics.get(name), bounds.get(name)
        meaning = f"{CATALOGUE[name].meaning if name in CATALOGUE else ''}."
        cells = [Cell("not measured", state="bad"), Cell(""), Cell("")]
        if metric is not None:
            value, state = value_text(name, metric.value, metric.unit, 4), state_of(name, metric, bound)
            interval, samples = Cell(interval_text(name, metric.interval, metric.unit)), Cell(count(metric.n), metric.n)
            cells = [Cell(value, metric.value, state=state), interval, samples]
        below = meaning if bound is None else f"{meaning} Expected {bound.words}."
        first = Cell(label_of(name), below=below, state=cells[0].state)
        rows.append([first, Cell(name, code=True), *cells])
    columns = [Column("metric"), Column("name", wide=True), Column("value", True),
               Column("95 % interval", True, help=COVERAGE), Column("samples", True, True)]  # fmt: skip
    note = (f"{interval_note(run.record.recorded_s)}. "
            "quadlog metrics RUN --explain NAME prints formula, source and worst instants.")  # fmt: skip
    return Table(columns, rows, "all-metrics", note, sortable=True)


def frame_table(frame: DataFrame, heads: Mapping[str, str], name: str, note: str = "") -> Table:
    """The columns of a frame that have a head; texts to the left, numbers to the right, `seconds` as links."""
    text = {column: frame[column].dtype.kind not in "fiu" for column in heads if frame[column].astype(str).any()}
    shown = frame.head(MOST_ROWS).to_dict("records")
    rows = [[_cell(column, row[column], text[column]) for column in text] for row in shown]
    if len(frame) > MOST_ROWS:
        note = f"{note} The first {MOST_ROWS} of {count(len(frame))} rows.".strip()
    return Table([Column(heads[column], not text[column]) for column in text], rows, name, note)


def _cell(column: str, value: Any, is_text: bool) -> Cell:
    if is_text:
        return Cell({True: "yes", False: "no"}.get(value, str(value)))
    number = float(value) if np.isfinite(value) else None
    shown = percent(number) if column.endswith("share") else sig(number)
    return Cell(shown, number, seconds=number if column == "seconds" else None)


_LEGS = {f"duty_factor_{leg}": f"duty {name}" for leg, name in enumerate(("FL", "FR", "RL", "RR"))}
_SHOWN = {
    "links": (
        {"tag": "tag", "anchor": "anchor", "n": "ranges", "residual_rms_m": "residual rms (m)",
         "range_std_m": "noise (m)", "bias_m": "bias (m)",
         "bias_std_m": "± std (m)", "bias_applied": "subtracted", "why_not": "why not", "nlos_share": "late"},
        "UWB links. Late: longer than predicted by more than three times the noise, most likely NLOS."),
    "contacts": (
        {"seconds": "from (s)", "duration_s": "for (s)", "x_m": "x (m)", "y_m": "y (m)",
         "clearance_m": "clearance (m)", "cause": "cause", "collision": "collision"},
        "Contacts of the simulated body. A cell that first appears inside the body is no collision."),
    "gait": (
        {"body": "body", "speed_mps": "speed (m/s)", "stride_frequency_hz": "strides (Hz)",
         **_LEGS, "cost_of_transport": "cost of transport"},
        "The logged and the simulated body."),
}  # fmt: skip
"""Heads of the columns shown of a table of the run, and a note."""


def _tables(run: Run, *names: str) -> Iterator[Table]:
    for name in names:
        frame = run.table(name)
        if frame is not None:
            yield frame_table(frame.replace({"cause": CAUSES}), _SHOWN[name][0], f"{name}-table", _SHOWN[name][1])


def _torques(run: Run) -> Iterator[Table]:
    body = run.table("body")
    if body is not None:
        wide = body[body["phase"] != "all"].pivot_table("torque_rms_nm", "joint", ["body", "phase"], sort=False)
        wide.columns = [", ".join(head) for head in wide.columns]
        names = {"joint": "torque, rms (N·m)", **{head: head for head in wide.columns}}
        yield frame_table(wide.reset_index(), names, "torques-of-bodies")


def _lost(run: Run) -> Iterator[Any]:
    lines = [
        f"{of.cause}{f' on {of.topic}' if of.topic else ''}{f', {count(of.count)} ×' if of.count else ''}: {of.detail}"
        for of in run.record.losses
    ]
    if lines:
        yield blocks.Notes("Lost from the recording", lines, "bad")
    warnings = [*matters(run), *run.notes]
    if warnings:
        yield blocks.Notes("Warnings", warnings)
    if rest := [text for text in run.record.warnings if text not in warnings]:
        yield blocks.Notes("To know", rest, "")


def _records(rows: Sequence[Mapping[str, Any]], name: str, note: str = "") -> list[Table]:
    """Rows of text and numbers below their names."""
    from pandas import DataFrame

    return [frame_table(DataFrame(rows), {key: key for key in rows[0]}, name, note)] if rows else []


def _topics(run: Run) -> Iterator[Any]:
    yield from _records([of.model_dump() for of in run.record.topics], "topics-used")
    if run.record.notes:
        yield blocks.Details("Choices that affected the result", [*map(blocks.Text, run.record.notes)])


def _made(run: Run) -> Iterator[Any]:
    record = run.record
    total_s = sum(stage.seconds for stage in record.stages) or 1.0
    stages = [
        {"stage": of.name, "time (s)": round(of.seconds, 2), "share": of.seconds / total_s,
         "peak memory (MB)": of.peak_memory_mb} for of in record.stages
    ]  # fmt: skip
    note = f"Start-up, imports and compilation, took {record.startup_s:.1f} s more."
    yield from _records(stages, "stages", note)
    yield blocks.Text(shlex.join(record.command), code=True)
    kind, value = record.input.fingerprint or ("no fingerprint", "")
    size = file_size(record.input.size_bytes)
    yield blocks.Text(f"Input: {record.input.path}, {size}, {kind} {value}. Seed {record.seed}.")
    if (config := run.path / "config.toml").is_file():
        text = config.read_text(encoding="utf-8", errors="replace")
        yield blocks.Details("Configuration", [blocks.Text(text, code=True)])
    yield blocks.Text("[Following], [Planning], [Tracking] and [Foot] are the papers listed in docs/references.md.")
