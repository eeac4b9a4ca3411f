"""The page of one run: what came out, the map beside its curves, sensors, metrics, and how the run was made."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.results.figures import FIGURES, drawings_of
from quadlog.results.numbers import count, file_size, percent, sig
from quadlog.results.page.blocks import (
    Beside,
    Cards,
    Cell,
    Chart,
    Column,
    Details,
    Notes,
    Page,
    SceneView,
    Section,
    Shown,
    Table,
    Text,
    Verdict,
    write_page,
)
from quadlog.results.page.pack import Pack
from quadlog.results.page.verdict import is_too_short, status, verdict
from quadlog.results.record import LossRecord, SavedMetric
from quadlog.results.run import Run
from quadlog.results.view import TIME, Drawing, Moment, Scene
from quadlog.results.words import Bound, State, bounds_of, interval_text, is_alarming, label_of, value_text

if TYPE_CHECKING:
    from pandas import DataFrame

_START = ("max_error_m", "eta_m", "ate_rmse_m", "uwb_rmse_m")
PER_CARD = 3
MOST_ROWS = 200
"""Of a table on the page; the run's files have all rows."""


def write_run_page(run: Run, drawings: Mapping[str, Drawing] | None = None) -> Path:
    """report.html of a run; drawings: those of drawings_of, if made already. Raises NotARun, CannotWrite."""
    page = run_page(run, drawings_of(run) if drawings is None else drawings)
    return write_page(run.path / "report.html", page)


def run_page(run: Run, drawings: Mapping[str, Drawing]) -> Page:
    """The page of a run and these drawings."""
    pack, views = Pack(), dict[str, Any]()
    for figure in FIGURES:
        if (drawing := drawings.get(figure.name)) is not None:
            pack.add(figure.name, drawing)
            kind = SceneView if isinstance(drawing, Scene) else Chart
            views[figure.name] = kind(figure.name, figure.title, figure.caption)
    scene = drawings.get("trajectory")
    first: list[Any] = [Verdict(verdict(run)), Cards(cards(run))]
    if isinstance(scene, Scene):
        del views["trajectory"]
        player = SceneView("trajectory", moments=scene.moments, start=_start(scene.moments))
        curves = [views.pop(name) for name in _timed(drawings)]
        first.append(Beside(player, curves) if curves else player)
    walk, sensors = (
        [views[figure.name] for figure in FIGURES if figure.about == about and figure.name in views]
        for about in ("walk", "sensors")
    )
    help_text = f"Drag in a chart to zoom, double-click to see all; a click moves the map there. {pack.thinned}"
    sections = [
        Section("", [*first, *_lost(run)]),
        Section("Walk", walk),
        Section("Sensors", [*_tables(run, "links"), *sensors], help_text.strip()),
        Section("Metrics", [metric_table(run)] if run.metrics else []),
        Section("Contacts and gait", [*_tables(run, "contacts", "gait"), *_torques(run)]),
        Section("Topics", list(_topics(run))),
        Section("How it was made", list(_made(run))),
    ]
    return Page(run.title, sections, _facts(run), status(run), [("all runs", "../report.html")], pack)


def _timed(drawings: Mapping[str, Drawing]) -> list[str]:
    """Charts over time, which stand beside the map; the error of the positions comes second."""
    names = [
        figure.name
        for figure in FIGURES
        if not isinstance(drawing := drawings.get(figure.name, ()), Scene) and drawing and drawing[0].x == TIME
    ]
    return sorted(names, key=lambda name: {"trot": 0, "tracking_error": 0, "uwb_error": 1}.get(name, 2))


def _start(moments: Sequence[Moment]) -> float | None:
    """The instant of the first view: the worst one of what matters most, which the map then draws."""
    worst = {moment.name: moment.seconds for moment in moments}
    first = moments[0].seconds if moments else None
    return next((worst[name] for name in _START if name in worst), first)


def _facts(run: Run) -> list[str]:
    record = run.record
    stages = ", ".join(stage.name for stage in record.stages)
    made = "simulated" if run.simulated else "replayed"
    facts = [f"{sig(record.recorded_s)} s", f"{made} by quadlog {record.quadlog_version}"]
    if record.realtime_factor is not None:
        facts.insert(1, f"{sig(record.realtime_factor)} × real time")
    return [*facts, stages]


def cards(run: Run) -> list[tuple[str, list[Shown]]]:
    """The metrics that matter of each theme; broken bounds first, and all of them."""
    bounds, found = bounds_of(run), []
    for theme, labels in THEMES.items():
        if theme in ("Walking", "Body") and is_too_short(run):
            continue
        shown = [_shown(run, name, bounds.get(name)) for name in labels if name in run.metrics or name in bounds]
        shown.sort(key=lambda one: one.state != "bad")
        most = max(PER_CARD, sum(one.state == "bad" for one in shown))
        if shown:
            found.append((theme, shown[:most]))
    return found


def _shown(run: Run, name: str, bound: Bound | None) -> Shown:
    metric, meaning = run.metrics.get(name), f"{CATALOGUE[name].meaning} ({name})"
    expected = "" if bound is None else f"expected {bound.words}"
    if metric is None:
        return Shown(label_of(name), "not measured", expected, meaning, "bad")
    state = _state(name, metric, bound)
    small = expected or interval_text(name, metric)
    seconds = None if metric.worst_t_ns is None else float(run.seconds(np.array([metric.worst_t_ns]))[0])
    return Shown(label_of(name), value_text(name, metric.value, metric.unit), small, meaning, state, seconds)


def _state(name: str, metric: SavedMetric | None, bound: Bound | None) -> State:
    if bound is not None:
        return bound.state
    return "warn" if metric is not None and is_alarming(name, metric.value) else ""


def metric_table(run: Run) -> Table:
    """All metrics, by theme."""
    bounds = bounds_of(run)
    known = {name: theme for theme, labels in THEMES.items() for name in labels}
    rows = []
    for name in [*(n for n in known if n in run.metrics or n in bounds), *(n for n in run.metrics if n not in known)]:
        metric, bound = run.metrics.get(name), bounds.get(name)
        meaning = CATALOGUE[name].meaning if name in CATALOGUE else ""
        expected = "" if bound is None else f" Expected {bound.words}."
        state = _state(name, metric, bound)
        shown = "not measured" if metric is None else value_text(name, metric.value, metric.unit, 4)
        rows.append([
            Cell(label_of(name), below=f"{meaning}.{expected}", state=state),
            Cell(name, code=True),
            Cell(shown, None if metric is None else metric.value, state=state),
            Cell("" if metric is None else interval_text(name, metric)),
            Cell("" if metric is None else count(metric.n), None if metric is None else metric.n),
            Cell(known.get(name, "")),
        ])  # fmt: skip
    columns = [Column("metric"), Column("name", wide=True), Column("value", True), Column("95 % interval", True),
               Column("samples", True, True), Column("theme", wide=True)]  # fmt: skip
    note = ("95 % interval of the value, corrected for autocorrelation; empty if the walk is too short for one. "
            "quadlog metrics RUN --explain NAME prints formula, source and worst instants.")  # fmt: skip
    return Table(columns, rows, "all-metrics", note, "Search, as in torque", sortable=True, folded=None)


def frame_table(frame: DataFrame, names: Mapping[str, str], name: str, note: str = "") -> Table:
    """Columns of a frame under their heads; texts to the left, numbers to the right, `seconds` as links."""
    text = {column: frame[column].dtype.kind not in "fiu" for column in names if frame[column].astype(str).any()}
    rows = []
    for row in frame.head(MOST_ROWS).to_dict("records"):
        cells = []
        for column, is_text in text.items():
            value = row[column]
            if is_text:
                cells.append(Cell({True: "yes", False: "no"}.get(value, str(value))))
                continue
            number = None if value is None or not np.isfinite(value) else float(value)
            shown = percent(number) if column.endswith("_share") else sig(number)
            cells.append(Cell(shown, number, seconds=number if column == "seconds" else None))
        rows.append(cells)
    if len(frame) > MOST_ROWS:
        note = f"{note} The first {MOST_ROWS} of {count(len(frame))} rows.".strip()
    return Table([Column(names[column], not is_text) for column, is_text in text.items()], rows, name, note)


_LEGS = {f"duty_factor_{leg}": f"duty {name}" for leg, name in enumerate(("FL", "FR", "RL", "RR"))}
_SHOWN = {
    "links": (
        {"tag": "tag", "anchor": "anchor", "n": "ranges", "residual_rms_m": "residual rms (m)", "bias_m": "bias (m)",
         "bias_std_m": "± std (m)", "bias_applied": "subtracted", "why_not": "why not", "nlos_share": "late"},
        "UWB links. Late: longer than predicted by more than three standard deviations, most likely NLOS."),
    "contacts": (
        {"seconds": "from (s)", "duration_s": "for (s)", "x_m": "x (m)", "y_m": "y (m)",
         "clearance_m": "clearance (m)", "cause": "cause", "collision": "collision"},
        "Contacts of the simulated body. A cell that first appears inside the body is no collision."),
    "gait": (
        {"body": "body", "speeds": "speeds", "speed_mps": "speed (m/s)", "stride_frequency_hz": "strides (Hz)",
         **_LEGS, "cost_of_transport": "cost of transport", "height_mean_m": "height (m)"},
        "The logged and the simulated body."),
}  # fmt: skip
"""Heads of the columns shown of a table of the run, and a note."""


def _tables(run: Run, *names: str) -> Iterator[Table]:
    for name in names:
        frame = run.table(name)
        if frame is not None:
            yield frame_table(frame, _SHOWN[name][0], f"{name}-table", _SHOWN[name][1])


def _torques(run: Run) -> Iterator[Table]:
    body = run.table("body")
    if body is not None:
        wide = body[body["phase"] != "all"].pivot_table(
            "torque_rms_nm", "joint", ["speeds", "body", "phase"], sort=False
        )
        wide.columns = [", ".join(head) for head in wide.columns]
        names = {"joint": "torque, rms (N·m)", **{head: head for head in wide.columns}}
        yield frame_table(wide.reset_index(), names, "torques-of-bodies")


def _lost(run: Run) -> Iterator[Any]:
    if run.record.losses:
        yield Notes("Lost from the recording", [loss_text(loss) for loss in run.record.losses], "bad")
    if run.record.warnings or run.notes:
        yield Notes("Warnings", [*run.record.warnings, *run.notes])


def loss_text(loss: LossRecord) -> str:
    """A loss in a line."""
    topic, times = f" on {loss.topic}" if loss.topic else "", f", {count(loss.count)} ×" if loss.count else ""
    return f"{loss.cause}{topic}{times}: {loss.detail}"


def _topics(run: Run) -> Iterator[Any]:
    record = run.record
    if record.topics:
        columns = [Column("role"), Column("topic"), Column("messages", True), Column("why", wide=True)]
        rows = [
            [Cell(of.role), Cell(of.topic, below=of.type, code=True), Cell(count(of.messages)), Cell(of.why)]
            for of in record.topics
        ]
        yield Table(columns, rows, "topics-used")
    if record.notes:
        yield Details("Choices that affected the result", [Text(note) for note in record.notes])


def _made(run: Run) -> Iterator[Any]:
    record = run.record
    total_s = sum(stage.seconds for stage in record.stages) or 1.0
    columns = [Column("stage"), Column("time (s)", True), Column("share", True), Column("peak memory (MB)", True)]
    rows = [
        [Cell(stage.name), Cell(f"{stage.seconds:.2f}"), Cell(percent(stage.seconds / total_s, 2)),
         Cell(f"{stage.peak_memory_mb:.0f}")]
        for stage in record.stages
    ]  # fmt: skip
    yield Table(columns, rows, "stages", f"Start-up, imports and compilation, took {record.startup_s:.1f} s more.")
    yield Text(shlex.join(record.command), code=True)
    kind, value = record.input.fingerprint or ("no fingerprint", "")
    size = file_size(record.input.size_bytes)
    yield Text(f"Input: {record.input.path}, {size}, {kind} {value}. Seed {record.seed}.")
    config = run.path / "config.toml"
    if config.is_file():
        yield Details("Configuration", [Text(config.read_text(encoding="utf-8", errors="replace"), code=True)])
    versions = {**{key: str(value) for key, value in sorted(record.host.items())}, **record.packages}
    rows = [[Cell(name), Cell(value)] for name, value in versions.items()]
    yield Details("Versions and host", [Table([Column("package"), Column("version")], rows, "versions")])
    yield Text("[Following], [Planning], [Tracking] and [Foot] are the papers listed in docs/references.md.")
