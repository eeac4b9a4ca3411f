"""UWB ranges from a tag to anchors: noise, a constant bias for each anchor, late first paths where sight is blocked.

A late path is a way around or through something, so that its delay belongs to the place: who stands keeps it, and who
comes back has it again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import gamma, norm

from quadlog.geometry import seconds_since
from quadlog.messages import Float, Int, UwbRanges
from quadlog.simulation.sensors.scene import RayCaster
from quadlog.simulation.sensors.trajectory import Walk, position_in_map


@dataclass(frozen=True, slots=True)
class UwbErrors:
    """How ranges err: range_std_m as in [Following, Fig. 9].

    A blocked path is longer by a delay of a gamma distribution (shape nlos_shape), whose mean each anchor draws from
    nlos_means_m. It is alike within about nlos_reach_m: .3 to 1 s of walking. With nlos_constant_share it is the same
    everywhere behind an anchor.
    """

    range_std_m: float = 0.08
    nlos_means_m: tuple[float, ...] = (0.15, 0.4, 1.0)
    nlos_shape: float = 2.0
    nlos_reach_m: float = 0.3
    nlos_constant_share: float = 0.25
    dropout_share: float = 0.02
    period_ns: int = 20_000_000


@dataclass(frozen=True, slots=True)
class CarriedTag:
    """A tag, who carries it, and where: (x_m, y_m, height_m) in the carrier's frame, whose floor is z = 0."""

    id: int
    walk: Walk
    height_m: float
    x_m: float = 0.0
    y_m: float = 0.0

    def position_m(self, t_s: Float) -> Float:
        """(N, 3) in map at t_s (N,)."""
        place_m = np.array([self.x_m, self.y_m, self.height_m])
        return position_in_map(self.walk.at(t_s), np.broadcast_to(place_m, (len(t_s), 3)))


@dataclass(frozen=True, slots=True)
class TagRanges:
    """Ranges of one tag to A anchors at T instants, and the truth behind them.

    t_ns: (T,); range_m: (T, A) as recorded, NaN where none came; true_m: (T, A); line_of_sight: (T, A) bool.
    """

    tag: int
    t_ns: Int
    range_m: Float
    true_m: Float
    line_of_sight: np.ndarray

    def messages(self) -> Iterator[UwbRanges]:
        """One frame per instant; ranges that did not come are left out."""
        for t_ns, range_m in zip(self.t_ns, self.range_m, strict=True):
            anchor = np.flatnonzero(np.isfinite(range_m)).astype(np.int64)
            yield UwbRanges(int(t_ns), self.tag, anchor, range_m[anchor])


def measure_ranges(
    uwb: UwbErrors,
    tag: CarriedTag,
    anchors_m: Float,
    bias_m: Float,
    caster: RayCaster,
    start_ns: int,
    t_ns: Int,
    rng: np.random.Generator,
) -> TagRanges:
    """Ranges at t_ns (T,) of a walk that starts at start_ns; anchors_m (A, 3) in map, bias_m (A,)."""
    tag_m = tag.position_m(seconds_since(t_ns, start_ns))
    true_m = np.linalg.norm(tag_m[:, None, :] - anchors_m, axis=2)
    shape = true_m.shape
    ends_m = np.broadcast_to(anchors_m, (*shape, 3)).reshape(-1, 3)
    line_of_sight = caster.line_of_sight(np.repeat(tag_m, shape[1], axis=0), ends_m).reshape(shape)
    range_m = true_m + bias_m + rng.normal(0.0, uwb.range_std_m, shape)
    range_m += np.where(line_of_sight, 0.0, _delays_m(uwb, tag_m, shape[1], rng))
    range_m[rng.random(shape) < uwb.dropout_share] = np.nan
    return TagRanges(tag.id, t_ns, np.maximum(range_m, 0.01), true_m, line_of_sight)


_WAVES = 32


def _delays_m(uwb: UwbErrors, place_m: Float, n_anchors: int, rng: np.random.Generator) -> Float:
    """(T, A) delays of blocked paths from places (T, 3): a random field of plane waves for each anchor."""
    wave = rng.normal(0.0, 1 / uwb.nlos_reach_m, (n_anchors, 2, _WAVES))
    wave[rng.random(n_anchors) < uwb.nlos_constant_share] = 0.0
    phase, mean_m = rng.uniform(0.0, 2 * np.pi, (n_anchors, _WAVES)), rng.choice(uwb.nlos_means_m, n_anchors)
    x_m, y_m = place_m[:, :2, None].transpose(1, 0, 2)
    height = [np.cos(x_m * x + y_m * y + at).sum(axis=1) for (x, y), at in zip(wave, phase, strict=True)]
    level = norm.cdf(np.column_stack(height) * np.sqrt(2 / _WAVES))
    delay_m: Float = gamma.ppf(level, uwb.nlos_shape, scale=mean_m / uwb.nlos_shape)
    return delay_m
