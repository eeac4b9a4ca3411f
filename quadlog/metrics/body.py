"""What a body's joints and feet did on a walk.

Legs are FL, FR, RL, RR, each with hip, thigh and calf; an instant is a row, and each row counts once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.metrics.summary import Samples, finite_samples
from quadlog.metrics.walking import GRAVITY_MPS2
from quadlog.planning.protocol import Bool

LEGS = ("FL", "FR", "RL", "RR")
JOINTS = tuple(f"{leg} {joint}" for leg in LEGS for joint in ("hip", "thigh", "calf"))
Phase = Literal["stance", "swing", "all"]
PHASES: tuple[Phase, ...] = ("stance", "swing", "all")

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
    all joints; height_m (N,) of the trunk above its feet or the ground; pitch_rad (N,) nose down.
    """

    t_ns: Int
    speed_mps: Float
    torque_nm: NDArray[np.floating]
    stance: Float
    power_w: Float
    height_m: Float
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
    """(N,) speed at t_ns (N,) over SPEED_OVER_S, from places xy_m (M, 2) at places_ns (M,) rising; NaN beside a gap.

    At the ends of the places over as much as there is.
    """
    if len(places_ns) < 2:
        return np.full(len(t_ns), np.nan)
    start_ns = int(places_ns[0])
    places_s, t_s = seconds_since(places_ns, start_ns), seconds_since(t_ns, start_ns)
    low_s, high_s = (np.clip(t_s + each_s, 0.0, places_s[-1]) for each_s in (-SPEED_OVER_S / 2, SPEED_OVER_S / 2))
    moved_m = [np.interp(high_s, places_s, each) - np.interp(low_s, places_s, each) for each in xy_m.T]
    gaps = np.concatenate([[0], np.cumsum(np.diff(places_s) > max_gap_s)])
    # The pieces between places that the stretch reaches into, the first and the last of them included.
    first, last = np.searchsorted(places_s, low_s, side="right") - 1, np.searchsorted(places_s, high_s, side="left")
    unknown = (high_s - low_s < LEAST_OVER_S) | (gaps[last] > gaps[np.minimum(first, last)])
    speed_mps: Float = np.hypot(*moved_m) / np.maximum(high_s - low_s, LEAST_OVER_S)
    return np.where(unknown | (t_s < 0) | (t_s > places_s[-1]), np.nan, speed_mps)


def stance_where(t_ns: Int, carried: Float, least: float) -> Float:
    """(N, F) 1 where what each foot carries (N, F) is `least` or more, else 0; NaN where it is not known.

    The majority of each SHORTEST_PHASE_S counts.
    """
    rows = len(t_ns)
    half = 0
    if rows > 1:
        half = min(round(SHORTEST_PHASE_S / float(np.median(np.diff(t_ns)) * 1e-9 + 1e-12)) // 2, rows)
    summed = np.concatenate([np.zeros((1, carried.shape[1])), np.cumsum(carried >= least, axis=0)])
    low, high = np.maximum(np.arange(rows) - half, 0), np.minimum(np.arange(rows) + half + 1, rows)
    share = (summed[high] - summed[low]) / (high - low)[:, None]
    return np.where(np.isnan(carried), np.nan, share > 0.5)


class Strides(NamedTuple):
    """S strides, each from one touch-down of a foot to its next.

    t_ns, row (S,): instant and row of the first touch-down, rising; frequency_hz (S,).
    """

    t_ns: Int
    row: Int
    frequency_hz: Float


def strides(body: BodySeries) -> Strides:
    """Of all legs while the body moves; those over a gap, or longer than LONGEST_STRIDE_S, are none."""
    gaps = np.concatenate([[0], np.cumsum(np.diff(body.t_ns) > MAX_GAP_S * 1e9)])
    begins: list[Int] = []
    ends: list[Int] = []
    for stance in body.stance.T:
        down = np.flatnonzero((stance[1:] == 1) & (stance[:-1] == 0)) + 1
        unknown = np.concatenate([[0], np.cumsum(np.isnan(stance))])
        begin, end = down[:-1], down[1:]
        lasts_s = (body.t_ns[end] - body.t_ns[begin]) * 1e-9
        whole = (gaps[end] == gaps[begin]) & (unknown[end] == unknown[begin]) & (lasts_s <= LONGEST_STRIDE_S)
        whole &= body.moves[begin] & body.moves[end]
        begins.append(begin[whole])
        ends.append(end[whole])
    begin, end = np.concatenate(begins), np.concatenate(ends)
    order = np.argsort(begin, kind="stable")
    begin, end = begin[order], end[order]
    return Strides(body.t_ns[begin], begin, 1e9 / (body.t_ns[end] - body.t_ns[begin]))


class TorqueRow(NamedTuple):
    """One joint in one phase over n rows with a known torque; n_unknown: rows of the phase without one."""

    joint: str
    phase: Phase
    torque_rms_nm: float
    torque_peak_nm: float
    n: int
    n_unknown: int


def torque_rows(body: BodySeries) -> list[TorqueRow]:
    """Every joint in every phase of its own leg that has a torque."""
    rows = []
    for joint, name in enumerate(JOINTS):
        torque_nm, stance = body.torque_nm[:, joint].astype(np.float64), body.stance[:, joint // 3]
        known = np.isfinite(torque_nm)
        for phase, inside in zip(PHASES, (stance == 1, stance == 0, np.ones(len(stance), bool)), strict=True):
            used = torque_nm[inside & known]
            if len(used):
                rms_nm, peak_nm = float(np.sqrt(np.mean(used**2))), float(np.abs(used).max())
                rows.append(TorqueRow(name, phase, rms_nm, peak_nm, len(used), int(inside.sum()) - len(used)))
    return rows


@dataclass(frozen=True, slots=True)
class GaitStatistics:
    """How a body walked over n rows; NaN where it is unknown.

    speed_mps: mean. duty_factor: (4,) share of the moving rows in which each foot stands. cost_of_transport: see the
    function. Height and pitch: mean and standard deviation over the moving rows.
    """

    n: int
    speed_mps: float
    stride_frequency_hz: float
    duty_factor: Float
    cost_of_transport: float
    height_mean_m: float
    height_std_m: float
    pitch_mean_rad: float
    pitch_std_rad: float


def gait(body: BodySeries, mass_kg: float) -> GaitStatistics:
    """Over all rows."""
    height_m, pitch_rad = (_known(each[body.moves]) for each in (body.height_m, body.pitch_rad))
    return GaitStatistics(
        n=int(body.moves.sum()),
        speed_mps=_mean(body.speed_mps[body.moves]),
        stride_frequency_hz=_mean(strides(body).frequency_hz),
        duty_factor=np.array([_mean(_known(stance[body.moves])) for stance in body.stance.T]),
        cost_of_transport=cost_of_transport(body, mass_kg),
        height_mean_m=_mean(height_m),
        height_std_m=float(np.std(height_m)) if len(height_m) else float("nan"),
        pitch_mean_rad=_mean(pitch_rad),
        pitch_std_rad=float(np.std(pitch_rad)) if len(pitch_rad) else float("nan"),
    )


def cost_of_transport(body: BodySeries, mass_kg: float) -> float:
    """Mean power over weight and mean speed, of rows with both known; speeds below MOVING_MPS count as 0.

    mass_kg: NaN where it is not known; the result is NaN then, and for a body that does not move.
    """
    known = body.cost_known
    way = float(np.where(body.moves, body.speed_mps, 0.0)[known].sum())
    return float(body.power_w[known].sum()) / (mass_kg * GRAVITY_MPS2 * way) if way > 0 else float("nan")


def _known(values: Float) -> Float:
    known: Float = values[np.isfinite(values)]
    return known


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
    found = strides(body)
    standing = np.where(body.moves, body.stance.mean(axis=1), np.nan)
    samples = {
        "torque_rms_nm": Samples(body.t_ns[some], np.sqrt(squared[some] / count[some]), "rms", weights=count[some]),
        "duty_factor": finite_samples(body.t_ns, standing, "mean"),
        "stride_frequency_hz": Samples(found.t_ns, found.frequency_hz, "mean"),
        "torque_max_nm": Samples(body.t_ns[some], peak_nm[some], "max"),
    }
    return {prefix + name: each for name, each in samples.items()}
