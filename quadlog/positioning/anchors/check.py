"""Anchors that are exchanged or displaced in the survey, found from the ranges of a log alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, takewhile

import numpy as np
from scipy.linalg import block_diag

from quadlog.geometry import seconds_since
from quadlog.messages import Float
from quadlog.positioning.anchors.walk import refine_place
from quadlog.positioning.batch.factors import Border, TagRanges
from quadlog.positioning.batch.solve import solve
from quadlog.positioning.batch.tracking import Body, Starts, Tracked, TrackSettings, track_body
from quadlog.positioning.epochs import Epochs, thin_rows
from quadlog.positioning.fixes import solve_fixes

MIN_RANGES = 4
"""Three ranges agree with almost any order of their anchors."""
MAX_EPOCHS = 200
"""Of each tag: tens of orders are tried, and an exchange is plain to see."""
LARGEST_BIAS_M = 0.4
"""What a link may be off by on average before its anchor is in doubt."""
COST_STD = 2.0
"""Residuals, in std, from where on a misfit counts by its order of magnitude only."""
NO_FIX_STD = 20.0
"""A range that leads to no fix counts as if it were so many std off."""
CLEARLY_BETTER = 0.7
"""One layout is better than another if its misfit is below this share. Chosen on seeds 7000 on of simulated logs, 4 to
8 anchors: the best wrong order came to 0.9 and more, the true one to 0.66 and less unless a symmetry hid it."""


@dataclass(frozen=True, slots=True)
class TagEpochs:
    """The epochs of one tag, and its height in map."""

    epochs: Epochs
    height_m: float


def find_exchanges(
    logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float
) -> tuple[tuple[tuple[int, int], ...], tuple[int, ...], float]:
    """Swapped pairs and turned steps, as in SurveyFaults, that explain logs better than anchors (A, 3) as configured.

    The third value is the misfit of the best of them, or of the configured order where there is none. Every pair and
    every step is tried on thinned epochs of four ranges or more. A symmetric layout hides exchanges: those that mirror
    or turn it onto itself fit as well as the truth, and neither is named.
    """
    index = np.arange(len(anchors_m))
    heard = np.flatnonzero(sum(np.isfinite(log.epochs.range_m).any(axis=0) for log in logs))
    pairs = [(int(i), int(j)) for i, j in combinations(heard, 2)]
    steps = [] if len(heard) < len(anchors_m) else list(range(1, len(anchors_m)))
    swaps = [np.where(index == i, j, np.where(index == j, i, index)) for i, j in pairs]
    orders = [index, *swaps, *((index + k) % len(index) for k in steps)]
    misfits = np.array([layout_misfit(logs, anchors_m[order], range_std_m) for order in orders])
    best = float(misfits.min())
    if best > CLEARLY_BETTER * misfits[0]:
        return (), (), float(misfits[0])
    as_good = [int(i) for i in np.argsort(misfits, kind="stable") if CLEARLY_BETTER * misfits[i] <= best]
    return (
        tuple(pairs[i - 1] for i in as_good if i <= len(pairs)),
        tuple(steps[i - 1 - len(pairs)] for i in as_good if i > len(pairs)),
        best,
    )


def layout_misfit(logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float) -> float:
    """Mean log(1 + (r / 2 std)^2) of what fixes of single epochs leave, each link's usual residual taken away.

    Some epoch must have four ranges.
    """
    return float(np.concatenate([_epoch_costs(log, anchors_m, range_std_m) for log in logs]).mean())


def _epoch_costs(log: TagEpochs, anchors_m: Float, range_std_m: float) -> Float:
    range_m = log.epochs.range_m[thin_rows(np.isfinite(log.epochs.range_m).sum(axis=1) >= MIN_RANGES, MAX_EPOCHS)]
    if len(range_m) == 0:
        return np.empty(0)
    fixes = solve_fixes("gauss_newton", anchors_m, range_m, log.height_m, range_std_m, np.inf)
    known = np.where(np.isfinite(fixes.residual_m).any(axis=0), fixes.residual_m, 0.0)
    bias_m = np.nanmedian(known, axis=0).clip(-LARGEST_BIAS_M, LARGEST_BIAS_M)
    off_std = np.where(fixes.solved[:, None], (fixes.residual_m - bias_m) / range_std_m, NO_FIX_STD)
    cost = np.log1p((off_std / COST_STD) ** 2)
    return np.asarray(cost[np.isfinite(range_m) & np.isfinite(cost)])


MAX_SHIFT_EPOCHS = 400
MIN_EPOCHS = 40
MIN_WALK_M = 0.5
"""A tag whose places scatter less stood still: what it seems to see from several sides is noise."""
SHIFT_STD_M, PLACE_STD_M = 5.0, 0.05
"""Priors of a displacement, and of what reflections that depend on the place make of one."""
SHIFT_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class AnchorShift:
    """Where an anchor, by its index, stands minus where it is configured.

    shift_m: (2,) in map, covariance_m2: (2, 2) of it; lasted_s: how long a tag heard it with enough others.
    """

    anchor: int
    shift_m: Float
    covariance_m2: Float
    lasted_s: float

    @property
    def significance(self) -> float:
        """The length of shift_m in standard deviations."""
        return float(np.sqrt(self.shift_m @ np.linalg.solve(self.covariance_m2, self.shift_m)))

    @property
    def widest_std_m(self) -> float:
        """Standard deviation in the direction that is known worst."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance_m2)[-1]))

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
class _CheckedTag:
    """A log thinned to E epochs, with how each anchor was heard then, and its track with the anchors as configured."""

    epochs: Epochs
    t_s: Float
    tracked: Tracked

    @property
    def place_m(self) -> Float:
        """(E, 3) at the epochs."""
        pose, _, _ = self.tracked.poses(self.t_s)
        return np.column_stack([pose, np.full(len(pose), self.tracked.body.ranges.height_m[0])])


def track_for_check(
    log: TagEpochs, anchors_m: Float, range_std_m: float, acceleration_std_mps2: float
) -> _CheckedTag | None:
    """The track of a tag by the epochs with MIN_RANGES; None without MIN_EPOCHS, and for a tag that stood still."""
    rows = thin_rows(np.isfinite(log.epochs.range_m).sum(axis=1) >= MIN_RANGES, MAX_SHIFT_EPOCHS)
    if len(rows) < MIN_EPOCHS:
        return None
    t_ns, range_m = log.epochs.t_ns[rows], log.epochs.range_m[rows]
    fixes = solve_fixes("gauss_newton", anchors_m, range_m, log.height_m, range_std_m, np.inf)
    at, anchor = np.nonzero(np.isfinite(range_m))
    t_s = seconds_since(t_ns, int(t_ns[0]))
    if not fixes.solved.any():
        return None
    own, tag = np.array([log.height_m]), np.zeros_like(anchor)
    ranges = TagRanges(t_s[at], tag, anchor, range_m[at, anchor], np.zeros((1, 2)), own, len(anchors_m))
    settings = TrackSettings(range_std_m, acceleration_std_mps2, 0.0, calibrate=True)
    starts = Starts(t_s[fixes.solved], fixes.position_m[fixes.solved, :2])
    tracked = track_body(Body(ranges, anchors_m, settings, np.empty(0)), starts)
    checked = _CheckedTag(Epochs(t_ns, t_ns, range_m), t_s, tracked)
    return checked if np.sqrt(checked.place_m.var(axis=0).sum()) >= MIN_WALK_M else None


def fit_anchor_shift(checked: _CheckedTag, anchor: int) -> AnchorShift | None:
    """How far an anchor, by its index, is off: its displacement is solved for together with the track and all biases.

    None without MIN_EPOCHS epochs in which three others were heard with it.
    """
    heard = np.isfinite(checked.epochs.range_m)
    with_it = heard[:, anchor] & (heard.sum(axis=1) >= MIN_RANGES)
    if np.count_nonzero(with_it) < MIN_EPOCHS:
        return None
    estimate = checked.tracked.last
    problem, n = estimate.problem, len(estimate.values)
    columns = np.where(np.arange(len(problem.model.anchors_m)) == anchor, n, -1)
    level = np.square([SHIFT_STD_M, SHIFT_STD_M, 1e-3])
    freed = replace(
        problem,
        model=replace(problem.model, border=Border(problem.model.border.n_links, n + 3, columns)),
        mean=np.append(problem.mean, np.zeros(3)),
        priors=np.array([block_diag(prior, np.diag(level)) for prior in problem.priors]),
    )
    range_m = checked.epochs.range_m[with_it, anchor]
    anchor_m = problem.model.anchors_m[anchor]
    guess, _ = refine_place(checked.place_m[with_it], range_m, anchor_m[:2], (float(anchor_m[2]), 1e-3))
    values = np.concatenate([estimate.values, guess[:2] - anchor_m[:2], [0.0]])
    solved = solve(freed, estimate.knots, values, estimate.weights.lasts, SHIFT_ROUNDS)
    covariance_m2 = solved.covariance[n : n + 2, n : n + 2] + PLACE_STD_M**2 * np.eye(2)
    return AnchorShift(anchor, solved.values[n : n + 2], covariance_m2, float(np.ptp(checked.t_s[with_it])))


SIGNIFICANT_STD = 3.2
MATTERS_M = 0.3
"""A displacement is reported beyond both. Chosen on simulated walks of 30 to 120 s, seeds 8100 to 8119, of correctly
surveyed anchors with NLOS, biases and slowly varying errors: one of 300 logs raised a false alarm."""
MIN_LOG_S = 25.0
"""In a shorter walk a displacement looks like errors that last: up to a third of such logs raised false alarms."""
PLACED_STD_M = 0.25
"""An anchor whose position is not known better, in its worst direction, is not accused."""
AS_LIKELY = 0.8
"""Other anchors with this share of the significance are named as well. Same seeds."""


@dataclass(frozen=True, slots=True)
class SurveyFaults:
    """What a log says against the survey of A anchors; anchors are indices into what was checked.

    swapped: pairs i < j whose ids or places were exchanged. turned: steps k, where what is named anchor i stands at
    the place of anchor i + k, around the list. shifted: anchors at another place. At most one thing is wrong
    in all this: several entries are alternatives the ranges cannot distinguish, the likeliest first of its kind.
    """

    swapped: tuple[tuple[int, int], ...] = ()
    turned: tuple[int, ...] = ()
    shifted: tuple[AnchorShift, ...] = ()


def check_survey(
    logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float, acceleration_std_mps2: float
) -> SurveyFaults:
    """Test anchors (A, 3) for an exchange of two, a renumbering of all, and one at a wrong place.

    Ranges alone cannot show a survey that is moved, turned or mirrored as a whole, an exchange that a symmetric layout
    hides, a displacement from a bias of half its size where the tag saw the anchor from one side only, or heights.
    Three anchors contradict each other too rarely to be checked; four show that something is wrong by half a metre,
    but accuse the right one only four times in five. One fault is looked for at a time: set it right, and check again.
    """
    full = [np.isfinite(log.epochs.range_m).sum(axis=1) >= MIN_RANGES for log in logs]
    if max((int(each.sum()) for each in full), default=0) < MIN_EPOCHS:
        return SurveyFaults()
    swapped, turned, misfit = find_exchanges(logs, anchors_m, range_std_m)
    exchanged = bool(swapped or turned)
    if not exchanged and max(np.ptp(log.epochs.t_ns) for log in logs if len(log.epochs)) * 1e-9 < MIN_LOG_S:
        return SurveyFaults()
    tracked = [track_for_check(log, anchors_m, range_std_m, acceleration_std_mps2) for log in logs]
    shifts = []
    for anchor in range(len(anchors_m)):
        fits = [fit_anchor_shift(each, anchor) for each in tracked if each is not None]
        found = [fit for fit in fits if fit is not None]
        if found:  # several tags share the place and its errors: the one that knows it best counts
            shifts.append(min(found, key=lambda fit: fit.widest_std_m))
    # A single displaced anchor, free to go anywhere, may explain more than the exchange does.
    if exchanged and not any(
        layout_misfit(logs, _place(anchors_m, shift.anchor, shift.shift_m), range_std_m) < CLEARLY_BETTER * misfit
        for shift in shifts
    ):
        return SurveyFaults(swapped, turned)
    if max((shift.lasted_s for shift in shifts), default=0.0) < MIN_LOG_S:
        return SurveyFaults()
    return SurveyFaults(shifted=_most_significant([shift for shift in shifts if shift.widest_std_m <= PLACED_STD_M]))


def _place(anchors_m: Float, anchor: int, shift_m: Float) -> Float:
    """Anchors (A, 3) with one of them displaced by (2,)."""
    placed_m = anchors_m.copy()
    placed_m[anchor, :2] += shift_m
    return placed_m


def _most_significant(shifts: list[AnchorShift]) -> tuple[AnchorShift, ...]:
    """The most significant, if it also matters, and those that are nearly as likely."""
    ranked = sorted(shifts, key=lambda shift: -shift.significance)
    enough = max([SIGNIFICANT_STD, *(AS_LIKELY * shift.significance for shift in ranked[:1])])
    return tuple(takewhile(lambda shift: shift.significance > enough and shift.distance_m > MATTERS_M, ranked))
