"""The figures of a run in the order of its page. A figure is made once; the page, pictures and films show the same."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quadlog.errors import CannotWrite
from quadlog.results.find_runs import PICTURES, PLOTS
from quadlog.results.run import Run
from quadlog.results.scenes import is_late, scan_scene, walk_scene
from quadlog.results.view import Array, Drawing, Figure, Panel, Series, break_gaps
from quadlog.storage.atomic_write import write_whole

if TYPE_CHECKING:
    from pandas import DataFrame


def curves(name: str, panels: Mapping[str, str], metric: str = "") -> Callable[[Run], list[Panel] | None]:
    """A maker of panels of one table: its curves by quantity with unit. metric: without which there are none."""

    def make(run: Run) -> list[Panel] | None:
        table = run.table(name)
        if table is None or (metric and run.metric(metric) is None):
            return None
        return with_curves(Panel(what, _series(table, wanted)) for what, wanted in panels.items())

    return make


def with_curves(panels: Iterable[Panel]) -> list[Panel] | None:
    """The panels that have a curve, None without any."""
    return [panel for panel in panels if panel.series] or None


def _series(table: DataFrame, curves: str) -> list[Series]:
    """A curve for each "column, label, colour" that has a value; angles in degrees."""
    found = []
    for column, label, color in (curve.split(", ") for curve in curves.split("; ")):
        values = table[column].to_numpy(float)
        if np.isfinite(values).any():
            values = np.degrees(values) if column.endswith("_rad") else values
            seconds, values = break_gaps(table["seconds"].to_numpy(), values)
            found.append(Series(label, color, seconds, values))
    return found


def _points(table: DataFrame, column: str, label: str, color: str) -> list[Series]:
    """Points of a column of these rows; nothing without rows."""
    seconds, values = (table[name].to_numpy(float) for name in ("seconds", column))
    return [Series(label, color, seconds, values, "points")] if len(table) else []


def tracking_error(run: Run) -> list[Panel] | None:
    """Distances to path and schedule with their mean and deviation."""
    control = run.table("control")
    if control is None:
        return None
    changes = _reference_changes(run, control)
    panels = []
    for column, what, mean, deviation in (
        ("error_m", "distance to the path (m)", "eta_m", "sigma_m"),
        ("time_error_m", "distance to the schedule (m)", "eta_time_m", "sigma_time_m"),
    ):
        series = _series(control, f"{column}, distance, resim")
        eta_m, sigma_m = run.metric(mean), run.metric(deviation)
        if series and eta_m is not None and len(control) > 1:
            ends, ones = control["seconds"].to_numpy()[[0, -1]], np.ones(2)
            if sigma_m is not None:
                low, high = max(eta_m - sigma_m, 0.0) * ones, (eta_m + sigma_m) * ones
                series.insert(0, Series("η ± σ", "soft", ends, low, "band", upper=high))
            series.append(Series("mean η", "text", ends, eta_m * ones, variant=1))
        panels.append(Panel(what, series, zero=True, marks=changes))
    return with_curves(panels)


def _reference_changes(run: Run, control: DataFrame) -> Array:
    """Instants at which the reference path of a replay is replaced: its nearest point jumps."""
    if run.simulated:
        return np.empty(0)
    step_m = np.hypot(np.diff(control["ref_x_m"]), np.diff(control["ref_y_m"]))
    walked_m = np.hypot(np.diff(control["x_m"]), np.diff(control["y_m"]))
    jumped = np.flatnonzero(step_m > walked_m + 0.1) + 1
    return np.asarray(control["seconds"].to_numpy()[jumped])


_LEGS = ("front left", "front right", "rear left", "rear right")


def search(run: Run) -> list[Panel] | None:
    """Cells per replan, of the recorded and the simulated walk."""
    panels = []
    for name, walk in (("plans", "recorded walk"), ("resim_plans", "simulated walk")):
        plans = run.table(name)
        if plans is None or run.simulated:
            continue
        series = _series(plans, "generated, generated, note; expanded, expanded, robot")
        series += _points(plans[plans["from_scratch"]], "expanded", "from scratch", "target")
        series += _points(plans[~plans["found"]], "expanded", "no path", "bad")
        panels.append(Panel(f"cells per replan, {walk}", series, zero=True))
    return with_curves(panels)


def ranges(run: Run) -> list[Panel] | None:
    """A lane for each tag and anchor: what its ranges exceed the predicted ones by, late ones in another colour."""
    table = run.table("ranges")
    if table is None:
        return None
    table = table.assign(residual_m=table["range_m"] - table["predicted_m"], late=is_late(run, table))
    several = table["tag"].nunique() > 1
    panels = []
    for (tag, anchor), link in table.groupby(["tag", "anchor"]):
        series = _points(link[~link["late"]], "residual_m", "in line of sight", "robot")
        series += _points(link[link["late"]], "residual_m", "late (NLOS)", "note")
        what = f"tag {tag}, anchor {anchor} (m)" if several else f"anchor {anchor} (m)"
        panels.append(Panel(what, series, lane=True, robust=True))
    return with_curves(panels)


def uwb_error(run: Run) -> list[Panel] | None:
    """Distance of fixes and track from the reference, and the 95 % bound that the track claims."""
    errors = run.table("uwb_errors")
    if errors is None:
        return None
    errors = errors.assign(error_m=np.hypot(errors["error_x_m"], errors["error_y_m"]))
    panels = []
    for tag, of_tag in errors.groupby("tag"):
        fixes, track = (of_tag[of_tag["source"] == source] for source in ("fixes", "track"))
        series = _points(fixes, "error_m", "fixes", "fix")
        series += _series(track, "error_m, track, robot; bound_m, 95 % bound of the track, text")
        panels.append(Panel(f"distance to the reference, tag {tag} (m)", series, zero=True, robust=True))
    return with_curves(panels)


FIGURES = (
    Figure("trajectory", "Trajectory over the map",
           "Robot, target and simulated robot over the cells that the maps had occupied.", walk_scene),
    Figure("trot", "Trot along x", "Displacement and Euler angles of the trunk [Foot, Figs 5–6].",
           curves("control", {
               "forward (m)": "x_m, forward, resim", "to the left (m)": "y_m, to the left, resim",
               "height (m)": "z_m, height, resim",
               "Euler angles (°)": "roll_rad, roll, target; pitch_rad, pitch, plan; yaw_rad, yaw, robot",
           }, metric="lateral_drift_m")),
    Figure("tracking_error", "Tracking error",
           "Of the simulated robot to its reference path [Tracking, eqs 45–47]. Vertical lines: the path is replaced.",
           tracking_error),
    Figure("cross_track", "Errors to the side and in heading", "To the left is positive [Tracking, eq. 47].",
           curves("control", {"cross-track error (m)": "cross_track_m, cross-track, resim",
                              "heading error (°)": "heading_error_rad, heading, resim"})),
    Figure("uwb_error", "Position error",
           "To the reference. The track lies below its bound 95 % of the time if its covariance is right.",
           uwb_error),
    Figure("commands", "Commands", "Commanded speeds, and those that the robot reaches [Tracking, eqs 15–16].",
           curves("control", {
               "forward speed (m/s)": "vx_mps, reached, resim; cmd_v_mps, commanded, robot",
               "speed to the left (m/s)": "vy_mps, reached, resim",
               "yaw rate (rad/s)": "yaw_rate_radps, reached, resim; cmd_yaw_rate_radps, commanded, robot",
           })),
    Figure("clearance", "Clearance", "From the body to the nearest obstacle, and from the robot to its target.",
           curves("clearances", {"clearance (m)": "clearance_m, clearance, resim",
                                 "distance to the target (m)": "target_distance_m, distance, target"})),
    Figure("lookahead", "Look-ahead", "Of the pure pursuit, and the fuzzy gains that adapt it [Tracking, eq. 17].",
           curves("control", {"look-ahead (m)": "lookahead_m, look-ahead, robot",
                              "gain": "k_v, k_v, plan; k_w, k_w, target"})),
    Figure("posture", "Posture", "Pitch: positive with the nose down; roll: with the left side up.",
           curves("control", {"tilt (°)": "pitch_rad, pitch, plan; roll_rad, roll, target",
                              "height (m)": "z_m, height, resim"})),
    Figure("torques", "Joint torques", "Of the simulated robot [Tracking, eqs 43–44].",
           # The widest curve first, which would hide the others.
           curves("control", {
               f"{name} leg (N·m)": f"tau_{3 * leg + 2:02d}_nm, calf, plan; tau_{3 * leg + 1:02d}_nm, thigh, target; "
               f"tau_{3 * leg:02d}_nm, hip, robot" for leg, name in enumerate(_LEGS)
           }), compared=False),
    Figure("expanded", "Cells per replan",
           "Cells that the planner expanded (closed) and generated (ever opened) in each replan [Planning, Fig. 18].",
           search),
    Figure("ranges", "Range residuals over time",
           "Measured minus predicted range. A late range most likely had no line of sight (NLOS).",
           ranges, compared=False),
    Figure("scan", "One scan from above", "Points by the class that the filter gave them.", scan_scene, compared=False),
    Figure("scans", "Points per scan", "Number of points of each class in each scan.",
           curves("scans", {"points": "n_valid, valid, text; n_ground, ground, fix; n_obstacle, obstacle, target; "
                                      "n_outlier, outlier, note"})),
)  # fmt: skip


def drawings_of(run: Run) -> dict[str, Drawing]:
    """Each figure whose data the run has, by name: made once for the page and for the pictures."""
    made = {figure.name: figure.make(run) for figure in FIGURES}
    return {name: drawing for name, drawing in made.items() if drawing is not None}


def write_plots(run: Path, drawings: Mapping[str, Drawing]) -> None:
    """plots/NAME.png of the figures that a replay saves; those of an earlier replay are removed.

    Raises CannotWrite, also where plots/ is a link.
    """
    folder = run / PLOTS
    if folder.is_symlink():
        raise CannotWrite(folder, "is a link; pictures are not written through it")
    wanted = {name: drawings[name] for name in PICTURES if name in drawings}
    try:
        for name in PICTURES:
            (folder / f"{name}.png").unlink(missing_ok=True)
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise CannotWrite(folder, error.strerror or str(error)) from error
    if wanted:
        from quadlog.results.mpl import render  # matplotlib, which a replay without plots does without
    for name, drawing in wanted.items():
        write_whole(folder / f"{name}.png", render(drawing))
