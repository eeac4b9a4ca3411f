"""The table foot-drift: how far asymmetric robots drift with and without y(t), and what survives of the claim."""

from __future__ import annotations

from collections import Counter

import numpy as np

from quadlog.pipelines.tables.foot.drift_walks import (
    BASELINE,
    CHOOSING_SEEDS,
    DERIVED,
    DRIFT,
    FORWARD,
    FRICTION,
    FRICTION_ROBOTS,
    OTHER_FRICTIONS,
    PITCH,
    ROBOTS,
    ROLL,
    SIGNED_DRIFT,
    SIGNED_TURN,
    SWEPT_ROBOTS,
    SYMMETRIC,
    TURN,
    Curve,
    DriftStatistic,
    DriftTask,
    Study,
    change_row,
    changes,
    mean_interval,
    mean_row,
    measure_drifts,
    side,
)
from quadlog.pipelines.tables.intervals import compare, not_comparable
from quadlog.pipelines.tables.pictures import drawn
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, TablePicture
from quadlog.results.view import Panel, Series, Spread, forest, look

MUCH_MM = 100.0
PRINTED = (
    ("without y(t)", BASELINE, ((DRIFT, 280.0, 10.0), (TURN, 0.25, 0.01), (ROLL, 7.5, 0.5), (PITCH, 6.0, 1.0))),
    ("with y(t)", DERIVED, ((DRIFT, 40.0, 10.0), (TURN, 0.03, 0.01), (ROLL, 7.5, 0.5), (PITCH, 6.0, 1.0))),
)
"""Sizes that the paper prints, with their last digits; roll from -2 to 5.5 degrees, pitch from -3 to 3 in both."""
WHY_NOT = {
    DRIFT: "A symmetric robot hardly drifts; what makes the paper's drift is not said.",
    TURN: "A symmetric robot hardly turns.",
    ROLL: "Trunk and hips are ours: the paper gives no measures.",
    PITCH: "Trunk and hips are ours: the paper gives no measures.",
}


def as_described_group(study: Study) -> RowGroup:
    """The robot as the paper describes it beside what the paper prints."""
    rows: list[PaperRow] = []
    for where, curve, printed in PRINTED:
        for figure, paper, step in printed:
            mean, interval = mean_interval(figure.of(study.drifts, SYMMETRIC, curve, study.seeds))
            quantity = f"{SYMMETRIC}, {where}: {_size(figure)}"
            if figure in (ROLL, PITCH):
                rows.append(not_comparable(quantity, paper, mean, interval, WHY_NOT[figure]))
            else:
                rows.append(compare(quantity, paper, step, mean, interval, why_not=WHY_NOT[figure]))
    text = (
        "The paper describes a symmetric robot. Drift and yaw rate are sizes, whatever the side. Intervals here and "
        "below: 95 % after Student over the seeds."
    )
    return RowGroup("The robot as described", text, tuple(rows))


def _size(figure: DriftStatistic) -> str:
    return f"{'size of ' if figure.size else ''}{figure.called} ({figure.unit})"


def derived_group(study: Study) -> RowGroup:
    """What the curve as it is derived changes on every robot."""
    rows = [
        row
        for robot in ROBOTS
        for row in (
            *(
                mean_row(study.drifts, robot, BASELINE, study.seeds, each, robot)
                for each in (SIGNED_DRIFT, SIGNED_TURN)
            ),
            *(
                change_row(study.drifts, robot, DERIVED, study.seeds, each, f"{robot}, with y(t)")
                for each in (DRIFT, TURN, FORWARD)
            ),
        )
    ]
    text = (
        f"y(t) alternates with the pair, k = {DERIVED.k:g}/m on every robot: {_peak_mm(study, SYMMETRIC, DERIVED)} mm, "
        "computed from the plan, as nobody tells the robot what it carries or how it is built. First what the robot "
        "does without y(t), with its sign; then what y(t) changes of the sizes, on the same seeds. The paper claims "
        "less drift and a lower yaw rate, printed as 280 to 40 mm and 0.25 to 0.03 °/s, and a longer way in words. It "
        "reproduces where the interval lies wholly on the claimed side of 0, and beyond a tenth of what is printed."
    )
    return RowGroup("The derived curve on symmetric and asymmetric robots", text, tuple(rows))


def chosen_group(study: Study) -> RowGroup:
    """The same with a curve chosen for each robot, as the paper chose its k."""
    rows = [
        change_row(study.drifts, robot, curve, study.seeds, each, f"{robot}, {kind} chosen", _described(curve))
        for robot in ROBOTS
        for kind, curve in zip(("alternating", "same side"), study.chosen[robot], strict=True)
        for each in (DRIFT, TURN)
    ]
    text = (
        "The paper chose k by several simulations. Here, for every robot, the curve that turned least on two other "
        "seeds: of alternating ones with k = 350, 175, 88, and of ones to the same side with every swing, k = 350 and "
        "700 to the left and to the right. The latter is not what the paper derives, but a trim: k = 700, or 2.5 mm, "
        "turns the symmetric robot by 0.15 °/s, more than robots need that hardly turn."
    )
    return RowGroup("Curves chosen for each robot", text, tuple(rows))


def _described(curve: Curve) -> str:
    return f"k = {curve.k:g}/m."


def sweep_group(study: Study) -> RowGroup:
    """How drift and yaw rate go with k, with their signs."""
    rows = [
        mean_row(study.drifts, robot, curve, study.sweep_seeds, each, f"{robot}, {_name(study, robot, curve)}")
        for robot in SWEPT_ROBOTS
        for curve in study.swept
        for each in (SIGNED_DRIFT, SIGNED_TURN)
    ]
    text = (
        "Peaks of y(t) in mm, left positive: of right fore and left hind leg where it alternates, of all legs where it "
        "is to the same side. Eased: at rest at both ends of the swing."
    )
    return RowGroup("Sweep of k", text, tuple(rows))


def _name(study: Study, robot: str, curve: Curve) -> str:
    eased = ", eased" if curve.shape == "eased" else ""
    return f"{curve.lateral}{eased}, k = {curve.k:g}/m, {_peak_mm(study, robot, curve)} mm"


def _peak_mm(study: Study, robot: str, curve: Curve) -> str:
    return f"{1e3 * study.drifts[DriftTask(robot, curve, study.seeds[0])].peak_m:.1f}"


def friction_group(study: Study) -> RowGroup:
    """What the curve changes by the friction of the ground, a constant of ours."""
    rows = []
    for robot in FRICTION_ROBOTS:
        for friction in sorted((FRICTION, *OTHER_FRICTIONS)):
            for figure in (DRIFT, TURN):
                mean, interval = mean_interval(
                    changes(study.drifts, robot, DERIVED, study.sweep_seeds, figure, friction)
                )
                quantity = f"{robot}, friction {friction:g}, with y(t): change of {figure.called} ({figure.unit})"
                rows.append(PaperRow(quantity, mean, None, *interval))
    text = (
        f"The paper prints no friction; ours is {FRICTION:g}. The derived curve again, on ground that is more and less "
        f"slippery, seeds {study.sweep_seeds[0]} to {study.sweep_seeds[-1]}. Intervals: 95 % after Student."
    )
    return RowGroup("What friction decides", text, tuple(rows))


def surviving_group(study: Study) -> RowGroup:
    """How many robots each part of the claim holds for, and in words."""
    kinds = {"the derived curve": dict.fromkeys(ROBOTS, DERIVED)}
    if study.chosen:
        for place, kind in enumerate(("an alternating curve chosen for it", "a same-sided curve chosen for it")):
            kinds[kind] = {robot: curves[place] for robot, curves in study.chosen.items()}
    rows: list[PaperRow] = []
    sentences: list[str] = []
    for kind, curves in kinds.items():
        counts = {figure: _sides(study, curves, figure) for figure in (DRIFT, TURN, FORWARD)}
        rows += [
            PaperRow(f"{kind}: robots that drift less (of {len(ROBOTS)})", counts[DRIFT][-1]),
            PaperRow(f"{kind}: robots that drift more (of {len(ROBOTS)})", counts[DRIFT][1]),
            PaperRow(f"{kind}: robots that turn less (of {len(ROBOTS)})", counts[TURN][-1]),
            PaperRow(f"{kind}: robots that turn more (of {len(ROBOTS)})", counts[TURN][1]),
            PaperRow(f"{kind}: robots that walk farther (of {len(ROBOTS)})", counts[FORWARD][1]),
        ]
        sentences.append(
            f"With {kind}, {counts[DRIFT][-1]} of {len(ROBOTS)} robots drift less and {counts[DRIFT][1]} more, "
            f"{counts[TURN][-1]} turn less and {counts[TURN][1]} more, and {counts[FORWARD][1]} walk farther."
        )
    text = (
        f"{_verdict(study)} {' '.join(sentences)} {_drifting(study)} Less, more and farther: where the interval of the "
        "change, on the same seeds, leaves out 0."
    )
    return RowGroup("What survives of the claim", text, tuple(rows))


def _verdict(study: Study) -> str:
    """In words what the derived curve does for more than half of the robots, and for which it does the rest."""
    helped = {
        name: [robot for robot in ROBOTS if _side(study, robot, DERIVED, figure) == wanted]
        for name, figure, wanted in (
            ("less drift", DRIFT, -1),
            ("a lower yaw rate", TURN, -1),
            ("a longer way", FORWARD, 1),
        )
    }
    holds = [name for name, robots in helped.items() if 2 * len(robots) > len(ROBOTS)]
    rest = [f"{name} ({'; '.join(robots) or 'on no robot'})" for name, robots in helped.items() if name not in holds]
    survives = f"On most robots {' and '.join(holds) or 'nothing'} survives of the claim"
    return f"{survives}; not {', nor '.join(rest)}." if rest else f"{survives}."


def _drifting(study: Study) -> str:
    """What becomes of the mean drift of robots whose drift is of the size of the paper's."""
    parts = []
    for robot in ROBOTS:
        curves = {"without y(t)": BASELINE, "with the derived one": DERIVED}
        if study.chosen:
            curves["with a trim to one side"] = study.chosen[robot][1]
        means = {how: float(np.mean(DRIFT.of(study.drifts, robot, each, study.seeds))) for how, each in curves.items()}
        if means["without y(t)"] >= MUCH_MM:
            parts.append(f"{robot}: " + ", ".join(f"{mean:.0f} mm {how}" for how, mean in means.items()))
    return f"Robots that drift by {MUCH_MM:.0f} mm and more: {'; '.join(parts) or 'none'}."


def _sides(study: Study, curves: dict[str, Curve], figure: DriftStatistic) -> Counter[int]:
    return Counter(_side(study, robot, curve, figure) for robot, curve in curves.items())


def _side(study: Study, robot: str, curve: Curve, figure: DriftStatistic) -> int:
    return side(mean_interval(changes(study.drifts, robot, curve, study.seeds, figure))[1])


WAYS = {"without y(t)": BASELINE, "derived y(t)": DERIVED}
PRINTED_MM = (280.0, 40.0)
LEAST_MM = 0.5


def walk_panels(study: Study) -> list[Panel]:
    """Place aside and yaw over time of each robot."""
    panels = []
    for robot in SWEPT_ROBOTS:
        walks = {name: study.drifts[DriftTask(robot, curve, study.seeds[0])] for name, curve in WAYS.items()}
        for what, factor, column in (("y, to the left (mm)", 1e3, "y_m"), ("yaw (°)", np.degrees(1.0), "yaw_rad")):
            curves = enumerate(walks.items())
            series = [Series(name, x=of.t_s, y=factor * getattr(of, column), **look(k)) for k, (name, of) in curves]
            panels.append(Panel(f"{robot}: {what}", series))
    return panels


def size_panel(study: Study) -> Panel:
    """A row for each robot and curve: a dot for each walk, and their mean."""
    ways = {name: dict.fromkeys(ROBOTS, curve) for name, curve in WAYS.items()}
    for place, name in enumerate(("alternating, chosen", "same side, chosen") if study.chosen else ()):
        ways[name] = {robot: curves[place] for robot, curves in study.chosen.items()}
    rows = {}
    for robot in ROBOTS:
        for number, (name, curves) in enumerate(ways.items()):
            sizes_mm = _sizes_mm(study, robot, curves[robot])
            rows[f"{robot}, {name}"] = Spread(float(sizes_mm.mean()), None, sizes_mm, look(number)["color"])
    what = "size of the drift after 30 s (mm)"
    return forest(what, rows, what, log=True, marks=PRINTED_MM)


def _sizes_mm(study: Study, robot: str, curve: Curve) -> np.ndarray:
    """(N,) a logarithmic axis has no place for 0."""
    return np.maximum(DRIFT.of(study.drifts, robot, curve, study.seeds), LEAST_MM)


ERRATA = (
    "Eqs 9 and 10: x(t) and y(t) of the swing hold on [0, λT), its z(t) is -h + z(t); in stance y = 0 on [λT, T).",
    (
        "Eqs 8, 11 and 12: x and y are interchanged. M is gravity's moment about x, 4 m g d L_x (L_y + 2 L_1) / D², "
        "which alternates with the pair, and y(t) = M / (4 k J_1) t (t - T/2), printed with a square term 16 times too "
        "large; its peak is M T² / (64 k J_1). T/2 presumes λ = 1/2, and k has the unit 1/m."
    ),
    (
        "Eq. 12: y(t) has the speed M T / (8 k J_1) at lift-off and touch-down, where x(t) and z(t) have neither speed "
        "nor acceleration: 80 mm/s for a peak of 10 mm. The eased form, our (4 s (1 - s))³, is at rest there."
    ),
)


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast walks less often, and chooses no curve for a robot."""
    study = measure_drifts(fast, seed)
    chosen = () if fast else (chosen_group(study),)
    seeds = study.seeds
    choosing = (
        ""
        if fast
        else f" Curves are chosen on seeds {CHOOSING_SEEDS[0]} and {CHOOSING_SEEDS[1]}, which are not reported."
    )
    return PaperTable(
        name="foot-drift",
        title="Drift of a 32 s trot, without and with a 3-D foot curve [Foot, Figs 5-6]",
        caption="A robot of 10 kg with legs of 0.4 kg trots for 30 s after 2 s of rest: T = 1 s, S = 40 mm, H = 20 mm, "
        "knees behind, joints driven to angles (300 N m/rad, 6 N m s/rad). The 3-D curve swings feet aside by y(t) as "
        "well. The paper's robot drifts 280 mm without and 40 mm with it; which asymmetry makes a robot drift that is "
        "sent straight on, and what k is, it does not say. Hips, trunk and friction are ours.",
        sizes=f"{len(seeds)} walks of each robot and curve, {len(study.sweep_seeds)} in the sweep of k; seeds "
        f"{seeds[0]} to {seeds[-1]}. A seed draws friction within 25 % of 0.8, the feet's radius within 10 % of 20 mm, "
        f"and each joint's start within 1°.{choosing}",
        seed=seed,
        fast=fast,
        groups=(
            surviving_group(study),
            as_described_group(study),
            derived_group(study),
            *chosen,
            sweep_group(study),
            friction_group(study),
        ),
        pictures=_pictures(study),
        errata=ERRATA,
    )


def _pictures(study: Study) -> tuple[TablePicture, ...]:
    return (
        drawn(
            "walks",
            "Place aside and yaw over time of the symmetric and of two loaded robots, without and with the curve.",
            f"The walks of seed {study.seeds[0]} [Foot, Figs 5b and 6c].",
            walk_panels(study),
        ),
        drawn(
            "sizes",
            "Size of the drift of every walk, by robot and curve, with means.",
            "A small dot for each walk, a large one for their mean. Dotted: the paper's 280 and 40 mm.",
            [size_panel(study)],
        ),
    )
