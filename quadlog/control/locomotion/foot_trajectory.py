"""The way of a foot through a swing: as the MPC walks it, and as [Foot, eqs 9-12] has it, corrected: a compound
cycloid on and up, and a bulge aside.

A swing has the phases 0..1. On: s - sin(2 pi s) / (2 pi). Up: the same at twice the pace, to the middle and back.
Aside: b = 4 s (1 - s), which is eq. 12's y(t) over its peak: its speed is not 0 at the ends, as that of the other two
is. b^3 has the same peak, and neither speed nor acceleration at its ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quadlog.compiled import inner, kernel
from quadlog.messages import Float

PARABOLA, EASED = 1, 3
"""The power of b: as printed, or at rest at both ends. Any whole number of at least 1 goes."""


@inner
def foot_curve_state(
    phase: float,
    duration_s: float,
    start_m: Float,
    end_m: Float,
    clearance_m: float,
    aside_m: Float,
    power: int,
    position_m: Float,
    velocity_mps: Float,
    acceleration_mps2: Float,
) -> None:
    """Writes position, velocity and acceleration (3,) at a phase of a swing from start_m to end_m (3,).

    aside_m: (3,) how far from the line between them the foot is in the middle of the swing, beside clearance_m of
    height; power: of b. Outside of 0..1 the foot rests at the end it is nearer to, as swing_state has it.
    """
    inside = 0.0 <= phase <= 1.0
    s = min(max(phase, 0.0), 1.0)
    up = 2.0 * min(s, 1.0 - s)
    pace = 1.0 / duration_s if inside else 0.0
    along, along_rate, along_gain = _cycloid(s)
    high, high_rate, high_gain = _cycloid(up)
    rising = 1.0 if s < 0.5 else -1.0
    bulge, bulge_rate, bulge_gain = _bulge(s, power)
    for axis in range(3):
        way = end_m[axis] - start_m[axis]
        position_m[axis] = start_m[axis] + way * along + aside_m[axis] * bulge
        velocity_mps[axis] = (way * along_rate + aside_m[axis] * bulge_rate) * pace
        acceleration_mps2[axis] = (way * along_gain + aside_m[axis] * bulge_gain) * pace * pace
    position_m[2] += clearance_m * high
    velocity_mps[2] += clearance_m * high_rate * 2.0 * rising * pace
    acceleration_mps2[2] += clearance_m * high_gain * 4.0 * pace * pace


@inner
def _cycloid(s):  # type: ignore[no-untyped-def]
    """From 0 to 1, and its first two derivatives, which are 0 at both ends."""
    angle = 2.0 * math.pi * s
    return s - math.sin(angle) / (2.0 * math.pi), 1.0 - math.cos(angle), 2.0 * math.pi * math.sin(angle)


@inner
def _bulge(s, power):  # type: ignore[no-untyped-def]
    """The power of b, 1 in the middle and 0 at both ends, and its first two derivatives."""
    b, slope = 4.0 * s * (1.0 - s), 4.0 * (1.0 - 2.0 * s)
    if power == 1:
        return b, slope, -8.0
    gain = power * (power - 1) * b ** (power - 2) * slope * slope - 8.0 * power * b ** (power - 1)
    return b**power, power * b ** (power - 1) * slope, gain


@dataclass(frozen=True, slots=True)
class FootCycle:
    """A foot's whole cycle: a swing for swing_share (lambda) of period_s, then a stance back along the line.

    step_m: S, how far it is carried on; lift_m: H; aside_m: the peak of y(t), left positive; power: of b.
    """

    period_s: float
    step_m: float
    lift_m: float
    swing_share: float = 0.5
    aside_m: float = 0.0
    power: int = PARABOLA

    def at(self, t_s: Float) -> tuple[Float, Float, Float]:
        """Position, velocity and acceleration, (N, 3) each, at times (N,) from a lift-off on; the cycle repeats.

        About the middle of the step, level with the ground.
        """
        states = np.empty((3, len(t_s), 3))
        cycles = np.ascontiguousarray(np.mod(np.asarray(t_s, np.float64) / self.period_s, 1.0))
        _cycle(cycles, self.period_s, self.step_m, self.lift_m, self.swing_share, self.aside_m, self.power, states)
        return states[0], states[1], states[2]


@kernel
def _cycle(cycles, period_s, step_m, lift_m, swing_share, aside_m, power, states):  # type: ignore[no-untyped-def]
    """Writes states (3, N, 3) at cycles (N,) 0..1."""
    back, front = np.array([-0.5 * step_m, 0.0, 0.0]), np.array([0.5 * step_m, 0.0, 0.0])
    aside, none = np.array([0.0, aside_m, 0.0]), np.zeros(3)
    swing_s, stance_s = swing_share * period_s, (1.0 - swing_share) * period_s
    for i in range(len(cycles)):
        position, velocity, acceleration = states[0, i], states[1, i], states[2, i]
        if cycles[i] < swing_share:
            phase = cycles[i] / swing_share
            foot_curve_state(phase, swing_s, back, front, lift_m, aside, power, position, velocity, acceleration)
        else:
            phase = (cycles[i] - swing_share) / (1.0 - swing_share)
            foot_curve_state(phase, stance_s, front, back, 0.0, none, 1, position, velocity, acceleration)


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
