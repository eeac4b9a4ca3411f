"""Known anchors that are exchanged or displaced: their places against those that a log itself gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int
from quadlog.positioning.anchors.frame import KNOWN_STD_M, gauge
from quadlog.positioning.batch.factors import TagRanges
from quadlog.positioning.batch.solve import solve
from quadlog.positioning.batch.tracking import Body, Starts, TrackSettings, track_body
from quadlog.positioning.epochs import Epochs, thin_rows
from quadlog.positioning.fixes import Fixes, solve_fixes

SIGNIFICANT_STD, MATTERS_M = 3.2, 0.6
"""A fault must explain more than this, and a displacement must be longer: delays of blocked paths that last look like
one of up to 0.57 m, on walks of 40 s of seeds 800 to 803."""
RIVAL_CHI2 = 6.0
"""Faults whose misfits differ by less are alternatives: the likelihoods' ratio is below 20."""
EXPLAINED_CHI2, UNFIT_CHI2 = 5.0, 20.0
"""Misfit for each degree of freedom up to which a single fault explains the places, and from which on the given ones do
not fit: delays that are constant for each anchor came to 14, with an anchor a metre off to 24 (the same walks)."""


@dataclass(frozen=True, slots=True)
class AnchorShift:
    """Where an anchor, by its index, stands minus where it is configured: shift_m (2,) in map, with its covariance."""

    anchor: int
    shift_m: Float
    covariance_m2: Float

    @property
    def distance_m(self) -> float:
        """The length of shift_m."""
        return float(np.hypot(*self.shift_m))

    @property
    def distance_std_m(self) -> float:
        """Standard deviation of that, along the displacement."""
        along = self.shift_m / self.distance_m
        return float(np.sqrt(along @ self.covariance_m2 @ along))


@dataclass(frozen=True, slots=True)
class SurveyFaults:
    """What a log says against the survey of A anchors; anchors are indices into what was checked.

    swapped: pairs i < j whose ids or places were exchanged. shifted: anchors at another place. At most one thing is
    wrong: several entries are alternatives the ranges cannot distinguish, the likeliest first of its kind. unfit: where
    no single fault explains the ranges, the anchors whose places fit them worst.
    """

    swapped: tuple[tuple[int, int], ...] = ()
    shifted: tuple[AnchorShift, ...] = ()
    unfit: tuple[int, ...] = ()


def find_faults(anchors_m: Float, covariance: Float, known_m: Float, numbers: Int) -> SurveyFaults | None:
    """Two known anchors (A, 2) that are exchanged, or one elsewhere, by generalised least squares of all places.

    anchors_m (A, 3) with their covariance (3A, 3A) and more, in about the frame of known_m, with which each fault is
    fitted; named by numbers (A,). None where no single fault explains places not far off, and of fewer than three.
    """
    known = np.flatnonzero(np.isfinite(known_m[:, 0]))
    if len(known) < 3:
        return None
    rows = (3 * known[:, None] + np.arange(2)).ravel()
    covariance_m2 = covariance[np.ix_(rows, rows)] + KNOWN_STD_M**2 / 2 * np.eye(len(rows))
    whiten, frame = np.linalg.inv(np.linalg.cholesky(covariance_m2)), gauge(anchors_m, len(covariance))[rows]

    def fit(places_m: Float, free: Float) -> tuple[float, Float, Float]:
        """The misfit with columns (2A, K) free, their values (K,) and covariance (K, K)."""
        design, off = whiten @ np.hstack([frame, free]), whiten @ (anchors_m[known, :2] - places_m).ravel()
        inverse = np.linalg.pinv(design.T @ design)
        value = inverse @ design.T @ off
        return float(np.sum((off - design @ value) ** 2)), value[3:], inverse[3:, 3:]

    places_m, alone, fixed = known_m[known], np.eye(len(rows)), np.empty((len(rows), 0))
    as_given, _, _ = fit(places_m, fixed)
    pairs = list(combinations(range(len(known)), 2))
    swaps = {pair: fit(places_m[_exchanged(len(known), *pair)], fixed)[0] for pair in pairs}
    shifts = {k: fit(places_m, alone[:, 2 * k : 2 * k + 2]) for k in range(len(known))}
    best = min([*swaps.values(), *(misfit for misfit, _, _ in shifts.values())])
    if as_given - best <= SIGNIFICANT_STD**2:
        return SurveyFaults()
    named, ranked = numbers[known].tolist(), sorted(shifts, key=lambda k: shifts[k][0])
    if best > EXPLAINED_CHI2 * (len(rows) - 3):
        far = as_given > UNFIT_CHI2 * (len(rows) - 3)
        return SurveyFaults(unfit=tuple(named[k] for k in ranked[:2])) if far else None
    swapped = sorted((pair for pair in swaps if swaps[pair] < best + RIVAL_CHI2), key=lambda pair: swaps[pair])
    shifted = [AnchorShift(named[k], *shifts[k][1:]) for k in ranked if shifts[k][0] < best + RIVAL_CHI2]
    shifted = [each for each in shifted if each.distance_m > MATTERS_M]
    return SurveyFaults(tuple((named[i], named[j]) for i, j in swapped), tuple(shifted))


def _exchanged(n: int, i: int, j: int) -> Int:
    """(n,) indices in order, but for two."""
    order = np.arange(n)
    order[[i, j]] = j, i
    return order


MIN_RANGES, MIN_EPOCHS, MAX_EPOCHS = 4, 40, 300
"""Ranges of an epoch, three of which agree with almost any anchors; and epochs of a tag."""
MIN_LOG_S, MIN_WALK_M = 25.0, 0.5
"""In a shorter walk a displacement looks like errors that last. A tag whose places scatter less stood still."""
LARGEST_BIAS_M = 0.4
"""What a link may be off by on average before its anchor is in doubt."""
COST_STD, NO_FIX_STD = 2.0, 20.0
"""Residuals, in std, from where on a misfit counts by its order of magnitude; and of a range that leads to no fix."""
CLEARLY_BETTER = 0.7
"""One layout is better than another if its misfit is below this share. Chosen on seeds 7000 on of simulated logs, 4 to
8 anchors: the best wrong order came to 0.9 and more, the true one to 0.66 and less unless a symmetry hid it."""
FREE_STD_M, ROUNDS = 5.0, 8
"""Prior of a displacement; and of the batch in which all anchors are free."""


@dataclass(frozen=True, slots=True)
class TagEpochs:
    """The epochs of one tag, and its height in map."""

    epochs: Epochs
    height_m: float

    def fixes(self, anchors_m: Float, range_std_m: float) -> Fixes:
        """Of all epochs."""
        return solve_fixes("gauss_newton", anchors_m, self.epochs.range_m, self.height_m, range_std_m, np.inf)

    def thinned(self) -> TagEpochs:
        """Those with MIN_RANGES, at most MAX_EPOCHS of them."""
        t_ns, last_ns, range_m = self.epochs.t_ns, self.epochs.last_ns, self.epochs.range_m
        rows = thin_rows(np.isfinite(range_m).sum(axis=1) >= MIN_RANGES, MAX_EPOCHS)
        return TagEpochs(Epochs(t_ns[rows], last_ns[rows], range_m[rows]), self.height_m)


def check_survey(
    logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float, acceleration_std_mps2: float
) -> SurveyFaults:
    """Test anchors (A, 3) for an exchange of two, and one at a wrong place, by ranges alone; one fault at a time.

    These cannot show a survey that is moved, turned or mirrored as a whole, an exchange that a symmetric layout hides,
    a displacement from a bias of half its size where the tag saw the anchor from one side only, or heights. Three
    anchors contradict each other too rarely; four accuse the right one of half a metre only four times in five.
    """
    logs = [each for log in logs if len((each := log.thinned()).epochs) >= MIN_EPOCHS]
    if not logs:
        return SurveyFaults()
    exchanges = _find_exchanges(logs, anchors_m, range_std_m)
    if exchanges:
        return SurveyFaults(exchanges)
    most = max(logs, key=lambda log: float(np.isfinite(log.epochs.range_m).sum()))
    placed = _placed(most, anchors_m, range_std_m, acceleration_std_mps2)
    if placed is None:
        return SurveyFaults()
    heard = np.isfinite(most.epochs.range_m).sum(axis=0) >= MIN_EPOCHS
    known_m = np.where(heard[:, None], anchors_m[:, :2], np.nan)
    return find_faults(*placed, known_m, np.arange(len(anchors_m))) or SurveyFaults()


def _find_exchanges(logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float) -> tuple[tuple[int, int], ...]:
    """Swapped pairs that explain logs better than anchors (A, 3) as configured, the likeliest first."""
    heard = np.flatnonzero(sum(np.isfinite(log.epochs.range_m).any(axis=0) for log in logs))
    pairs = list(combinations(heard.tolist(), 2))
    layouts = [anchors_m, *(anchors_m[_exchanged(len(anchors_m), *pair)] for pair in pairs)]
    misfits = np.array([_misfit(logs, each, range_std_m) for each in layouts])
    best = float(misfits.min())
    ranked = np.argsort(misfits, kind="stable").tolist() if best < CLEARLY_BETTER * misfits[0] else []
    return tuple(pairs[i - 1] for i in ranked if CLEARLY_BETTER * misfits[i] <= best)


def _misfit(logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float) -> float:
    """Mean log(1 + (r / 2 std)^2) of what fixes of single epochs leave, each link's usual residual taken away."""
    costs = []
    for log in logs:
        fixes = log.fixes(anchors_m, range_std_m)
        known = np.where(np.isfinite(fixes.residual_m).any(axis=0), fixes.residual_m, 0.0)
        bias_m = np.nanmedian(known, axis=0).clip(-LARGEST_BIAS_M, LARGEST_BIAS_M)
        off_std = np.where(fixes.solved[:, None], (fixes.residual_m - bias_m) / range_std_m, NO_FIX_STD)
        costs.append(np.log1p((off_std / COST_STD) ** 2)[np.isfinite(log.epochs.range_m + off_std)])
    return float(np.concatenate(costs).mean())


def _placed(
    log: TagEpochs, anchors_m: Float, range_std_m: float, acceleration_std_mps2: float
) -> tuple[Float, Float] | None:
    """Anchors (A, 3), solved for with track and biases, their covariance (3A, 3A); None if short, or it stood still."""
    range_m, fixes = log.epochs.range_m, log.fixes(anchors_m, range_std_m)
    t_s = seconds_since(log.epochs.t_ns, int(log.epochs.t_ns[0]))
    if t_s[-1] < MIN_LOG_S or not fixes.solved.any():
        return None
    at, anchor = np.nonzero(np.isfinite(range_m))
    own, tag, n = np.array([log.height_m]), np.zeros_like(anchor), len(anchors_m)
    ranges = TagRanges(t_s[at], tag, anchor, range_m[at, anchor], np.zeros((1, 2)), own, n)
    settings = TrackSettings(range_std_m, acceleration_std_mps2, 0.0, calibrate=True)
    starts = Starts(t_s[fixes.solved], fixes.position_m[fixes.solved, :2])
    tracked = track_body(Body(ranges, anchors_m, settings, np.empty(0), scaled=False), starts)
    if np.sqrt(tracked.poses(t_s)[0].var(axis=0).sum()) < MIN_WALK_M:
        return None
    estimate, problem, m = tracked.last, tracked.last.problem, len(tracked.last.values)
    level = np.diag(np.tile(np.square([FREE_STD_M, FREE_STD_M, 1e-3]), n))
    from scipy.linalg import block_diag  # slow to import

    priors = np.array([block_diag(prior, level) for prior in problem.priors])
    mean, values = (np.append(each, np.zeros(3 * n)) for each in (problem.mean, estimate.values))
    freed = replace(problem, model=replace(problem.model, free=m), mean=mean, priors=priors)
    solved = solve(freed, estimate.knots, values, estimate.weights, ROUNDS)
    placed_m = anchors_m + solved.values[m:].reshape(-1, 3)
    return placed_m, solved.covariance[m:, m:]
