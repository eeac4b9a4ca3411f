"""Constant biases of a tag's links, estimated jointly with its track, and whether they make positions agree better.

The test is delete-one-link: the track is estimated again without each link in turn. What these tracks differ by shows
errors that last, which residuals hide because the track follows them: it decides whether biases are applied, and how
uncertain positions are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from quadlog.messages import Float, Int
from quadlog.positioning.epochs import thin_links
from quadlog.positioning.shared_errors import redescending_weights
from quadlog.positioning.track.bias_filter import filter_biases
from quadlog.positioning.track.range_log import START_STD, RangeLog, Stretch, log_ranges, walker
from quadlog.positioning.track.rts_smoother import (
    LinkWindows,
    refilter,
    refilter_usual,
    smooth_covariances,
    weigh_lateness,
    windows_of,
)
from quadlog.positioning.track.segments import follow
from quadlog.positioning.track.tracker import PositionSpread

COMMON_STD_M, LINK_STD_M = 0.2, 0.05
"""Prior of the biases: real sets lie within 0 and 0.4 m, and links of one make share most of it. LINK_STD_M was chosen
between 0.03 and 0.1 m on simulated round-robin logs and the first 12 s of `synthesize follow`."""
SHRINK_NEEDED = 0.3
"""Biases are applied where the delete-one-link spread shrinks by this share or more."""
RARE_SHARE = 0.05
"""Links with fewer ranges than this share of the busiest one's are not left out: that would change nothing."""
ROUNDS, SETTLED_M = 10, 0.002
MOST_SLOTS, MOST_STEPS = 5000, 1_000_000_000
"""Longest log that is looked at in slots of THIN_S, and arithmetic that all links left out in turn may take: of A
links, each slot has A rows, and each row changes a covariance of (5 + A)^2 numbers, A times over."""
BLOCKS_S, FEWEST_BLOCKS = (0.5, 1.0, 2.0, 4.0), 5
"""Over how long residuals of a link are summed to see how much of them lasts."""


@dataclass(frozen=True, slots=True)
class AnchorBias:
    """Measured minus true range of one tag's links to A anchors.

    bias_m, std_m: (A,); n: (A,) ranges of each link in the log. significant: (A,) bool, the links that are corrected:
    all that were heard, or none, for biases estimated together cancel only together. spread_m, corrected_spread_m: rms
    by which positions differ when one link is left out, without and with biases; zero where that cannot be tried.
    """

    bias_m: Float
    std_m: Float
    significant: np.ndarray
    n: Int
    spread_m: float
    corrected_spread_m: float

    @property
    def applied_m(self) -> Float:
        """(A,) what to subtract from the ranges: the biases of the links that are corrected, zero elsewhere."""
        return np.where(self.significant, self.bias_m, 0.0)

    @property
    def reason(self) -> str:
        """Why the biases are applied, or why not."""
        if self.spread_m == 0:
            return "too few links to try positions without one of them"
        return (
            f"positions without one link differ by {self.corrected_spread_m:.3f} m with biases, {self.spread_m:.3f} m "
            f"without: {1 - self.corrected_spread_m / self.spread_m:.0%} less, {SHRINK_NEEDED:.0%} is needed"
        )


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a whole log shows of the ranges of a tag: biases, and how far positions may be off.

    usual_m: (A,) what a link's ranges are usually off by once the applied biases are subtracted; lateness is judged
    about it. shared_m: the part of that which all links have in common, zero where biases are applied; a smoother has
    it as a state beside the place. spread: of smoothed positions.
    """

    bias: AnchorBias
    usual_m: Float
    shared_m: float
    spread: PositionSpread


def calibrate_links(
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
    tag_height_std_m: float = 0.0,
    apply: bool = True,
) -> Calibration:
    """Biases of one tag's links to anchors_m (A, 3), without any truth, from N ranges in time order.

    The arguments are those of `track_ranges`; every range counts at its own time, so motion within a round of single
    ranges is none of the bias. In turn: the track is smoothed with the biases of before, its residuals weigh the
    ranges, and a filter over place, velocity and all biases gives the next ones. Ranges are thinned (`thin_links`), and
    count for as little as their errors last (`_persistence`), so a short log keeps biases near the prior. With
    tag_height_std_m above zero the height is tracked as well. apply=False: no bias is applied, whatever the spread is.
    """
    n_links = len(anchors_m)
    kept = thin_links(t_ns, anchor, min(MOST_SLOTS, MOST_STEPS // (n_links * (5 + n_links)) ** 2))
    log = log_ranges(
        t_ns[kept],
        anchor[kept],
        range_m[kept],
        anchors_m,
        fix_t_ns,
        fix_m,
        range_std_m,
        walker(acceleration_std_mps2, tag_height_m, tag_height_std_m),
    )
    pieces = [_Piece(log, each) for each in follow(log, causal=False)]
    fit = _fit_jointly(log, pieces, n_links)
    return _judge(log, pieces, fit, np.bincount(anchor, minlength=n_links), anchors_m, apply)


class _Piece:
    """A stretch of a log, with what does not change between passes over it."""

    def __init__(self, log: RangeLog, stretch: Stretch) -> None:
        self.stretch = stretch
        self.rows = log.rows(stretch.begin, stretch.end)
        self.first_row = log.first_row[stretch.begin : stretch.end + 1] - self.rows.start
        self.instant = np.repeat(np.arange(stretch.end - stretch.begin), np.diff(self.first_row))
        self.link = log.anchor[self.rows]
        self.anchor_m = log.anchor_m[self.rows]
        self.t_s = log.seconds(stretch.begin, stretch.end)
        self.windows: LinkWindows = windows_of(log, stretch)

    def directions(self, states: Float) -> tuple[Float, Float, Float]:
        """Places (N, 3) of the rows, unit vectors (N, 3) from their anchors and distances (N,)."""
        place_m = states[self.instant, :3]
        offset_m = place_m - self.anchor_m
        distance_m = np.sqrt(np.einsum("ni,ni->n", offset_m, offset_m))
        return place_m, offset_m / np.maximum(distance_m, 1e-9)[:, None], distance_m


@dataclass(frozen=True, slots=True)
class _Fit:
    """Biases (A,), their covariance (A, A), and of every piece: states (T, 5) with the biases subtracted, weights (N,)
    that judge lateness, and the variances (N,) that ranges have where biases are estimated.
    """

    bias_m: Float
    covariance_m2: Float
    states: list[Float]
    weights: list[Float]
    variances: list[Float]


def _fit_jointly(log: RangeLog, pieces: list[_Piece], n_links: int) -> _Fit:
    """Biases and track in turn, from a track of plain least squares on."""
    bias_m: Float = np.zeros(n_links)
    covariance_m2 = _prior(n_links)
    weights: list[Float] = [np.ones(len(piece.link)) for piece in pieces]
    variances: list[Float] = [np.full(len(piece.link), log.range_std_m**2) for piece in pieces]
    states = [_smooth(log, piece, weight) for piece, weight in zip(pieces, weights, strict=True)]
    for _ in range(ROUNDS if pieces else 0):
        before_m = bias_m
        bias_m, covariance_m2 = _fit_biases(log, pieces, states, variances, n_links)
        unbiased = log.without(bias_m)
        states = [_smooth(unbiased, piece, weight) for piece, weight in zip(pieces, weights, strict=True)]
        weights, variances = _weigh(unbiased, pieces, states, n_links)
        if np.abs(bias_m - before_m).max() < SETTLED_M:
            break
    unbiased = log.without(bias_m)
    states = [_smooth(unbiased, piece, weight) for piece, weight in zip(pieces, weights, strict=True)]
    return _Fit(bias_m, covariance_m2, states, weights, variances)


def _prior(n_links: int) -> Float:
    covariance_m2: Float = COMMON_STD_M**2 + LINK_STD_M**2 * np.eye(n_links)
    return covariance_m2


def _shared_bias(bias_m: Float) -> float:
    """What the biases (A,) of all links have in common, by the prior."""
    share = np.linalg.solve(_prior(len(bias_m)), np.full(len(bias_m), COMMON_STD_M**2))
    return float(share @ bias_m)


def _smooth(log: RangeLog, piece: _Piece, weight: Float) -> Float:
    """(T, 5) states of a piece with these weights."""
    return refilter(log, piece.stretch, weight).states


def _weigh(log: RangeLog, pieces: list[_Piece], states: list[Float], n_links: int) -> tuple[list[Float], list[Float]]:
    """Weights that judge lateness, and variances for estimating biases: those are alike on both sides, since trimming
    one side only would shift a bias.
    """
    residuals = _residuals(log, pieces, states)
    weights = [
        weigh_lateness(piece.windows, residual_m, log.range_std_m)
        for piece, residual_m in zip(pieces, residuals, strict=True)
    ]
    both_sided = []
    for piece, residual_m in zip(pieces, residuals, strict=True):
        off_m = residual_m - _link_medians(piece.link, residual_m, n_links)[piece.link]
        both_sided.append(redescending_weights(off_m, log.range_std_m))
    lasts = _persistence(log, pieces, residuals, both_sided)
    return weights, [lasts / np.maximum(each, 1e-9) for each in both_sided]


def _link_medians(link: Int, residual_m: Float, n_links: int) -> Float:
    """(A,) median residual of each link, zero where it has none."""
    ordered = np.append(residual_m[np.lexsort((residual_m, link))], 0.0)
    n = np.bincount(link, minlength=n_links)
    first = np.cumsum(n) - n
    middle: Float = (ordered[first + (n - 1).clip(0) // 2] + ordered[first + n // 2 * (n > 0)]) / 2
    return np.where(n > 0, middle, 0.0)


def _residuals(log: RangeLog, pieces: list[_Piece], states: list[Float]) -> list[Float]:
    """What the ranges (N,) of each piece are longer by than its states say."""
    return [log.range_m[piece.rows] - piece.directions(each)[2] for piece, each in zip(pieces, states, strict=True)]


def _persistence(log: RangeLog, pieces: list[_Piece], residuals: list[Float], information: list[Float]) -> float:
    """By how much the variance of a link's summed residuals exceeds that of white noise, at least 1.

    information (N,) in 1/m^2. The largest over blocks of BLOCKS_S counts; of m links the place absorbs two.
    """
    link = np.concatenate([piece.link for piece in pieces])
    heard = len(np.unique(link))
    t_s = np.concatenate([log.instant_ns[p.stretch.begin : p.stretch.end][p.instant] for p in pieces])
    t_s = (t_s - log.instant_ns[0]) * 1e-9
    told, pull = np.concatenate(information), np.concatenate(residuals) * np.concatenate(information)
    lasts = 1.0
    for block_s in BLOCKS_S:
        block = (t_s / block_s).astype(np.int64)
        if block[-1] + 1 < FEWEST_BLOCKS:
            break
        cell = block * (int(link.max()) + 1) + link
        scores = np.bincount(cell, pull)
        lasts = max(lasts, float((scores**2).sum() / told.sum()) * heard / max(heard - 2, 1))
    return lasts


def _fit_biases(
    log: RangeLog, pieces: list[_Piece], states: list[Float], variances: list[Float], n_links: int
) -> tuple[Float, Float]:
    """Biases (A,) and their covariance (A, A), place and velocity being free, linearised at the states."""
    state, covariance, lever = np.zeros(5 + n_links), np.zeros((5 + n_links, 5 + n_links)), np.empty(5 + n_links)
    covariance[5:, 5:] = _prior(n_links)
    for piece, each, variance_m2 in zip(pieces, states, variances, strict=True):
        stretch = piece.stretch
        place_m, unit, distance_m = piece.directions(each)
        if log.axes == 2:
            unit[:, 2] = 0.0
        state[:5], covariance[:5], covariance[:, :5] = stretch.start, 0.0, 0.0
        covariance[[0, 1, 3, 4], [0, 1, 3, 4]] = np.square(START_STD)
        covariance[2, 2] = log.motion.height_std_m**2
        filter_biases(
            piece.t_s,
            piece.first_row,
            piece.link,
            unit,
            log.range_m[piece.rows] - distance_m + np.einsum("ni,ni->n", unit, place_m),
            variance_m2,
            log.motion,
            state,
            covariance,
            lever,
        )
    return state[5:].copy(), covariance[5:, 5:].copy()


@dataclass(frozen=True, slots=True)
class _Deleted:
    """Without one link: the biases (A,), and places (T, 2) of all pieces with them, with what they share, with none."""

    bias_m: Float
    corrected_m: Float
    shared_m: Float
    plain_m: Float


def _delete_links(log: RangeLog, pieces: list[_Piece], fit: _Fit, links: Int) -> Iterator[_Deleted]:
    """For each of the links: biases and weights estimated again without it, and the track smoothed with them."""
    n_links = len(fit.bias_m)
    for link in links:
        gone = [piece.link == link for piece in pieces]
        states, weights, variances = fit.states, fit.weights, fit.variances
        for again in (True, False):
            weights = [np.where(left, 0.0, each) for left, each in zip(gone, weights, strict=True)]
            variances = [np.where(left, np.inf, each) for left, each in zip(gone, variances, strict=True)]
            bias_m, _ = _fit_biases(log, pieces, states, variances, n_links)
            unbiased = log.without(bias_m)
            states = [_smooth(unbiased, piece, weight) for piece, weight in zip(pieces, weights, strict=True)]
            if again:
                weights, variances = _weigh(unbiased, pieces, states, n_links)
        late = _residuals(unbiased, pieces, states)
        shared, plain = (
            [
                refilter_usual(
                    log.without(np.full(n_links, off_m)), replace(piece.stretch, weight=weight), late_m
                ).states
                for piece, weight, late_m in zip(pieces, weights, late, strict=True)
            ]
            for off_m in (_shared_bias(bias_m), 0.0)
        )
        yield _Deleted(bias_m, *(np.concatenate(each)[:, :2] for each in (states, shared, plain)))


def _judge(log: RangeLog, pieces: list[_Piece], fit: _Fit, n: Int, anchors_m: Float, apply: bool) -> Calibration:
    """Whether the biases are applied, and how far positions may be off then."""
    busy = np.flatnonzero(n > RARE_SHARE * n.max(initial=0))
    variance_m2, none = np.diag(fit.covariance_m2), np.zeros(len(n), dtype=bool)
    if not pieces or len(busy) < 3:
        unknown = AnchorBias(fit.bias_m, np.sqrt(variance_m2), none, n, 0.0, 0.0)
        return Calibration(unknown, np.zeros(len(n)), 0.0, PositionSpread())
    deleted = list(_delete_links(log, pieces, fit, busy))
    corrected_m2, shared_m2, plain_m2 = (
        _spread([getattr(each, name) for each in deleted]) for name in ("corrected_m", "shared_m", "plain_m")
    )
    known = np.array([np.arange(len(n)) != left for left in busy])
    scatter_m2 = _jackknife(np.where(known, [each.bias_m for each in deleted], np.nan))
    helps = corrected_m2 <= (1 - SHRINK_NEEDED) ** 2 * plain_m2
    applied = (n > 0) if apply and helps else none
    std_m = np.sqrt(variance_m2 + scatter_m2)
    bias = AnchorBias(fit.bias_m, std_m, applied, n, float(np.sqrt(plain_m2)), float(np.sqrt(corrected_m2)))
    # By m/(m - 1) / (1 - h) the spread overstates the variance, as each of m links has a share h = 2/m in the place.
    share = (len(busy) - 2) / (len(busy) - 1)
    left_m = np.zeros(len(n)) if applied.any() else fit.bias_m - _shared_bias(fit.bias_m)
    bias_m2 = fit.covariance_m2 + np.outer(left_m, left_m)
    lasting_m2 = share * (corrected_m2 if applied.any() else shared_m2) + _bias_variance(fit, bias_m2, anchors_m, n > 0)
    spread = PositionSpread(_model_variance(log.without(fit.bias_m), pieces, fit.weights), lasting_m2)
    return Calibration(bias, fit.bias_m - bias.applied_m, 0.0 if applied.any() else _shared_bias(fit.bias_m), spread)


def _spread(places_m: list[Float]) -> float:
    """Trace of the jackknife's covariance (m - 1)/m sum (p - mean)(p - mean)^T of m tracks (T, 2), log's mean."""
    return float(_jackknife(np.array(places_m)).sum(axis=1).mean())


def _jackknife(values: Float) -> Float:
    """Delete-one variance (m - 1)/m sum (v - mean)^2 along the first of the axes of (m, ...), without its NaN."""
    count = np.isfinite(values).sum(axis=0)
    off = values - np.nanmean(values, axis=0)
    variance: Float = np.nansum(off**2, axis=0) * (count - 1) / np.maximum(count, 1)
    return variance


def _model_variance(log: RangeLog, pieces: list[_Piece], weights: list[Float]) -> float:
    """Trace of the place's covariance as the smoother has it, mean over the log."""
    traces = []
    for piece, weight in zip(pieces, weights, strict=True):
        filtered = refilter(log, piece.stretch, weight).filtered
        covariances = smooth_covariances(piece.t_s, filtered, log.motion)
        traces.append(covariances[:, 0, 0] + covariances[:, 1, 1])
    return float(np.concatenate(traces).mean())


def _bias_variance(fit: _Fit, bias_m2: Float, anchors_m: Float, heard: np.ndarray) -> float:
    """Trace of what biases with second moments P (A, A) do to places, mean over the log: G P G^T with
    G = (sum u u^T)^-1 U^T.
    """
    place_m = np.concatenate(fit.states)[:, :3]
    offset_m = place_m[:, None] - anchors_m[heard]
    unit = (offset_m / np.maximum(np.linalg.norm(offset_m, axis=2), 1e-9)[:, :, None])[:, :, :2]
    normal = np.einsum("tai,taj->tij", unit, unit) + 1e-6 * np.eye(2)
    reply = np.linalg.solve(normal, unit.transpose(0, 2, 1))
    return float(np.einsum("tia,ab,tib->t", reply, bias_m2[np.ix_(heard, heard)], reply).mean())
