"""Walks of the tracking tables: course, ground and disturbances drawn from a seed, many at a time; rows and pictures
of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from quadlog.config.schema import Config
from quadlog.control.following.lookahead import FuzzySettings
from quadlog.messages import Float
from quadlog.metrics.intervals import Interval, student_interval
from quadlog.pipelines.executor.machine import cores
from quadlog.pipelines.executor.pool import LocalPool
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.simulation.courses import find_course, make_ground
from quadlog.pipelines.simulation.run_folder import walk_metrics
from quadlog.pipelines.simulation.walk import SimulatedWalk, walk_once, warm_up
from quadlog.pipelines.tables.intervals import NEGLIGIBLE, compare, judge_claim, not_comparable, share_interval
from quadlog.results.papers.table import PaperRow, Verdict
from quadlog.results.view import Panel, Series, Spread, forest, look
from quadlog.simulation.robot.disturbances import DISTURBED

HELD_OUT_SEED = 2000
"""Seeds that are reported start here."""
CHOOSING_SEEDS = (100, 101)
"""Whatever is chosen, is chosen on these."""
SEEDS_PER_TABLE = 100
CONDITIONS = {"ideal": False, "disturbed": True}
"""What the tables call them, and whether `quadlog simulate --disturbed` is meant."""
NS = 1_000_000_000
CURVES = (
    *("x_m", "y_m", "ref_x_m", "ref_y_m", "heading_error_rad", "vx_mps", "yaw_rate_radps", "lookahead_m"),
    *("k_v", "k_w", "tau_00_nm", "tau_01_nm", "tau_02_nm"),
)
"""What the paper draws of a walk; torques are those of the front left leg."""


@dataclass(frozen=True, slots=True)
class Steering:
    """controller: as `quadlog simulate` has it. lookahead_m: l, or l0 of the fuzzy rules, the paper's unless given."""

    name: str
    controller: str
    lookahead_m: float = 2.0
    fuzzy: FuzzySettings | None = None


@dataclass(frozen=True, slots=True)
class TrackingTask:
    """One walk; terrain: as [simulation] has it. drawn: its curves are kept for a picture.

    turning_share, friction: of [mpc] and [simulation], None for the defaults.
    """

    course: str
    terrain: str
    steering: Steering
    disturbed: bool
    seed: int
    drawn: bool = False
    turning_share: float | None = None
    friction: float | None = None

    @property
    def config(self) -> Config:
        """As a file of `quadlog simulate` would have it."""
        steering, fuzzy = self.steering, {}
        if steering.fuzzy is not None:
            fuzzy = asdict(steering.fuzzy)
            fuzzy |= {"lambda_v_s2_per_m": fuzzy.pop("lambda_v"), "lambda_w_s": fuzzy.pop("lambda_w")}
            assert fuzzy.pop("l0_m") == steering.lookahead_m
        simulation = {} if self.friction is None else {"friction": self.friction}
        given: dict[str, Any] = {
            "mpc": {} if self.turning_share is None else {"turning_share": self.turning_share},
            "pursuit": {"lookahead_m": steering.lookahead_m, "fuzzy": fuzzy},
            "simulation": simulation
            | {
                "controller": steering.controller,
                "terrain": self.terrain,
                "disturbances": asdict(DISTURBED) if self.disturbed else {},
            },
        }
        return Config.model_validate(given)


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What is kept of a walk: figures by name, one that does not apply is absent, and error_m (T,) at t_s (T,).

    curves: columns (T,) of control.parquet; none unless they are to be drawn.
    """

    figures: dict[str, float]
    t_s: Float
    error_m: Float
    curves: Mapping[str, Float] = field(default_factory=dict)

    def of(self, name: str) -> float:
        """A figure, NaN when it is absent."""
        return self.figures.get(name, math.nan)


def held_out_seeds(count: int, seed: int) -> range:
    """The walks' seeds of a table's seed; those of two tables' seeds have none in common."""
    assert count <= SEEDS_PER_TABLE
    first = HELD_OUT_SEED + SEEDS_PER_TABLE * seed
    return range(first, first + count)


def walk_all(tasks: Sequence[TrackingTask]) -> list[Tracked]:
    """The walks in the order of the tasks, on as many cores as there are."""
    # Compiled once, here: the workers find it in the cache.
    _warm_up(tasks[0])
    workers = min(cores(), len(tasks))
    if workers == 1:
        return [walk_task(task) for task in tasks]
    with LocalPool(workers) as pool:
        return list(pool.map(walk_task, tasks))


def walk_task(task: TrackingTask, most_s: float | None = None) -> Tracked:
    """One walk; most_s: stop after so long."""
    config = task.config
    course = find_course(task.course, config)
    ground = make_ground(task.course, course, config, task.seed)
    simulated = walk_once(course, config, ground, task.seed, most_s)
    walk, control = tracked(simulated), simulated.walk.control
    return replace(walk, curves={name: np.asarray(control[name]) for name in CURVES}) if task.drawn else walk


def tracked(simulated: SimulatedWalk) -> Tracked:
    """A walk's metrics, but for how fast it was simulated, and figures of its look-ahead and velocity."""
    control = simulated.walk.control
    metrics = walk_metrics(simulated)
    figures = {name: metric.value for name, metric in metrics.items() if name != "realtime_factor"}
    lookahead_m = control["lookahead_m"]
    figures |= {
        "lookahead_mean_m": float(np.mean(lookahead_m)),
        "lookahead_range_m": float(np.ptp(lookahead_m)),
        "x_error_rms_m": _rms(control["x_m"] - control["ref_x_m"]),
        "y_error_rms_m": _rms(control["y_m"] - control["ref_y_m"]),
        "speed_mean_mps": float(np.mean(control["vx_mps"])),
        "speed_std_mps": float(np.std(control["vx_mps"])),
        "yaw_rate_std_radps": float(np.std(control["yaw_rate_radps"])),
    }
    gains = {name: control[name] for name in ("k_v", "k_w") if name in control}
    figures |= {f"{name}_range": float(np.ptp(gain)) for name, gain in gains.items() if np.isfinite(gain).all()}
    t_ns = control["t_ns"]
    return Tracked(figures, (t_ns - t_ns[0]) / NS, np.asarray(control["error_m"], np.float64))


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _warm_up(task: TrackingTask) -> None:
    config = task.config
    course = find_course(task.course, config)
    warm_up(course, config, make_ground(task.course, course, config, task.seed), Silent().say)


@dataclass(frozen=True, slots=True)
class TrackingStatistic:
    """One of the figures of Tracked, what a row calls it, and by what it is multiplied to have the row's unit."""

    key: str
    called: str
    unit: str
    factor: float = 1.0

    def of(self, walks: Sequence[Tracked]) -> Float:
        """(N,) of the walks that have it."""
        values = self.factor * np.array([walk.of(self.key) for walk in walks])
        return values[np.isfinite(values)]


ETA = TrackingStatistic("eta_m", "η", "m")
SIGMA = TrackingStatistic("sigma_m", "σ", "m")
ETA_TIME = TrackingStatistic("eta_time_m", "η beside the place in time", "m")
SIGMA_TIME = TrackingStatistic("sigma_time_m", "σ beside the place in time", "m")
TIME = TrackingStatistic("completion_time_s", "completion time", "s")
PITCH = TrackingStatistic("pitch_rms_rad", "pitch rms", "°", math.degrees(1.0))
HEIGHT = TrackingStatistic("height_rms_m", "height rms", "mm", 1e3)
YAW_ERROR = TrackingStatistic("heading_rmse_rad", "yaw error, rms", "rad")
TORQUE = TrackingStatistic("torque_max_nm", "largest joint torque", "N m")
SATURATED = TrackingStatistic("torque_saturation_share", "share of torques at their limit", "1")
LOOKAHEAD = TrackingStatistic("lookahead_mean_m", "mean look-ahead", "m")
LOOKAHEAD_RANGE = TrackingStatistic("lookahead_range_m", "range of look-ahead", "m")


def mean_interval(values: Float) -> tuple[float, Interval | None]:
    """Mean over N seeds and its 95 % interval after Student, which starts no lower than 0; None for one seed."""
    interval = student_interval(values)
    return float(np.mean(values)), None if interval is None else (max(interval[0], 0.0), interval[1])


def ratio_interval(parts: Float, wholes: Float) -> tuple[float, Interval | None]:
    """Geometric mean of N paired ratios of positive figures and its 95 % interval, Student's of their logarithms."""
    logs = np.log(parts / wholes)
    interval = student_interval(logs)
    ratio = math.exp(float(np.mean(logs)))
    return ratio, None if interval is None else (math.exp(interval[0]), math.exp(min(interval[1], 700.0)))


def mean_row(
    where: str,
    figure: TrackingStatistic,
    walks: Sequence[Tracked],
    paper: float | None = None,
    printed_step: float = 1.0,
    note: str = "",
    why_not: str = "",
    why_not_comparable: str = "",
) -> list[PaperRow]:
    """The mean of a figure over the walks that have it, judged where the paper prints it; no row when none has.

    why_not_comparable: what the paper leaves open, where that keeps ours from confirming or refuting its number.
    """
    values = figure.of(walks)
    if len(values) == 0:
        return []
    if len(values) < len(walks):
        note = " ".join(filter(None, [note, f"Of {len(values)} of {len(walks)} walks."]))
    quantity = f"{where}: {figure.called} ({figure.unit})"
    mean, interval = mean_interval(values)
    if paper is None:
        low, high = interval or (None, None)
        return [PaperRow(quantity, mean, None, low, high, note=note)]
    if why_not_comparable:
        why = " ".join(filter(None, [note, why_not_comparable]))
        return [not_comparable(quantity, paper, mean, interval, why)]
    return [compare(quantity, paper, printed_step, mean, interval, note, why_not)]


def fall_row(where: str, walks: Sequence[Tracked]) -> PaperRow:
    """The share of walks that fell."""
    fell = sum(walk.of("fallen") == 1 for walk in walks)
    share, interval = share_interval(fell, len(walks))
    return PaperRow(f"{where}: share of walks that fall (1)", share, None, *interval, note=f"{fell} of {len(walks)}.")


def ratio_row(
    quantity: str,
    figure: TrackingStatistic,
    parts: Sequence[Tracked],
    wholes: Sequence[Tracked],
    paper: float | None = None,
    note: str = "",
    *,
    is_claimed: bool = False,
) -> list[PaperRow]:
    """A figure of one way of walking over another's, by seeds that have both.

    It is judged where it is_claimed in words to be above 1, or where the paper prints a ratio above 1: all of our
    interval must lie above 1, and exceed it by NEGLIGIBLE of what the printed one does. That holds for the order; how
    much is in the columns. A single pair has no interval and cannot tell.
    """
    pairs = np.array([[a.of(figure.key), b.of(figure.key)] for a, b in zip(parts, wholes, strict=False)])
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    if len(pairs) == 0:
        return []
    if len(pairs) < len(parts):
        note = f"{note} Of {len(pairs)} seeds.".strip()
    ours, interval = ratio_interval(pairs[:, 0], pairs[:, 1])
    low, high = interval or (None, None)
    if paper is None and not is_claimed:
        return [PaperRow(quantity, ours, None, low, high, note=note)]
    assert paper is None or paper >= 1
    least = 1.0 if paper is None else 1 + NEGLIGIBLE * (paper - 1)
    verdict = Verdict.UNDECIDED if interval is None else judge_claim(least, ours, interval)
    if verdict is Verdict.NO:
        above = f"By less than a tenth of what is printed, {least:.4g}."
        note = f"{note} {'Ours is not above 1.' if high is None or high <= 1 else above}".strip()
    return [PaperRow(quantity, ours, paper, low, high, verdict, note)]


Ways = Mapping[str, Mapping[str, Sequence[Tracked]]]
"""By condition and by how was walked: the walks, in the order of their seeds."""


def error_panels(ways: Ways) -> list[Panel]:
    """The distance to the path over time, of the first walk of each."""
    panels = []
    for title, mine in ways.items():
        firsts = enumerate((name, walks[0]) for name, walks in mine.items())
        series = [Series(name, x=walk.t_s, y=walk.error_m, **look(k)) for k, (name, walk) in firsts]
        panels.append(Panel(f"{title}: distance to path (m)", series, zero=True))
    return panels


def eta_panels(ways: Ways) -> list[Panel]:
    """A dot for each walk's η, and the mean with its 95 % interval."""
    panels = []
    for title, mine in ways.items():
        rows = {}
        for number, (name, walks) in enumerate(mine.items()):
            eta_m = ETA.of(walks)
            rows[name] = Spread(*mean_interval(eta_m), eta_m, look(number)["color"])
        panels.append(forest(f"{title}: η (m)", rows, "η (m)", log=True))
    return panels
