"""What a re-simulated body touches: the cells that can be touched, and a list of contacts with time, place and cause.

A map shows what is no obstacle to a robot that walks elsewhere than the logged one did: people who did not see it, and
false points. A cell that first appears inside the body was not walked into. It is listed, and is no collision.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quadlog.control.following.path import nearest_on_path
from quadlog.mapping.grid import Window
from quadlog.messages import NS_PER_S, Float
from quadlog.planning.protocol import Bool
from quadlog.simulation.worlds.world import body_clearance, body_gaps, occupied_centres

APPEARED, FELL, NO_PLAN, OLD_PLAN, BEYOND_PLAN = "appeared", "fell", "no_plan", "old_plan", "beyond_plan"
PLANNED, CUT, UNSEEN, TURNING = "planned", "cut_corner", "unseen", "turning"
"""Causes of a contact; where several hold, the first of them. results.scenes has them in words."""


class Contact(NamedTuple):
    """The body touched an obstacle from t_ns on, for duration_s.

    x_m, y_m: the cell's centre, the nearest one when the contact began, in map. clearance_m: the least, <= 0. cause:
    one of the above. collision: whether it counts; cells that first appear inside the body do not.
    """

    t_ns: int
    duration_s: float
    x_m: float
    y_m: float
    clearance_m: float
    cause: str
    collision: bool


@dataclass(frozen=True, slots=True)
class Footprint:
    """A rectangle about the robot's pose, its length along x."""

    length_m: float
    width_m: float


class TouchableCells:
    """The obstacle cells that a body can touch, map after map: all but those that first appeared inside of it.

    Such a cell can be touched once the body has been out of it, or the cell was free, at a later map.
    """

    def __init__(self, body: Footprint) -> None:
        self.body = body
        self._before: tuple[Window, Bool] | None = None
        self._inside: frozenset[tuple[int, int]] = frozenset()

    def renew(self, window: Window, solid: Bool, pose: Float) -> tuple[Float, Float]:
        """Centres (N, 2) in map of what can be touched of solid (rows, cols), and (M, 2) of what newly appeared inside.

        pose: (3,) x_m, y_m, yaw_rad of the body at the map's instant.
        """
        centres_m = occupied_centres(solid, window)
        body = self.body.length_m, self.body.width_m, centres_m, window.cell_m
        before, self._before = self._before, (window, solid)
        if body_clearance(*pose.tolist(), *body) > 0:
            self._inside = frozenset()
            return centres_m, centres_m[:0]
        inside = np.flatnonzero(body_gaps(pose, *body) <= 0)
        cells = window.cell_of(centres_m[inside])
        names = [(col + window.col0, row + window.row0) for col, row in cells.tolist()]
        was_there = np.zeros(len(inside), dtype=np.bool_) if before is None else _was_solid(before, names)
        stays = np.array([name in self._inside for name in names])
        appeared = ~was_there | stays
        self._inside = frozenset(name for name, each in zip(names, appeared, strict=True) if each)
        return np.delete(centres_m, inside[appeared], axis=0), centres_m[inside[appeared & ~stays]]


def _was_solid(before: tuple[Window, Bool], names: list[tuple[int, int]]) -> Bool:
    """Which cells, by column and row of the lattice, an earlier map had as solid; it knows none outside its window."""
    window, solid = before
    cells = np.array(names) - np.array([window.col0, window.row0])
    was = window.contains(cells)
    was[was] = solid[cells[was, 1], cells[was, 0]]
    return was


class PlanInUse(NamedTuple):
    """The plan (K, 2) in map that is followed: whether it was made on the present map, and what is left of it.

    chord_m: (2, 2) from the robot to the point it aims at, in map.
    """

    path_m: Float
    is_newest: bool
    remaining_m: float
    chord_m: Float


def cause_of(cell_m: Float, is_mapped: bool, fallen: bool, plan: PlanInUse | None, width_m: float) -> str:
    """Why a body of that width touches the cell at cell_m (2,); is_mapped: the present map has it."""
    if fallen:
        return FELL
    if plan is None:
        return NO_PLAN
    if not plan.is_newest:
        return OLD_PLAN
    if plan.remaining_m == 0.0:
        return BEYOND_PLAN
    x_m, y_m = cell_m.tolist()
    from_plan_m, from_chord_m = (abs(nearest_on_path(way, x_m, y_m).distance_m) for way in (plan.path_m, plan.chord_m))
    if from_plan_m <= width_m / 2:
        return PLANNED if is_mapped else UNSEEN
    if from_chord_m < from_plan_m:
        return CUT
    return TURNING if is_mapped else UNSEEN


@dataclass(slots=True)
class ContactLog:
    """Contacts as they come, tick after tick."""

    _contacts: list[Contact] = field(default_factory=list)
    _open: Contact | None = None

    def appeared(self, t_ns: int, end_ns: int, cell_m: Float, clearance_m: float) -> None:
        """Cells appeared inside the body with the map of t_ns to end_ns, the deepest at cell_m (2,)."""
        x_m, y_m = cell_m.tolist()
        self._contacts.append(Contact(t_ns, (end_ns - t_ns) / NS_PER_S, x_m, y_m, clearance_m, APPEARED, False))

    def tick(self, t_ns: int, clearance_m: float, where_and_why: Callable[[], tuple[Float, str]]) -> None:
        """The clearance at a tick, NaN where it is not known; where_and_why: the cell (2,) touched, and the cause."""
        if not clearance_m <= 0:
            self.end(t_ns)
        elif self._open is not None:
            self._open = self._open._replace(clearance_m=min(self._open.clearance_m, clearance_m))
        else:
            cell_m, cause = where_and_why()
            x_m, y_m = cell_m.tolist()
            self._open = Contact(t_ns, 0.0, x_m, y_m, clearance_m, cause, True)

    def end(self, t_ns: int) -> None:
        """The contact that goes on, if any, ends."""
        if self._open is not None:
            self._contacts.append(self._open._replace(duration_s=(t_ns - self._open.t_ns) / NS_PER_S))
            self._open = None

    @property
    def contacts(self) -> list[Contact]:
        """All that ended, in the order in which they began."""
        return sorted(self._contacts)


def nearest_cell(pose: Float, body: Footprint, centres_m: Float, cell_m: float) -> Float:
    """(2,) the centre of the cell nearest to the body, or deepest inside of it."""
    gaps_m = body_gaps(pose, body.length_m, body.width_m, centres_m, cell_m)
    away_m = np.hypot(*(centres_m - pose[:2]).T)
    return np.asarray(centres_m[np.lexsort((away_m, gaps_m))[0]])
