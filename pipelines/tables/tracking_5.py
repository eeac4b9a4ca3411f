"""tracking-5: three controllers on the S-curve [Tracking, Table 5]; and the walks of both tables on tracking."""

from __future__ import annotations

import numpy as np

from quadlog.config.schema import Config
from quadlog.metrics.catalogue import THEMES
from quadlog.pipelines.simulation.courses import find_course, make_ground
from quadlog.pipelines.simulation.simulate import walk_metrics
from quadlog.pipelines.simulation.walk import walk_once
from quadlog.pipelines.tables.claims import Claim, Figures, Group, Study, StudyTable, Where, grid, held_out_seeds, order
from quadlog.pipelines.tables.judge import SHARE, SIZE, not_comparable
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
"""l, or l0 of the fuzzy rules, as printed; so are the rules."""


def config_of(terrain: str, steering: str, disturbed: bool) -> Config:
    """As a file of `quadlog simulate` would have it."""
    simulation = {"controller": steering.lower(), "terrain": terrain}
    return Config.model_validate(
        {
            "pursuit": {"lookahead_m": LOOKAHEAD_M, "fuzzy": {"tables": "printed"}},
            "simulation": {**simulation, "disturbances": DISTURBED.model_dump() if disturbed else {}},
        }
    )


def track(course: str, terrain: str, steering: str, condition: str, seed: int) -> Figures:
    """One walk: its metrics, but for how fast it was simulated, and figures of its look-ahead and velocity."""
    config = config_of(terrain, steering, CONDITIONS[condition])
    found = find_course(course, config)
    simulated = walk_once(found, config, make_ground(course, found, config, seed), seed)
    control = simulated.walk.control
    metrics = walk_metrics(simulated)
    figures = {name: metric.value for name, metric in metrics.items() if name not in THEMES["Computing"]}
    return figures | {
        "lookahead_range_m": float(np.ptp(control["lookahead_m"])),
        "speed_mean_mps": float(np.mean(control["vx_mps"])),
        "speed_std_mps": float(np.std(control["vx_mps"])),
        "yaw_rate_std_radps": float(np.std(control["yaw_rate_radps"])),
    }


def fall_row(which: str, where: Where) -> Claim:
    """The share of walks that fall."""
    return Claim(f"{which}: share of walks that fall (1)", "fallen", where, statistic=SHARE)


NAMES = ("FpMW", "FpM", "pMW")
ETA, SIGMA, TIME = (0.2801, 0.2933, 0.5133), (0.1957, 0.1981, 0.3822), (64.0, 68.0, 75.0)
PRINTED = {"eta_m": ETA, "sigma_m": SIGMA, "eta_time_m": ETA, "sigma_time_m": SIGMA, "completion_time_s": TIME}
"""Table 5, which does not say what its errors are: either of ours stands beside them."""
CLAIMS = {"eta_m": "η", "sigma_m": "σ", "eta_time_m": "η", "sigma_time_m": "σ", "completion_time_s": "completion time"}
ELSEWHERE = "The paper walked outdoors, one walk each; its course and pose source are not printed."
PAUSES = "The lengths of the paper's course and its pauses are not printed; ours is 30.8 m at 0.5 m/s."


def number_rows(condition: str) -> list[Claim]:
    """Table 5 as printed beside ours."""
    rows: list[Claim] = []
    for at, name in enumerate(NAMES):
        which, where = f"{condition}, {name}", {"condition": condition, "steering": name}
        for column, printed in PRINTED.items():
            judge = not_comparable(printed[at], PAUSES if column == "completion_time_s" else ELSEWHERE)
            quantity = f"{which}: {FIGURES[column]}"
            rows.append(Claim(quantity, column, where, judge, SIZE, of=f"{CLAIMS[column]} of {name}"))
        rows.append(fall_row(which, where))
    return rows


def order_rows(condition: str) -> list[Claim]:
    """FpMW < FpM < pMW, as printed."""
    rows: list[Claim] = []
    pairs = [(column, name, "FpMW") for column in PRINTED for name in NAMES[1:]] + [("eta_m", "pMW", "FpM")]
    for column, more, less in pairs:
        printed = PRINTED[column][NAMES.index(more)] / PRINTED[column][NAMES.index(less)]
        quantity = f"{condition}: {FIGURES[column].rpartition(' (')[0]}, {more} / {less} (1)"
        of = f"order in {CLAIMS[column]}: {more} after {less}"
        sides = {"steering": more}, {"steering": less}
        rows.append(order(quantity, column, {"condition": condition}, *sides, printed, of))
    return rows


def table(fast: bool, seed: int) -> StudyTable:
    """Fast walks less often, and only with disturbances."""
    seeds, conditions = held_out_seeds(2 if fast else 10, seed), ["disturbed"] if fast else list(CONDITIONS)
    points = grid(course=["s-curve"], terrain=["course"], steering=NAMES, condition=conditions, seed=seeds)
    return StudyTable(
        title="Three controllers on an S-curve [Tracking, Table 5]",
        caption="A quadruped follows an S-curve, up 15° and down 20°, by fuzzy pure pursuit with MPC and whole-body "
        "control (FpMW), without whole-body control (FpM), and with a fixed look-ahead instead of the fuzzy one (pMW, "
        "l = 2 m). The paper did it outdoors with a robot of its own, once each. Here it is simulated, on a course of "
        "the same slopes and roughness whose lengths are ours (30.8 m at 0.5 m/s).",
        sizes=f"{len(seeds)} walks of each controller, {' and '.join(conditions)}, seed {seed}: walks drawn from seeds "
        f"{seeds[0]} to {seeds[-1]}.",
        study=Study(track, points),
        groups=[
            *(
                Group(f"Table 5, {condition}", f"{GROUNDS[condition]} {ERRORS}", number_rows(condition))
                for condition in CONDITIONS
            ),
            Group(
                "The order of the three",
                "Table 5's order is FpMW, FpM, pMW in all of its rows. It is judged, and not by how much: our interval "
                "has to lie above 1, by a tenth of the printed difference at least. Walks are paired by seed. "
                "Geometric means; intervals: Student, of the logarithms.",
                [row for condition in CONDITIONS for row in order_rows(condition)],
            ),
        ],
    )
