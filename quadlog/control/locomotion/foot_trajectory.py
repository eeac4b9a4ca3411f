"""The way of a foot through a swing, as the MPC walks it."""

from __future__ import annotations

from quadlog.compiled import inner
from quadlog.messages import Float


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
