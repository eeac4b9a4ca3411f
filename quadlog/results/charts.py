"""The charts of a run that can be zoomed and read off: figure's name -> panels over time, from the saved tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from quadlog.messages import Float
from quadlog.results.chart_map import trajectory_chart
from quadlog.results.chart_panels import COLORS, Line, panel
from quadlog.results.plots.run_data import RunData, Table

MAX_TAGS, MAX_ANCHORS = 4, len(COLORS)
LEGS, JOINTS = 4, 3

Panel = dict[str, Any] | None
# What the panel shows, and its lines: column, label, colour.
Columns = tuple[str, Sequence[tuple[str, str, str]]]

_ERRORS: tuple[Columns, ...] = (
    ("distance (m)", [("time_error_m", "to the timed reference", "target"), ("error_m", "to the path", "robot")]),
    ("cross-track (m, left +)", [("cross_track_m", "cross-track", "plan")]),
    ("yaw error (rad)", [("heading_error_rad", "yaw error", "resim")]),
)
_LOOKAHEAD: tuple[Columns, ...] = (
    ("look-ahead (m)", [("lookahead_m", "l", "robot")]),
    ("fuzzy gain (1)", [("k_v", "k_v", "plan"), ("k_w", "k_w", "target")]),
)
_COMMANDS: tuple[Columns, ...] = (
    ("forward speed (m/s)", [("vx_mps", "reached", "resim"), ("cmd_v_mps", "commanded", "robot")]),
    ("yaw rate (rad/s)", [("yaw_rate_radps", "reached", "resim"), ("cmd_yaw_rate_radps", "commanded", "robot")]),
)
_POSTURE: tuple[Columns, ...] = (
    ("tilt (rad)", [("pitch_rad", "pitch", "plan"), ("roll_rad", "roll", "target")]),
    ("height (m)", [("z_m", "height in map", "resim")]),
)
_TORQUES: tuple[Columns, ...] = tuple(
    (
        f"torque of leg {leg} (N·m)",
        [(f"tau_{joint:02d}_nm", f"τ{joint:02d}", COLORS[joint % JOINTS]) for joint in range(first, first + JOINTS)],
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
    """Charts by the name of the figure that each stands beside, as plain JSON. Raises NotARun for damaged tables."""
    charts = {name: chart_of(run) for name, chart_of in _CHARTS.items()}
    return {name: chart for name, chart in charts.items() if chart is not None}


def _over_time(panels: Sequence[Panel]) -> dict[str, Any] | None:
    present = [each for each in panels if each is not None]
    return {"panels": present} if present else None


def _of_table(name: str, layout: Sequence[Columns]) -> Callable[[RunData], dict[str, Any] | None]:
    """Draws columns of one table over its time."""

    def chart(run: RunData) -> dict[str, Any] | None:
        table = run.table(name)
        return None if table is None else _over_time([_panel(run, table, columns) for columns in layout])

    return chart


def _panel(run: RunData, table: Table, columns: Columns) -> Panel:
    what, lines = columns
    seconds = run.seconds(table["t_ns"])
    return panel(
        what,
        [Line(label, color, seconds, _floats(table[name])) for name, label, color in lines if name in table],
    )


def _expanded(run: RunData) -> dict[str, Any] | None:
    """Cells per replan of the logged and of the re-simulated walk."""
    lines = [("generated", "generated", "note"), ("expanded", "expanded", "robot")]
    panels = []
    for name, walk in (("plans", "logged walk"), ("resim_plans", "re-simulated walk")):
        if (plans := run.table(name)) is not None:
            panels.append(_panel(run, plans, (f"cells per replan (count), {walk}", lines)))
    return _over_time(panels)


def _scans(run: RunData) -> dict[str, Any] | None:
    lines = [("n_valid", "valid", "text"), ("n_ground", "ground", "fix"), ("n_obstacle", "obstacle", "target")]
    lines += [("n_outlier", "outlier", "note")]
    return _of_table("scans", [("points per scan (count)", lines)])(run)


def _residuals(run: RunData) -> dict[str, Any] | None:
    """Residuals of each tag's ranges, a colour for each anchor."""
    ranges = run.table("ranges")
    if ranges is None:
        return None
    residual_m = ranges["range_m"] - ranges["predicted_m"]
    seconds = run.seconds(ranges["t_ns"])
    panels = []
    for tag in np.unique(ranges["tag"])[:MAX_TAGS]:
        lines = []
        for color, anchor in zip(COLORS, np.unique(ranges["anchor"]), strict=False):
            mine = (ranges["tag"] == tag) & (ranges["anchor"] == anchor)
            lines.append(Line(f"anchor {anchor}", color, seconds[mine], residual_m[mine], points=True))
        panels.append(panel(f"residual of tag {tag} (m)", lines))
    return _over_time(panels)


def _uwb_error(run: RunData) -> dict[str, Any] | None:
    """Distance of fixes and track from the truth, for each tag."""
    errors = run.table("uwb_errors")
    if errors is None:
        return None
    error_m = np.hypot(errors["error_x_m"], errors["error_y_m"])
    seconds = run.seconds(errors["t_ns"])
    panels = []
    for tag in np.unique(errors["tag"])[:MAX_TAGS]:
        lines = []
        for source, color in (("fixes", "note"), ("track", "robot")):
            mine = (errors["tag"] == tag) & (errors["source"] == source)
            lines.append(Line(source, color, seconds[mine], error_m[mine], points=source == "fixes"))
        panels.append(panel(f"error of tag {tag} (m)", lines))
    return _over_time(panels)


def _floats(values: Any) -> Float:
    return np.asarray(values, dtype=np.float64)


_CHARTS: dict[str, Callable[[RunData], dict[str, Any] | None]] = {
    "trajectory": trajectory_chart,
    "ranges": _residuals,
    "uwb_error": _uwb_error,
    "scans": _scans,
    "expanded": _expanded,
    "tracking_error": _of_table("control", _ERRORS),
    "displacement": _of_table("control", _DISPLACEMENT),
    "euler_angles": _of_table("control", _ANGLES),
    "lookahead": _of_table("control", _LOOKAHEAD),
    "commands": _of_table("control", _COMMANDS),
    "posture": _of_table("control", _POSTURE),
    "torques": _of_table("control", _TORQUES),
}
