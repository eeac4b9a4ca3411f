"""An anchor that does not stand where it is configured: where the ranges of a log put it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import seconds_since
from quadlog.messages import Float
from quadlog.positioning.anchor_order import MIN_RANGES, TagEpochs, thin_rows
from quadlog.positioning.calibration import track_epochs
from quadlog.positioning.epochs import Epochs
from quadlog.positioning.shared_errors import (
    HALF_TRUST_STD,
    SharedErrors,
    scatter_covariances,
    solve_shared_errors,
    wander_covariance,
    weigh_by_lateness,
)

MAX_EPOCHS = 400
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
    """Where an anchor stands minus where it is configured.

    shift_m: (2,) in map, covariance_m2: (2, 2) of it; lasted_s: how long the tag heard it with enough others.
    """

    shift_m: Float
    covariance_m2: Float
    lasted_s: float

    @property
    def significance(self) -> float:
        """The length of shift_m in standard deviations."""
        return float(np.sqrt(self.shift_m @ np.linalg.solve(self.covariance_m2, self.shift_m)))

    @property
    def widest_std_m(self) -> float:
        """Its standard deviation in the direction that the log tells worst."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance_m2)[-1]))


def fit_anchor_shift(
    log: TagEpochs, anchors_m: Float, anchor: int, range_std_m: float, acceleration_std_mps2: float
) -> AnchorShift | None:
    """How far anchor, an index into anchors_m (A, 3), is off, judged by the track that the others give.

    That track tells the weights and the first guess; then the displacement is
    solved for together with the biases of all links, the fixes being free. None
    without MIN_EPOCHS epochs in which three others were heard with it, and of a
    tag that stood still.
    """
    heard = np.isfinite(log.epochs.range_m)
    rows = thin_rows(heard[:, anchor] & (heard.sum(axis=1) >= MIN_RANGES), MAX_EPOCHS)
    if len(rows) < MIN_EPOCHS:
        return None
    t_ns, range_m = log.epochs.t_ns[rows], log.epochs.range_m[rows]
    others = np.delete(np.arange(len(anchors_m)), anchor)
    prior = _prior(len(anchors_m))

    def track_without(bias_m: Float) -> tuple[Float, int]:
        unbiased = Epochs(t_ns, t_ns, (range_m - bias_m)[:, others])
        return track_epochs(unbiased, anchors_m[others], log.height_m, range_std_m, acceleration_std_mps2)

    def fit(place_m: Float, free_axes: int, shift_m: Float) -> tuple[SharedErrors, Float]:
        placed_m = anchors_m.copy()
        placed_m[anchor, :2] += shift_m
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
    return AnchorShift(errors.shift_m[0], _shift_covariance(errors, weight, t_s), float(t_s[-1]))


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
        std_m = max(range_std_m, 1.4826 * float(np.median(np.abs(residual_m))))
        weight = 1 / (1 + (residual_m / (HALF_TRUST_STD * std_m)) ** 2) ** 2 / std_m**2
        effect = np.column_stack([-offset_m[:, :2] / distance_m[:, None], np.ones(len(range_m))])
        pull = effect.T @ (weight * residual_m) - prior @ value
        step_m = np.linalg.solve((effect.T * weight) @ effect + prior, pull)
        value = value + step_m
        if np.abs(step_m).max() < 1e-3:
            break
    return value[:2]
