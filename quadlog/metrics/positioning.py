"""How far fixes and trajectories are from the truth; ATE and RPE are those that evo gives."""

from __future__ import annotations

import numpy as np

from quadlog.geometry import rotation_from_quat, seconds_since
from quadlog.messages import NS_PER_S, Float, Int, PoseSeries
from quadlog.metrics.summary import Samples
from quadlog.positioning.ellipses import CHI2_95


def fix_error_samples(t_ns: Int, error_xy_m: Float) -> dict[str, Samples]:
    """Of uwb_rmse_m and, the length of the mean error, uwb_bias_m; fixes less truth (N, 2), NaN where unknown."""
    known = np.isfinite(error_xy_m).all(axis=1)
    t_ns, error_m = t_ns[known], error_xy_m[known]
    mean_m = error_m.mean(axis=0) if len(error_m) else np.zeros(2)
    length_m = float(np.hypot(*mean_m))
    direction = mean_m / length_m if length_m > 0 else np.array([1.0, 0.0])
    return {
        "uwb_rmse_m": Samples(t_ns, np.hypot(*error_m.T), "rms"),
        "uwb_bias_m": Samples(t_ns, error_m @ direction, "mean"),
    }


def ellipse_samples(t_ns: Int, error_xy_m: Float, bound_m: Float) -> dict[str, Samples]:
    """Of uwb_nees and uwb_coverage_95, from errors (N, 2) and the reach (N,) of 95 % ellipses towards them.

    An error e with covariance C is e^T C^-1 e = CHI2_95 (distance/bound)^2.
    """
    share = np.hypot(*error_xy_m.T) / bound_m
    known = np.isfinite(share)
    t_ns, share, seen = t_ns[known], share[known], errors_seen(error_xy_m[known] / bound_m[known, None])
    return {
        "uwb_nees": Samples(t_ns, CHI2_95 * share**2, "mean", seen),
        "uwb_coverage_95": Samples(t_ns, 1.0 * (share <= 1), "mean", seen),
    }


def errors_seen(error: Float) -> float:
    """How many independent errors there are among errors (N, 2): 1 if they are all alike, N at most.

    N over 1 + 2 times the sum of their autocorrelation about zero, as far as it is above a twentieth.
    """
    n = max(len(error), 1)
    products = np.fft.irfft(np.abs(np.fft.rfft(error, 2 * n, axis=0)) ** 2, axis=0)[1:n].sum(axis=1)
    alike = products / max((error**2).sum(), 1e-300)
    last = np.argmax(np.append(alike <= 0.05, True))
    return float(np.clip(n / (1 + 2 * alike[:last].sum()), 1, n))


def by_chance(name: str, independent: float) -> tuple[float, float]:
    """What uwb_nees, or uwb_coverage_95, of a right covariance exceeds in 99 of 100 logs, and stays below in 98."""
    from scipy.special import bdtrik, chdtri  # slow to import

    if name == "uwb_nees":
        low, high = chdtri(2 * independent, [0.99, 0.02]) / independent
        return float(low), float(high)
    return float(bdtrik(0.01, independent, 0.95)) / independent, 1.0


def residual_samples(t_ns: Int, residual_rms_m: Float, n_ranges: Int) -> dict[str, Samples]:
    """Of uwb_residual_m, the rms over single ranges: the residual of each of N fixes counts once for each range."""
    rows = np.repeat(np.arange(len(t_ns)), np.where(np.isfinite(residual_rms_m), n_ranges, 0))
    return {"uwb_residual_m": Samples(t_ns[rows], residual_rms_m[rows], "rms")}


def pair_samples(reference: PoseSeries, estimate: PoseSeries) -> dict[str, Samples]:
    """Of ate_rmse_m and rpe_rmse_m, from M pairs of poses: how far apart they are, and their steps to the next.

    Steps are seen from their first pose, so that a rigid motion of either trajectory does not change them.
    """
    absolute_m: Float = np.linalg.norm(estimate.position_m - reference.position_m, axis=1)
    # E = (true step)^-1 (our step): its translation is their difference, turned, which leaves its length.
    relative_m: Float = np.linalg.norm(_steps(estimate) - _steps(reference), axis=1)
    return {
        "ate_rmse_m": Samples(estimate.t_ns, absolute_m, "rms"),
        "rpe_rmse_m": Samples(estimate.t_ns[1:], relative_m, "rms"),
    }


def positions_at(t_ns: Int, known_ns: Int, known_m: Float, max_gap_ns: int) -> Float:
    """Positions (N, D) at t_ns (N,), on the straight line between the two around of known_m (M, D) at known_ns (M,).

    NaN before the first, after the last, and where those around lie farther apart than max_gap_ns.
    """
    position_m = np.full((len(t_ns), known_m.shape[1]), np.nan)
    before, after = np.searchsorted(known_ns, t_ns, "right") - 1, np.searchsorted(known_ns, t_ns, "left")
    inside = np.flatnonzero((before >= 0) & (after < len(known_ns)))
    inside = inside[known_ns[after[inside]] - known_ns[before[inside]] <= max_gap_ns]
    if len(inside):
        known_s, at_s = (seconds_since(each, int(known_ns[0])) for each in (known_ns, t_ns[inside]))
        position_m[inside] = np.column_stack([np.interp(at_s, known_s, axis_m) for axis_m in known_m.T])
    return position_m


def associate(t_ns: Int, other_t_ns: Int, max_difference_s: float, offset_s: float = 0.0) -> tuple[Int, Int]:
    """Indices (M,) into two rising time series of the pairs nearest in time, as evo pairs them.

    Each of the shorter series (the second, when equal) takes its nearest of the longer one,
    the earlier of two as near, if within max_difference_s; one of the longer may be taken twice.
    offset_s is added to the other's times; that is, taken from the first ones where these are the longer series.
    """
    # Python divides integers to the nearest float, as reading a TUM file does; numpy rounds t_ns first. So pairs
    # exactly max_difference_s apart fall on the same side as evo's.
    first_s, other_s = (np.array([t / NS_PER_S for t in each.tolist()], np.float64) for each in (t_ns, other_t_ns))
    if len(other_s) > len(first_s):
        return _nearest_pairs(first_s, other_s + offset_s, max_difference_s)
    in_other, in_first = _nearest_pairs(other_s, first_s - offset_s, max_difference_s)
    return in_first, in_other


def _nearest_pairs(short_s: Float, long_s: Float, max_difference_s: float) -> tuple[Int, Int]:
    around = np.searchsorted(long_s, short_s, side="right") - [[1], [0]]
    around = np.clip(around, 0, len(long_s) - 1)
    apart_s = np.abs(long_s[around] - short_s)
    paired = np.flatnonzero(apart_s.min(axis=0) <= max_difference_s)
    return paired, around[apart_s.argmin(axis=0)[paired], paired]


def _steps(poses: PoseSeries) -> Float:
    """From each pose to the next, seen from the first of the two: (N - 1, 3)."""
    return np.einsum("nij,ni->nj", rotation_from_quat(poses.quat_xyzw[:-1]), np.diff(poses.position_m, axis=0))
