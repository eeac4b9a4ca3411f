"""The walks behind the table foot-drift: symmetric and asymmetric robots, with and without y(t), and their
statistics.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadlog.config.control import Simulation
from quadlog.messages import Float
from quadlog.metrics.intervals import Interval, student_interval
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.executor.pool import LocalPool
from quadlog.pipelines.simulation.trot import trot_metrics, trot_once
from quadlog.pipelines.tables.intervals import NEGLIGIBLE, claim
from quadlog.results.papers.table import PaperRow, Verdict

NS = 1_000_000_000
SYMMETRIC = "symmetric"
AHEAD, BEHIND = "2.4 kg ahead, right", "1.2 kg behind, left"
ROBOTS: dict[str, dict[str, float]] = {
    SYMMETRIC: {},
    "symmetric, 0.3 m high": {"height_m": 0.3},
    "1.2 kg ahead, right": {"payload_kg": 1.2, "payload_x_m": 0.15, "payload_y_m": -0.1},
    AHEAD: {"payload_kg": 2.4, "payload_x_m": 0.15, "payload_y_m": -0.1},
    BEHIND: {"payload_kg": 1.2, "payload_x_m": -0.15, "payload_y_m": 0.1},
    "left legs 30 % heavier": {"leg_mass_spread": 0.3},
    "left hips 20 mm ahead": {"hip_offset_m": 0.02},
    "some of each": {
        "payload_kg": 0.6,
        "payload_x_m": 0.1,
        "payload_y_m": -0.05,
        "leg_mass_spread": 0.1,
        "hip_offset_m": -0.01,
    },
}
"""By what the table calls them: keys of [simulation.trot]. Chosen on CHOOSING_SEEDS, two of them to drift as far as the
paper's robot does."""
CHOOSING_SEEDS = (100, 101)
"""Whatever is chosen, is chosen on these."""
FIRST_SEED, SEEDS_PER_TABLE = 5000, 100
"""Where seeds that are reported start, and how many a table may take."""


def reported_seeds(count: int, seed: int) -> range:
    """The walks' seeds of a table's seed; those of two tables' seeds have none in common."""
    assert count <= SEEDS_PER_TABLE
    first = FIRST_SEED + SEEDS_PER_TABLE * seed
    return range(first, first + count)


@dataclass(frozen=True, slots=True)
class Curve:
    """What swings as: k of eq. 12, None for the baseline; lateral and shape as [simulation.trot] has them."""

    k: float | None
    lateral: str = "alternating"
    shape: str = "parabola"


BASELINE = Curve(None)
DERIVED = Curve(175.0)
"""As the paper derives it, k being ours: 10 mm aside."""
EASED = Curve(175.0, shape="eased")
ALTERNATING = (Curve(350.0), DERIVED, Curve(88.0))
SAME_SIDE = tuple(Curve(k, "same") for k in (-350.0, -700.0, 700.0, 350.0))


FRICTION = Simulation().friction
OTHER_FRICTIONS = (0.4, 1.2)
"""The paper prints none; ours, and what else it might be."""


@dataclass(frozen=True, slots=True)
class DriftTask:
    """One walk of one of ROBOTS; friction: before the seed draws it within its spread."""

    robot: str
    curve: Curve
    seed: int
    friction: float = FRICTION


@dataclass(frozen=True, slots=True, eq=False)
class Drifted:
    """What is kept of a walk: metrics by name, the peak of y(t), and y_m, yaw_rad (T,) at t_s (T,)."""

    figures: dict[str, float]
    peak_m: float
    t_s: Float
    y_m: Float
    yaw_rad: Float


Drifts = dict[DriftTask, Drifted]


def walk_all(tasks: Iterable[DriftTask]) -> Drifts:
    """Each walk once, on as many cores as there are."""
    todo = list(dict.fromkeys(tasks))
    workers = min(cores(), len(todo))
    if workers <= 1:
        return {task: walk_task(task) for task in todo}
    # Compiled once, here: the workers find it in the cache.
    first = walk_task(todo[0])
    with LocalPool(workers) as pool:
        return dict(zip(todo, [first, *pool.map(walk_task, todo[1:])], strict=True))


def walk_task(task: DriftTask) -> Drifted:
    """One walk, as `quadlog simulate trot-32s` has it."""
    curve, simulation = task.curve, settings(task.robot, task.curve, task.friction)
    trotted = trot_once(simulation, "baseline" if curve.k is None else "3d-curve", task.seed)
    walk = trotted.walk
    figures = {name: metric.value for name, metric in trot_metrics(trotted).items() if name != "realtime_factor"}
    y_m, yaw_rad = walk.position_m[:, 1].copy(), np.unwrap(walk.rpy_rad[:, 2])
    return Drifted(figures, trotted.planned.peak_m, walk.t_ns / NS, y_m, yaw_rad)


def settings(robot: str, curve: Curve, friction: float = FRICTION) -> Simulation:
    """[simulation] of a robot and a curve on ground of that friction."""
    trot: dict[str, object] = {**ROBOTS[robot], "lateral": curve.lateral, "lateral_shape": curve.shape}
    if curve.k is not None:
        trot["foot_curve_k"] = curve.k
    return Simulation.model_validate({"trot": trot, "friction": friction})


def choose(drifts: Drifts, robot: str, curves: Iterable[Curve]) -> Curve:
    """The curve with which a robot turns least on CHOOSING_SEEDS."""

    def turns(curve: Curve) -> float:
        rates = [drifts[DriftTask(robot, curve, seed)].figures["yaw_rate_degps"] for seed in CHOOSING_SEEDS]
        return float(np.mean(np.abs(rates)))

    return min(curves, key=turns)


@dataclass(frozen=True, slots=True)
class DriftStatistic:
    """A metric, what a row calls it, its factor to the row's unit, and whether its size alone counts."""

    key: str
    called: str
    unit: str
    factor: float = 1.0
    size: bool = False

    def of(self, drifts: Drifts, robot: str, curve: Curve, seeds: Sequence[int], friction: float = FRICTION) -> Float:
        """(N,) by seed."""
        values = np.array([drifts[DriftTask(robot, curve, seed, friction)].figures[self.key] for seed in seeds])
        return self.factor * (np.abs(values) if self.size else values)


DRIFT = DriftStatistic("lateral_drift_m", "drift", "mm", 1e3, size=True)
TURN = DriftStatistic("yaw_rate_degps", "yaw rate", "°/s", size=True)
SIGNED_DRIFT = DriftStatistic("lateral_drift_m", "drift to the left", "mm", 1e3)
SIGNED_TURN = DriftStatistic("yaw_rate_degps", "yaw rate to the left", "°/s")
FORWARD = DriftStatistic("forward_m", "way forward", "m")
ROLL = DriftStatistic("roll_range_deg", "roll, peak to peak", "°")
PITCH = DriftStatistic("pitch_range_deg", "pitch, peak to peak", "°")
CLAIMED = {DRIFT: 40.0 - 280.0, TURN: 0.03 - 0.25}
"""What the paper's curve changes of sizes."""


def mean_interval(values: Float) -> tuple[float, Interval]:
    """Mean of N > 1 values and its 95 % interval after Student."""
    interval = student_interval(values)
    assert interval is not None
    return float(np.mean(values)), interval


def mean_row(
    drifts: Drifts, robot: str, curve: Curve, seeds: Sequence[int], figure: DriftStatistic, where: str
) -> PaperRow:
    """The mean of a figure; where: how the row begins."""
    mean, interval = mean_interval(figure.of(drifts, robot, curve, seeds))
    return PaperRow(f"{where}: {figure.called} ({figure.unit})", mean, None, *interval)


def changes(
    drifts: Drifts,
    robot: str,
    curve: Curve,
    seeds: Sequence[int],
    figure: DriftStatistic,
    friction: float = FRICTION,
) -> Float:
    """(N,) a figure with the curve less that of the baseline, by seed."""
    with_curve, without = (figure.of(drifts, robot, each, seeds, friction) for each in (curve, BASELINE))
    return with_curve - without


def change_row(
    drifts: Drifts,
    robot: str,
    curve: Curve,
    seeds: Sequence[int],
    figure: DriftStatistic,
    where: str,
    note: str = "",
    friction: float = FRICTION,
) -> PaperRow:
    """What a curve changes, beside the claim in words that drift and yaw rate get less and the way longer.

    It reproduces where the interval lies wholly on the claimed side of 0, and of a tenth of the change that is printed.
    """
    mean, interval = mean_interval(changes(drifts, robot, curve, seeds, figure, friction))
    quantity = f"{where}: change of {figure.called} ({figure.unit})"
    if figure is FORWARD:
        row = claim(quantity, 0.0, mean, interval, f"Claimed: more than 0. {note}".strip())
        return replace(row, note=f"{row.note} The other way round.") if interval[1] < 0 else row
    if figure not in CLAIMED:
        return PaperRow(quantity, mean, None, *interval, note=note)
    least = NEGLIGIBLE * CLAIMED[figure]
    row = claim(quantity, least, mean, interval, f"Claimed: less than 0. {note}".strip(), above=False)
    if row.reproduces is not Verdict.NO:
        return row
    why = "The other way round." if interval[0] > 0 else f"By less than a tenth of what is printed, {least:.3g}."
    return replace(row, note=f"{row.note} {why}")


def side(interval: Interval) -> int:
    """-1 or 1 where the interval lies on one side of 0, else 0."""
    low, high = interval
    return -1 if high < 0 else int(low > 0)


FULL_WALKS, FAST_WALKS = 10, 3
FULL_SWEEP, FAST_SWEEP = 3, 2
SWEPT_ROBOTS = (SYMMETRIC, AHEAD, BEHIND)
FRICTION_ROBOTS = (SYMMETRIC, AHEAD)
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
        DriftTask(robot, curve, each)
        for robot in ROBOTS
        for curve in (BASELINE, DERIVED, *chosen.get(robot, ()))
        for each in seeds
    ]
    tasks += [DriftTask(robot, curve, each) for robot in SWEPT_ROBOTS for curve in swept for each in sweep_seeds]
    tasks += [
        DriftTask(robot, curve, each, friction)
        for robot in FRICTION_ROBOTS
        for curve in (BASELINE, DERIVED)
        for each in sweep_seeds
        for friction in OTHER_FRICTIONS
    ]
    return Study(walk_all(tasks), seeds, sweep_seeds, swept, chosen)


def _choose_all() -> dict[str, tuple[Curve, Curve]]:
    curves = (*ALTERNATING, *SAME_SIDE)
    tried = walk_all(DriftTask(robot, curve, each) for robot in ROBOTS for curve in curves for each in CHOOSING_SEEDS)
    return {robot: (choose(tried, robot, ALTERNATING), choose(tried, robot, SAME_SIDE)) for robot in ROBOTS}
