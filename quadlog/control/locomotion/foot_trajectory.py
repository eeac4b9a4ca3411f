"""The way of a foot through a swing: as the MPC walks it, and as [Foot, eqs 9-12] has it, corrected: a compound
cycloid on and up, and a bulge aside.

A swing has the phases 0..1. On: s - sin(2 pi s) / (2 pi). Up: the same at twice the pace, to the middle and back.
Aside: 4 s (1 - s), which is eq. 12's y(t) over its peak: its speed is not 0 at the ends, as that of the other two is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.compiled import inner
from quadlog.messages import Float


@dataclass(frozen=True, slots=True)
class FootCycle:
    """A foot's whole cycle: a swing for swing_share (lambda) of period_s, then a stance back along the line.

    step_m: S, how far it is carried on; lift_m: H; aside_m: the peak of y(t), left positive.
    """

    period_s: float
    step_m: float
    lift_m: float
    swing_share: float = 0.5
    aside_m: float = 0.0

    def at(self, t_s: Float) -> Float:
        """Positions (N, 3) at times (N,) from a lift-off on, about the middle of the step, level with the ground."""
        cycle = np.mod(np.asarray(t_s, np.float64) / self.period_s, 1.0)
        swings = cycle < self.swing_share
        s = np.where(swings, cycle / self.swing_share, (cycle - self.swing_share) / (1.0 - self.swing_share))
        on_m = self.step_m * _cycloid(s) - 0.5 * self.step_m
        aside_m, up_m = self.aside_m * (4.0 * s * (1.0 - s)), _cycloid(2.0 * np.minimum(s, 1.0 - s))
        return np.column_stack([np.where(swings, on_m, -on_m), swings * aside_m, swings * (self.lift_m * up_m)])


def _cycloid(s: Float) -> Float:
    """From 0 to 1, at rest at both ends."""
    return s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi)


def lateral_peak_m(moment_nm: float, k: float, hip_inertia_kgm2: float, period_s: float) -> float:
    """The peak of y(t) = M / (4 k J1) t (t - T/2), which solves 2 J1 k y'' = M, y(0) = y(T/2) = 0 [Foot, eqs 11-12].

    moment_nm: M, about x on the body while the other pair stands; its sign alternates with the pair, and so does the
    peak's. hip_inertia_kgm2: J1, of a leg about its abduction axis. As printed, k has the unit 1/m, and half of
    period_s is swing.
    """
    return -moment_nm * period_s**2 / (64.0 * k * hip_inertia_kgm2)


@inner
def swing_state(
    phase: float,
    duration_s: float,
    start_m: Float,
    end_m: Float,
    clearance_m: float,
    position_m: Float,
    velocity_mps: Float,
    acceleration_mps2: Float,
) -> None:
    """Writes position, velocity and acceleration (3,) at a phase 0..1 of a swing from start_m to end_m (3,).

    Along the line between them the quintic 10 s^3 - 15 s^4 + 6 s^5, and on top of it clearance_m (4 s (1 - s))^3 of
    height: velocity and acceleration are 0 at both ends, so that neither lift-off nor landing jerks. Outside of 0..1
    the foot rests at the end it is nearer to.
    """
    s = min(max(phase, 0.0), 1.0)
    rest = s * (1.0 - s)
    along = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    along_rate = 30.0 * rest * rest / duration_s
    along_gain = 60.0 * rest * (1.0 - 2.0 * s) / (duration_s * duration_s)
    for axis in range(3):
        way = end_m[axis] - start_m[axis]
        position_m[axis] = start_m[axis] + way * along
        velocity_mps[axis] = way * along_rate
        acceleration_mps2[axis] = way * along_gain
    slope = 1.0 - 2.0 * s
    high = 64.0 * clearance_m
    position_m[2] += high * rest * rest * rest
    velocity_mps[2] += high * 3.0 * rest * rest * slope / duration_s
    acceleration_mps2[2] += high * 6.0 * rest * (slope * slope - rest) / (duration_s * duration_s)
