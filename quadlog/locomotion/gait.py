"""Which feet are on the ground when: gaits as phase tables [Following, Table 1]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inlined, inner
from quadlog.messages import Float

Bool = NDArray[np.bool_]


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

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period_s) and self.period_s > 0 and 0 < self.duty <= 1):
            raise ValueError(f"{self.name}: a gait needs a period above 0 s and a duty in (0, 1]")
        if not all(math.isfinite(offset) for offset in self.offsets):
            raise ValueError(f"{self.name}: a gait needs finite offsets")

    @property
    def stance_s(self) -> float:
        """How long a foot stands."""
        return self.duty * self.period_s

    @property
    def swing_s(self) -> float:
        """How long a foot is in the air."""
        return (1 - self.duty) * self.period_s

    @property
    def offsets_array(self) -> Float:
        """(4,) for the compiled functions."""
        return np.array(self.offsets)


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
# [Following] names these gaits only; periods and duties are ours.
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


def contact_schedule(t_s: float, step_s: float, period_s: float, duty: float, offsets: Float, contacts: Bool) -> None:
    """Writes (N, 4): which legs stand at t_s, t_s + step_s and so on; the first row is the present."""
    turns = (t_s + np.arange(len(contacts)) * step_s)[:, None] / period_s + offsets
    phase = turns - np.floor(turns)
    # Just below a whole turn the difference rounds to 1.
    contacts[:] = np.where(phase < 1.0, phase, 0.0) < duty
