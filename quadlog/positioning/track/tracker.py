"""From the ranges of one tag, as they come, to a track: robust filter, smoother over the whole log."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.track.covariance_inflation import NOISE_SHARE, ResidualSums, excess_variance, total_excess
from quadlog.positioning.track.range_log import RangeLog, Stretch, VelocitySeries, log_ranges, predict_rows, walker
from quadlog.positioning.track.rts_smoother import smooth_covariances, smooth_stretch, smoothed_slope
from quadlog.positioning.track.segments import follow


@dataclass(frozen=True, slots=True)
class Track:
    """A tag's way at T instants.

    t_ns: (T,) strictly increasing; position_m, velocity_mps: (T, 2) in map.
    covariance_m2, velocity_covariance_m2ps2: (T, 2, 2) of each of them.
    z_m, z_std_m: (T,) height in map; where it was given instead of tracked, that, and a std of zero.
    position_excess: (T,) or (1,), by how much covariance_m2 was raised for range errors that are not white.
    """

    t_ns: Int
    position_m: Float
    velocity_mps: Float
    covariance_m2: Float
    velocity_covariance_m2ps2: Float
    z_m: Float
    z_std_m: Float
    position_excess: Float = field(default_factory=lambda: np.ones(1))

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class TrackedRanges:
    """A track, and what it makes of each of N ranges.

    predicted_m: (N,), NaN off the track. weight: (N,), one for full trust, near zero for NLOS, zero off the track.
    restart_ns: (R,) where a track that had left its tag, although ranges kept coming, started anew.
    excess: variance of what ranges tell over what white noise would make it, see `covariance_inflation`.
    """

    track: Track
    predicted_m: Float
    weight: Float
    restart_ns: Int
    excess: float


def track_ranges(
    t_ns: Int,
    anchor: Int,
    range_m: Float,
    anchors_m: Float,
    tag_height_m: float,
    fix_t_ns: Int,
    fix_m: Float,
    *,
    range_std_m: float,
    acceleration_std_mps2: float,
    smooth: bool,
    tag_height_std_m: float = 0.0,
    velocity: VelocitySeries | None = None,
) -> TrackedRanges:
    """Track one tag from N ranges in time order to anchors_m (A, 3), with anchor (N,) an index into them.

    Fixes (F, 2), known from fix_t_ns on, only tell where the track starts: at the beginning, after a gap, and where
    they show that the track has left its tag (`segments`). Ranges are used one by one, so asynchronous ones
    need no epoch. With tag_height_std_m above zero the height is tracked too, about its known mean. A measured velocity
    of the tag joins in where given.

    Causal (smooth=False): a pose depends on ranges up to its own instant only. Long residuals lose weight as
    1/residual, so that an NLOS burst pulls with bounded force, while no gate ever locks the filter out of the truth.
    Smoothed: that result, smoothed, with weights from its own residuals (`rts_smoother`). Positions' covariances grow
    with what the residuals show of errors that are not white (`covariance_inflation`).
    """
    log = log_ranges(
        t_ns,
        anchor,
        range_m,
        anchors_m,
        fix_t_ns,
        fix_m,
        range_std_m,
        walker(acceleration_std_mps2, tag_height_m, tag_height_std_m),
        velocity,
        causal=not smooth,
    )
    judge = _judge_smoothed if smooth else _judge_causal
    return _gather(log, [judge(log, stretch) for stretch in follow(log, causal=not smooth)], causal=not smooth)


def smooth_places(log: RangeLog) -> tuple[Int, Float]:
    """Instants t_ns (T,) and smoothed places (T, 3) of a log: of track_ranges no more than that."""
    smoothed = [smooth_stretch(log, stretch) for stretch in follow(log, causal=False)]
    t_ns = np.concatenate([np.empty(0, np.int64), *(log.instant_ns[each.begin : each.end] for each in smoothed)])
    return t_ns, np.concatenate([np.empty((0, 3)), *(each.states[:, :3] for each in smoothed)])


@dataclass(frozen=True, slots=True)
class _Judged:
    """A stretch, its covariances (T, 5, 5), its rows' predicted_m and direction, and the slope of weight x residual."""

    stretch: Stretch
    covariances: Float
    predicted_m: Float
    unit: Float
    slope: Float


def _judge_causal(log: RangeLog, stretch: Stretch) -> _Judged:
    """Beyond a Huber limit the pull does not change with the residual, within it one to one."""
    return _Judged(stretch, stretch.covariances, *predict_rows(log, stretch), (stretch.weight >= 1).astype(np.float64))


def _judge_smoothed(log: RangeLog, stretch: Stretch) -> _Judged:
    smoothed = smooth_stretch(log, stretch)
    covariances = smooth_covariances(log.seconds(stretch.begin, stretch.end), smoothed.filtered, log.motion)
    return _Judged(smoothed, covariances, *predict_rows(log, smoothed), smoothed_slope(log, smoothed))


def _gather(log: RangeLog, judged: list[_Judged], *, causal: bool) -> TrackedRanges:
    weight, predicted_m = np.zeros(len(log.range_m)), np.full(len(log.range_m), np.nan)
    tally = ResidualSums()
    excess: list[Float] = [np.empty(0)]
    for each in judged:
        stretch = each.stretch
        rows = slice(log.first_row[stretch.begin], log.first_row[stretch.end])
        weight[rows], predicted_m[rows] = stretch.weight, each.predicted_m
        factor, tally = excess_variance(
            tally,
            log.first_row[stretch.begin : stretch.end + 1] - rows.start,
            log.anchor[rows],
            log.range_m[rows] - each.predicted_m,
            stretch.weight,
            each.slope,
            each.unit,
            each.covariances[:, : log.axes, : log.axes],
            log.range_std_m,
        )
        excess.append(factor)
    total = total_excess(tally, log.range_std_m)
    factor = np.concatenate(excess)
    stretches = [each.stretch for each in judged]
    track = _join(log, judged, factor if causal else np.full(len(factor), total))
    restart_ns = np.array([log.instant_ns[each.begin] for each in stretches if each.restarted], dtype=np.int64)
    return TrackedRanges(track, predicted_m, weight, restart_ns, total)


def _join(log: RangeLog, judged: list[_Judged], excess: Float) -> Track:
    """One track, its positions' variance raised by excess (T,) in what ranges brought to it.

    Velocities keep theirs: errors that persist move a place, and hardly a velocity.
    """
    stretches = [each.stretch for each in judged]
    t_ns = np.concatenate([np.empty(0, np.int64), *(log.instant_ns[each.begin : each.end] for each in stretches)])
    states = np.concatenate([np.empty((0, 5)), *(each.states for each in stretches)])
    covariances = np.concatenate([np.empty((0, 5, 5)), *(each.covariances for each in judged)])
    position_excess = 1 + NOISE_SHARE * (excess - 1)
    z_m, z_std_m = np.full(len(t_ns), log.motion.height_m), np.zeros(len(t_ns))
    if log.axes == 3:
        variance = covariances[:, 2, 2]
        # What the known mean tells of a height is no range's doing.
        from_ranges = variance * (1 - variance / log.motion.height_std_m**2).clip(0)
        z_m, z_std_m = states[:, 2].copy(), np.sqrt(variance + NOISE_SHARE * (excess - 1) * from_ranges)
    return Track(
        t_ns=t_ns,
        position_m=states[:, :2].copy(),
        velocity_mps=states[:, 3:].copy(),
        covariance_m2=covariances[:, :2, :2] * position_excess[:, None, None],
        velocity_covariance_m2ps2=covariances[:, 3:, 3:].copy(),
        z_m=z_m,
        z_std_m=z_std_m,
        position_excess=position_excess,
    )
