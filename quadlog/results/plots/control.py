"""What the controller decided, and how the robot walked by it: look-ahead, commands, torques, posture, errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.results.plots import style
from quadlog.results.plots.run_data import RunData, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEGS, JOINTS = 4, 3


def draw_lookahead(run: RunData) -> Figure | None:
    """Look-ahead distance l, and the fuzzy gains k_v and k_w where a controller has them [Tracking, eq. 17]."""
    control = run.table("control")
    if control is None or not _has(control, "lookahead_m"):
        return None
    gains = [name for name in ("k_v", "k_w") if _has(control, name)]
    figure, grid = style.new_stack(2 if gains else 1, 2.1)
    panels = grid[:, 0]
    _draw_lines(run, panels[0], control, [("lookahead_m", "l", style.ROBOT)], "look-ahead (m)")
    panels[0].set_ylim(bottom=0)
    if gains:
        colors = {"k_v": style.PLAN, "k_w": style.TARGET}
        _draw_lines(run, panels[1], control, [(name, name, colors[name]) for name in gains], "fuzzy gain (1)")
    panels[-1].set_xlabel("time (s)")
    return figure


def draw_commands(run: RunData) -> Figure | None:
    """Commanded and reached speed and yaw rate; and how fast it went sideways, where it did."""
    control = run.table("control")
    if control is None or not _has(control, "cmd_v_mps"):
        return None
    sways = _has(control, "vy_mps") and bool(np.nan_to_num(control["vy_mps"]).any())
    figure, grid = style.new_stack(2 + sways, 2.1)
    panels = grid[:, 0]
    speed = [("vx_mps", "reached", style.RESIM), ("cmd_v_mps", "commanded", style.ROBOT)]
    turn = [("yaw_rate_radps", "reached", style.RESIM), ("cmd_yaw_rate_radps", "commanded", style.ROBOT)]
    _draw_lines(run, panels[0], control, speed, "forward speed (m/s)")
    _draw_lines(run, panels[1], control, turn, "yaw rate (rad/s)")
    if sways:
        _draw_lines(run, panels[2], control, [("vy_mps", "reached", style.RESIM)], "speed to the left (m/s)")
    panels[-1].set_xlabel("time (s)")
    return figure


def draw_posture(run: RunData) -> Figure | None:
    """Roll, pitch and height of the body; only for robots that have one."""
    control = run.table("control")
    if control is None or not _has(control, "pitch_rad"):
        return None
    figure, grid = style.new_stack(2, 2.1)
    panels = grid[:, 0]
    tilt = [("pitch_rad", "pitch", style.PLAN), ("roll_rad", "roll", style.TARGET)]
    _draw_lines(run, panels[0], control, tilt, "tilt (rad)")
    _draw_lines(run, panels[1], control, [("z_m", "height in map", style.RESIM)], "height (m)")
    panels[1].set_xlabel("time (s)")
    return figure


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
            panel.set_title(f"τ{name[4:6]}", pad=3)
        row[0].set_ylabel(f"leg {leg}: τ (N·m)")
    for panel in panels[-1]:
        panel.set_xlabel("time (s)")
    return figure


def _has(control: Table, name: str) -> bool:
    return name in control and bool(np.isfinite(control[name]).any())


def _draw_lines(run: RunData, panel: Axes, control: Table, lines: list[tuple[str, str, str]], ylabel: str) -> None:
    seconds = run.seconds(control["t_ns"])
    for (name, label, color), width in zip(lines, (2.4, 1.0), strict=False):
        if not _has(control, name):
            continue
        keep = style.thin_line(control[name])
        # The first line is drawn broad, so that a second one on top of it does not hide it.
        panel.plot(
            seconds[keep], control[name][keep], color=color, linewidth=width if len(lines) == 2 else 1.4, label=label
        )
    panel.set_ylabel(ylabel)
    style.legend_above(panel)


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
Columns = tuple[tuple[str, str, float], ...]


def draw_displacement(run: RunData) -> Figure | None:
    """x, y and z of the trunk over time, of a run of trot-32s only."""
    return _draw(run, _PLACES)


def draw_euler_angles(run: RunData) -> Figure | None:
    """Roll, pitch and yaw over time, of a run of trot-32s only."""
    return _draw(run, _ANGLES)


def _draw(run: RunData, columns: Columns) -> Figure | None:
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
