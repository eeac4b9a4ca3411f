"""How well a robot followed its path, and what it came near to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float, Int
from quadlog.metrics.metric import Metric, Metrics, add_mean, add_rmse, add_sample_std, finite
from quadlog.planning.protocol import Bool


@dataclass(frozen=True, slots=True)
class TrackedWalk:
    """A walk of T ticks, (T,) each; NaN where there was nothing to measure, None where it does not apply.

    error_m, cross_track_m, time_error_m, heading_error_rad: columns of control.parquet.
    clearance_m: from the body to the nearest obstacle, <= 0 in contact.
    target_distance_m: to who is followed. fallen: None for a robot that cannot fall.
    """

    t_ns: Int
    error_m: Float
    cross_track_m: Float
    time_error_m: Float
    heading_error_rad: Float
    clearance_m: Float | None = None
    target_distance_m: Float | None = None
    fallen: Bool | None = None


def tracking_metrics(walk: TrackedWalk, completed_ns: int | None = None) -> Metrics:
    """eta_m, sigma_m and their kin; those that do not apply are absent.

    eta_m and sigma_m are the mean and the sample standard deviation of error_m over
    all N ticks [Tracking] eqs 46, 47, whose two names for the same number, N and N_e,
    are one here. completed_ns: when a course was finished, None for a walk without an end.
    """
    metrics: Metrics = {}
    add_mean(metrics, "eta_m", walk.error_m, "m")
    add_sample_std(metrics, "sigma_m", walk.error_m, "m")
    add_mean(metrics, "eta_time_m", walk.time_error_m, "m")
    add_sample_std(metrics, "sigma_time_m", walk.time_error_m, "m")
    if completed_ns is not None and len(walk.t_ns):
        metrics["completion_time_s"] = Metric((completed_ns - int(walk.t_ns[0])) / 1e9, 1, "s")
    errors_m = finite(walk.error_m)
    if len(errors_m):
        metrics["max_error_m"] = Metric(float(errors_m.max()), len(errors_m), "m")
    add_rmse(metrics, "cross_track_rmse_m", walk.cross_track_m, "m")
    add_rmse(metrics, "heading_rmse_rad", walk.heading_error_rad, "rad")
    if walk.fallen is not None and len(walk.fallen):
        metrics["fallen"] = Metric(float(walk.fallen.any()), len(walk.fallen), "")
    if walk.clearance_m is not None:
        _add_clearance(metrics, walk.clearance_m)
    if walk.target_distance_m is not None:
        add_mean(metrics, "following_distance_mean_m", walk.target_distance_m, "m")
    return metrics


def contact_begins(clearance_m: Float) -> Bool:
    """Ticks (T,) in contact whose tick before was not; unknown (NaN) is no contact."""
    contact = np.asarray(clearance_m) <= 0
    begins: Bool = contact & ~np.concatenate([[False], contact[:-1]])
    return begins


def count_collisions(clearance_m: Float) -> int:
    """How often contact began in ticks (T,), see contact_begins."""
    return int(np.count_nonzero(contact_begins(clearance_m)))


def _add_clearance(metrics: Metrics, clearance_m: Float) -> None:
    # Infinite clearance was measured too: there was no obstacle, hence no collision, but no distance either.
    measured = int(np.count_nonzero(~np.isnan(clearance_m)))
    distances_m = finite(clearance_m)
    if len(distances_m):
        metrics["clearance_min_m"] = Metric(float(distances_m.min()), len(distances_m), "m")
    if measured:
        metrics["collisions"] = Metric(float(count_collisions(clearance_m)), measured, "")
