"""Whether foot forces are those of the legs that they are assigned to: a foot that bears weight is not lifted."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float

OTHER_ORDERS = ((1, 0, 3, 2), (2, 3, 0, 1))
"""Left and right swapped, front and rear swapped. A trot lifts diagonal feet together, so these two look alike to it,
and diagonal feet that are swapped look right: only the first is proposed where both fit."""
MOST_ROWS = 20_000
FEWEST_ROWS = 100
CONTRADICTED = -0.2
"""Mean correlation of force with depth, over the legs, that contradicts an order; its opposite confirms one."""


def better_foot_order(position_rad: Float, foot_force_n: Float) -> tuple[int, ...] | None:
    """The order in which the forces' columns would fit the legs, where they contradict them as they are; else None.

    position_rad: (N, 12) and foot_force_n: (N, 4) as in JointSeries. None for a robot that stands, or without forces.
    """
    step = max(len(position_rad) // MOST_ROWS, 1)
    depth, force_n = _depth(position_rad[::step]), foot_force_n[::step].astype(np.float64)
    known = np.isfinite(depth).all(axis=1) & np.isfinite(force_n).all(axis=1)
    depth, force_n = depth[known], force_n[known]
    if len(depth) < FEWEST_ROWS or not (depth.std(axis=0).all() and force_n.std(axis=0).all()):
        return None
    fit = np.corrcoef(depth.T, force_n.T)[:4, 4:]
    if np.diagonal(fit).mean() > CONTRADICTED:
        return None
    found = [float(np.mean([fit[leg, foot] for leg, foot in enumerate(order)])) for order in OTHER_ORDERS]
    best = int(np.argmax(np.round(found, 2)))
    return OTHER_ORDERS[best] if found[best] > -CONTRADICTED else None


def _depth(position_rad: Float) -> Float:
    """(N, 4) how far each foot is below its hip, in lengths of a thigh that is as long as the calf."""
    joints = position_rad.astype(np.float64).reshape(-1, 4, 3)
    hip, thigh, calf = joints[..., 0], joints[..., 1], joints[..., 2]
    depth: Float = np.cos(hip) * (np.cos(thigh) + np.cos(thigh + calf))
    return depth
