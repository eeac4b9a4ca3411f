"""From the ranges of one tag, as they come, to a track: robust filter, smoother over the whole log."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.track.kalman import INNOVATION
from quadlog.positioning.track.range_log import RangeLog, Stretch, VelocitySeries, log_ranges, predict_rows, walker
from quadlog.positioning.track.rts_smoother import refilter_usual, smooth_covariances, smooth_stretch
from quadlog.positioning.track.segments import follow

STAMP_STD_S = 0.05
"""How well the stamps of ranges are known: radios, drivers and references have clocks of their own, of which no range
tells. Real recordings were 0.08 and 0.11 s off."""


LEAST_TRUST = 1e-3
"""Mean weight of ranges below which a track rests on none of them."""


@dataclass(frozen=True, slots=True)
class PositionSpread:
    """Variances of a place, traces in m^2, means over a log: model_m2 as the smoother of thinned ranges has it, and
    lasting_m2 of range errors that last, as delete-one-link shows them.
    """

    model_m2: float = 0.0
    lasting_m2: float = 0.0


@dataclass(frozen=True, slots=True)
class Track:
    """A tag's way at T instants.

    t_ns: (T,) strictly increasing; position_m, velocity_mps: (T, 2) in map.
    covariance_m2, velocity_covariance_m2ps2: (T, 2, 2) of each of them.
    z_m, z_std_m: (T,) height in map; where it was given instead of tracked, that, and a std of zero.
    position_excess: (T,) or (1,), by how much covariance_m2 was raised above what the filter works with.
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
    restart_ns: (R,) where a track that had left its tag, although ranges kept coming, restarted.
    n_ranges, nis: (T,) of each of the track's instants, its ranges and the normalised innovation squared per range:
    what they miss the filter's prediction by, by their weights over the mean weight; 1 on average where range_std_m
    and the motion are right, somewhat less as weights are the lower the farther off a range is.
    """

    track: Track
    predicted_m: Float
    weight: Float
    restart_ns: Int
    n_ranges: Int
    nis: Float


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
    usual_m: Float | None = None,
    spread: PositionSpread | None = None,
) -> TrackedRanges:
    """Track one tag from N ranges in time order to anchors_m (A, 3), with anchor (N,) an index into them.

    Fixes (F, 2), known from fix_t_ns on, only tell where the track starts: at the beginning, after a gap, and where
    they show that the track has left its tag (`segments`). Ranges are used one by one, so asynchronous ones
    need no epoch. With tag_height_std_m above zero the height is tracked too, about its known mean. A measured velocity
    of the tag joins in where given.

    Causal (smooth=False): a pose depends on ranges up to its own instant only. Long residuals lose weight as
    1/residual, so that an NLOS burst pulls with bounded force, while no gate ever locks the filter out of the truth.
    Smoothed: that result, smoothed, with weights from its own residuals (`rts_smoother`). usual_m (A,): what each link
    is usually off by; smoothing, these weights judge ranges less that, for ranges that are all too long are not late,
    and the track is that of the ranges as they are. spread: raises the positions' covariances to what is known of the
    whole log; the stamps' STAMP_STD_S comes on top.
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
    spread = spread or PositionSpread()
    if not smooth:
        causal = [(each, each.covariances) for each in follow(log, causal=True)]
        return _gather(log, causal, PositionSpread(0.0, spread.lasting_m2))
    biased = usual_m is not None and bool(usual_m.any())
    judged = log.without(usual_m) if usual_m is not None and biased else log
    smoothed = [smooth_stretch(judged, stretch) for stretch in follow(judged, causal=False)]
    if biased:
        smoothed = [refilter_usual(log, each, _residuals(judged, each)) for each in smoothed]
    covariances = [smooth_covariances(log.seconds(s.begin, s.end), s.filtered, log.motion) for s in smoothed]
    return _gather(log, list(zip(smoothed, covariances, strict=True)), spread)


def smooth_places(log: RangeLog) -> tuple[Int, Float]:
    """Instants t_ns (T,) and smoothed places (T, 3) of a log: of track_ranges no more than that."""
    smoothed = [smooth_stretch(log, stretch) for stretch in follow(log, causal=False)]
    t_ns = np.concatenate([np.empty(0, np.int64), *(log.instant_ns[each.begin : each.end] for each in smoothed)])
    return t_ns, np.concatenate([np.empty((0, 3)), *(each.states[:, :3] for each in smoothed)])


def _residuals(log: RangeLog, stretch: Stretch) -> Float:
    """(N,) what the ranges of a stretch are longer by than its states say."""
    residual_m: Float = log.range_m[log.rows(stretch.begin, stretch.end)] - predict_rows(log, stretch)[0]
    return residual_m


def _gather(log: RangeLog, tracked: list[tuple[Stretch, Float]], spread: PositionSpread) -> TrackedRanges:
    """One result of stretches and their covariances (T, 5, 5)."""
    weight, predicted_m = np.zeros(len(log.range_m)), np.full(len(log.range_m), np.nan)
    n_ranges, nis = [np.empty(0, np.int64)], [np.empty(0)]
    for stretch, _ in tracked:
        rows = log.rows(stretch.begin, stretch.end)
        weight[rows], predicted_m[rows] = stretch.weight, predict_rows(log, stretch)[0]
        n_ranges.append(np.diff(log.first_row[stretch.begin : stretch.end + 1]))
        nis.append(stretch.filtered[:, INNOVATION] / n_ranges[-1])
    stretches = [stretch for stretch, _ in tracked]
    restart_ns = np.array([log.instant_ns[each.begin] for each in stretches if each.restarted], dtype=np.int64)
    track = _join(log, stretches, [covariance for _, covariance in tracked], spread)
    on_track = np.isfinite(predicted_m)
    trust = max(float(weight[on_track].mean()), LEAST_TRUST) if on_track.any() else 1.0
    return TrackedRanges(track, predicted_m, weight, restart_ns, np.concatenate(n_ranges), np.concatenate(nis) / trust)


def _join(log: RangeLog, stretches: list[Stretch], covariances: list[Float], spread: PositionSpread) -> Track:
    """One track, the covariances of its positions raised.

    They are scaled alike all along the log, so that their mean trace is what the spread says; what stamps that are off
    by STAMP_STD_S do lies along the velocity. Velocities keep theirs: errors that last move a place, and hardly a
    velocity.
    """
    t_ns = np.concatenate([np.empty(0, np.int64), *(log.instant_ns[each.begin : each.end] for each in stretches)])
    states = np.concatenate([np.empty((0, 5)), *(each.states for each in stretches)])
    covariance = np.concatenate([np.empty((0, 5, 5)), *covariances])
    place_m2, velocity_mps = covariance[:, :2, :2], states[:, 3:]
    own_m2 = float(np.trace(place_m2, axis1=1, axis2=2).mean()) if len(t_ns) else 1.0
    scale = (max(own_m2, spread.model_m2) + spread.lasting_m2) / own_m2
    stamps_m2 = STAMP_STD_S**2 * (velocity_mps[:, :, None] * velocity_mps[:, None, :])
    raised_m2 = scale * place_m2 + stamps_m2
    z_m: Float = np.full(len(t_ns), log.motion.height_m)
    z_std_m: Float = np.zeros(len(t_ns))
    if log.axes == 3:
        z_m, z_std_m = states[:, 2].copy(), _height_std(covariance[:, 2, 2], log.motion.height_std_m, scale)
    return Track(
        t_ns=t_ns,
        position_m=states[:, :2].copy(),
        velocity_mps=velocity_mps.copy(),
        covariance_m2=raised_m2,
        velocity_covariance_m2ps2=covariance[:, 3:, 3:].copy(),
        z_m=z_m,
        z_std_m=z_std_m,
        position_excess=np.trace(raised_m2, axis1=1, axis2=2) / np.trace(place_m2, axis1=1, axis2=2),
    )


def _height_std(variance: Float, known_std_m: float, scale: float) -> Float:
    """(T,) with the part scaled that ranges brought: what the known mean tells of a height is no range's doing."""
    from_ranges = variance * (1 - variance / known_std_m**2).clip(0)
    std_m: Float = np.sqrt(variance + (scale - 1) * from_ranges)
    return std_m
