"""Whether a track and its reference lie in two frames: a shift and a turn that explain most of the error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float

MIN_SHIFT_M = 0.3
MIN_TURN_RAD = np.radians(3.0)
MIN_TURNED_M = 0.1
"""A turn that moves the track by less is one of its noise, as that of a robot that stood."""
EXPLAINED = 0.5
MIN_PAIRS = 10


@dataclass(frozen=True, slots=True)
class FrameOffset:
    """The best rigid motion from a track onto its reference: turned by turn_rad about map's origin, then shifted.

    shift_m: (2,); mean_shift_m: (2,) mean of reference less track; spread_m: rms distance of the track from its mean.
    before_m, after_m: rmse without and with it.
    """

    turn_rad: float
    shift_m: Float
    mean_shift_m: Float
    spread_m: float
    before_m: float
    after_m: float


def find_frame_offset(position_m: Float, reference_m: Float) -> FrameOffset | None:
    """The rotation and translation that bring N positions (N, 2) nearest to those of the reference [Umeyama].

    Rows with a NaN on either side are left out; None with fewer than MIN_PAIRS of them left.
    """
    known = np.isfinite(position_m).all(axis=1) & np.isfinite(reference_m).all(axis=1)
    position_m, reference_m = position_m[known], reference_m[known]
    if len(position_m) < MIN_PAIRS:
        return None
    mean_m, reference_mean_m = position_m.mean(axis=0), reference_m.mean(axis=0)
    centred, wanted = position_m - mean_m, reference_m - reference_mean_m
    # In the plane the singular value decomposition comes down to one angle.
    turn = np.arctan2(np.sum(centred[:, 0] * wanted[:, 1] - centred[:, 1] * wanted[:, 0]), np.sum(centred * wanted))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return FrameOffset(
        turn_rad=float(turn),
        shift_m=reference_mean_m - rotation @ mean_m,
        mean_shift_m=reference_mean_m - mean_m,
        spread_m=_rms(centred),
        before_m=_rms(reference_m - position_m),
        after_m=_rms(wanted - centred @ rotation.T),
    )


def frame_offset_words(offset: FrameOffset) -> str | None:
    """A warning where the rigid motion is large and explains at least half of the error; None elsewhere."""
    turned_m = 2 * abs(np.sin(offset.turn_rad / 2)) * offset.spread_m
    shifted = float(np.hypot(*offset.mean_shift_m)) > MIN_SHIFT_M
    turned = abs(offset.turn_rad) > MIN_TURN_RAD and turned_m > MIN_TURNED_M
    if not (shifted or turned) or offset.after_m > EXPLAINED * offset.before_m:
        return None
    x_m, y_m = offset.shift_m
    return (
        f"the reference seems to lie in another frame than the poses: map turned by "
        f"{np.degrees(offset.turn_rad):.1f} degrees and then shifted by ({x_m:.2f}, {y_m:.2f}) m would bring the "
        f"error from {offset.before_m:.2f} to {offset.after_m:.2f} m; errors against it count that too"
    )


def _rms(vectors_m: Float) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors_m**2, axis=1))))
