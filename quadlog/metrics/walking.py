"""How well a robot walked: drift and sway of a trot [Foot, Figs 5-6], effort, tracking errors and contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.summary import Metric, Metrics, Samples, Statistic, finite_samples, metrics_of
from quadlog.planning.protocol import Bool


@dataclass(frozen=True, slots=True)
class TrottedWalk:
    """T samples of a walk along x, evenly spaced: x_m, y_m (T,), rpy_rad (T, 3), fallen (T,).

    rest: how many samples the robot rests before it trots; period: samples of one gait cycle, which the trot's number
    of samples after the first is a multiple of.
    """

    x_m: Float
    y_m: Float
    rpy_rad: Float
    fallen: Bool
    rest: int
    period: int


def drift_metrics(walk: TrottedWalk, period_s: float) -> Metrics:
    """forward_m, lateral_drift_m (left positive), yaw_rate_degps, the ranges of roll, pitch and yaw, and fallen.

    From the trot's first sample to its last, which are at the same instant of a cycle, so that swaying does not count.
    The yaw rate is the slope of the line that fits best the mean yaw of each cycle: fitted to single samples, what
    swings within a cycle would tilt it. A walk with a fall has its metrics like any other.
    """
    x_m, y_m = walk.x_m[walk.rest :], walk.y_m[walk.rest :]
    angles_deg = np.degrees(np.unwrap(walk.rpy_rad[walk.rest :], axis=0))
    cycles = (len(x_m) - 1) // walk.period
    if cycles < 2 or cycles * walk.period != len(x_m) - 1:
        raise ValueError(f"{len(x_m)} samples are no two or more whole cycles of {walk.period}, and one")
    means_deg = angles_deg[:-1, 2].reshape(cycles, walk.period).mean(axis=1)
    slope = np.polyfit(np.arange(cycles) * period_s, means_deg, 1)[0]
    metrics = {
        "lateral_drift_m": Metric(float(y_m[-1] - y_m[0]), len(y_m), "m"),
        "yaw_rate_degps": Metric(float(slope), cycles, "deg/s"),
        "forward_m": Metric(float(x_m[-1] - x_m[0]), len(x_m), "m"),
        "fallen": Metric(float(walk.fallen.any()), len(walk.fallen), ""),
    }
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        metrics[f"{name}_range_deg"] = Metric(float(np.ptp(angles_deg[:, axis])), len(angles_deg), "deg")
    return metrics


JOINTS = 12
GRAVITY_MPS2 = 9.81


@dataclass(frozen=True, slots=True)
class Effort:
    """Over all ticks: the joints' energy and the way walked, the largest torque, and the share of torques cut.

    pitch_rms_rad, height_rms_m: of the body's tilt and height beside those that the ground under its feet asks for.
    """

    energy_j: float
    distance_m: float
    torque_max_nm: float
    saturation_share: float
    pitch_rms_rad: float
    height_rms_m: float


def effort_metrics(mass_kg: float, ticks: int, effort: Effort) -> Metrics:
    """pitch_rms_rad, height_rms_m, torque_max_nm, torque_saturation_share and cost_of_transport; none without ticks.

    Over all ticks of the simulation, torques of all joints. The energy is the sum of |torque x joint speed|, so that
    braking costs as much as driving, and is given per weight and distance walked.
    """
    if ticks == 0:
        return {}
    metrics = {
        "pitch_rms_rad": Metric(effort.pitch_rms_rad, ticks, "rad"),
        "height_rms_m": Metric(effort.height_rms_m, ticks, "m"),
        "torque_max_nm": Metric(effort.torque_max_nm, ticks * JOINTS, "N·m"),
        "torque_saturation_share": Metric(effort.saturation_share, ticks * JOINTS, ""),
    }
    if effort.distance_m > 0:
        cost = effort.energy_j / (mass_kg * GRAVITY_MPS2 * effort.distance_m)
        metrics["cost_of_transport"] = Metric(cost, ticks, "")
    return metrics


@dataclass(frozen=True, slots=True)
class TrackedWalk:
    """A walk of T ticks, (T,) each: columns of control.parquet, NaN where there was nothing to measure.

    fallen: None for a robot that cannot fall.
    """

    t_ns: Int
    error_m: Float
    cross_track_m: Float
    time_error_m: Float
    heading_error_rad: Float
    plan_error_m: Float | None = None
    fallen: Bool | None = None


def tracking_metrics(walk: TrackedWalk, completed_ns: int | None = None) -> Metrics:
    """eta_m, sigma_m and their kin; those that do not apply are absent.

    eta_m and sigma_m are the mean and the sample standard deviation of error_m over
    all N ticks [Tracking] eqs 46, 47, whose two names for the same number, N and N_e,
    are one here. completed_ns: when a course was finished, None for a walk without an end.
    """
    metrics = metrics_of(tracking_samples(walk))
    if completed_ns is not None and len(walk.t_ns):
        metrics["completion_time_s"] = Metric((completed_ns - int(walk.t_ns[0])) / 1e9, 1, "s")
    return {name: metrics[name] for name in CATALOGUE if name in metrics}


def tracking_samples(walk: TrackedWalk) -> dict[str, Samples]:
    """The samples behind tracking_metrics, completion_time_s apart."""
    columns: tuple[tuple[str, Statistic, Float | Bool | None], ...] = (
        ("eta_m", "mean", walk.error_m),
        ("sigma_m", "std", walk.error_m),
        ("eta_time_m", "mean", walk.time_error_m),
        ("sigma_time_m", "std", walk.time_error_m),
        ("max_error_m", "max", walk.error_m),
        ("cross_track_rmse_m", "rms", walk.cross_track_m),
        ("heading_rmse_rad", "rms", walk.heading_error_rad),
        ("plan_error_m", "mean", walk.plan_error_m),
        ("fallen", "max", walk.fallen),
    )
    return {
        name: finite_samples(walk.t_ns, column, statistic) for name, statistic, column in columns if column is not None
    }


def clearance_samples(t_ns: Int, clearance_m: Float, target_distance_m: Float) -> dict[str, Samples]:
    """Of clearance_min_m, collisions and following_distance_mean_m, from the columns (T,) of clearances.parquet.

    clearance_m: from the body to the nearest obstacle, <= 0 in contact; target_distance_m: to who is followed. Contact
    at a tick in contact whose tick before was not. Infinite clearance was measured too: there was no obstacle,
    hence no collision, but no distance either; NaN is unknown, and no contact.
    """
    contact = np.asarray(clearance_m) <= 0
    begins = contact & ~np.concatenate([[False], contact[:-1]])
    inside = ~np.isnan(clearance_m)
    return {
        "clearance_min_m": finite_samples(t_ns, clearance_m, "min"),
        "collisions": finite_samples(t_ns[inside], begins[inside], "sum"),
        "following_distance_mean_m": finite_samples(t_ns, target_distance_m, "mean"),
    }
