"""Where every foot stands or swings to at a tick: the gait's plan, corrected by what the feet feel.

A foot that meets the ground early, late in its swing, stands from there on; one
that does not meet it in time, or loses it, goes on downwards until it does.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inlined, inner
from quadlog.locomotion.foot_trajectory import EASED, foot_curve_state
from quadlog.locomotion.footholds import fit_plane, foothold
from quadlog.locomotion.gait import Gait, contact_schedule, contact_state
from quadlog.locomotion.record import Record
from quadlog.locomotion.robot import Robot
from quadlog.locomotion.swing import swing_state
from quadlog.messages import Float

Bool = NDArray[np.bool_]
# From this phase of the swing on, touching is landing; before, it is stumbling, and the foot goes on.
LANDS_FROM_PHASE = 0.6
# How fast a foot that is late for the ground is pushed down: a body that waits for it falls at 0.8 m/s after 0.08 s.
SEEKING_MPS = 0.8
# A foot that stands and feels no ground for so long has lost it: pushing on, its leg would only fling the foot away.
LOST_S = 0.01
# Of each leg, to which side it goes aside: with alternating moments, the other way with the other diagonal pair.
ASIDE_SIGNS: Float = np.array([1.0, -1.0, -1.0, 1.0])
SWINGS = ("quintic", "foot_curve")

_LAYOUT = np.dtype(
    [
        ("stands", "u1", 4),
        ("planned", "u1", 4),
        ("was_planned", "u1", 4),
        ("phase", "f8", 4),
        ("swing", "f8", (3, 4, 3)),
        ("contacts_m", "f8", (4, 3)),
        ("landings_m", "f8", (4, 3)),
        ("lift_offs_m", "f8", (4, 3)),
        ("airborne_s", "f8", 4),
        ("plane", "f8", 3),
        ("standing_feet_m", "f8", (4, 3)),
        ("offsets", "f8", 4),
        ("period_s", "f8"),
        ("duty", "f8"),
        ("clearance_m", "f8"),
        ("curved", "u1"),
        ("asides_m", "f8", 4),
        ("aside_m", "f8", 3),
    ],
    align=True,
)


class Stride(Record):
    """The legs' state, one tick after the other (`advance`).

    stands (4,): which feet carry. swing (3, 4, 3): position, velocity and acceleration wanted of the others, in map.
    contacts_m (4, 3): where each foot stands, or stood last; landings_m (4, 3): where it is to stand next.
    plane (3,): of the ground under the feet's centres, see fit_plane. swing_name, of SWINGS: the quintic, or the curve
    of [Foot, eqs 9-12], whose bulge of aside_m goes left with left fore and right hind, right with the others.
    """

    stands: Bool
    planned: Bool
    was_planned: Bool
    swing: Float
    contacts_m: Float
    landings_m: Float
    lift_offs_m: Float
    plane: Float
    standing_feet_m: Float
    offsets: Float
    asides_m: Float

    def __init__(
        self,
        robot: Robot,
        gait: Gait,
        clearance_m: float,
        feet_m: Float,
        swing_name: str = SWINGS[0],
        aside_m: float = 0.0,
    ) -> None:
        super().__init__(_LAYOUT)
        self._gait = gait
        self.stands[:] = self.planned[:] = self.was_planned[:] = True
        self.contacts_m[:] = self.landings_m[:] = self.lift_offs_m[:] = feet_m
        self.standing_feet_m[:], self.offsets[:] = robot.standing_feet_m, gait.offsets
        record = self.record
        record["period_s"], record["duty"], record["clearance_m"] = gait.period_s, gait.duty, clearance_m
        record["curved"], self.asides_m[:] = swing_name == "foot_curve", aside_m * ASIDE_SIGNS
        fit_plane(self.contacts_m, self.plane)

    def contacts_ahead(self, t_s: float, step_s: float, contacts: Bool) -> None:
        """Writes which feet stand during each of the next steps (N, 4): now as they do, later as planned."""
        gait = self._gait
        # A step counts as what holds in its middle.
        contact_schedule(t_s + 0.5 * step_s, step_s, gait.period_s, gait.duty, self.offsets, contacts)
        contacts[0] = self.stands


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
            foothold(
                position,
                yaw,
                velocity,
                wanted,
                wanted_yaw_rate,
                to.standing_feet_m[leg],
                (1.0 - phase[leg]) * swing_s,
                stance_s,
                to.plane,
                to.landings_m[leg],
            )
            _swing(to, leg, phase[leg], swing_s, yaw)
        changed |= stands[leg] != stood
        to.was_planned[leg] = planned[leg]
    if changed:
        fit_plane(to.contacts_m, to.plane)
    return changed


@inner
def _swing(to, leg, phase, swing_s, yaw):  # type: ignore[no-untyped-def]
    """Writes where a leg's foot is wanted on the curve of its choice."""
    start, end, position, velocity = to.lift_offs_m[leg], to.landings_m[leg], to.swing[0, leg], to.swing[1, leg]
    acceleration, aside = to.swing[2, leg], to.aside_m
    if to.curved:
        aside[0], aside[1] = -math.sin(yaw) * to.asides_m[leg], math.cos(yaw) * to.asides_m[leg]
        # The parabola of eq. 12 would leave and meet the ground with speed.
        foot_curve_state(phase, swing_s, start, end, to.clearance_m, aside, EASED, position, velocity, acceleration)
    else:
        swing_state(phase, swing_s, start, end, to.clearance_m, position, velocity, acceleration)


@inlined
def _put(feet, leg, places):  # type: ignore[no-untyped-def]
    for axis in range(3):
        places[leg, axis] = feet[leg, axis]
