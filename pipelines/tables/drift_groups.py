"""The groups of rows of the table foot-drift, and the sentence on what survives of the claim."""

from __future__ import annotations

from collections import Counter

import numpy as np

from quadlog.pipelines.tables.drift_rows import (
    DRIFT,
    FORWARD,
    PITCH,
    ROLL,
    SIGNED_DRIFT,
    SIGNED_TURN,
    TURN,
    Figure,
    change_row,
    changes,
    mean_interval,
    mean_row,
    side,
)
from quadlog.pipelines.tables.drift_study import SWEPT_ROBOTS, Study
from quadlog.pipelines.tables.drift_walks import BASELINE, DERIVED, ROBOTS, SYMMETRIC, Curve, Task
from quadlog.pipelines.tables.judging import compare
from quadlog.results.paper_rows import PaperRow, RowGroup

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
            rows.append(compare(quantity, paper, step, mean, interval, why_not=WHY_NOT[figure]))
    text = (
        "The paper describes a symmetric robot. Drift and yaw rate are sizes, whatever the side. Intervals here and "
        "below: 95 % after Student over the seeds."
    )
    return RowGroup("The robot as described", text, tuple(rows))


def _size(figure: Figure) -> str:
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
        "does without y(t), with its sign; then what y(t) changes of the sizes, on the same seeds. It reproduces where "
        "the interval lies wholly on the claimed side of 0."
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
    return f"{1e3 * study.drifts[Task(robot, curve, study.seeds[0])].peak_m:.1f}"


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


def _sides(study: Study, curves: dict[str, Curve], figure: Figure) -> Counter[int]:
    return Counter(_side(study, robot, curve, figure) for robot, curve in curves.items())


def _side(study: Study, robot: str, curve: Curve, figure: Figure) -> int:
    return side(mean_interval(changes(study.drifts, robot, curve, study.seeds, figure))[1])
