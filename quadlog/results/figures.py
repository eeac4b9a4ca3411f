"""The figures of a run in the order of its page. A figure is made once; the page, pictures and films show the same."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quadlog.errors import CannotWrite
from quadlog.geometry import yaw_from_quat
from quadlog.metrics.walking import stance_where
from quadlog.results import view
from quadlog.results.find_runs import PICTURES, PLOTS
from quadlog.results.run import Run
from quadlog.results.scenes import is_late, line, walk_scene
from quadlog.results.tables import CONTACTS, FOOT_FORCES, FORCES
from quadlog.results.view import Drawing, Figure, Layer, Marks, Panel, Scene, Series, break_gaps, in_gaps, rows_within
from quadlog.storage.atomic_write import write_whole, writing

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


def _points(table: DataFrame, column: str, label: str, color: str, events: bool = False) -> list[Series]:
    """Points of a column of these rows; nothing without rows."""
    seconds, values = (table[name].to_numpy(float) for name in ("seconds", column))
    return [Series(label, color, seconds, values, "points", events=events)] if len(table) else []


DASHED = {"text": 1, "olive": 2}
RATE_OVER_S = 0.5
"""Speeds and rates are differences of positions so far apart."""


def moved(panels: Mapping[str, str], gait: bool = False) -> Callable[[Run], list[Panel] | None]:
    """A maker of panels by quantity and column of poses: recorded, simulated, the truth and another estimate."""
    return lambda run: with_curves([*_moved(run, panels), *(_gait(run) if gait else ())])


def _moved(run: Run, wanted: Mapping[str, str]) -> Iterator[Panel]:
    """Those in which the recorded robot moves."""
    poses = run.table("poses")
    if poses is None or run.simulated or set(poses["source"].unique()) == {"fixed"}:
        return
    bodies = {"recorded, robot": poses, "simulated, resim": run.table("control"), "reference, text": _truth(run),
              "other track, olive": run.table("other_poses")}  # fmt: skip
    moved = {look: with_rates(table) for look, table in bodies.items() if table is not None}
    for what, column in wanted.items():
        if moved["recorded, robot"][column].nunique() > 1:
            curves_of = (_series(table, f"{column}, {look}") for look, table in moved.items() if column in table)
            series = [replace(one, variant=DASHED.get(one.color, 0)) for of in curves_of for one in of]
            yield Panel(what, series, zero=column == "speed")


def _truth(run: Run) -> DataFrame | None:
    """The reference as a table like poses; None without one in the same frame."""
    from pandas import DataFrame

    truth = run.trajectory("reference")
    if truth is None or run.metric("ate_rmse_m") is None:
        return None
    places = dict(zip(("x_m", "y_m", "z_m"), truth.position_m.T, strict=True))
    return DataFrame({"seconds": run.seconds(truth.t_ns), **places, "yaw_rad": yaw_from_quat(truth.quat_xyzw)})


def with_rates(table: DataFrame) -> DataFrame:
    """A table of poses, yaw without jumps by turns, with speed and yaw_rate_rad over RATE_OVER_S, NaN in gaps."""
    seconds, yaw_rad = table["seconds"].to_numpy(), table["yaw_rad"].to_numpy(float, copy=True)
    known, rows = np.isfinite(yaw_rad), np.arange(len(table))
    yaw_rad[known] = np.unwrap(yaw_rad[known])
    side = rows_within(np.diff(seconds), RATE_OVER_S / 2)
    before, after = np.maximum(rows - side, 0), np.minimum(rows + side, len(rows) - 1)
    step_s = seconds[after] - seconds[before]
    step_s[in_gaps(step_s) | (step_s <= 0)] = np.nan
    place_m = table["x_m"].to_numpy() + 1j * table["y_m"].to_numpy()
    speed, rate = np.abs(place_m[after] - place_m[before]) / step_s, (yaw_rad[after] - yaw_rad[before]) / step_s
    return table.assign(speed=speed, yaw_rad=yaw_rad, yaw_rate_rad=rate)


def _gait(run: Run) -> Iterator[Panel]:
    """When each foot was on the ground, by what it carries as in the metrics, and how often it touched down."""
    joints, stances, strides = run.table("joints"), list[Series](), list[Series]()
    if joints is None:
        return
    from quadlog.positioning.leg_odometry import CARRIES_SHARE, share_of_usual  # slow to import

    columns = CONTACTS if joints[[*FOOT_FORCES]].isna().all(axis=None) else FOOT_FORCES
    bodies = [(joints, columns, "recorded", "robot"), (run.table("control"), FORCES, "simulated", "resim")]
    for below, (table, columns, label, color) in enumerate(bodies):
        carried = np.empty((0, 4)) if table is None else table[[*columns]].to_numpy(float)
        if table is None or np.isnan(carried).all():
            continue
        carried, least = (carried, 0.5) if columns is CONTACTS else (share_of_usual(carried), CARRIES_SHARE)
        rates, stance = [], stance_where(table["t_ns"].to_numpy(), carried, least)
        seconds, *legs = break_gaps(table["seconds"].to_numpy(), *stance.T)
        for leg, stands in enumerate(legs):
            row = np.where(stands == 1, leg + 0.25 * below, np.nan)
            stances.append(Series(f"{_LEGS[leg]}, {label}", color, seconds, row))
            down_s = seconds[1:][np.diff(stands) == 1]
            rates.append(np.stack([down_s[1:], 1 / np.diff(down_s)]))
        at_s, often_hz = (found := np.concatenate(rates, axis=1))[:, found[0].argsort()]
        strides += [Series(label, color, at_s, often_hz, "points", events=True)] if len(at_s) else []
    yield Panel("feet on the ground", stances, rows=("FL", "FR", "RL", "RR"))
    yield Panel("strides (Hz)", strides, zero=True, robust=True)


def error_curve(column: str, what: str, mean: str, deviation: str) -> Callable[[Run], list[Panel] | None]:
    """A maker of a panel of a distance of control, with its mean and deviation."""

    def make(run: Run) -> list[Panel] | None:
        control = run.table("control")
        series = [] if control is None else _series(control, f"{column}, distance, resim")
        eta_m, sigma_m = run.metric(mean), run.metric(deviation)
        if control is None or not series:
            return None
        if eta_m is not None and len(control) > 1:
            ends, ones = control["seconds"].to_numpy()[[0, -1]], np.ones(2)
            if sigma_m is not None:
                low, high = max(eta_m - sigma_m, 0.0) * ones, (eta_m + sigma_m) * ones
                series.insert(0, Series("η ± σ", "soft", ends, low, "band", upper=high))
            series.append(Series("mean η", "text", ends, eta_m * ones, variant=1))
        # The reference path of a replay is replaced where its nearest point jumps.
        step_m, walked_m = (np.hypot(control[f"{of}x_m"].diff(), control[f"{of}y_m"].diff()) for of in ("ref_", ""))
        marks = control["seconds"].to_numpy()[(step_m > walked_m + 0.1) & (not run.simulated)]
        return [Panel(what, series, zero=True, marks=marks)]

    return make


_LEGS = ("front left", "front right", "rear left", "rear right")


def search(run: Run) -> list[Panel] | None:
    """Cells per replan, of the recorded and the simulated walk."""
    panels = []
    for name, walk in (("plans", "recorded walk"), ("resim_plans", "simulated walk")):
        plans = run.table(name)
        if plans is None or run.simulated:
            continue
        series = _series(plans, "generated, generated, note; expanded, expanded, robot")
        series += _points(plans[plans["from_scratch"]], "expanded", "from scratch", "target", True)
        series += _points(plans[~plans["found"]], "expanded", "no path", "bad", True)
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
        series = _points(link[~link["late"]], "residual_m", "in line of sight", "robot", True)
        series += _points(link[link["late"]], "residual_m", "late (NLOS)", "note", True)
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
        series += _series(track, "error_m, track, robot; bound_m, 95 % bound, text")
        panels.append(Panel(f"position error, tag {tag} (m)", series, zero=True, robust=True))
    return with_curves(panels)


CLASSES = {"ground": "fix", "obstacle": "target", "outlier": "note"}
"""Colours of the classes of points; all others are soft."""


def scan_scene(run: Run) -> Scene | None:
    """The middle one of the saved scans from above, in the frame base, by class, the rarest last."""
    saved = run.arrays("cloud_samples")
    if saved is None or not len(saved["t_ns"]):
        return None
    number = len(saved["t_ns"]) // 2
    rows = slice(*saved["offset"][number : number + 2])
    every, label = saved["xyz_m"][rows, :2].astype(float), saved["label"][rows]
    every, label = every[finite := np.isfinite(every).all(axis=1)], label[finite]
    points = {str(name).lower(): every[label == k] for k, name in enumerate(saved["classes"])}
    layers: list[Layer] = [
        Marks(f"{name} ({len(of)})", CLASSES.get(name, "soft"), of[:, 0], of[:, 1])
        for name, of in sorted(points.items(), key=lambda item: -len(item[1])) if len(of)
    ]  # fmt: skip
    if not layers:
        return None
    half_m = np.array(run.config.robot.body_m[:2]) / 2
    layers.append(line("robot", "robot", *(half_m * [[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]).T))
    reach = max(3.0, float(np.percentile(np.abs(every).max(axis=1), 98)))
    return Scene(layers, (-reach, reach, -0.6 * reach, 0.6 * reach), axes=("forward (m)", "left (m)"))


FIGURES = (
    Figure("trajectory", "Trajectory over the map",
           "Robot, target and simulated robot over the cells that the maps had occupied.", walk_scene),
    Figure("motion", "Motion", "From positions; speed and yaw rate over 0.5 s.",
           moved({"speed (m/s)": "speed", "yaw rate (°/s)": "yaw_rate_rad", "yaw (°)": "yaw_rad",
                  "height (m)": "z_m", "roll (°)": "roll_rad", "pitch (°)": "pitch_rad"}, gait=True)),
    Figure("trot", "Trot along x", "Displacement and Euler angles of the trunk [Foot, Figs 5–6].",
           curves("control", {
               "forward (m)": "x_m, forward, resim", "to the left (m)": "y_m, to the left, resim",
               "height (m)": "z_m, height, resim",
               "Euler angles (°)": "roll_rad, roll, target; pitch_rad, pitch, plan; yaw_rad, yaw, robot",
           }, metric="lateral_drift_m")),
    Figure("tracking_error", "Tracking error",
           "Of the simulated robot [Tracking, eqs 45–47]; dotted: its path is replaced.",
           error_curve("error_m", "distance to the path (m)", "eta_m", "sigma_m")),
    Figure("uwb_error", "Position error",
           "To the reference; below its bound for 95 % of the time if that is right.",
           uwb_error),
    Figure("clearance", "Clearance", "From the body to the nearest obstacle, and from the robot to its target.",
           curves("clearances", {"clearance (m)": "clearance_m, clearance, resim",
                                 "distance to the target (m)": "target_distance_m, distance, target"})),
    Figure("cross_track", "Errors to the side and in heading", "To the left is positive [Tracking, eq. 47].",
           curves("control", {"cross-track error (m)": "cross_track_m, cross-track, resim",
                              "heading error (°)": "heading_error_rad, heading, resim"})),
    Figure("schedule", "Error in time", "Distance to the point where the path is at that instant.",
           error_curve("time_error_m", "distance to the schedule (m)", "eta_time_m", "sigma_time_m")),
    Figure("place", "Place", "Positions over time.", moved({"x (m)": "x_m", "y (m)": "y_m"})),
    Figure("commands", "Commands", "Commanded speeds, and those that the robot reaches [Tracking, eqs 15–16].",
           curves("control", {
               "forward speed (m/s)": "vx_mps, reached, resim; cmd_v_mps, commanded, robot",
               "speed to the left (m/s)": "vy_mps, reached, resim; cmd_vy_mps, commanded, robot",
               "yaw rate (rad/s)": "yaw_rate_radps, reached, resim; cmd_yaw_rate_radps, commanded, robot",
           })),
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
    Figure("forces", "Forces of the feet",
           "Normal to the ground: planned by the MPC [Tracking, eq. 28], and on the simulated feet.",
           curves("control", {
               f"{name} foot (N)": f"fz_{leg}_n, on the foot, resim; wanted_fz_{leg}_n, planned, robot"
               for leg, name in enumerate(_LEGS)
           }), compared=False),
    Figure("step_time", "Time of the controller's steps", "Of the simulation's ticks within each tick of control.",
           curves("control", {"time of a step (µs)": "us_max, longest, target; us_median, median, robot"})),
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


def merged_drawings(runs: Mapping[str, Run]) -> dict[str, Drawing]:
    """The figures of several runs over each other, by name; without those of one run alone, or alike in all."""
    merged = dict[str, Drawing]()
    for figure in (figure for figure in FIGURES if figure.compared):
        made: Any = {name: drawing for name, run in runs.items() if (drawing := figure.make(run))}
        merge: Any = view.merge_scenes if figure.make is walk_scene else view.merge_panels
        if made and (drawing := merge(made)):
            merged[figure.name] = drawing
    return merged


def write_plots(run: Path, drawings: Mapping[str, Drawing]) -> None:
    """plots/NAME.png of the figures that a replay saves; those of an earlier replay are removed.

    Raises CannotWrite, also where plots/ is a link.
    """
    folder = run / PLOTS
    if folder.is_symlink():
        raise CannotWrite(folder, "is a link; pictures are not written through it")
    wanted = {name: drawings[name] for name in PICTURES if name in drawings}
    with writing(folder):
        for name in PICTURES:
            (folder / f"{name}.png").unlink(missing_ok=True)
        folder.mkdir(exist_ok=True)
    if wanted:
        from quadlog.results.mpl import render  # matplotlib, which a replay without plots does without
    for name, drawing in wanted.items():
        write_whole(folder / f"{name}.png", render(drawing))
