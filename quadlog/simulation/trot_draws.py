"""What a seed draws of the experiment of [Foot, section 4]: friction, the feet's radius, and how the robot stands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.locomotion.robot import JOINTS, LEGS
from quadlog.messages import Float


@dataclass(frozen=True, slots=True)
class Draw:
    """friction_share, radius_share: by how much these are off, as shares. postures_rad: (4, 3) by leg, see of_pair."""

    friction_share: float
    radius_share: float
    postures_rad: Float

    def of_pair(self, first_pair: int) -> Float:
        """(12,) how far the joints are off: mirrored where the right fore leg (1) swings first, and not the left (0).

        So a symmetric robot that starts with the other pair does all that it does mirrored.
        """
        if first_pair == 0:
            return self.postures_rad.ravel()
        mirrored = self.postures_rad[[1, 0, 3, 2]] * [-1.0, 1.0, 1.0]
        return mirrored.ravel()


def draw_trot(seed: int, friction_spread: float, radius_spread: float, posture_spread_rad: float) -> Draw:
    """Each number evenly within its spread about 0."""
    rng = np.random.default_rng([seed, _TROTS])
    friction, radius = rng.uniform(-1.0, 1.0, 2).tolist()
    postures = rng.uniform(-1.0, 1.0, (len(LEGS), len(JOINTS)))
    return Draw(friction_spread * friction, radius_spread * radius, posture_spread_rad * postures)


# Beside the seed itself, which draws grounds; 1 draws disturbances.
_TROTS = 2
