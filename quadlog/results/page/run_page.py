"""The page of one run: what came out, the map beside its curves, sensors, metrics, and how the run was made."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.metrics.intervals import COVERAGE
from quadlog.results.figures import FIGURES, drawings_of
from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Table, metric_cell
from quadlog.results.page.pack import Pack
from quadlog.results.page.verdict import matters, status, verdict
from quadlog.results.record import TopicRecord
from quadlog.results.run import Run
from quadlog.results.scenes import CAUSES
from quadlog.results.text import Bound, State, bounds_of, count, interval_note, label_of, percent, sig
from quadlog.results.view import TIME, Drawing, Scene

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
    first: list[Any] = [blocks.Verdict(sentences), *([blocks.Cards(numbers)] if (numbers := cards(run)) else [])]
    torques = [views.pop("torques")] if "torques" in views else []
    if isinstance(scene := drawings.get("trajectory"), Scene):
        names = (*moments_of, *_START)
        ranked = sorted(scene.moments, key=lambda of: names.index(of.name) if of.name in names else len(names))
        start = ranked[0].seconds if ranked else None
        del views["trajectory"]
        timed = [name for name in views if name in pack.charts and pack.charts[name]["panels"][0]["x"] == TIME]
        curves = [views.pop(name) for name in timed]
        first.append(blocks.Drawn("trajectory", moments=scene.moments, start=start, charts=curves))
    hint = "Drag in a chart, or turn the wheel with Ctrl, to zoom; double-click to see all."
    sections = [
        blocks.Section("", [*first, *_lost(run)]),
        blocks.Section("Sensors", [*_tables(run, "links"), *views.values()], pack.thinned, hint),
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


def cards(run: Run) -> list[tuple[str, list[tuple[Cell, Cell]]]]:
    """The metrics that matter of each theme; broken bounds first, and all of them."""
    bounds, found = bounds_of(run), []
    for theme, labels in THEMES.items():
        shown = [_shown(run, name, bounds) for name in labels if name in run.metrics or name in bounds]
        shown.sort(key=lambda one: one[1].state != "bad")
        most = max(PER_CARD, sum(value.state == "bad" for _, value in shown))
        if shown and (theme != "Computing" or shown[0][1].state):  # which the page's head has
            found.append((theme, shown[:most]))
    return found


def _shown(run: Run, name: str, bounds: Mapping[str, Bound]) -> tuple[Cell, Cell]:
    metric, bound = run.metrics.get(name), bounds.get(name)
    value, worst_t_ns = metric_cell(name, metric, bound), None if metric is None else metric.worst_t_ns
    seconds = None if worst_t_ns is None else float(run.seconds(np.array([worst_t_ns]))[0])
    label = Cell(label_of(name), below=f"{CATALOGUE[name].meaning} ({name})", seconds=seconds)
    return label, value if bound is None else value._replace(below=f"expected {bound.words}")


def metric_table(run: Run) -> Table:
    """All metrics, by theme."""
    bounds, rows = bounds_of(run), []
    known = [name for labels in THEMES.values() for name in labels]
    for name in (of for of in dict.fromkeys([*known, *run.metrics]) if of in run.metrics or of in bounds):
        metric, bound = run.metrics.get(name), bounds.get(name)
        cell, samples = (
            metric_cell(name, metric, bound, 4),
            Cell("") if metric is None else Cell(count(metric.n), metric.n),
        )
        meaning = f"{CATALOGUE[name].meaning if name in CATALOGUE else ''}."
        below = meaning if bound is None else f"{meaning} Expected {bound.words}."
        first = Cell(label_of(name), below=below, state=cell.state)
        rows.append([first, Cell(name, code=True), cell._replace(below=""), Cell(cell.below), samples])
    columns = [Column("metric"), Column("name", wide=True), Column("value", True),
               Column("95 % interval", True, help=COVERAGE), Column("samples", True, True)]  # fmt: skip
    shown = [at for at, _ in enumerate(columns) if any(row[at].text for row in rows)]  # a short log has no interval
    columns, rows = [columns[at] for at in shown], [[row[at] for at in shown] for row in rows]
    note = (f"{interval_note(run.record.recorded_s)}. "
            "quadlog metrics RUN --explain NAME prints formula, source and worst instants.")  # fmt: skip
    return Table(columns, rows, "all-metrics", note, sortable=True)


def rows_table(rows: Sequence[Mapping[Any, Any]], heads: Mapping[str, str], name: str, note: str = "") -> list[Table]:
    """The columns of these rows that have a head and a value; texts to the left, numbers to the right."""
    filled = [column for column in heads if any(row[column] != "" for row in rows)]
    text = {column: isinstance(rows[0][column], str | bool) for column in filled}
    cells = [[_cell(column, row[column]) for column in text] for row in rows[:MOST_ROWS]]
    if len(rows) > MOST_ROWS:
        note = f"{note} The first {MOST_ROWS} of {count(len(rows))} rows.".strip()
    return [Table([Column(heads[column], not text[column]) for column in text], cells, name, note)] if rows else []


def _cell(column: str, value: Any) -> Cell:
    if isinstance(value, str | bool):
        return Cell(value if isinstance(value, str) else "yes" if value else "no")
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
        if (frame := run.table(name)) is not None:
            rows = frame.replace({"cause": CAUSES}).to_dict("records")
            yield from rows_table(rows, _SHOWN[name][0], f"{name}-table", _SHOWN[name][1])


def _torques(run: Run) -> list[Table]:
    body = run.table("body")
    if body is None:
        return []
    wide = body[body["phase"] != "all"].pivot_table("torque_rms_nm", "joint", ["body", "phase"], sort=False)
    wide.columns = [", ".join(head) for head in wide.columns]
    heads = {"joint": "torque, rms (N·m)", **{head: head for head in wide.columns}}
    return rows_table(wide.reset_index().to_dict("records"), heads, "torques-of-bodies")


def _lost(run: Run) -> Iterator[Any]:
    lines = [
        f"{of.cause}{f' on {of.topic}' if of.topic else ''}{f', {count(of.count)} ×' if of.count else ''}: {of.detail}"
        for of in run.record.losses
    ]
    warnings = [*matters(run), *run.notes]
    rest = [text for text in run.record.warnings if text not in warnings]
    states: dict[str, State] = {"Lost from the recording": "bad", "Warnings": "warn", "To know": ""}
    for (title, state), texts in zip(states.items(), (lines, warnings, rest), strict=True):
        if texts:
            yield blocks.Notes(title, texts, state)


def _topics(run: Run) -> Iterator[Any]:
    heads = {name: name for name in TopicRecord.model_fields}
    yield from rows_table([of.model_dump() for of in run.record.topics], heads, "topics-used")
    if run.record.notes:
        yield blocks.Details("Choices that affected the result", [*map(blocks.Text, run.record.notes)])


def _made(run: Run) -> Iterator[Any]:
    record = run.record
    total_s = sum(stage.seconds for stage in record.stages) or 1.0
    stages = [of.model_dump() | {"time_s": round(of.seconds, 2), "share": of.seconds / total_s} for of in record.stages]
    heads = {"name": "stage", "time_s": "time (s)", "share": "share", "peak_memory_mb": "peak memory (MB)"}
    note = f"Start-up, imports and compilation, took {record.startup_s:.1f} s more."
    yield from rows_table(stages, heads, "stages", note)
    yield blocks.Text(shlex.join(record.command), code=True)
    kind, value = record.input.fingerprint or ("no fingerprint", "")
    size = f"{record.input.size_bytes / 1e6:.3g} MB"
    yield blocks.Text(f"Input: {record.input.path}, {size}, {kind} {value}. Seed {record.seed}.")
    if (config := run.path / "config.toml").is_file():
        text = config.read_text(encoding="utf-8", errors="replace")
        yield blocks.Details("Configuration", [blocks.Text(text, code=True)])
    yield blocks.Text("[Following], [Planning], [Tracking] and [Foot] are the papers listed in docs/references.md.")
