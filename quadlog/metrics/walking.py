"""How well a robot walked: drift of a trot [Foot, Figs 5-6], effort, tracking errors, contacts, joints and feet.

Legs are FL, FR, RL, RR, each with hip, thigh and calf; an instant is a row, and each row counts once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import GRAVITY_MPS2, NS_PER_S, Float, Int
from quadlog.metrics.positioning import positions_at
from quadlog.metrics.summary import Metric, Metrics, Samples, Statistic, finite_samples
from quadlog.planning.protocol import Bool
from quadlog.positioning.unlocated import MAX_UNMEASURED_NS


def drift_metrics(position_m: Float, rpy_rad: Float, fallen: Bool, rest: int, period: int, period_s: float) -> Metrics:
    """forward_m, lateral_drift_m (left positive), yaw_rate_degps, the ranges of roll, pitch and yaw, and fallen.

    Of a walk along x, evenly spaced samples: position_m, rpy_rad (T, 3), fallen (T,). After `rest` samples it trots for
    two gait cycles or more, of `period` samples and period_s each, and a sample: first and last are at one instant of a
    cycle, so that swaying does not count, nor in the yaw rate, the slope of the best line through cycles' mean yaws.
    """
    x_m, y_m = position_m[rest:, :2].T
    angles_deg = np.degrees(np.unwrap(rpy_rad[rest:], axis=0))
    means_deg = angles_deg[:-1, 2].reshape(-1, period).mean(axis=1)
    slope = np.polyfit(np.arange(len(means_deg)) * period_s, means_deg, 1)[0]
    ranges_deg = dict(zip(("roll", "pitch", "yaw"), np.ptp(angles_deg, axis=0).tolist(), strict=True))
    return {
        "lateral_drift_m": Metric(float(y_m[-1] - y_m[0]), len(y_m), "m"),
        "yaw_rate_degps": Metric(float(slope), len(means_deg), "deg/s"),
        "forward_m": Metric(float(x_m[-1] - x_m[0]), len(x_m), "m"),
        "fallen": Metric(float(fallen.any()), len(fallen), ""),
    } | {f"{axis}_range_deg": Metric(of, len(angles_deg), "deg") for axis, of in ranges_deg.items()}


LEGS = ("FL", "FR", "RL", "RR")
JOINTS = tuple(f"{leg} {joint}" for leg in LEGS for joint in ("hip", "thigh", "calf"))


@dataclass(frozen=True, slots=True)
class Effort:
    """Over all ticks: the joints' energy, the largest torque, and the share of torques cut.

    pitch_rms_rad, height_rms_m: of the body's tilt and height beside those that the ground under its feet asks for.
    """

    energy_j: float
    torque_max_nm: float
    saturation_share: float
    pitch_rms_rad: float
    height_rms_m: float


def effort_metrics(mass_kg: float, ticks: int, effort: Effort, walk: Mapping[str, NDArray[Any]]) -> Metrics:
    """pitch_rms_rad, height_rms_m, torque_max_nm, torque_saturation_share and cost_of_transport; none without ticks.

    The energy is the sum of |torque x joint speed|, given per weight and way, as in `gait`. walk: t_ns, x_m, y_m (T,).
    """
    if ticks == 0:
        return {}
    metrics = {
        "pitch_rms_rad": Metric(effort.pitch_rms_rad, ticks, "rad"),
        "height_rms_m": Metric(effort.height_rms_m, ticks, "m"),
        "torque_max_nm": Metric(effort.torque_max_nm, ticks * len(JOINTS), "N·m"),
        "torque_saturation_share": Metric(effort.saturation_share, ticks * len(JOINTS), ""),
    }
    speed_mps = ground_speed(walk["t_ns"], walk["t_ns"], np.column_stack([walk["x_m"], walk["y_m"]]))
    way_m = float((np.where(speed_mps >= MOVING_MPS, speed_mps, 0.0)[1:] * np.diff(walk["t_ns"])).sum()) / NS_PER_S
    if way_m > 0:
        cost = effort.energy_j / (mass_kg * GRAVITY_MPS2 * way_m)
        metrics["cost_of_transport"] = Metric(cost, ticks, "")
    return metrics


_TRACKED: tuple[tuple[str, Statistic, str], ...] = (
    ("eta_m", "mean", "error_m"),
    ("sigma_m", "std", "error_m"),
    ("eta_time_m", "mean", "time_error_m"),
    ("sigma_time_m", "std", "time_error_m"),
    ("max_error_m", "max", "error_m"),
    ("cross_track_rmse_m", "rms", "cross_track_m"),
    ("heading_rmse_rad", "rms", "heading_error_rad"),
    ("plan_error_m", "mean", "plan_error_m"),
    ("fallen", "max", "fallen"),
    ("us_step_median", "median", "us_median"),
    ("us_step_p95", "p95", "us_max"),
)


def tracking_samples(walk: Mapping[str, NDArray[Any]]) -> dict[str, Samples]:
    """The samples of eta_m, sigma_m, [Tracking] eqs 46 and 47, and their kin; those that do not apply are absent.

    walk: t_ns and columns of control.parquet (T,), NaN where nothing was measured; `fallen` only if it can fall.
    Forces that are wanted come with those on the feet.
    """
    samples = {
        name: finite_samples(walk["t_ns"], walk[column], statistic)
        for name, statistic, column in _TRACKED
        if column in walk
    }
    if "wanted_fz_0_n" in walk:
        apart_n = [walk[f"wanted_fz_{leg}_n"] - walk[f"fz_{leg}_n"] for leg in range(4)]
        samples["force_error_rms_n"] = finite_samples(walk["t_ns"], np.sqrt(np.mean(np.square(apart_n), axis=0)), "rms")
    return samples


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


SPEED_OVER_S = 1.0
"""A speed is the distance between the places before and after an instant, so far apart: sway is not speed."""
LEAST_OVER_S = 0.25
MOVING_MPS = 0.1
SHORTEST_PHASE_S = 0.05
"""What is shorter is no stance and no swing, but noise of its estimate."""
LONGEST_STRIDE_S = 2.0
MAX_GAP_S = 0.1
"""Strides over a longer gap between rows are not counted."""


@dataclass(frozen=True, slots=True)
class BodySeries:
    """A walk of N rows: t_ns (N,) rising; what is unknown is NaN.

    speed_mps (N,) over ground; torque_nm (N, 12); stance (N, 4) 1 or 0; power_w (N,) sum of |torque x joint speed| of
    all joints; pitch_rad (N,) nose down.
    """

    t_ns: Int
    speed_mps: Float
    torque_nm: NDArray[np.floating]
    stance: Float
    power_w: Float
    pitch_rad: Float

    @property
    def moves(self) -> Bool:
        """(N,) whether the body goes at MOVING_MPS or faster."""
        return self.speed_mps >= MOVING_MPS

    @property
    def cost_known(self) -> Bool:
        """(N,) whether a row counts in the cost of transport: power and speed are known, at rest too."""
        return np.isfinite(self.power_w) & np.isfinite(self.speed_mps)


def ground_speed(t_ns: Int, places_ns: Int, xy_m: Float, max_gap_s: float = 0.5) -> Float:
    """(N,) speed at t_ns (N,) over SPEED_OVER_S, from places xy_m (M, 2) at places_ns (M,); NaN if one lies in a gap.

    At the ends of the places over as much as there is, LEAST_OVER_S at least.
    """
    if len(places_ns) < 2:
        return np.full(len(t_ns), np.nan)
    half_ns, first_ns, last_ns = round(SPEED_OVER_S * NS_PER_S / 2), places_ns[0], places_ns[-1]
    ends_ns = [np.clip(t_ns + sign * half_ns, first_ns, last_ns) for sign in (-1, 1)]
    before_m, after_m = (positions_at(each, places_ns, xy_m, round(max_gap_s * NS_PER_S)) for each in ends_ns)
    over_s = (ends_ns[1] - ends_ns[0]) / NS_PER_S
    known = (over_s >= LEAST_OVER_S) & (t_ns >= first_ns) & (t_ns <= last_ns)
    return np.where(known, np.hypot(*(after_m - before_m).T) / np.maximum(over_s, LEAST_OVER_S), np.nan)


def speed_difference(walk: Mapping[str, NDArray[Any]], poses: Mapping[str, NDArray[Any]]) -> Samples:
    """Speed of a walk less that of the log, over SPEED_OVER_S, from t_ns, x_m, y_m of each (T,), (N,)."""
    speeds = (ground_speed(walk["t_ns"], of["t_ns"], np.column_stack([of["x_m"], of["y_m"]])) for of in (walk, poses))
    return finite_samples(walk["t_ns"], np.subtract(*speeds), "rms")


def uneven_share(t_ns: Int) -> float:
    """Share of the time, pauses apart, in which SHORTEST_PHASE_S's usual number of rows takes another time by half."""
    usual_s = _usual_s(t_ns)
    rows = max(round(SHORTEST_PHASE_S / max(usual_s, 1e-9)), 1)
    took_s = (t_ns[rows:] - t_ns[:-rows]) / NS_PER_S
    lasts_ns = np.diff(t_ns)[: len(took_s)]
    lasts_ns = np.where(lasts_ns <= MAX_UNMEASURED_NS, lasts_ns, 0)
    return float(lasts_ns[np.abs(took_s / (rows * usual_s) - 1) > 0.5].sum() / max(lasts_ns.sum(), 1))


MOST_UNEVEN = 0.1
"""Of the time; with more, as in bursts, rows say nothing of when a foot stands."""


def _usual_s(t_ns: Int) -> float:
    """Mean time between rows at t_ns (N,), pauses apart; infinite without any."""
    steps_ns = np.diff(t_ns)[np.diff(t_ns) <= MAX_UNMEASURED_NS]
    return float(steps_ns.mean()) / NS_PER_S if len(steps_ns) else np.inf


def stance_where(t_ns: Int, carried: Float, least: float) -> Float:
    """(N, F) 1 where carried (N, F) is `least` or more for most of each SHORTEST_PHASE_S, else 0; NaN if unknown."""
    from scipy.ndimage import uniform_filter1d  # slow to import

    half = min(round(SHORTEST_PHASE_S / (_usual_s(t_ns) + 1e-12)) // 2, len(t_ns))
    share = uniform_filter1d((carried >= least).astype(np.float64), 2 * half + 1, axis=0, mode="nearest")
    return np.where(np.isnan(carried), np.nan, share > 0.5)


def strides(body: BodySeries) -> Samples:
    """The frequency in Hz of strides, each from one touch-down of a foot to its next, at the first of the two.

    Of all legs while the body moves; those over a gap, or longer than LONGEST_STRIDE_S, are left out.
    """
    gap = np.diff(body.t_ns, prepend=body.t_ns[:1]) > MAX_GAP_S * NS_PER_S
    whole: list[Int] = []
    for stance in body.stance.T:
        down = np.flatnonzero((stance[1:] == 1) & (stance[:-1] == 0)) + 1
        breaks = np.cumsum(gap | np.isnan(stance))
        begin, end = down[:-1], down[1:]
        kept = (breaks[end] == breaks[begin]) & body.moves[begin] & body.moves[end]
        kept &= body.t_ns[end] - body.t_ns[begin] <= LONGEST_STRIDE_S * NS_PER_S
        whole.append(np.stack([begin, end])[:, kept])
    begin, end = np.concatenate(whole, axis=1)
    order = np.argsort(begin, kind="stable")
    return Samples(body.t_ns[begin[order]], NS_PER_S / (body.t_ns[end] - body.t_ns[begin])[order], "mean")


def stride_hz(t_ns: Int, contact: Float) -> float:
    """The median frequency of strides of feet that carry (N, F) as surely as 0..1, infinite without a whole one."""
    fast, stance = np.full(len(t_ns), np.inf), stance_where(t_ns, contact, 0.5)
    found = strides(BodySeries(t_ns, fast, np.empty((0, 12)), stance, fast, fast)).values
    return float(np.median(found)) if len(found) else np.inf


def torque_rows(body: BodySeries) -> list[dict[str, str | float | int]]:
    """Rows of body.parquet, every joint in every phase of its leg; n, n_unknown: instants with and without torque."""
    rows: list[dict[str, str | float | int]] = []
    for joint, name in enumerate(JOINTS):
        torque_nm, stance = body.torque_nm[:, joint].astype(np.float64), body.stance[:, joint // 3]
        for phase, inside in (("stance", stance == 1), ("swing", stance == 0), ("all", np.full(len(stance), True))):
            used = _known(torque_nm[inside])
            if len(used):
                rms_nm, peak_nm = float(np.sqrt(np.mean(used**2))), float(np.abs(used).max())
                counts = {"n": len(used), "n_unknown": int(inside.sum()) - len(used)}
                torques = {"torque_rms_nm": rms_nm, "torque_peak_nm": peak_nm}
                rows.append({"joint": name, "phase": phase, **torques, **counts})
    return rows


def gait(body: BodySeries, mass_kg: float) -> dict[str, float | int]:
    """The row of gait.parquet, over the n rows in which the body moves; NaN where it is unknown.

    duty_factor_0 to 3: share of these rows in which each foot stands. cost_of_transport: mean power over weight and
    mean speed, of rows with both known, at rest too; speeds below MOVING_MPS count as 0. mass_kg: NaN if unknown.
    """
    moves, known = body.moves, body.cost_known
    pitch_rad, way = _known(body.pitch_rad[moves]), float(np.where(moves, body.speed_mps, 0.0)[known].sum())
    weight_n = mass_kg * GRAVITY_MPS2
    return {
        "n": int(moves.sum()),
        "speed_mps": _mean(body.speed_mps[moves]),
        "stride_frequency_hz": _mean(strides(body).values),
        **{f"duty_factor_{foot}": _mean(_known(stance[moves])) for foot, stance in enumerate(body.stance.T)},
        "cost_of_transport": float(body.power_w[known].sum()) / (weight_n * way) if way > 0 else float("nan"),
        "pitch_mean_rad": _mean(pitch_rad),
        "pitch_std_rad": float(np.std(pitch_rad)) if len(pitch_rad) else float("nan"),
    }


def _known(values: Float) -> Float:
    return values[np.isfinite(values)]


def _mean(values: Float) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def body_samples(body: BodySeries, prefix: str = "") -> dict[str, Samples]:
    """The samples of torque_rms_nm, torque_max_nm, duty_factor and stride_frequency_hz, by names with a prefix."""
    count, (squared, peak_nm) = np.zeros(len(body.t_ns), np.int64), np.zeros((2, len(body.t_ns)))
    for torque_nm in body.torque_nm.T:  # all at once would take 1 GB for an hour
        known = np.isfinite(torque_nm)
        count += known
        squared[known] += np.square(torque_nm[known], dtype=np.float64)
        np.fmax(peak_nm, np.abs(torque_nm), out=peak_nm)
    some = count > 0
    standing = np.where(body.moves, body.stance.mean(axis=1), np.nan)
    samples = {
        "torque_rms_nm": Samples(body.t_ns[some], np.sqrt(squared[some] / (count.sum() / max(some.sum(), 1))), "rms"),
        "duty_factor": finite_samples(body.t_ns, standing, "mean"),
        "stride_frequency_hz": strides(body),
        "torque_max_nm": Samples(body.t_ns[some], peak_nm[some], "max"),
    }
    return {prefix + name: each for name, each in samples.items()}
