"""The scenes of the papers' figures, as far as their texts tell them: each a world by name.

Printed are cells of 0.1 m, windows of 40 and 200 cells, the growth by 3 cells, the obstacle of 1.6 m, the passage of
1.5 m and the site of 5 m. Everything else, places, speeds and the obstacles of the other scenes, is our choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from quadlog.mapping.window import Window
from quadlog.planning.protocol import Bool
from quadlog.simulation.planning_worlds import (
    CELL_M,
    MovingDisc,
    Rectangle,
    Track,
    World,
    discs_in,
    rectangles_in,
    standing,
)

FOLLOWING_CELLS = 200
"""[Following]: the grid map, and so its window."""


def single_obstacle() -> World:
    """A square of 1.6 m, as printed, in the middle of the straight way; the way of 6 m is ours. [Planning] Fig. 19."""
    window, start_m, goal = _ground(8.0, 6.0), (1.05, 3.05), standing(7.05, 3.05)
    occupied = rectangles_in(window, [Rectangle(3.2, 2.2, 4.8, 3.8)])
    return _planning("a single obstacle", "19", window, occupied, start_m, goal)


def passage() -> World:
    """A way through of 1.5 m, as printed, in a wall 1 m deep and 10 m long, and beside the straight line: ours.

    [Planning] Fig. 20. Three cells of growth leave 9 of its 15 cells open.
    """
    window, start_m, goal = _ground(10.0, 10.0), (1.55, 5.05), standing(8.55, 5.05)
    walls = [Rectangle(4.5, 0.0, 5.5, 5.3), Rectangle(4.5, 6.8, 5.5, 10.0)]
    return _planning("a narrow passage", "20", window, rectangles_in(window, walls), start_m, goal)


def complex_environment() -> World:
    """Boxes, walls and trunks with ways of 0.8 m and wider between them, all ours. [Planning] Fig. 21."""
    window, start_m, goal = _ground(14.0, 8.0), (1.05, 4.05), standing(13.05, 4.05)
    boxes = [
        Rectangle(2.4, 3.2, 3.6, 4.6),
        Rectangle(4.6, 0.0, 5.0, 3.4),
        Rectangle(4.8, 5.0, 6.2, 6.0),
        Rectangle(6.4, 2.6, 7.8, 4.2),
        Rectangle(8.4, 4.8, 8.8, 8.0),
        Rectangle(9.4, 1.0, 10.6, 2.2),
        Rectangle(10.2, 3.4, 11.2, 4.8),
    ]
    trunks = [(3.0, 1.8, 0.2), (3.4, 6.4, 0.25), (7.2, 5.6, 0.2), (8.9, 3.2, 0.15), (6.6, 1.0, 0.25), (11.9, 2.4, 0.2)]
    occupied = rectangles_in(window, boxes) | discs_in(window, np.array(trunks))
    return _planning("a complex environment", "21", window, occupied, start_m, goal)


def path_coherence() -> World:
    """A box in the way, and a person beyond it who walks across, so that the shorter way round changes sides.

    [Planning] Fig. 5, whose grid the text does not print: all ours. The first plan stays free throughout, so a planner
    that extends it keeps to its side, while A* plans a totally different path as soon as the other side is shorter.
    The goal lies aslant, because IA* keeps only steps that do not lead away from it, in columns and rows.
    """
    window, start_m = _ground(8.0, 8.0), (1.05, 1.05)
    occupied = rectangles_in(window, [Rectangle(1.9, 1.9, 2.5, 2.5)])
    return _planning("path coherence", "5", window, occupied, start_m, _walked(((4.05, 5.25), (5.25, 4.05)), 1.2))


def static_obstacles() -> World:
    """A person at the far side of a site of 5 m, behind what stands there. [Following] Fig. 14.

    The site is printed, and that one obstacle was put into it; a second one and both places are ours.
    """
    window = _ground(5.0, 5.0)
    boxes = [Rectangle(1.4, 1.5, 2.2, 3.1), Rectangle(3.2, 0.9, 3.8, 1.9)]
    return _following("static obstacles", "14", window, rectangles_in(window, boxes), ())


def dynamic_obstacle() -> World:
    """Somebody crosses the way to the person, from side to side of the site of 5 m. [Following] Fig. 15.

    Only the site is printed; a radius of 0.25 m, 0.5 m/s, and when and where they cross, are ours.
    """
    window = _ground(5.0, 5.0)
    crossing = _walked(((2.85, 4.45), (2.85, 0.65)), 0.5)
    moving = (MovingDisc(crossing, radius_m=0.25),)
    return _following("a dynamic obstacle", "15", window, rectangles_in(window, []), moving)


SCENES: dict[str, Callable[[], World]] = {
    "single-obstacle": single_obstacle,
    "passage": passage,
    "complex": complex_environment,
    "coherence": path_coherence,
    "static-obstacles": static_obstacles,
    "dynamic-obstacle": dynamic_obstacle,
}
"""Every scene by name."""


def _ground(length_m: float, width_m: float) -> Window:
    """A site with its lower-left corner at map's origin."""
    return Window(0, 0, CELL_M, (round(width_m / CELL_M), round(length_m / CELL_M)))


def _walked(corners_m: Sequence[tuple[float, float]], speed_mps: float) -> Track:
    """From corner to corner at an even speed, from t_ns = 0."""
    xy_m = np.array(corners_m)
    legs_s = np.hypot(*np.diff(xy_m, axis=0).T) / speed_mps
    return Track(np.rint(1e9 * np.concatenate([[0.0], np.cumsum(legs_s)])).astype(np.int64), xy_m)


def _planning(
    title: str, figure: str, window: Window, occupied: Bool, start_m: tuple[float, float], goal: Track
) -> World:
    return World(title, f"[Planning] Fig. {figure}", window, occupied, np.array(start_m), goal)


def _following(title: str, figure: str, window: Window, occupied: Bool, moving: tuple[MovingDisc, ...]) -> World:
    start_m, goal = np.array([0.55, 2.25]), standing(4.55, 2.25)
    return World(title, f"[Following] Fig. {figure}", window, occupied, start_m, goal, moving, FOLLOWING_CELLS)
