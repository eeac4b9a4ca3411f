"""One trajectory brought onto another: the rigid motion, the plane and the clock's offset between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import quat_from_yaw, yaw_from_quat
from quadlog.messages import NS_PER_S, Float, Int, PoseSeries
from quadlog.metrics.summary import Samples, finite_samples

_RANK = 1e-9  # of the largest singular value


def rigid_motion(position_m: Float, wanted_m: Float) -> tuple[Float, Float]:
    """The rotation (D, D) and shift (D,) that bring positions (N, D) nearest to those wanted (N, D) [Umeyama]."""
    mean_m, wanted_mean_m = position_m.mean(axis=0), wanted_m.mean(axis=0)
    u, _, vh = np.linalg.svd((wanted_m - wanted_mean_m).T @ (position_m - mean_m))
    mirrored = np.ones(len(u))
    mirrored[-1] = np.sign(np.linalg.det(u) * np.linalg.det(vh))
    rotation: Float = (u * mirrored) @ vh
    return rotation, wanted_mean_m - rotation @ mean_m


def align_rigidly(estimate: PoseSeries, reference: PoseSeries, axes: int = 3) -> PoseSeries:
    """The estimate moved, without scaling, so that the sum of its squared distances from the reference is least.

    M poses each, in pairs. axes: 2 turns it in the plane alone.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    rotation = np.eye(3)
    rotation[:axes, :axes], _ = rigid_motion(estimate.position_m[:, :axes], reference.position_m[:, :axes])
    centred_m = estimate.position_m - estimate.position_m.mean(axis=0)
    quat_xyzw = (Rotation.from_matrix(rotation) * Rotation.from_quat(estimate.quat_xyzw)).as_quat()
    return PoseSeries(estimate.t_ns, centred_m @ rotation.T + reference.position_m.mean(axis=0), quat_xyzw)


def are_on_line(estimate: PoseSeries, reference: PoseSeries) -> bool:
    """Whether what M pairs of poses have in common lies on one line, about which any turn fits as well."""
    centred_m, wanted_m = (each.position_m - each.position_m.mean(axis=0) for each in (estimate, reference))
    singular = np.linalg.svd(wanted_m.T @ centred_m, compute_uv=False)
    return bool(singular[1] <= _RANK * singular[0])


def project_to_plane(trajectory: PoseSeries) -> PoseSeries:
    """The trajectory in the plane z = 0: heights, roll and pitch left out."""
    position_m = trajectory.position_m * np.array([1.0, 1.0, 0.0])
    return PoseSeries(trajectory.t_ns, position_m, quat_from_yaw(yaw_from_quat(trajectory.quat_xyzw)))


def aligned_square_m2(spread_m2: Float, other_spread_m2: Float, covariance_m2: Float) -> Float:
    """Mean squared distance (L,) that the best rigid motion leaves between the pairs of each of L sets [Umeyama].

    From what a set can be summed up in: the variances (L,) of both trajectories, as mean squared distances from
    their means, and covariance_m2 (L, D, D) of D axes, one row for each axis of the first. On one line, too.
    """
    turned = np.linalg.svd(covariance_m2, compute_uv=False)
    turned[:, -1] *= np.sign(np.linalg.det(covariance_m2))
    left_m2: Float = np.maximum(spread_m2 + other_spread_m2 - 2 * turned.sum(axis=1), 0)
    return left_m2


_STEP_S = 0.05
_MOST_STEPS = 1 << 17
_LEAST_S = 5.0  # of either trajectory: some steps look like any others
_LEAST_PAIRS = 10
_LEAST_OVERLAP = 0.5  # of the most that could be: at its ends anything fits
_LONGEST_GAP_S = 1.0  # that a straight line bridges, unless most gaps are longer
# Shares of how far the robot moved about its mean place:
_PERFECT = 0.01  # whatever fits better than this fits as well
_WORST = 0.25
_APART_S = 1.0
_CLEAR = 2.5
"""How much worse all offsets farther away than _APART_S must fit. Of a walk that UWB positions to 0.1 m, parts of 5 to
40 s are then aligned to 0.3 s or called ambiguous; two different walks come to 1.3 at most."""


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """offset_s: what to add to the estimate's times; residual_m: how far apart positions are then, rms, once aligned.

    rival_s: another offset, more than a second away, that fits about as well; None when offset_s is clearly the best.
    """

    offset_s: float
    residual_m: float
    rival_s: float | None


def estimate_clock_offset(reference: PoseSeries, estimate: PoseSeries) -> ClockOffset | None:
    """The offset at which a rigid motion brings the positions of both nearest to each other, whatever frames they have.

    None where one is too short or stands still, and where they fit at no offset. Not by speeds, which are quicker to
    compare: those of a steady walk are alike at many offsets, and those of noisy positions at all.
    """
    durations_s = [int(each.t_ns[-1] - each.t_ns[0]) / NS_PER_S for each in (reference, estimate)]
    if min(durations_s) < _LEAST_S:
        return None
    step_s = max(_STEP_S, max(durations_s) / _MOST_STEPS)
    own = _median_gap_s(reference.t_ns) > _median_gap_s(estimate.t_ns)
    fits = _fits(_sampled(reference, step_s, own), _sampled(estimate, step_s, not own))
    if fits is None:
        return None
    lags, square_m2, spread_m2 = fits
    share = np.sqrt(square_m2 / spread_m2)
    best = int(np.argmin(share))
    far = np.flatnonzero(np.abs(lags - lags[best]) * step_s > _APART_S)
    if share[best] > _WORST or len(far) == 0:
        return None
    between_starts_s = int(reference.t_ns[0] - estimate.t_ns[0]) / NS_PER_S
    offset_s = between_starts_s + (float(lags[best]) + _vertex(lags, square_m2, best)) * step_s
    rival = int(far[np.argmin(share[far])])
    clear = share[rival] >= _CLEAR * max(share[best], _PERFECT)
    rival_s = None if clear else between_starts_s + float(lags[rival]) * step_s
    return ClockOffset(offset_s, float(np.sqrt(square_m2[best])), rival_s)


def _median_gap_s(t_ns: Int) -> float:
    return float(np.median(np.diff(t_ns))) / NS_PER_S


def _sampled(trajectory: PoseSeries, step_s: float, own: bool) -> tuple[Float, Float]:
    """Positions (K, 3) about their mean at even steps from the start on, and the weight (K,) of each: 1 or 0.

    1 only beside the trajectory's own poses, or anywhere but in gaps: so one of few poses is compared where it has
    them, with the other one between whose poses a straight line does.
    """
    seconds = (trajectory.t_ns - trajectory.t_ns[0]) / NS_PER_S
    at_s = np.arange(int(seconds[-1] / step_s) + 1) * step_s
    position_m = np.column_stack([np.interp(at_s, seconds, axis_m) for axis_m in trajectory.position_m.T])
    if own:
        weight = np.zeros(len(at_s))
        weight[np.minimum(np.round(seconds / step_s).astype(np.int64), len(at_s) - 1)] = 1
    else:
        after = np.clip(np.searchsorted(seconds, at_s), 1, len(seconds) - 1)
        longest_s = max(_LONGEST_GAP_S, 3 * _median_gap_s(trajectory.t_ns))
        weight = (seconds[after] - seconds[after - 1] <= longest_s).astype(np.float64)
    return position_m - position_m.mean(axis=0), weight


@np.errstate(over="ignore", invalid="ignore")  # of positions beyond all measure, which then fit nowhere
def _fits(a: tuple[Float, Float], b: tuple[Float, Float]) -> tuple[Int, Float, Float] | None:
    """For b moved by lags (L,): the mean squared distance (L,) that alignment leaves, and the smaller variance (L,).

    Only lags with enough overlap and motion; None if there are none.
    """
    lags = np.arange(-(len(b[0]) - 1), len(a[0]))
    sums = _sliding_sums(a, b)
    count = sums[0, 0]
    enough = count >= max(_LEAST_PAIRS - 0.5, _LEAST_OVERLAP * count.max())
    lags, means = lags[enough], sums[:, :, enough] / count[enough]
    if len(lags) == 0 or not np.isfinite(means).all():
        return None
    centre_a, centre_b = means[1:4, 0], means[0, 1:4]
    spread_a, spread_b = means[4, 0] - (centre_a**2).sum(axis=0), means[0, 4] - (centre_b**2).sum(axis=0)
    covariance = np.moveaxis(means[1:4, 1:4] - centre_a[:, None] * centre_b[None, :], 2, 0)
    smaller = np.minimum(spread_a, spread_b)
    # What the transforms round is no motion.
    moved = smaller > 1e-9 * max(spread_a.max(), spread_b.max())
    if not moved.any():
        return None
    square = aligned_square_m2(spread_a[moved], spread_b[moved], covariance[moved])
    return lags[moved], square, smaller[moved]


def _sliding_sums(a: tuple[Float, Float], b: tuple[Float, Float]) -> Float:
    """Sums (5, 5, L) over the overlap of products of 1, x, y, z and the squared length of a with those of b, weighted.

    For each lag from -(N - 1) to M - 1, by Fourier transforms.
    """
    size = len(a[0]) + len(b[0]) - 1
    terms = [
        np.vstack([np.ones(len(weight)), position_m.T, (position_m**2).sum(axis=1)]) * weight
        for position_m, weight in (a, b)
    ]
    of_a, of_b = np.fft.rfft(terms[0], size), np.fft.rfft(terms[1][:, ::-1], size)
    sums: Float = np.fft.irfft(of_a[:, None] * of_b[None, :], size)
    return sums


def _vertex(lags: Int, square: Float, best: int) -> float:
    """Where the parabola through the best lag and its neighbours has its top, from it; 0 where one is missing."""
    if not 0 < best < len(lags) - 1 or lags[best + 1] - lags[best - 1] != 2:
        return 0.0
    before, middle, after = square[best - 1 : best + 2]
    bend = before - 2 * middle + after
    return float(np.clip(0.5 * (before - after) / bend, -1, 1)) if bend > 0 else 0.0


MIN_SHIFT_M = 0.3
MIN_TURN_RAD = np.radians(3.0)
MIN_TURNED_M = 0.1
"""A turn that moves the track by less is one of its noise, as that of a robot that stood."""
EXPLAINED = 0.5
MIRRORED_SHARE = 0.1
"""Of the spread of a track: the least that a mirrored one misses its reference by."""
MIN_PAIRS = 10


@dataclass(frozen=True, slots=True)
class FrameOffset:
    """The best rigid motion from a track onto its reference: turned by turn_rad about map's origin, then shifted.

    shift_m: (2,); mean_shift_m: (2,) mean of reference less track; spread_m: rms distance of the track from its mean.
    before_m, after_m: rmse without and with it.
    """

    turn_rad: float
    shift_m: Float
    mean_shift_m: Float
    spread_m: float
    before_m: float
    after_m: float


def find_frame_offset(position_m: Float, reference_m: Float) -> FrameOffset | None:
    """The rotation and translation that bring N positions (N, 2) nearest to those of the reference [Umeyama].

    Rows with a NaN on either side are left out; None with fewer than MIN_PAIRS of them left.
    """
    known = np.isfinite(position_m).all(axis=1) & np.isfinite(reference_m).all(axis=1)
    position_m, reference_m = position_m[known], reference_m[known]
    if len(position_m) < MIN_PAIRS:
        return None
    rotation, shift_m = rigid_motion(position_m, reference_m)
    return FrameOffset(
        turn_rad=float(np.arctan2(rotation[1, 0], rotation[0, 0])),
        shift_m=shift_m,
        mean_shift_m=reference_m.mean(axis=0) - position_m.mean(axis=0),
        spread_m=_rms(position_m - position_m.mean(axis=0)),
        before_m=_rms(reference_m - position_m),
        after_m=_rms(reference_m - position_m @ rotation.T - shift_m),
    )


def track_difference_samples(t_ns: Int, lidar_xy_m: Float, uwb_xy_m: Float) -> dict[str, Samples]:
    """Of lidar_uwb_rmse_m: distances of positions (N, 2), NaN where unknown, once a rigid motion has aligned them."""
    offset = find_frame_offset(lidar_xy_m, uwb_xy_m)
    if offset is None:
        return {}
    cos, sin = np.cos(offset.turn_rad), np.sin(offset.turn_rad)
    moved_m = lidar_xy_m @ np.array([[cos, sin], [-sin, cos]]) + offset.shift_m
    return {"lidar_uwb_rmse_m": finite_samples(t_ns, np.hypot(*(moved_m - uwb_xy_m).T), "rms")}


def mirror_words(position_m: Float, reference_m: Float) -> str | None:
    """A warning where positions (N, 2) fit the reference's only mirrored, as NED against ENU; None elsewhere."""
    fits = [find_frame_offset(each, reference_m) for each in (position_m, position_m * [1.0, -1.0])]
    if fits[0] is None or fits[1] is None or fits[1].after_m > EXPLAINED * fits[0].after_m:
        return None
    # A straight walk that bends a little the wrong way is not mirrored.
    if fits[0].after_m < max(MIN_TURNED_M, MIRRORED_SHARE * fits[0].spread_m):
        return None
    return (
        f"the reference fits the poses only mirrored (x and y swapped, as in NED against ENU): {fits[0].after_m:.2f} m "
        f"aligned, {fits[1].after_m:.2f} m mirrored; errors against it count that too"
    )


def frame_offset_words(offset: FrameOffset) -> str | None:
    """A warning where the rigid motion is large and explains at least half of the error; None elsewhere."""
    turned_m = 2 * abs(np.sin(offset.turn_rad / 2)) * offset.spread_m
    shifted = float(np.hypot(*offset.mean_shift_m)) > MIN_SHIFT_M
    turned = abs(offset.turn_rad) > MIN_TURN_RAD and turned_m > MIN_TURNED_M
    if not (shifted or turned) or offset.after_m > EXPLAINED * offset.before_m:
        return None
    x_m, y_m = offset.shift_m
    return (
        f"the reference seems to lie in another frame than the poses: map turned by "
        f"{np.degrees(offset.turn_rad):.1f} degrees and then shifted by ({x_m:.2f}, {y_m:.2f}) m would bring the "
        f"error from {offset.before_m:.2f} to {offset.after_m:.2f} m; errors against it count that too"
    )


def _rms(vectors_m: Float) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors_m**2, axis=1))))
