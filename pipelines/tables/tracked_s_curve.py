"""The walks of the table tracking-5: the three controllers on the S-curve, and what the fuzzy rules have to beat."""

from __future__ import annotations

import numpy as np

from quadlog.following.lookahead import HONEST
from quadlog.pipelines.tables.tracked_walks import (
    CHOOSING_SEEDS,
    CONDITIONS,
    Steering,
    Task,
    Tracked,
    held_out_seeds,
    walk_all,
)
from quadlog.pipelines.tables.tracking_figures import ETA

CONTROLLERS = (Steering("FpMW", "fpmw"), Steering("FpM", "fpm"), Steering("pMW", "pmw"))
TUNED = Steering("tuned rules", "fpmw", HONEST.l0_m, HONEST)
SAME_MEAN, TUNED_SAME_MEAN, BEST_FIXED = "fixed l, FpMW's mean", "fixed l, tuned rules' mean", "best fixed l"
RIVALS = (SAME_MEAN, BEST_FIXED, TUNED.name, TUNED_SAME_MEAN)
"""All with MPC and whole-body control."""
LENGTHS_M = (0.2, 0.4, 0.6, 0.8, 1.0, 1.4)
"""Among these the best fixed look-ahead is chosen."""
KNOWN_BEST_M = {"ideal": 0.2, "disturbed": 0.6}
"""What a full run chooses; a fast one takes it from here."""
FAST_RIVAL_WALKS = 1

Measured = dict[tuple[str, str], list[Tracked]]
"""By condition and way of steering."""
Scan = dict[tuple[str, float], list[Tracked]]
"""By condition and fixed look-ahead, on the seeds for choosing; empty for a fast run."""


def measure_controllers(walks: int, seed: int, fast: bool) -> tuple[Measured, Scan]:
    """All walks. Fast ones leave out the choosing, and the rivals but for one undisturbed walk each."""
    seeds = held_out_seeds(walks, seed)
    rival_seeds = seeds[:FAST_RIVAL_WALKS] if fast else seeds
    rival_conditions = ["ideal"] if fast else list(CONDITIONS)
    first = {(condition, each.name): _tasks(each, condition, seeds) for condition in CONDITIONS for each in CONTROLLERS}
    first |= {(condition, TUNED.name): _tasks(TUNED, condition, rival_seeds) for condition in rival_conditions}
    choosing = {} if fast else {key: _tasks(fixed(key[1]), key[0], CHOOSING_SEEDS) for key in _lengths()}
    done = iter(walk_all([task for tasks in [*first.values(), *choosing.values()] for task in tasks]))
    measured = {key: [next(done) for _ in tasks] for key, tasks in first.items()}
    scan = {key: [next(done) for _ in tasks] for key, tasks in choosing.items()}

    then: dict[tuple[str, str], list[Task]] = {}
    for condition in rival_conditions:
        for name, of in ((SAME_MEAN, "FpMW"), (TUNED_SAME_MEAN, TUNED.name)):
            means_m = [walk.of("lookahead_mean_m") for walk in measured[condition, of]]
            pairs = zip(rival_seeds, means_m, strict=False)
            then[condition, name] = [task for each, l_m in pairs for task in _tasks(fixed(l_m), condition, [each])]
        then[condition, BEST_FIXED] = _tasks(fixed(best_fixed_m(condition, scan)), condition, rival_seeds)
    done = iter(walk_all([task for tasks in then.values() for task in tasks]))
    return measured | {key: [next(done) for _ in tasks] for key, tasks in then.items()}, scan


def _lengths() -> list[tuple[str, float]]:
    return [(condition, length_m) for condition in CONDITIONS for length_m in LENGTHS_M]


def _tasks(steering: Steering, condition: str, seeds: range | tuple[int, ...] | list[int]) -> list[Task]:
    return [Task("s-curve", "course", steering, CONDITIONS[condition], each) for each in seeds]


def fixed(lookahead_m: float) -> Steering:
    """Pure pursuit with one look-ahead, MPC and whole-body control."""
    return Steering(f"fixed l {lookahead_m:g} m", "pmw", lookahead_m)


def best_fixed_m(condition: str, scan: Scan) -> float:
    """The fixed look-ahead with the smallest mean η of those that never fall, as is known when none was walked."""
    if not scan:
        return KNOWN_BEST_M[condition]
    standing = [
        length_m for length_m in LENGTHS_M if not any(walk.of("fallen") == 1 for walk in scan[condition, length_m])
    ]
    return min(standing or LENGTHS_M, key=lambda length_m: float(np.mean(ETA.of(scan[condition, length_m]))))
