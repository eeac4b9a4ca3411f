"""Where every foot stands or swings to at a tick: the gait's plan, corrected by what the feet feel.

A foot that meets the ground early, late in its swing, stands from there on; one
that does not meet it in time goes on downwards until it does.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.locomotion.footholds import fit_plane, foothold
from quadlog.locomotion.gait import Gait, contact_schedule, contact_state
from quadlog.locomotion.robot import Robot
from quadlog.locomotion.swing import swing_state
from quadlog.messages import Float

Bool = NDArray[np.bool_]
# From this phase of the swing on, touching is landing; before, it is stumbling, and the foot goes on.
LANDS_FROM_PHASE = 0.6
# How fast a foot that is late for the ground is pushed down.
SEEKING_MPS = 0.35


class Stride:
    """The legs' state, one tick after the other.

    stands (4,): which feet carry. swing (3, 4, 3): position, velocity and acceleration wanted of the others, in map.
    contacts_m (4, 3): where each foot stands, or stood last; landings_m (4, 3): where it is to stand next.
    plane (3,): of the ground under the feet's centres, see fit_plane.
    """

    def __init__(self, robot: Robot, gait: Gait, clearance_m: float, feet_m: Float) -> None:
        self.stands: Bool = np.ones(4, dtype=np.bool_)
        self.swing: Float = np.zeros((3, 4, 3))
        self.contacts_m, self.landings_m = feet_m.copy(), feet_m.copy()
        self.plane: Float = np.zeros(3)
        self._gait, self._offsets = gait, gait.offsets_array
        self._clearance_m = clearance_m
        self._standing_feet_m = robot.standing_feet_m
        self._planned, self._phase = np.ones(4, dtype=np.bool_), np.zeros(4)
        self._lift_offs_m = feet_m.copy()
        self._was_planned: Bool = np.ones(4, dtype=np.bool_)
        fit_plane(self.contacts_m, self.plane)

    def step(
        self,
        t_s: float,
        dt_s: float,
        feet_m: Float,
        touches: Bool,
        position_m: Float,
        yaw_rad: float,
        velocity_mps: Float,
        wanted_mps: Float,
        wanted_yaw_rate_radps: float,
    ) -> bool:
        """Go to t_s: feet_m (4, 3) and touches (4,) as measured, the body's motion (3,) each in map.

        Returns whether another set of feet carries than before.
        """
        gait = self._gait
        contact_state(t_s, gait.period_s, gait.duty, self._offsets, self._planned, self._phase)
        changed: bool = _advance(
            self._planned,
            self._was_planned,
            self._phase,
            self.stands,
            self.swing,
            self.contacts_m,
            self.landings_m,
            self._lift_offs_m,
            feet_m,
            touches,
            position_m,
            yaw_rad,
            velocity_mps,
            wanted_mps,
            wanted_yaw_rate_radps,
            self._standing_feet_m,
            self.plane,
            (gait.swing_s, gait.stance_s, self._clearance_m, dt_s),
        )
        return changed

    def contacts_ahead(self, t_s: float, step_s: float, contacts: Bool) -> None:
        """Writes which feet stand during each of the next steps (N, 4): now as they do, later as planned."""
        gait = self._gait
        # A step counts as what holds in its middle.
        contact_schedule(t_s + 0.5 * step_s, step_s, gait.period_s, gait.duty, self._offsets, contacts)
        contacts[0] = self.stands


@njit(cache=True, error_model="numpy")
def _advance(  # type: ignore[no-untyped-def]
    planned,
    was_planned,
    phase,
    stands,
    swing,
    contacts,
    landings,
    lift_offs,
    feet,
    touches,
    position,
    yaw,
    velocity,
    wanted,
    wanted_yaw_rate,
    standing_feet,
    plane,
    times,
):
    swing_s, stance_s, clearance, dt = times
    changed = False
    for leg in range(4):
        if was_planned[leg] and not planned[leg]:
            lift_offs[leg] = feet[leg]
        stood = stands[leg]
        if planned[leg]:
            # What stands goes on standing though the ground gives way for a tick: forces are planned on it.
            stands[leg] = stood or touches[leg]
        else:
            landed_early = stood and not was_planned[leg]
            stands[leg] = landed_early or (touches[leg] and phase[leg] >= LANDS_FROM_PHASE)
        if stands[leg]:
            contacts[leg] = feet[leg]
            landings[leg] = feet[leg]
        elif planned[leg]:
            # Late: straight on downwards from where it was sent.
            swing[0, leg, 2] -= SEEKING_MPS * dt
            swing[1, leg, 0], swing[1, leg, 1], swing[1, leg, 2] = 0.0, 0.0, -SEEKING_MPS
            swing[2, leg] = 0.0
        else:
            until_landing = (1.0 - phase[leg]) * swing_s
            foothold(
                position,
                yaw,
                velocity,
                wanted,
                wanted_yaw_rate,
                standing_feet[leg],
                until_landing,
                stance_s,
                plane,
                landings[leg],
            )
            swing_state(
                phase[leg],
                swing_s,
                lift_offs[leg],
                landings[leg],
                clearance,
                swing[0, leg],
                swing[1, leg],
                swing[2, leg],
            )
        changed |= stands[leg] != stood
        was_planned[leg] = planned[leg]
    if changed:
        fit_plane(contacts, plane)
    return changed
