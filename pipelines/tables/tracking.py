"""Walks of the tracking tables: a course, its ground and disturbances, drawn from a seed; and rows of their figures."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from quadlog.config.schema import Config
from quadlog.pipelines.simulation.courses import find_course, make_ground
from quadlog.pipelines.simulation.run_folder import walk_metrics
from quadlog.pipelines.simulation.walk import SimulatedWalk, walk_once
from quadlog.pipelines.tables.claims import Claim, Where
from quadlog.pipelines.tables.judge import SHARE
from quadlog.pipelines.tables.study import Figures
from quadlog.simulation.robot.disturbances import DISTURBED

CONDITIONS = {"ideal": False, "disturbed": True}
"""What the tables call them, and whether `quadlog simulate --disturbed` is meant."""
GROUNDS = {
    "ideal": "The pose is known exactly and nothing pushes; the seed draws the ground.",
    "disturbed": "As `quadlog simulate --disturbed`: a push of 60 N to a side every 2 s, wrong velocities, a noisy and "
    "late pose, a wrong mass. The seed draws them and the ground.",
}
ERRORS = (
    "η, σ: mean and standard deviation of the distance to the path; beside the place in time: to where a robot without "
    "delay would be. A walk that falls counts until then, and has no completion time. Intervals: Student and Wilson."
)
FIGURES = {
    "eta_m": "η (m)",
    "sigma_m": "σ (m)",
    "eta_time_m": "η beside the place in time (m)",
    "sigma_time_m": "σ beside the place in time (m)",
    "completion_time_s": "completion time (s)",
    "speed_mean_mps": "mean speed forward (m/s)",
}
"""What a row calls them, unit last."""
LOOKAHEAD_M = 2.0
"""l, or l0 of the fuzzy rules, as printed."""


def config_of(terrain: str, steering: str, disturbed: bool, turning_share: float | None = None) -> Config:
    """As a file of `quadlog simulate` would have it."""
    simulation = {"controller": steering.lower(), "terrain": terrain}
    return Config.model_validate(
        {
            "mpc": {} if turning_share is None else {"turning_share": turning_share},
            "pursuit": {"lookahead_m": LOOKAHEAD_M},
            "simulation": {**simulation, "disturbances": asdict(DISTURBED) if disturbed else {}},
        }
    )


def track(
    course: str, terrain: str, steering: str, condition: str, seed: int, turning_share: float | None = None
) -> Figures:
    """One walk."""
    config = config_of(terrain, steering, CONDITIONS[condition], turning_share)
    found = find_course(course, config)
    return figures_of(walk_once(found, config, make_ground(course, found, config, seed), seed))


def figures_of(simulated: SimulatedWalk) -> Figures:
    """A walk's metrics, but for how fast it was simulated, and figures of its look-ahead and velocity."""
    control = simulated.walk.control
    metrics = walk_metrics(simulated)
    figures = {name: metric.value for name, metric in metrics.items() if name != "realtime_factor"}
    return figures | {
        "lookahead_range_m": float(np.ptp(control["lookahead_m"])),
        "speed_mean_mps": float(np.mean(control["vx_mps"])),
        "speed_std_mps": float(np.std(control["vx_mps"])),
        "yaw_rate_std_radps": float(np.std(control["yaw_rate_radps"])),
    }


def fall_row(which: str, where: Where) -> Claim:
    """The share of walks that fall."""
    return Claim(f"{which}: share of walks that fall (1)", "fallen", where, statistic=SHARE)
