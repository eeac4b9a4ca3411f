"""Interactive charts of a run, from its saved tables: name of the figure -> panels over time."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float
from quadlog.results.plots.control import COMMANDS, JOINT_NAMES, JOINTS, LEG_NAMES, LEGS, LOOKAHEAD, POSTURE, Columns
from quadlog.results.plots.run_data import RunData, Table, seen_around
from quadlog.results.plots.style import COLORS, error_classes, thin_line, thin_points
from quadlog.results.plots.trajectory import is_ahead, some_plans
from quadlog.storage.formats.tum import read_tum

PANEL_POINTS = 800
"""Points per line: about two per pixel of a phone, extremes included."""

_DIGITS = 4
"""Numbers are rounded to this many digits of their line's span, which is finer than a pixel."""
_TIME_DIGITS = 3


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a panel: seconds, values (N,); points: drawn as unconnected points."""

    label: str
    color: str
    seconds: Float
    values: Float
    points: bool = False


@dataclass(frozen=True, slots=True)
class ChartPanel:
    """One panel of a chart over time. what: quantity and unit."""

    what: str
    lines: Sequence[Line]


def over_time(panels: Sequence[ChartPanel]) -> dict[str, Any] | None:
    """A chart with those panels that have a value, as plain JSON; None without any."""
    drawn = [each for each in map(panel_json, panels) if each is not None]
    return {"panels": drawn} if drawn else None


def panel_json(panel: ChartPanel) -> dict[str, Any] | None:
    """One panel as plain JSON, or None if no line has a value.

    Lines may have different time stamps: a line has no value (None) at the time stamps of
    another; the page connects its neighbouring values, but not across a gap of the line itself.
    """
    lines = [line for line in panel.lines if np.isfinite(line.values).any()]
    if not lines:
        return None
    if all(line.seconds is lines[0].seconds for line in lines):
        keep = np.unique(np.concatenate([thin_line(line.values, PANEL_POINTS) for line in lines]))
        times, columns = lines[0].seconds[keep], [line.values[keep] for line in lines]
        joined = False
    else:
        times, columns = _merged(lines)
        joined = True
    return {
        "what": panel.what,
        "joined": joined,
        "lines": [{"label": line.label, "color": line.color, "points": line.points} for line in lines],
        "seconds": [round(value, _TIME_DIGITS) for value in times.tolist()],
        "values": [rounded(column) for column in columns],
    }


def rounded(values: Float) -> list[float | None]:
    """Numbers with as many decimals as their span needs; None for one that is not finite."""
    finite = values[np.isfinite(values)]
    span = float(np.ptp(finite)) if len(finite) else 0.0
    size = span or (float(np.abs(finite).max()) if len(finite) else 0.0)
    digits = int(np.clip(_DIGITS - math.floor(math.log10(size)), 0, 12)) if size > 0 else 0
    short = np.round(values, digits) + 0.0
    return [value if math.isfinite(value) else None for value in short.tolist()]


def to_script_json(content: Any) -> str:
    """JSON that is safe inside <script type="application/json">: it cannot end the element or open another.

    ASCII only, so that Unicode line separators are escaped, too.
    """
    text = json.dumps(content, separators=(",", ":"), sort_keys=True, allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _merged(lines: Sequence[Line]) -> tuple[Float, list[Float]]:
    """The time stamps of all lines, sorted, and each line's values there, NaN where it has none."""
    kept = [(line, thin_line(line.values, PANEL_POINTS)) for line in lines]
    times = np.unique(np.concatenate([line.seconds[keep] for line, keep in kept]))
    columns = []
    for line, keep in kept:
        column = np.full(len(times), np.nan)
        column[np.searchsorted(times, line.seconds[keep])] = line.values[keep]
        columns.append(column)
    return times, columns


POINTS = 2000
"""Points per walk: 3 cm apart in a walk of one minute."""
WALL_SHARE = 0.5
"""Cells occupied in this share of the maps that cover them are drawn: walls, not moving objects."""
MAX_RUNS = 20_000


def trajectory_chart(run: RunData) -> dict[str, Any] | None:
    """Paths of robot, target, re-simulated or simulated walk and reference with their times; None without paths.

    Beside them anchors, walls, fixes (points), plans (lines); around: further points that must be in view. The robot's
    walk has the class of its error at each point, whose labels are `errors`, where there is a reference.
    """
    walked = "simulated walk" if run.simulated else "re-simulated walk"
    wanted = [("course", "paths", "note")] if run.simulated else []
    wanted += [("robot", "poses", "robot"), ("target", "target", "target"), (walked, "control", "resim")]
    tables = [(label, run.table(name), color) for label, name, color in wanted]
    walks = [_walk(run, label, table, color) for label, table, color in tables if table is not None]
    walks = [walk for walk in walks if walk["x"]]
    if is_ahead(run.table("target")):  # it would hide the colours of the robot's line
        walks = [walk | {"hidden": True} if walk["label"] == "target" else walk for walk in walks]
    if not walks:
        return None
    anchors = [{"label": str(anchor), "x": x_m, "y": y_m} for anchor, x_m, y_m in run.anchors()]
    walked_m = np.array([[x_m, y_m] for walk in walks for x_m, y_m in zip(walk["x"], walk["y"], strict=True)])
    around = [{"x": x_m, "y": y_m} for x_m, y_m in seen_around(walked_m, run.occupancy).tolist()]
    beside = {"fixes": _fixes(run), "plans": _plans(run)}
    return {"walks": walks, "anchors": anchors, "around": around, "walls": _walls(run), **beside, **_errors(run, walks)}


def _errors(run: RunData, walks: list[dict[str, Any]]) -> dict[str, Any]:
    """The labels of the classes of the robot's error, each point's class put into its walk; the reference as a walk."""
    poses, error_m = run.table("poses"), run.pose_error_m
    if poses is None or error_m is None or not walks or walks[0]["label"] != "robot":
        return {"errors": []}
    kept = error_m[_kept(poses)]
    of, labels = error_classes(kept)
    walks[0]["classes"] = of.tolist()
    truth = read_tum(run.path / "reference.tum")
    columns = {"t_ns": truth.t_ns, "x_m": truth.position_m[:, 0], "y_m": truth.position_m[:, 1]}
    walks.append(_walk(run, "reference", columns, "text") | {"dashed": True})
    return {"errors": labels}


def _fixes(run: RunData) -> dict[str, Any] | None:
    """The fixes that are tracked, as points; None without any."""
    fixes = run.table("fixes")
    if fixes is None:
        return None
    good = np.flatnonzero(np.isfinite(fixes["x_m"]) & np.isfinite(fixes["y_m"]) & ~fixes["outlier"])
    keep = good[thin_points(len(good), POINTS)]
    return {"x": rounded(fixes["x_m"][keep]), "y": rounded(fixes["y_m"][keep])} if len(keep) else None


def _plans(run: RunData) -> list[dict[str, Any]]:
    """Some of the plans of a logged walk, the same as in the picture."""
    if run.simulated:
        return []
    return [{"x": rounded(x), "y": rounded(y)} for x, y in some_plans(run.table("paths"))]


def _kept(table: Table) -> NDArray[np.int64]:
    """The rows of a walk that are drawn."""
    finite = np.flatnonzero(np.isfinite(table["x_m"]) & np.isfinite(table["y_m"]))
    return finite[thin_points(len(finite), POINTS)]


def _walk(run: RunData, label: str, table: Table, color: str) -> dict[str, Any]:
    keep = _kept(table)
    seconds = [round(value, 3) for value in run.seconds(table["t_ns"])[keep].tolist()]
    return {
        "label": label,
        "color": color,
        "seconds": seconds,
        "x": rounded(table["x_m"][keep]),
        "y": rounded(table["y_m"][keep]),
    }


def _walls(run: RunData) -> list[dict[str, Any]]:
    """Occupied cells as runs along x: flat triples of row, first column and length; none without a map."""
    occupancy = run.occupancy
    if occupancy is None:
        return []
    runs = row_runs(np.nan_to_num(occupancy.share) >= WALL_SHARE)
    if len(runs) > MAX_RUNS:  # only the PNG shows them
        return []
    x_m, y_m = occupancy.origin_m.tolist()
    return [{"cell_m": occupancy.cell_m, "x": x_m, "y": y_m, "runs": runs.ravel().tolist()}]


def row_runs(cells: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Runs (R, 3) of row, first column and length of the true cells (rows, columns), in order."""
    edges = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(edges == 1)
    _, past = np.nonzero(edges == -1)
    return np.column_stack([row, first, past - first]).astype(np.int64)


MAX_TAGS, MAX_ANCHORS = 4, len(COLORS)

_ERRORS: tuple[Columns, ...] = (
    ("distance (m)", [("time_error_m", "to the timed reference", "target"), ("error_m", "to the path", "robot")]),
    ("cross-track (m, left +)", [("cross_track_m", "cross-track", "plan")]),
    ("yaw error (rad)", [("heading_error_rad", "yaw error", "resim")]),
)
_TORQUES: tuple[Columns, ...] = tuple(
    (
        f"torque of leg {LEG_NAMES[leg]} (N·m)",
        [
            (f"tau_{joint:02d}_nm", JOINT_NAMES[joint], tuple(COLORS)[joint % JOINTS])
            for joint in range(first, first + JOINTS)
        ],
    )
    for leg, first in enumerate(range(0, LEGS * JOINTS, JOINTS))
)
_DISPLACEMENT: tuple[Columns, ...] = (
    ("x, forward (m)", [("x_m", "x", "resim")]),
    ("y, to the left (m)", [("y_m", "y", "resim")]),
    ("z, height (m)", [("z_m", "z", "resim")]),
)
_ANGLES: tuple[Columns, ...] = (
    (
        "roll, pitch, yaw (rad)",
        [("roll_rad", "roll", "target"), ("pitch_rad", "pitch", "plan"), ("yaw_rad", "yaw", "robot")],
    ),
)


def run_charts(run: RunData) -> dict[str, Any]:
    """Charts by name of the figure, as plain JSON. Raises NotARun for damaged tables."""
    charts = {"trajectory": trajectory_chart(run)}
    charts |= {name: over_time(panels) for name, panels in run_panels(run).items()}
    return {name: chart for name, chart in charts.items() if chart is not None}


def run_panels(run: RunData) -> dict[str, list[ChartPanel]]:
    """The panels of every chart over time, by name of the figure; no panels of what the run does not have."""
    return {name: panels_of(run) for name, panels_of in _PANELS.items()}


def _of_table(name: str, layout: Sequence[Columns]) -> Callable[[RunData], list[ChartPanel]]:
    """A function that gives columns of one table over time."""

    def panels(run: RunData) -> list[ChartPanel]:
        table = run.table(name)
        return [] if table is None else [_panel(run, table, columns) for columns in layout]

    return panels


def _panel(run: RunData, table: Table, columns: Columns) -> ChartPanel:
    what, lines = columns
    seconds = run.seconds(table["t_ns"])
    present = [line for line in lines if line[0] in table]
    return ChartPanel(
        what, [Line(label, color, seconds, table[name].astype(np.float64)) for name, label, color in present]
    )


def _expanded(run: RunData) -> list[ChartPanel]:
    """Cells per replan of the logged and of the re-simulated walk."""
    lines = [("generated", "generated", "note"), ("expanded", "expanded", "robot")]
    panels = []
    for name, walk in (("plans", "logged walk"), ("resim_plans", "re-simulated walk")):
        if (plans := run.table(name)) is None:
            continue
        seconds = run.seconds(plans["t_ns"])
        drawn = [Line(label, color, seconds, plans[column].astype(np.float64)) for column, label, color in lines]
        scratch = np.where(plans["from_scratch"], plans["expanded"], np.nan)
        drawn.append(Line("from scratch", "target", seconds, scratch, points=True))
        panels.append(ChartPanel(f"cells per replan (count), {walk}", drawn))
    return panels


def _scans(run: RunData) -> list[ChartPanel]:
    lines = [("n_valid", "valid", "text"), ("n_ground", "ground", "fix"), ("n_obstacle", "obstacle", "target")]
    lines += [("n_outlier", "outlier", "note")]
    return _of_table("scans", [("points per scan (count)", lines)])(run)


def _residuals(run: RunData) -> list[ChartPanel]:
    """Residuals of each tag's ranges, a colour for each anchor."""
    ranges = run.table("ranges")
    if ranges is None:
        return []
    residual_m = ranges["range_m"] - ranges["predicted_m"]
    seconds = run.seconds(ranges["t_ns"])
    panels = []
    for tag in np.unique(ranges["tag"])[:MAX_TAGS]:
        measured, lines = [], []
        for color, anchor in zip(COLORS, np.unique(ranges["anchor"]), strict=False):
            mine = (ranges["tag"] == tag) & (ranges["anchor"] == anchor)
            measured.append(Line(f"anchor {anchor}", color, seconds[mine], ranges["range_m"][mine], points=True))
            lines.append(Line(f"anchor {anchor}", color, seconds[mine], residual_m[mine], points=True))
        of_tag = seconds[ranges["tag"] == tag][[0, -1]]
        lines.append(Line("NLOS above", "text", of_tag, np.full(2, run.late_beyond_m())))
        panels += [ChartPanel(f"range of tag {tag} (m)", measured), ChartPanel(f"residual of tag {tag} (m)", lines)]
    return panels


def _tracking_error(run: RunData) -> list[ChartPanel]:
    """The errors of place and yaw, and the saved means of the distances."""
    control = run.table("control")
    if control is None:
        return []
    panels = []
    seconds = run.seconds(control["t_ns"])
    for what, columns in _ERRORS:
        lines = [Line(label, color, seconds, control[name]) for name, label, color in columns]
        for name, metric in (("time_error_m", "eta_time_m"), ("error_m", "eta_m")):
            color = next((color for column, _, color in columns if column == name), None)
            if color is not None and (mean_m := run.metric(metric)) is not None:
                lines.append(Line(f"mean {metric}", color, seconds, np.full(len(seconds), mean_m)))
        panels.append(ChartPanel(what, lines))
    return panels


def _uwb_error(run: RunData) -> list[ChartPanel]:
    """Distance of fixes and track from the truth, for each tag."""
    errors = run.table("uwb_errors")
    if errors is None:
        return []
    error_m = np.hypot(errors["error_x_m"], errors["error_y_m"])
    seconds = run.seconds(errors["t_ns"])
    panels = []
    for tag in np.unique(errors["tag"])[:MAX_TAGS]:
        lines = []
        for source, color in (("fixes", "note"), ("track", "robot")):
            mine = (errors["tag"] == tag) & (errors["source"] == source)
            lines.append(Line(source, color, seconds[mine], error_m[mine], points=source == "fixes"))
            if source == "track":
                lines.append(Line("95 % bound of track", "text", seconds[mine], errors["bound_m"][mine]))
        panels.append(ChartPanel(f"error of tag {tag} (m)", lines))
    return panels


_PANELS: dict[str, Callable[[RunData], list[ChartPanel]]] = {
    "ranges": _residuals,
    "uwb_error": _uwb_error,
    "scans": _scans,
    "expanded": _expanded,
    "tracking_error": _tracking_error,
    "displacement": _of_table("control", _DISPLACEMENT),
    "euler_angles": _of_table("control", _ANGLES),
    "lookahead": _of_table("control", LOOKAHEAD),
    "commands": _of_table("control", COMMANDS),
    "posture": _of_table("control", POSTURE),
    "torques": _of_table("control", _TORQUES),
}
