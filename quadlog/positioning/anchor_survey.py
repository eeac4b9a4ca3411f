"""Anchors that are exchanged or displaced in the survey, found from the ranges of a log alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, takewhile

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float
from quadlog.positioning.epochs import Epochs, thin_rows
from quadlog.positioning.fix.trilateration import solve_gauss_newton
from quadlog.positioning.shared_errors import (
    SharedErrors,
    column_medians,
    redescending_weights,
    scatter_covariances,
    solve_shared_errors,
    track_epochs,
    wander_covariance,
    weigh_by_lateness,
)

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
    fixes = solve_gauss_newton(anchors_m, range_m, log.height_m, range_std_m, np.inf)
    bias_m = column_medians(fixes.residual_m).clip(-LARGEST_BIAS_M, LARGEST_BIAS_M)
    off_std = np.where(fixes.solved[:, None], (fixes.residual_m - bias_m) / range_std_m, NO_FIX_STD)
    cost = np.log1p((off_std / COST_STD) ** 2)
    return np.asarray(cost[np.isfinite(range_m) & np.isfinite(cost)])


MAX_SHIFT_EPOCHS = 400
MIN_EPOCHS = 40
MIN_WALK_M = 0.5
"""A tag whose places scatter less stood still: what it seems to see from several sides is noise."""
ROUNDS = 2
COMMON_BIAS_STD_M, LINK_BIAS_STD_M, SHIFT_STD_M = 0.2, 0.1, 5.0
"""Priors. Links of one make share most of their bias; without that, a shift towards the tag would pass for one."""
WANDER_STD_M, WANDER_S = 0.05, 10.0
"""What every link may be off by, and for how long at a time, as the reflections of a place have it."""
LATE_STD_M = 0.02
"""What late ranges may do to a place."""


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


def fit_anchor_shift(
    log: TagEpochs, anchors_m: Float, anchor: int, range_std_m: float, acceleration_std_mps2: float
) -> AnchorShift | None:
    """How far anchor, an index into anchors_m (A, 3), is off, judged by the track that the others give.

    That track gives the weights and the first guess; then the displacement is solved for together with the biases of
    all links and the fixes. None without MIN_EPOCHS epochs in which three others were heard with it, and for a tag
    that stood still.
    """
    heard = np.isfinite(log.epochs.range_m)
    rows = thin_rows(heard[:, anchor] & (heard.sum(axis=1) >= MIN_RANGES), MAX_SHIFT_EPOCHS)
    if len(rows) < MIN_EPOCHS:
        return None
    t_ns, range_m = log.epochs.t_ns[rows], log.epochs.range_m[rows]
    others = np.delete(np.arange(len(anchors_m)), anchor)
    prior = _prior(len(anchors_m))

    def track_without(bias_m: Float) -> tuple[Float, int]:
        unbiased = Epochs(t_ns, t_ns, (range_m - bias_m)[:, others])
        return track_epochs(unbiased, anchors_m[others], log.height_m, range_std_m, acceleration_std_mps2)

    def fit(place_m: Float, free_axes: int, shift_m: Float) -> tuple[SharedErrors, Float]:
        placed_m = _place(anchors_m, anchor, shift_m)
        residual_m = range_m - np.linalg.norm(place_m[:, None] - placed_m, axis=2)
        weight = weigh_by_lateness(residual_m, range_std_m)
        moving = np.array([anchor])
        return solve_shared_errors(anchors_m, moving, range_m, weight, place_m, free_axes, prior), weight

    place_m, free_axes = track_without(np.zeros(len(anchors_m)))
    if np.sqrt(place_m.var(axis=0).sum()) < MIN_WALK_M:
        return None
    shift_m = _place_anchor(place_m, anchors_m[anchor], range_m[:, anchor], range_std_m)
    errors, weight = fit(place_m, free_axes, shift_m)
    for _ in range(ROUNDS - 1):
        errors, weight = fit(*track_without(errors.bias_m), errors.shift_m[0])
    t_s = seconds_since(t_ns, int(t_ns[0]))
    return AnchorShift(anchor, errors.shift_m[0], _shift_covariance(errors, weight, t_s), float(t_s[-1]))


def _shift_covariance(errors: SharedErrors, weight: Float, t_s: Float) -> Float:
    """(2, 2) the widest there is reason for, what a place does to ranges included."""
    told_m2 = np.array([errors.covariance_m2, *scatter_covariances(errors, weight)])[:, -2:, -2:]
    widest_m2 = told_m2[np.trace(told_m2, axis1=1, axis2=2).argmax()]
    wander_m2 = wander_covariance(errors, t_s, WANDER_STD_M, WANDER_S)[-2:, -2:]
    return np.asarray(widest_m2 + wander_m2 + LATE_STD_M**2 * np.eye(2))


def _prior(n_links: int) -> Float:
    """(A + 2, A + 2) information in 1/m^2 about the biases and one displacement."""
    covariance_m2 = np.eye(n_links + 2) * SHIFT_STD_M**2
    covariance_m2[:n_links, :n_links] = LINK_BIAS_STD_M**2 * np.eye(n_links) + COMMON_BIAS_STD_M**2
    return np.asarray(np.linalg.inv(covariance_m2))


def _place_anchor(place_m: Float, anchor_m: Float, range_m: Float, range_std_m: float) -> Float:
    """(2,) displacement at which an anchor (3,) is at ranges (E,) from places (E, 3), but for one bias; robust."""
    value = np.zeros(3)
    prior = np.diag([SHIFT_STD_M**-2, SHIFT_STD_M**-2, COMMON_BIAS_STD_M**-2])
    for _ in range(15):
        offset_m = place_m - anchor_m - np.append(value[:2], 0.0)
        distance_m = np.maximum(np.linalg.norm(offset_m, axis=1), 1e-9)
        residual_m = range_m - distance_m - value[2]
        weight = redescending_weights(residual_m, range_std_m)
        effect = np.column_stack([-offset_m[:, :2] / distance_m[:, None], np.ones(len(range_m))])
        pull = effect.T @ (weight * residual_m) - prior @ value
        step_m = np.linalg.solve((effect.T * weight) @ effect + prior, pull)
        value = value + step_m
        if np.abs(step_m).max() < 1e-3:
            break
    return value[:2]


SIGNIFICANT_STD = 3.2
MATTERS_M = 0.3
"""A displacement is reported beyond both. Chosen on simulated walks of 30 to 120 s, seeds 8100 to 8119, of correctly
surveyed anchors with NLOS, biases and slowly varying errors: one of 300 logs raised a false alarm."""
MIN_LOG_S = 25.0
"""A shorter walk cannot tell a displacement from errors that last: up to a third of such logs raised false alarms."""
PLACED_STD_M = 0.25
"""An anchor whose place the log tells no better, in its worst direction, is not accused."""
AS_LIKELY = 0.8
"""Other anchors with this share of the significance are named as well. Same seeds."""


@dataclass(frozen=True, slots=True)
class SurveyFaults:
    """What a log says against the survey of A anchors; anchors are indices into what was checked.

    swapped: pairs i < j whose ids or places were exchanged. turned: steps k, where what is named anchor i stands at
    the place of anchor i + k, around the list. shifted: anchors at another place. At most one thing is wrong
    in all this: several entries are alternatives the ranges cannot tell apart, the likeliest first of its kind.
    """

    swapped: tuple[tuple[int, int], ...] = ()
    turned: tuple[int, ...] = ()
    shifted: tuple[AnchorShift, ...] = ()


def check_survey(
    logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float, acceleration_std_mps2: float
) -> SurveyFaults:
    """Test anchors (A, 3) for an exchange of two, a renumbering of all, and one at a wrong place.

    Ranges alone cannot tell a survey that is moved, turned or mirrored as a whole, an exchange that a symmetric layout
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
    shifts = []
    for anchor in range(len(anchors_m)):
        fits = [fit_anchor_shift(log, anchors_m, anchor, range_std_m, acceleration_std_mps2) for log in logs]
        found = [fit for fit in fits if fit is not None]
        if found:
            shifts.append(_combine(found))
    # A single displaced anchor, free to go anywhere, may explain more than the exchange does.
    if exchanged and not any(
        layout_misfit(logs, _place(anchors_m, shift.anchor, shift.shift_m), range_std_m) < CLEARLY_BETTER * misfit
        for shift in shifts
    ):
        return SurveyFaults(swapped, turned)
    if max((shift.lasted_s for shift in shifts), default=0.0) < MIN_LOG_S:
        return SurveyFaults()
    return SurveyFaults(shifted=_most_significant([shift for shift in shifts if shift.widest_std_m <= PLACED_STD_M]))


def _combine(shifts: list[AnchorShift]) -> AnchorShift:
    """What several tags say of one anchor: the weighted mean, no surer than one of them, as they share the place."""
    information = [np.linalg.inv(shift.covariance_m2) for shift in shifts]
    total = np.sum(information, axis=0)
    mean_m = np.linalg.solve(total, np.sum([i @ s.shift_m for i, s in zip(information, shifts, strict=True)], axis=0))
    lasted_s = max(shift.lasted_s for shift in shifts)
    return AnchorShift(shifts[0].anchor, mean_m, np.linalg.inv(total / len(shifts)), lasted_s)


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
