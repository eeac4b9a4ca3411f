"""What the table foot-drift rests on: which walks, on which seeds, and the curves that are chosen for each robot."""

from __future__ import annotations

from dataclasses import dataclass

from quadlog.pipelines.tables.drift_walks import (
    AHEAD,
    ALTERNATING,
    BASELINE,
    BEHIND,
    CHOOSING_SEEDS,
    DERIVED,
    EASED,
    ROBOTS,
    SAME_SIDE,
    SYMMETRIC,
    Curve,
    Drifts,
    Task,
    choose,
    reported_seeds,
    walk_all,
)

FULL_WALKS, FAST_WALKS = 10, 3
FULL_SWEEP, FAST_SWEEP = 3, 2
SWEPT_ROBOTS = (SYMMETRIC, AHEAD, BEHIND)
SWEPT = (Curve(700.0), *ALTERNATING, Curve(44.0), EASED, *SAME_SIDE)
FAST_SWEPT = (DERIVED, SAME_SIDE[0], SAME_SIDE[-1])


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """drifts: of every walk on a reported seed. chosen: by robot the best of ALTERNATING and of SAME_SIDE, or none.

    swept: the curves of the sweep, each walked on sweep_seeds by SWEPT_ROBOTS; all others on seeds.
    """

    drifts: Drifts
    seeds: range
    sweep_seeds: range
    swept: tuple[Curve, ...]
    chosen: dict[str, tuple[Curve, Curve]]


def measure_drifts(fast: bool, seed: int) -> Study:
    """All walks; fast ones are fewer, and nothing is chosen for a robot."""
    seeds = reported_seeds(FAST_WALKS if fast else FULL_WALKS, seed)
    sweep_seeds, swept = seeds[: FAST_SWEEP if fast else FULL_SWEEP], FAST_SWEPT if fast else SWEPT
    chosen = {} if fast else _choose_all()
    tasks = [
        Task(robot, curve, each)
        for robot in ROBOTS
        for curve in (BASELINE, DERIVED, *chosen.get(robot, ()))
        for each in seeds
    ]
    tasks += [Task(robot, curve, each) for robot in SWEPT_ROBOTS for curve in swept for each in sweep_seeds]
    return Study(walk_all(tasks), seeds, sweep_seeds, swept, chosen)


def _choose_all() -> dict[str, tuple[Curve, Curve]]:
    curves = (*ALTERNATING, *SAME_SIDE)
    tried = walk_all(Task(robot, curve, each) for robot in ROBOTS for curve in curves for each in CHOOSING_SEEDS)
    return {robot: (choose(tried, robot, ALTERNATING), choose(tried, robot, SAME_SIDE)) for robot in ROBOTS}
