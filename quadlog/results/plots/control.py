"""Control of the walk over time: look-ahead, commands, torques, posture, errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEG_NAMES = ("FL", "FR", "RL", "RR")
JOINT_NAMES = tuple(f"{leg} {joint}" for leg in LEG_NAMES for joint in ("hip", "thigh", "calf"))
"""Of the columns tau_00_nm to tau_11_nm."""
LEGS, JOINTS = 4, 3

Columns = tuple[str, Sequence[tuple[str, str, str]]]
"""Quantity and unit of a panel, and its lines: column, label, name of the colour."""

LOOKAHEAD: tuple[Columns, ...] = (
    ("look-ahead (m)", (("lookahead_m", "l", "robot"),)),
    ("fuzzy gain (1)", (("k_v", "k_v", "plan"), ("k_w", "k_w", "target"))),
)
COMMANDS: tuple[Columns, ...] = (
    ("forward speed (m/s)", (("vx_mps", "reached", "resim"), ("cmd_v_mps", "commanded", "robot"))),
    ("yaw rate (rad/s)", (("yaw_rate_radps", "reached", "resim"), ("cmd_yaw_rate_radps", "commanded", "robot"))),
)
_SIDEWAYS: Columns = ("speed to the left (m/s)", (("vy_mps", "reached", "resim"),))
POSTURE: tuple[Columns, ...] = (
    ("tilt (rad)", (("pitch_rad", "pitch", "plan"), ("roll_rad", "roll", "target"))),
    ("height (m)", (("z_m", "height in map", "resim"),)),
)


def draw_lookahead(run: RunData) -> Figure | None:
    """Look-ahead distance l, and the fuzzy gains k_v and k_w where a controller has them [Tracking, eq. 17]."""
    figure = _draw_lines(run, "lookahead_m", LOOKAHEAD)
    if figure is not None:
        figure.axes[0].set_ylim(bottom=0)
    return figure


def draw_commands(run: RunData) -> Figure | None:
    """Commanded and reached speed and yaw rate; sideways speed where the robot has one."""
    control = run.table("control")
    sways = control is not None and bool(np.nan_to_num(control["vy_mps"]).any())
    return _draw_lines(run, "cmd_v_mps", (*COMMANDS, _SIDEWAYS) if sways else COMMANDS)


def draw_posture(run: RunData) -> Figure | None:
    """Roll, pitch and height of the body; only for robots that have one."""
    return _draw_lines(run, "pitch_rad", POSTURE)


def draw_torques(run: RunData) -> Figure | None:
    """Joint torques, a row of panels per leg; only for controllers that have joints."""
    control = run.table("control")
    names = [[f"tau_{leg * JOINTS + joint:02d}_nm" for joint in range(JOINTS)] for leg in range(LEGS)]
    if control is None or not any(_has(control, name) for leg in names for name in leg):
        return None
    figure, panels = style.new_stack(LEGS, 1.6, above_in=0.26, columns=JOINTS)
    for leg, row in enumerate(panels):
        for name, panel in zip(names[leg], row, strict=True):
            keep = style.thin_line(control[name])
            panel.plot(run.seconds(control["t_ns"])[keep], control[name][keep], color=style.ROBOT, linewidth=0.7)
            panel.set_title(JOINT_NAMES[int(name[4:6])], pad=3)
        row[0].set_ylabel(f"{LEG_NAMES[leg]}: τ (N·m)")
    for panel in panels[-1]:
        panel.set_xlabel("time (s)")
    return figure


def _has(control: Table, name: str) -> bool:
    return bool(np.isfinite(control[name]).any())


def _draw_lines(run: RunData, needed: str, layout: Sequence[Columns]) -> Figure | None:
    """A panel for each entry of the layout that has a value; None for a run without values in the column `needed`."""
    control = run.table("control")
    if control is None or not _has(control, needed):
        return None
    present = [(ylabel, [line for line in lines if _has(control, line[0])]) for ylabel, lines in layout]
    present = [(ylabel, lines) for ylabel, lines in present if lines]
    figure, grid = style.new_stack(len(present), 2.1)
    seconds = run.seconds(control["t_ns"])
    for panel, (ylabel, lines) in zip(grid[:, 0], present, strict=True):
        # The first line is drawn broad, so that a second one on top of it does not hide it.
        for (name, label, color), width in zip(lines, (2.4, 1.0) if len(lines) == 2 else (1.4,), strict=True):
            keep = style.thin_line(control[name])
            panel.plot(seconds[keep], control[name][keep], color=style.COLORS[color], linewidth=width, label=label)
        panel.set_ylabel(ylabel)
        style.legend_above(panel)
    grid[-1, 0].set_xlabel("time (s)")
    return figure


# column, its colour, the saved mean and deviation shown beside it
_ERRORS = (
    ("error_m", "distance to the path (m)", style.ROBOT, ("eta_m", "sigma_m"), "η"),
    ("cross_track_m", "cross-track (m, left +)", style.PLAN, None, ""),
    ("time_error_m", "timed distance (m)", style.TARGET, ("eta_time_m", "sigma_time_m"), "η"),
    ("heading_error_rad", "yaw error (rad)", style.RESIM, None, ""),
)


def draw_tracking_error(run: RunData) -> Figure | None:
    """The errors of place and yaw over time, with the saved η ± σ as line and band."""
    control = run.table("control")
    if control is None:
        return None
    errors = [error for error in _ERRORS if np.isfinite(control[error[0]]).any()]
    if not errors:
        return None
    figure, grid = style.new_stack(len(errors), 2.0)
    panels = grid[:, 0]
    seconds = run.seconds(control["t_ns"])
    for panel, (column, label, color, saved, symbol) in zip(panels, errors, strict=True):
        keep = style.thin_line(control[column])
        panel.axhline(0, color=style.GREY, linewidth=0.8)
        panel.plot(seconds[keep], control[column][keep], color=color, label=column)
        if saved is not None:
            panel.set_ylim(bottom=0)  # distances
            _draw_mean(run, panel, saved, symbol)
        panel.set_ylabel(label)
        style.legend_above(panel)
    panels[-1].set_xlabel("time (s)")
    return figure


def _draw_mean(run: RunData, panel: Axes, saved: tuple[str, str], symbol: str) -> None:
    mean_m, deviation_m = (run.metric(name) for name in saved)
    if mean_m is None:
        return
    label = f"{symbol} = {mean_m:.4f} m"
    if deviation_m is not None:
        panel.axhspan(max(0.0, mean_m - deviation_m), mean_m + deviation_m, color=style.LIGHT, alpha=0.6, linewidth=0)
        label = f"{symbol} ± σ = {mean_m:.4f} ± {deviation_m:.4f} m"
    panel.axhline(mean_m, color=style.BLACK, linewidth=1.0, linestyle="--", label=label)


COURSE = "trot-32s"
_TO_DEG = float(np.degrees(1.0))
_PLACES = (("x_m", "x, forward (m)", 1.0), ("y_m", "y, to the left (mm)", 1e3), ("z_m", "z, height (mm)", 1e3))
_ANGLES = (("roll_rad", "roll (°)", _TO_DEG), ("pitch_rad", "pitch (°)", _TO_DEG), ("yaw_rad", "yaw (°)", _TO_DEG))


def draw_displacement(run: RunData) -> Figure | None:
    """x, y and z of the trunk over time, of a run of trot-32s only."""
    return _draw(run, _PLACES)


def draw_euler_angles(run: RunData) -> Figure | None:
    """Roll, pitch and yaw over time, of a run of trot-32s only."""
    return _draw(run, _ANGLES)


def _draw(run: RunData, columns: Sequence[tuple[str, str, float]]) -> Figure | None:
    control = run.table("control")
    if control is None or run.record.options.get("course") != COURSE:
        return None
    figure, grid = style.new_stack(len(columns), 1.85, above_in=0.15)
    panels = grid[:, 0]
    seconds = run.seconds(control["t_ns"])
    for panel, (column, label, factor) in zip(panels, columns, strict=True):
        panel.plot(seconds, factor * control[column], color=style.RESIM, linewidth=1.0)
        panel.set_ylabel(label)
    panels[-1].set_xlabel("time (s)")
    return figure
