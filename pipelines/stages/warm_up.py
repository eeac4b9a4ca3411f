"""Imports and compilation, done before the clock of the stages starts and timed apart from them."""

from __future__ import annotations

import time
from collections.abc import Collection

import numpy as np

from quadlog.lidar.paper import PaperSettings, classify_scan_paper
from quadlog.mapping.accumulated import AccumulatedMap
from quadlog.mapping.ground_height import GroundHeight
from quadlog.mapping.occupancy import occupancy
from quadlog.mapping.window import window_around


def warm_up(stages: Collection[str]) -> float:
    """Load and compile what the given stages need by running it on a toy scan; returns the seconds it took.

    Planners and the re-simulation warm themselves up, see Replanner.
    """
    started = time.perf_counter()
    if "filter" in stages:
        cloud = np.random.default_rng(0).uniform(-3, 3, (200, 3)).astype(np.float32)
        classify_scan_paper(cloud, np.eye(4), PaperSettings(), seed=0)
    if "map" in stages:
        window = window_around(np.zeros(2), 0.1, 11)
        occupied = occupancy(np.array([[0.2, 0.2]]), window, 1)
        AccumulatedMap(0.1).add(window, occupied, np.zeros(2))
        GroundHeight(0.1).add(np.zeros((1, 2)), np.zeros(1))
    return time.perf_counter() - started
