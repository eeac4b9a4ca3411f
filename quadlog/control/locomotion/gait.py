"""Which feet are on the ground when: gaits as phase tables [Following, Table 1], and a stride that goes on by them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from quadlog.compiled import inlined, inner, kernel
from quadlog.control.locomotion.body_reference import fit_plane, foothold
from quadlog.control.locomotion.numba_record import Bool, Record
from quadlog.control.locomotion.robot import Robot
from quadlog.messages import Float


@dataclass(frozen=True)
class Gait:
    """A cycle of steps. A leg's phase at t is t / period_s + its offset, modulo 1: on the ground while below duty.

    duty: the share of the cycle that a foot stands, 0 < duty <= 1.
    offsets: of left fore, right fore, left hind, right hind; the larger one steps earlier.
    """

    name: str
    period_s: float
    duty: float
    offsets: tuple[float, float, float, float]


# [Following] names these gaits only; periods and duties are ours.
_GAITS = (
    # One foot after the other: left hind, left fore, right hind, right fore; three on the ground.
    Gait("walk", 0.8, 0.75, (0.75, 0.25, 0.0, 0.5)),
    # Diagonal pairs; with the period and duty that track best on rough ground.
    Gait("trot", 0.44, 0.56, (0.0, 0.5, 0.5, 0.0)),
    # Diagonal pairs with flight between them.
    Gait("flying_trot", 0.36, 0.4, (0.0, 0.5, 0.5, 0.0)),
    # All four at once, then flight.
    Gait("pronk", 0.4, 0.5, (0.0, 0.0, 0.0, 0.0)),
    # Fore pair and hind pair in turn, with flight.
    Gait("bound", 0.36, 0.4, (0.0, 0.0, 0.5, 0.5)),
)
GAITS = {gait.name: gait for gait in _GAITS}


@inlined
def _phase(t_s: float, period_s: float, offset: float) -> float:
    """0 <= phase < 1; just below a whole turn the difference rounds to 1."""
    turns = t_s / period_s + offset
    phase = turns - math.floor(turns)
    return phase if phase < 1.0 else 0.0


@inner
def contact_state(t_s: float, period_s: float, duty: float, offsets: Float, stance: Bool, leg_phase: Float) -> None:
    """Writes for each leg (4,) whether it stands at t_s, and its phase 0..1 within that stance or swing."""
    for leg in range(4):
        phase = _phase(t_s, period_s, offsets[leg])
        stance[leg] = phase < duty
        leg_phase[leg] = phase / duty if phase < duty else (phase - duty) / (1.0 - duty)


@kernel
def contact_schedule(t_s: float, step_s: float, period_s: float, duty: float, offsets: Float, contacts: Bool) -> None:
    """Writes (N, 4): which legs stand at t_s, t_s + step_s and so on; the first row is the present."""
    for step in range(len(contacts)):
        for leg in range(4):
            contacts[step, leg] = _phase(t_s + step * step_s, period_s, offsets[leg]) < duty


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


# From this phase of the swing on, touching is landing; before, it is stumbling, and the foot goes on.
LANDS_FROM_PHASE = 0.6
# How fast a foot that is late for the ground is pushed down: a body that waits for it falls at 0.8 m/s after 0.08 s.
SEEKING_MPS = 0.8
# A foot that stands and feels no ground for so long has lost it: pushing on, its leg would only fling the foot away.
LOST_S = 0.01


class Stride(Record):
    """The legs' state, one tick after the other (`advance`).

    stands (4,): which feet carry. swing (3, 4, 3): position, velocity and acceleration wanted of the others, in map.
    contacts_m (4, 3): where each foot stands, or stood last; landings_m (4, 3): where it is to stand next.
    plane (3,): of the ground under the feet's centres, see fit_plane.
    """

    stands: Annotated[Bool, 4]
    planned: Annotated[Bool, 4]
    was_planned: Annotated[Bool, 4]
    phase: Annotated[Float, 4]
    swing: Annotated[Float, 3, 4, 3]
    contacts_m: Annotated[Float, 4, 3]
    landings_m: Annotated[Float, 4, 3]
    lift_offs_m: Annotated[Float, 4, 3]
    airborne_s: Annotated[Float, 4]
    plane: Annotated[Float, 3]
    standing_feet_m: Annotated[Float, 4, 3]
    offsets: Annotated[Float, 4]
    period_s: float
    duty: float
    clearance_m: float

    def __init__(self, robot: Robot, gait: Gait, clearance_m: float, feet_m: Float) -> None:
        super().__init__()
        self.stands[:] = self.planned[:] = self.was_planned[:] = True
        self.contacts_m[:] = self.landings_m[:] = self.lift_offs_m[:] = feet_m
        self.standing_feet_m[:], self.offsets[:] = robot.standing_feet_m, gait.offsets
        record = self.record
        record["period_s"], record["duty"], record["clearance_m"] = gait.period_s, gait.duty, clearance_m
        fit_plane(self.contacts_m, self.plane)


@inlined
def advance(  # type: ignore[no-untyped-def]
    stride, t_s, dt_s, feet, touches, position, yaw, velocity, wanted, wanted_yaw_rate
):
    """Takes the legs to t_s; True when another set of feet carries than before.

    feet (4, 3) and touches (4,) as measured; position and velocity (3,) of the body, and the velocity wanted, in map.
    """
    to = stride[0]
    swing_s, stance_s = (1 - to.duty) * to.period_s, to.duty * to.period_s
    stands, planned, phase, swing = to.stands, to.planned, to.phase, to.swing
    contact_state(t_s, to.period_s, to.duty, to.offsets, planned, phase)
    changed = False
    for leg in range(4):
        if to.was_planned[leg] and not planned[leg]:
            _put(feet, leg, to.lift_offs_m)
        stood = stands[leg]
        to.airborne_s[leg] = 0.0 if touches[leg] else to.airborne_s[leg] + dt_s
        holds = stood and to.airborne_s[leg] < LOST_S
        if planned[leg]:
            # What stands goes on standing though the ground gives way for some ticks: forces are planned on it.
            stands[leg] = holds or touches[leg]
            if stood and not stands[leg]:
                # It seeks the ground from where it is.
                _put(feet, leg, swing[0])
        else:
            landed_early = holds and not to.was_planned[leg]
            stands[leg] = landed_early or (touches[leg] and phase[leg] >= LANDS_FROM_PHASE)
        if stands[leg]:
            _put(feet, leg, to.contacts_m)
            _put(feet, leg, to.landings_m)
        elif planned[leg]:
            # Late: straight on downwards.
            swing[0, leg, 2] -= SEEKING_MPS * dt_s
            swing[1, leg, 0], swing[1, leg, 1], swing[1, leg, 2] = 0.0, 0.0, -SEEKING_MPS
            swing[2, leg, 0], swing[2, leg, 1], swing[2, leg, 2] = 0.0, 0.0, 0.0
        else:
            times_s, foot = ((1.0 - phase[leg]) * swing_s, stance_s), to.standing_feet_m[leg]
            foothold(position, yaw, velocity, wanted, wanted_yaw_rate, foot, *times_s, to.plane, to.landings_m[leg])
            ends = to.lift_offs_m[leg], to.landings_m[leg]
            swing_state(phase[leg], swing_s, *ends, to.clearance_m, swing[0, leg], swing[1, leg], swing[2, leg])
        changed |= stands[leg] != stood
        to.was_planned[leg] = planned[leg]
    if changed:
        fit_plane(to.contacts_m, to.plane)
    return changed


@inlined
def _put(feet, leg, places):  # type: ignore[no-untyped-def]
    for axis in range(3):
        places[leg, axis] = feet[leg, axis]
