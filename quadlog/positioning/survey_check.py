"""Whether the anchors stand where the configuration has them, from the ranges of a log alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.positioning.anchor_order import (
    CLEARLY_BETTER,
    MIN_RANGES,
    Exchanges,
    TagEpochs,
    find_exchanges,
    layout_misfit,
)
from quadlog.positioning.anchor_shifts import MIN_EPOCHS, AnchorShift, fit_anchor_shift

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
class ShiftedAnchor:
    """An anchor, by its index, that does not stand at its configured place.

    place_m: (2,) where it seems to stand in map; shift_m: (2,) that minus the configured place.
    covariance_m2: (2, 2) of both.
    """

    anchor: int
    place_m: Float
    shift_m: Float
    covariance_m2: Float

    @property
    def distance_m(self) -> float:
        """How far it is from its configured place."""
        return float(np.hypot(*self.shift_m))

    @property
    def distance_std_m(self) -> float:
        """Standard deviation of that, along the displacement."""
        along = self.shift_m / self.distance_m
        return float(np.sqrt(along @ self.covariance_m2 @ along))


@dataclass(frozen=True, slots=True)
class SurveyCheck:
    """What a log says about the survey of A anchors; anchors are indices into what was checked.

    swapped: pairs whose ids or places were exchanged. turned: steps k, where what is named anchor i stands at
    the place of anchor i + k, around the list. shifted: anchors at another place. At most one thing is wrong
    in all this: several entries are alternatives the ranges cannot tell apart, the likeliest first of its kind.
    detectable_m: (A,) from what displacement on, in its worst direction, each anchor would have been reported;
    infinite where it could not be checked. checked: displacements were looked for; reason: why not, else empty.
    """

    swapped: tuple[tuple[int, int], ...]
    turned: tuple[int, ...]
    shifted: tuple[ShiftedAnchor, ...]
    detectable_m: Float
    checked: bool
    reason: str

    @property
    def consistent(self) -> bool:
        """Whether nothing speaks against the survey."""
        return not (self.swapped or self.turned or self.shifted)


def check_survey(
    logs: Sequence[TagEpochs], anchors_m: Float, range_std_m: float, acceleration_std_mps2: float
) -> SurveyCheck:
    """Test anchors (A, 3) for an exchange of two, a renumbering of all, and one at a wrong place.

    Ranges alone cannot tell a survey that is moved, turned or mirrored as a
    whole, an exchange that a symmetric layout hides, a displacement from a bias
    of half its size where the tag saw the anchor from one side only, or heights.
    Three anchors contradict each other too rarely to be checked; four show that
    something is wrong by half a metre, but accuse the right one only four times
    in five. One fault is looked for at a time: set it right, and check again.
    """
    reason = _why_unchecked(logs, anchors_m)
    nowhere: Float = np.full(len(anchors_m), np.inf)
    if reason:
        return SurveyCheck((), (), (), nowhere, False, reason)
    exchanges = find_exchanges(logs, anchors_m, range_std_m)
    span_s = max(float(np.ptp(log.epochs.t_ns)) * 1e-9 for log in logs if len(log.epochs))
    if span_s < MIN_LOG_S and not (exchanges.swapped or exchanges.turned):
        return SurveyCheck((), (), (), nowhere, False, f"{span_s:.0f} s of ranges, {MIN_LOG_S:.0f} s are needed")
    shifts = {}
    for anchor in range(len(anchors_m)):
        fits = [fit_anchor_shift(log, anchors_m, anchor, range_std_m, acceleration_std_mps2) for log in logs]
        found = [fit for fit in fits if fit is not None]
        if found:
            shifts[anchor] = _combine(found)
    if _exchange_explains(exchanges, shifts, logs, anchors_m, range_std_m):
        return SurveyCheck(exchanges.swapped, exchanges.turned, (), nowhere, False, "exchanged anchors come first")

    if not shifts:
        return SurveyCheck((), (), (), nowhere, False, "the tags stood still")
    longest_s = max(shift.lasted_s for shift in shifts.values())
    if longest_s < MIN_LOG_S:
        return SurveyCheck((), (), (), nowhere, False, f"{longest_s:.0f} s of ranges, {MIN_LOG_S:.0f} s are needed")
    placed = {anchor: shift for anchor, shift in shifts.items() if shift.widest_std_m <= PLACED_STD_M}
    if not placed:
        return SurveyCheck((), (), (), nowhere, False, "the tags saw no anchor from enough sides")
    detectable_m = nowhere.copy()
    detectable_m[list(placed)] = [max(MATTERS_M, SIGNIFICANT_STD * shift.widest_std_m) for shift in placed.values()]
    return SurveyCheck((), (), _name_shifted(placed, anchors_m), detectable_m, True, "")


def _why_unchecked(logs: Sequence[TagEpochs], anchors_m: Float) -> str:
    heard = sum(np.isfinite(log.epochs.range_m).any(axis=0).astype(int) for log in logs)
    n_heard = int(np.count_nonzero(heard)) if len(logs) else 0
    if n_heard < MIN_RANGES:
        return f"{n_heard} of {len(anchors_m)} anchors were heard, {MIN_RANGES} are needed"
    full = max(int((np.isfinite(log.epochs.range_m).sum(axis=1) >= MIN_RANGES).sum()) for log in logs)
    if full < MIN_EPOCHS:
        return f"{full} epochs have {MIN_RANGES} ranges, {MIN_EPOCHS} are needed"
    return ""


def _combine(shifts: list[AnchorShift]) -> AnchorShift:
    """What several tags say of one anchor: the weighted mean, no surer than one of them, as they share the place."""
    information = [np.linalg.inv(shift.covariance_m2) for shift in shifts]
    total = np.sum(information, axis=0)
    mean_m = np.linalg.solve(total, np.sum([i @ s.shift_m for i, s in zip(information, shifts, strict=True)], axis=0))
    return AnchorShift(mean_m, np.linalg.inv(total / len(shifts)), max(shift.lasted_s for shift in shifts))


def _exchange_explains(
    exchanges: Exchanges,
    shifts: dict[int, AnchorShift],
    logs: Sequence[TagEpochs],
    anchors_m: Float,
    range_std_m: float,
) -> bool:
    """Whether there is an exchange, and no single displaced anchor, free to go anywhere, fits clearly better."""
    if not (exchanges.swapped or exchanges.turned):
        return False
    for anchor, shift in shifts.items():
        placed_m = anchors_m.copy()
        placed_m[anchor, :2] += shift.shift_m
        if layout_misfit(logs, placed_m, range_std_m) < CLEARLY_BETTER * exchanges.misfit:
            return False
    return True


def _name_shifted(shifts: dict[int, AnchorShift], anchors_m: Float) -> tuple[ShiftedAnchor, ...]:
    """The most significant, if it also matters, and those that are nearly as likely."""
    by_significance = sorted(shifts.items(), key=lambda item: -item[1].significance)
    named: list[ShiftedAnchor] = []
    for anchor, shift in by_significance:
        enough = max(SIGNIFICANT_STD, AS_LIKELY * by_significance[0][1].significance)
        if shift.significance <= enough or np.hypot(*shift.shift_m) <= MATTERS_M:
            break
        place_m = anchors_m[anchor, :2] + shift.shift_m
        named.append(ShiftedAnchor(anchor, place_m, shift.shift_m, shift.covariance_m2))
    return tuple(named)
