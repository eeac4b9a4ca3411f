"""Clock and frame of a reference against a trajectory: errors as they are, time-corrected, and aligned as well.

The time offset and the rigid motion between the frames are estimated together, by least squares over the positions. A
motion that another place or direction explains as well as another time (standing still, a straight line or a circle at
constant speed) does not observe the offset, and none is claimed then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from quadlog.errors import PosesOnLine
from quadlog.messages import NS_PER_S, Float, Int, PoseSeries
from quadlog.metrics.alignment import (
    align_rigidly,
    are_on_line,
    find_frame_offset,
    frame_offset_words,
    mirror_words,
    project_to_plane,
    rigid_motion,
)
from quadlog.metrics.intervals import Interval, independent_values, mean_interval_in_time
from quadlog.metrics.positioning import associate, pair_samples, positions_at
from quadlog.metrics.summary import Samples

TRAJECTORY_METRICS = (
    "ate_rmse_m",
    "ate_time_corrected_rmse_m",
    "ate_aligned_rmse_m",
    "reference_time_offset_s",
    "rpe_rmse_m",
)
FRAME_METRICS = ("ate_rmse_m", "ate_time_corrected_rmse_m")
"""Those of poses that are in the reference's frame."""

_WINDOW_S = 1.0  # searched on either side of where the search starts
_GRID_S = 0.05
_RESOLUTION_S = 1e-5
_DERIVATIVE_S = 0.2  # half the base of differences: noise of positions is no motion
_LEAST_STEP_S, _MOST_SAMPLES = 0.05, 20_000
_LONGEST_GAP_S = 0.1  # bridged by a straight line, unless three usual gaps are longer
_MOST_OF_SPREAD = 0.25  # residual over the spread of positions: beyond, the two did not walk alike
_LEAST_OF_SPEED = 0.1  # speed that no rigid motion explains, over speed
_LEAST_OF_CURVATURE = 0.3  # of what that speed promises: below, most of it is noise
_FARTHEST_M = 1e7  # of positions; beyond, squares lose what is measured
_LEAST_MOVED_M = 0.1  # by a reference onto which a trajectory can be turned
_FEWEST_SAMPLES, _FEWEST_INDEPENDENT = 100, 6.0  # with fewer the offset's error is not known
_LEAST_TOLD_S = 0.01  # poses this far apart count as simultaneous

# Of the search over all offsets at which the two overlap:
_WIDE_STEP_S, _MOST_STEPS, _MOST_WIDE_SAMPLES, _WIDE_GAP_S = 0.25, 8000, 500, 1.0
_LEAST_S = 5.0  # of either trajectory: some steps look like any others
_LEAST_PAIRS = 10
_LEAST_OVERLAP = 0.5  # of the most that could be: at its ends anything fits
_PERFECT = 0.01  # of the spread of positions: whatever fits better than this fits as well
_CLEAR = 2.5
"""How much worse all offsets more than _WINDOW_S away must fit. Of a walk that UWB positions to 0.1 m, parts of 5 to
40 s are then aligned to 0.3 s or called ambiguous; two different walks come to 1.3 at most."""


@dataclass(frozen=True, slots=True)
class _Pairing:
    """K samples of the trajectory with fewer poses, and the other one to be interpolated at their times.

    sample_ns (K,), at the estimate's clock for both; sample_m (K, D); sign: 1 where the reference is interpolated.
    """

    sample_ns: Int
    sample_m: Float
    dense: PoseSeries
    max_gap_ns: int
    sign: int

    @classmethod
    def of(
        cls, reference: PoseSeries, estimate: PoseSeries, axes: int, most_samples: int, gap_s: float
    ) -> _Pairing | None:
        """gap_s: the longest that is bridged, unless three usual ones are longer. None for positions too far off."""
        if max(np.abs(each.position_m).max() for each in (reference, estimate)) > _FARTHEST_M:
            return None
        gaps_ns = [float(np.median(np.diff(each.t_ns))) for each in (reference, estimate)]
        sign = 1 if gaps_ns[0] <= gaps_ns[1] else -1
        dense, sparse = (reference, estimate) if sign == 1 else (estimate, reference)
        rows = _thinned(sparse.t_ns, most_samples)
        max_gap_ns = max(round(gap_s * NS_PER_S), round(3 * min(gaps_ns)))
        return cls(sparse.t_ns[rows], sparse.position_m[rows, :axes], dense, max_gap_ns, sign)

    def with_partners(self, offsets_s: Iterable[float]) -> _Pairing | None:
        """The samples that have a partner at all of these offsets; None for too few of them."""
        known = np.all([np.isfinite(self.partner_m(each)).all(axis=1) for each in offsets_s], axis=0)
        kept = replace(self, sample_ns=self.sample_ns[known], sample_m=self.sample_m[known])
        return kept if known.sum() >= _LEAST_PAIRS else None

    def partner_m(self, offset_s: float) -> Float:
        """(K, D) where the dense trajectory was, the estimate's times counted with that offset."""
        at_ns = self.sample_ns + self.sign * round(offset_s * NS_PER_S)
        partner_m: Float = positions_at(at_ns, self.dense, self.max_gap_ns)[:, : self.sample_m.shape[1]]
        return partner_m

    def fit(self, offset_s: float) -> tuple[int, float, float]:
        """Number of pairs, mean squared distance that the best rigid motion leaves [Umeyama], and smaller variance."""
        partner_m = self.partner_m(offset_s)
        known = np.isfinite(partner_m[:, 0])
        n = int(known.sum())
        if n < _LEAST_PAIRS:
            return n, math.inf, 0.0
        sample_m, partner_m = (each[known] - each[known].mean(axis=0) for each in (self.sample_m, partner_m))
        covariance_m2 = sample_m.T @ partner_m / n
        turned_m2 = np.linalg.svd(covariance_m2, compute_uv=False)
        turned_m2[-1] *= np.sign(np.linalg.det(covariance_m2))
        spreads_m2 = [float(np.mean(np.sum(each**2, axis=1))) for each in (sample_m, partner_m)]
        return n, max(sum(spreads_m2) - 2 * float(turned_m2.sum()), 0.0), min(spreads_m2)

    def best_offset_s(self, about_s: float, window_s: float) -> float | None:
        """Where the fit is best, to _RESOLUTION_S; None at the window's ends."""
        from scipy.optimize import minimize_scalar  # slow to import

        offsets_s = about_s + np.arange(-window_s, window_s + _GRID_S / 2, _GRID_S)
        best = int(np.argmin([self.fit(float(each))[1] for each in offsets_s]))
        if best in (0, len(offsets_s) - 1):
            return None
        bounds = float(offsets_s[best - 1]), float(offsets_s[best + 1])
        options = {"xatol": _RESOLUTION_S}
        return float(minimize_scalar(lambda each_s: self.fit(each_s)[1], bounds=bounds, options=options).x)


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
    pairing = _Pairing.of(reference, estimate, 3, _MOST_WIDE_SAMPLES, _WIDE_GAP_S)
    if pairing is None:
        return None
    step_s = max(_WIDE_STEP_S, sum(durations_s) / _MOST_STEPS)
    first_s = int(reference.t_ns[0] - estimate.t_ns[-1]) / NS_PER_S
    offsets_s = first_s + np.arange(0.0, sum(durations_s) + step_s, step_s)
    count, square_m2, spread_m2 = np.array([pairing.fit(float(each)) for each in offsets_s]).T
    # What rounding leaves is no motion.
    usable = (count >= max(_LEAST_PAIRS, _LEAST_OVERLAP * count.max())) & (spread_m2 > 1e-9 * spread_m2.max())
    offsets_s, share = offsets_s[usable], np.sqrt(square_m2[usable] / spread_m2[usable])
    if not usable.any():
        return None
    offset_s = float(offsets_s[np.argmin(share)])
    offset_s = pairing.best_offset_s(offset_s, step_s + _GRID_S) or offset_s
    _, best_m2, best_spread_m2 = pairing.fit(offset_s)
    best, far = math.sqrt(best_m2 / best_spread_m2), np.abs(offsets_s - offset_s) > _WINDOW_S
    if best > _MOST_OF_SPREAD or not far.any():
        return None
    rival = int(np.argmin(share[far]))
    clear = share[far][rival] >= _CLEAR * max(best, _PERFECT)
    return ClockOffset(offset_s, math.sqrt(best_m2), None if clear else float(offsets_s[far][rival]))


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """offset_s: what to add to the estimate's times to have the reference's; None where it is unknown, with why_not.

    samples_s: (K,) at t_ns (K,): what each sample says, whose mean is offset_s and whose scatter gives the interval.
    """

    offset_s: float | None
    interval: Interval | None
    t_ns: Int
    samples_s: Float
    why_not: str = ""

    def differs_from(self, offset_s: float) -> bool:
        """Whether the interval, made twice as wide, excludes another offset that is at least 0.01 s away.

        Twice, because the interval of a log that is short against the errors' correlation time is too narrow.
        """
        if self.offset_s is None or self.interval is None:
            return False
        apart_s = self.offset_s - offset_s
        half_s = max(self.offset_s - self.interval[0], self.interval[1] - self.offset_s)
        return abs(apart_s) > max(2 * half_s, _LEAST_TOLD_S)


def estimate_time_offset(reference: PoseSeries, estimate: PoseSeries) -> TimeOffset:
    """The offset at which positions, brought together by the best rigid motion, differ least, and its 95 % interval.

    The denser of the two is interpolated at the other's times. The motion is of the plane, or of space where both have
    heights. The interval is the sandwich estimate of a least-squares offset: the long-run variance of the residuals'
    products with the velocity, which counts neighbours as dependent (`mean_interval_in_time`), over the square of the
    measured curvature. Offsets beyond a second are found where the motion determines them without a rival.
    """
    if min(len(reference.t_ns), len(estimate.t_ns)) < 2:
        return _unknown("too few poses")
    coarse = estimate_clock_offset(reference, estimate)
    start_s = coarse.offset_s if coarse is not None and coarse.rival_s is None else 0.0
    pairing = _Pairing.of(reference, estimate, _known_axes(reference, estimate), _MOST_SAMPLES, _LONGEST_GAP_S)
    if pairing is not None:
        pairing = pairing.with_partners((start_s - _WINDOW_S, start_s, start_s + _WINDOW_S))
    if pairing is None:
        return _unknown("too few poses at common times")
    offset_s = pairing.best_offset_s(start_s, _WINDOW_S)
    if offset_s is None:
        return _unknown(f"positions fit best at the end of what was searched, {_WINDOW_S:g} s")
    return _with_interval(pairing, offset_s)


def _with_interval(pairing: _Pairing, offset_s: float) -> TimeOffset:
    """The offset with what is known of its error, or why it is unknown."""
    later, earlier = (pairing.partner_m(offset_s + shift_s) for shift_s in (_DERIVATIVE_S, -_DERIVATIVE_S))
    partner_m = pairing.partner_m(offset_s)
    known = np.isfinite(partner_m + later + earlier).all(axis=1)
    sample_m, partner_m = pairing.sample_m[known], partner_m[known]
    velocity_mps = (later - earlier)[known] / (2 * _DERIVATIVE_S)
    partner_m = partner_m - partner_m.mean(axis=0)
    rotation, shift_m = rigid_motion(sample_m, partner_m)
    residual_m = partner_m - sample_m @ rotation.T - shift_m
    square_m2, spread_m2 = (float(np.mean(np.sum(each**2, axis=1))) for each in (residual_m, partner_m))
    if spread_m2 <= 0 or square_m2 > _MOST_OF_SPREAD**2 * spread_m2:
        return _unknown("it moved too little, or another way than the reference")
    unexplained_mps = _without_rigid_motions(velocity_mps, partner_m)
    told_m2ps2, speed_m2ps2 = (float(np.mean(np.sum(each**2, axis=1))) for each in (unexplained_mps, velocity_mps))
    if told_m2ps2 <= _LEAST_OF_SPEED**2 * speed_m2ps2:
        return _unknown("its motion is one that another place or direction explains as well as another time")
    around_m2 = [pairing.fit(offset_s + shift_s)[1] for shift_s in (-_DERIVATIVE_S, 0.0, _DERIVATIVE_S)]
    curvature_m2ps2 = (around_m2[0] - 2 * around_m2[1] + around_m2[2]) / (2 * _DERIVATIVE_S**2)
    if curvature_m2ps2 <= _LEAST_OF_CURVATURE * told_m2ps2:
        return _unknown("the noise of the positions hides it")
    influence_s = np.sum(unexplained_mps * residual_m, axis=1) / curvature_m2ps2
    samples_s = offset_s + influence_s - influence_s.mean()
    is_long = len(samples_s) >= _FEWEST_SAMPLES and independent_values(samples_s) >= _FEWEST_INDEPENDENT
    interval = mean_interval_in_time(samples_s) if is_long else None
    if interval is None and np.ptp(samples_s) > 2 * _RESOLUTION_S:
        return _unknown("the walk is too short for an interval")
    return TimeOffset(offset_s, interval or (offset_s, offset_s), pairing.sample_ns[known], samples_s)


def _without_rigid_motions(velocity_mps: Float, position_m: Float) -> Float:
    """Velocities (K, D) less what shifts and small turns of centred positions (K, D) explain of them."""
    n, axes = position_m.shape
    in_space_m = np.pad(position_m, ((0, 0), (0, 3 - axes)))
    shifts = [np.tile(axis, n) for axis in np.eye(axes)]
    turns = [np.cross(axis, in_space_m)[:, :axes].ravel() for axis in np.eye(3)[2 if axes == 2 else 0 :]]
    motions = np.column_stack([*shifts, *turns])
    weights, *_ = np.linalg.lstsq(motions, velocity_mps.ravel(), rcond=None)
    left_mps: Float = velocity_mps - (motions @ weights).reshape(n, axes)
    return left_mps


def _thinned(t_ns: Int, most: int) -> Int:
    """Rows at least _LEAST_STEP_S apart, about, and at most so many of them."""
    step_ns = max(round(_LEAST_STEP_S * NS_PER_S), int(t_ns[-1] - t_ns[0]) // most, 1)
    _, rows = np.unique((t_ns - t_ns[0]) // step_ns, return_index=True)
    return rows.astype(np.int64)


def _known_axes(*trajectories: PoseSeries) -> int:
    """3 where all have heights, else 2."""
    return 3 if min(np.ptp(each.position_m[:, 2]) for each in trajectories) > 0 else 2


def _unknown(why: str) -> TimeOffset:
    return TimeOffset(None, None, np.empty(0, np.int64), np.empty(0), why)


@dataclass(frozen=True)
class ReferenceComparison:
    """A trajectory against its reference, N pairs of poses as they are paired without and with the time offset.

    given_offset_s: what was added to the estimate's times for the first pairing. truth, estimate: (N,) poses each;
    corrected_truth, corrected_estimate: (M,), the same where the offset is unknown.
    """

    given_offset_s: float
    offset: TimeOffset
    truth: PoseSeries
    estimate: PoseSeries
    corrected_truth: PoseSeries
    corrected_estimate: PoseSeries

    @cached_property
    def aligned(self) -> PoseSeries:
        """The time-corrected estimate, moved in the plane, or in space where both have heights, onto the reference."""
        estimate, truth = self.corrected_estimate, self.corrected_truth
        return align_rigidly(estimate, truth, _known_axes(estimate, truth))

    @cached_property
    def samples(self) -> dict[str, Samples]:
        """Of each metric of a trajectory against a reference, those that apply."""
        found = pair_samples(self.truth, self.estimate)
        corrected = pair_samples(self.corrected_truth, self.corrected_estimate)["ate_rmse_m"]
        if self.offset.offset_s is not None:
            found["ate_time_corrected_rmse_m"] = corrected
            found["reference_time_offset_s"] = Samples(self.offset.t_ns, self.offset.samples_s, "mean")
        if np.ptp(self.corrected_truth.position_m, axis=0).max() > _LEAST_MOVED_M:
            found["ate_aligned_rmse_m"] = pair_samples(self.corrected_truth, self.aligned)["ate_rmse_m"]
        return {name: each for name, each in found.items() if len(each.values)}

    @cached_property
    def mirrored(self) -> str | None:
        """A line for a reference that fits only mirrored."""
        return mirror_words(self.corrected_estimate.position_m[:, :2], self.corrected_truth.position_m[:, :2])

    def warnings(self) -> list[str]:
        """A line for a clock, and one for a frame, that differ from the reference's by more than can be chance."""
        frame = find_frame_offset(self.corrected_estimate.position_m[:, :2], self.corrected_truth.position_m[:, :2])
        words = [self.mirrored or (None if frame is None else frame_offset_words(frame))]
        if self.offset.differs_from(self.given_offset_s):
            words.insert(0, f"the reference's clock is not that of the poses: {self.summary()}")
        return [each for each in words if each is not None]

    def summary(self) -> str:
        """The offset and the three errors in one line."""
        rms_m = {name: float(np.sqrt(np.mean(each.values**2))) for name, each in self.samples.items()}
        errors = [f"ATE {rms_m['ate_rmse_m']:.3f} m"]
        if self.offset.offset_s is None or self.offset.interval is None:
            clock = f"time offset unknown: {self.offset.why_not}"
        else:
            low_s, high_s = self.offset.interval
            clock = f"time offset {self.offset.offset_s:+.3f} s (95 % {low_s:+.3f} to {high_s:+.3f})"
            errors.append(f"{rms_m['ate_time_corrected_rmse_m']:.3f} m with it added to the poses' times")
        if "ate_aligned_rmse_m" in rms_m:
            errors.append(f"{rms_m['ate_aligned_rmse_m']:.3f} m aligned")
        return f"{clock}; {', '.join(errors)}"


def compare_trajectories(
    reference: PoseSeries,
    estimate: PoseSeries,
    max_difference_s: float = 0.01,
    offset_s: float = 0.0,
    *,
    align: bool = False,
    planar: bool = False,
) -> ReferenceComparison | None:
    """Poses paired as evo pairs them, offset_s added to the estimate's times, and by the estimated offset.

    align, planar: as evo's --align and --project_to_plane xy, for every one of the errors. None without a pair. Raises
    PosesOnLine where poses on one line are to be aligned.
    """
    offset = estimate_time_offset(*(project_to_plane(each) if planar else each for each in (reference, estimate)))
    told_s = offset_s if offset.offset_s is None else offset.offset_s
    pairs = [_paired(reference, estimate, max_difference_s, each_s, align, planar) for each_s in (offset_s, told_s)]
    given, corrected = pairs
    if given is None:
        return None
    if corrected is None:
        offset, corrected = _unknown("too few poses at common times"), given
    return ReferenceComparison(offset_s, offset, *given, *corrected)


def _paired(
    reference: PoseSeries, estimate: PoseSeries, max_difference_s: float, offset_s: float, align: bool, planar: bool
) -> tuple[PoseSeries, PoseSeries] | None:
    """Reference and estimate pair by pair; None without a pair."""
    in_reference, in_estimate = associate(reference.t_ns, estimate.t_ns, max_difference_s, offset_s)
    if len(in_reference) == 0:
        return None
    truth, moved = reference.rows(in_reference), estimate.rows(in_estimate)
    if align and are_on_line(moved, truth):
        raise PosesOnLine
    if align:
        moved = align_rigidly(moved, truth)
    if planar:
        truth = project_to_plane(truth)
        # A run's poses lie in the plane, and projecting them again would change their last digit.
        if moved.position_m[:, 2].any() or moved.quat_xyzw[:, :2].any():
            moved = project_to_plane(moved)
    return truth, moved
