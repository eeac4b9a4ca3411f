"""Clock and frame of a reference against a trajectory: errors as they are, time-corrected, and aligned as well.

The time offset and the rigid motion between the frames are estimated together, by least squares over the positions. A
motion that another place or direction explains as well as another time (standing still, a straight line or a circle at
constant speed) does not observe the offset, and none is claimed then.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from quadlog.messages import NS_PER_S, Float, Int, PoseSeries
from quadlog.metrics import alignment
from quadlog.metrics.alignment import align_rigidly, find_frame_offset, project_to_plane, rigid_motion, rms
from quadlog.metrics.intervals import Interval, independent_values, mean_interval_in_time
from quadlog.metrics.positioning import associate, pair_samples, positions_at
from quadlog.metrics.summary import Samples

FRAME_METRICS = ("ate_rmse_m", "ate_time_corrected_rmse_m")
"""Those of poses that are in the reference's frame."""
TRAJECTORY_METRICS = (*FRAME_METRICS, "ate_aligned_rmse_m", "reference_time_offset_s", "rpe_rmse_m")

_STEP_S = 0.05
_MOST_STEPS, _MOST_SAMPLES = 16_000, 20_000  # of the search over all offsets; of the offset found
_LONGEST_GAP_S = 0.5  # bridged by a straight line, unless three usual gaps are longer
_LEAST_S = 5.0  # of an overlap: some steps look like any others
_LEAST_OVERLAP = 0.5  # of the longest one: at its ends anything fits
_WINDOW_S = 1.0  # offsets farther apart are rivals; about 0 also an ambiguous one is taken
_PERFECT = 0.01  # of the spread of positions: whatever fits better than this fits as well
_CLEAR = 2.5
"""How much worse all rivals must fit. Of a walk that UWB positions to 0.1 m, parts of 5 to 40 s are then aligned to
0.3 s or called ambiguous; two different walks come to 1.3 at most."""
_MOST_OF_SPREAD = 0.25  # residual over the spread of positions: beyond, the two did not walk alike
_DERIVATIVE_S = 0.2  # half the base of differences: noise of positions is no motion
_RESOLUTION_S = 1e-5
_LEAST_OF_SPEED = 0.1  # what the fit depends on time by, over speed
_LEAST_OF_CURVATURE = 0.3  # of what the speed that no rigid motion explains promises: below, most of it is noise
_FEWEST_INDEPENDENT = 6.0  # with fewer the offset's error is not known
_LEAST_TOLD_S = 0.01  # poses this far apart count as simultaneous
_ANOTHER_WALK = "it moved too little, or another way than the reference"


class TimeOffset(NamedTuple):
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
        return abs(self.offset_s - offset_s) > max(self.interval[1] - self.interval[0], _LEAST_TOLD_S)

    def words(self) -> str:
        """The offset with its interval, or why it is unknown."""
        if self.offset_s is None or self.interval is None:
            return f"the time offset is unknown: {self.why_not}"
        return f"time offset {self.offset_s:+.3f} s (95 % {self.interval[0]:+.3f} to {self.interval[1]:+.3f})"


def estimate_time_offset(reference: PoseSeries, estimate: PoseSeries) -> TimeOffset:
    """The offset at which positions, brought together by the best rigid motion, differ least, and its 95 % interval.

    Every offset at which they overlap is searched. Not by speeds: those of a steady walk are alike at many offsets, and
    those of noisy positions at all. The interval is the sandwich estimate of a least-squares offset: the long-run
    variance (`mean_interval_in_time`) of residuals' products with the velocity over the measured curvature's square.
    """
    durations_s = [int(np.ptp(each.t_ns)) / NS_PER_S if len(each.t_ns) else 0.0 for each in (reference, estimate)]
    if min(durations_s) < _LEAST_S:
        return _unknown(f"one of them is shorter than {_LEAST_S:g} s")
    offsets_s, seconds, share = _fits(reference, estimate, sum(durations_s))
    if not len(offsets_s):
        return _unknown("they share too little time or motion")
    fit = np.where(seconds >= _LEAST_OVERLAP * seconds.max(), share, np.inf)
    best = int(np.argmin(fit))
    rivals = np.where(np.abs(offsets_s - offsets_s[best]) > _WINDOW_S, fit, np.inf)
    if fit[best] <= _MOST_OF_SPREAD and rivals.min() >= _CLEAR * max(fit[best], _PERFECT):
        return _refined(reference, estimate, float(offsets_s[best]))
    near = np.where(np.abs(offsets_s) <= _WINDOW_S, share, np.inf)
    if np.isfinite(near.min()):
        return _refined(reference, estimate, float(offsets_s[np.argmin(near)]))
    if fit[best] > _MOST_OF_SPREAD:
        return _unknown(_ANOTHER_WALK)
    rival_s = offsets_s[np.argmin(rivals)]
    return _unknown(f"it is ambiguous: {offsets_s[best]:.3f} s and {rival_s:.3f} s fit about as well")


def _fits(reference: PoseSeries, estimate: PoseSeries, duration_s: float) -> tuple[Float, Float, Float]:
    """The offsets (L,) at which both overlap and move, for how long, and what the best rigid motion leaves [Umeyama].

    The last as a share of the smaller spread of positions. All sums of products at all offsets by one FFT.
    """
    step_s = max(_STEP_S, duration_s / _MOST_STEPS)
    columns = []
    for each in (reference, estimate):
        grid_ns = np.arange(each.t_ns[0], each.t_ns[-1] + 1, round(step_s * NS_PER_S))
        position_m = _positions_on(grid_ns, each.t_ns, each)
        known = np.isfinite(position_m[:, :1])
        centred_m = np.where(known, position_m - np.nanmean(position_m, axis=0), 0.0)
        columns.append(np.column_stack([known, centred_m, (centred_m**2).sum(axis=1)]))
    size = sum(map(len, columns)) - 1
    of_reference, of_estimate = (np.fft.rfft(each, size, axis=0) for each in columns)
    # Row k: sums over j of the reference's columns at step j + k times the estimate's at step j.
    sums = np.fft.irfft(of_reference[:, :, None] * of_estimate[:, None].conj(), size, axis=0)
    lags = np.arange(size) - size * (np.arange(size) >= len(columns[0]))
    kept = sums[:, 0, 0] * step_s >= _LEAST_S
    lags, count, sums = lags[kept], np.round(sums[kept, 0, 0]), sums[kept] / np.round(sums[kept, :1, :1])
    means_m = sums[:, 1:4, 0], sums[:, 0, 1:4]
    spreads_m2 = np.stack([sums[:, 4, 0], sums[:, 0, 4]]) - (np.stack(means_m) ** 2).sum(axis=2)
    covariance_m2 = sums[:, 1:4, 1:4] - means_m[0][:, :, None] * means_m[1][:, None]
    turned_m2 = np.linalg.svd(covariance_m2, compute_uv=False)
    turned_m2[:, -1] *= np.sign(np.linalg.det(covariance_m2))
    left_m2, least_m2 = spreads_m2.sum(axis=0) - 2 * turned_m2.sum(axis=1), spreads_m2.min(axis=0)
    # What rounding leaves is no motion.
    moves = least_m2 > 1e-9 * max(least_m2.max(initial=0.0), 1e-12)
    apart_s = int(reference.t_ns[0] - estimate.t_ns[0]) / NS_PER_S
    share = np.sqrt(np.maximum(left_m2[moves], 0.0) / least_m2[moves])
    return apart_s + lags[moves] * step_s, count[moves] * step_s, share


def _positions_on(t_ns: Int, known_ns: Int, poses: PoseSeries) -> Float:
    """Positions (N, 3) of poses at known_ns, NaN in gaps longer than _LONGEST_GAP_S and than three usual ones."""
    usual_ns = int(np.median(np.diff(known_ns)))
    return positions_at(t_ns, known_ns, poses.position_m, max(round(_LONGEST_GAP_S * NS_PER_S), 3 * usual_ns))


def _refined(reference: PoseSeries, estimate: PoseSeries, start_s: float) -> TimeOffset:
    """The offset near start_s by Newton's method, with what is known of its error, or why it is unknown."""
    offset_s, shifts_ns = start_s, [round(sign * _DERIVATIVE_S * NS_PER_S) for sign in (-1, 0, 1)]
    for _ in range(3):
        own_ns = estimate.t_ns + round(offset_s * NS_PER_S)
        first_ns, last_ns = max(reference.t_ns[0], own_ns[0]), min(reference.t_ns[-1], own_ns[-1])
        step_ns = max(round(_STEP_S * NS_PER_S), int(last_ns - first_ns) // _MOST_SAMPLES)
        t_ns = np.arange(first_ns, last_ns + 1, step_ns)
        sample_m = _positions_on(t_ns, own_ns, estimate)
        partners_m = [_positions_on(t_ns + shift_ns, reference.t_ns, reference) for shift_ns in shifts_ns]
        known = np.isfinite(sum(partners_m, sample_m)).all(axis=1)
        if known.sum() * step_ns < _LEAST_S * NS_PER_S - 2 * shifts_ns[2]:
            return _unknown("too few poses at common times")
        sample_m, partners_m = sample_m[known], [each[known] for each in partners_m]
        motions = [rigid_motion(sample_m, each) for each in partners_m]
        residuals_m = [
            to - sample_m @ turn.T - shift_m for to, (turn, shift_m) in zip(partners_m, motions, strict=True)
        ]
        squares_m2, centred_m = [rms(each) ** 2 for each in residuals_m], partners_m[1] - partners_m[1].mean(axis=0)
        velocity_mps = (partners_m[2] - partners_m[0]) / (2 * _DERIVATIVE_S)
        unexplained_mps = (residuals_m[2] - residuals_m[0]) / (2 * _DERIVATIVE_S)
        if squares_m2[1] > (_MOST_OF_SPREAD * rms(centred_m)) ** 2:
            return _unknown(_ANOTHER_WALK)
        curvature_m2ps2 = (squares_m2[0] - 2 * squares_m2[1] + squares_m2[2]) / (2 * _DERIVATIVE_S**2)
        promised_m2ps2, least_m2ps2 = rms(unexplained_mps) ** 2, (_LEAST_OF_SPEED * rms(velocity_mps)) ** 2
        if curvature_m2ps2 <= max(_LEAST_OF_CURVATURE * promised_m2ps2, least_m2ps2):
            return _unknown("another place or direction explains its motion as well as another time, or noise hides it")
        offset_s += (squares_m2[0] - squares_m2[2]) / (4 * _DERIVATIVE_S * curvature_m2ps2)
        if abs(offset_s - start_s) > _WINDOW_S:
            return _unknown("positions fit better at any other offset near")
    influence_s = -np.sum(unexplained_mps * residuals_m[1], axis=1) / curvature_m2ps2
    samples_s = offset_s + influence_s - influence_s.mean()
    interval: Interval | None = (offset_s, offset_s)
    if np.ptp(samples_s) > 2 * _RESOLUTION_S:
        interval = mean_interval_in_time(samples_s) if independent_values(samples_s) >= _FEWEST_INDEPENDENT else None
    if interval is None:
        return _unknown("the walk is too short for an interval")
    return TimeOffset(offset_s, interval, t_ns[known] - round(offset_s * NS_PER_S), samples_s)


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
    def samples(self) -> dict[str, Samples]:
        """Of each metric that applies, aligned in the plane, or in space where both have heights."""
        found, truth, estimate = pair_samples(self.truth, self.estimate), self.corrected_truth, self.corrected_estimate
        if self.offset.offset_s is not None:
            found["ate_time_corrected_rmse_m"] = pair_samples(truth, estimate)["ate_rmse_m"]
            found["reference_time_offset_s"] = Samples(self.offset.t_ns, self.offset.samples_s, "mean")
        have_heights = all(np.ptp(each.position_m[:, 2]) > 0 for each in (truth, estimate))
        if all(np.ptp(each.position_m, axis=0).any() for each in (truth, estimate)):
            aligned = align_rigidly(estimate, truth, 3 if have_heights else 2)
            found["ate_aligned_rmse_m"] = pair_samples(truth, aligned)["ate_rmse_m"]
        return {name: each for name, each in found.items() if len(each.values)}

    @cached_property
    def mirrored(self) -> str | None:
        """A line for a reference that fits only mirrored."""
        ours_m, theirs_m = (each.position_m[:, :2] for each in (self.corrected_estimate, self.corrected_truth))
        return alignment.mirror_words(ours_m, theirs_m)

    @property
    def in_any_frame(self) -> list[str]:
        """That line, or else one for a reference whose yaw is that of another axis."""
        words = self.mirrored or alignment.yaw_offset_words(self.corrected_estimate, self.corrected_truth)
        return [] if words is None else [words]

    def warnings(self) -> list[str]:
        """A line for a clock, and one for a frame, that differ from the reference's by more than can be chance."""
        frame = find_frame_offset(self.corrected_estimate.position_m[:, :2], self.corrected_truth.position_m[:, :2])
        words = [*self.in_any_frame, None if frame is None or self.mirrored else alignment.frame_offset_words(frame)]
        if self.offset.differs_from(self.given_offset_s):
            words.insert(0, f"the reference's clock is not that of the poses: {self.summary()}")
        return [each for each in words if each is not None]

    def summary(self) -> str:
        """The offset and the three errors in one line."""
        rms_m = {name: float(np.sqrt(np.mean(each.values**2))) for name, each in self.samples.items()}
        errors = [f"ATE {rms_m['ate_rmse_m']:.3f} m"]
        if "ate_time_corrected_rmse_m" in rms_m:
            errors.append(f"{rms_m['ate_time_corrected_rmse_m']:.3f} m with it added to the poses' times")
        if "ate_aligned_rmse_m" in rms_m:
            errors.append(f"{rms_m['ate_aligned_rmse_m']:.3f} m aligned")
        return f"{self.offset.words()}; {', '.join(errors)}"


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

    align, planar: as evo's --align and --project_to_plane xy, for every one of the errors. None without a pair.
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
    if align:
        moved = align_rigidly(moved, truth)
    if planar:
        truth, moved = project_to_plane(truth), project_to_plane(moved)
    return truth, moved
