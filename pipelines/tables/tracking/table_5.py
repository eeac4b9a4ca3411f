"""The table tracking-5: three controllers on the S-curve, and what the fuzzy rules have to beat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadlog.control.following.lookahead import HONEST
from quadlog.pipelines.tables.intervals import share_interval
from quadlog.pipelines.tables.pictures import drawn
from quadlog.pipelines.tables.tracking.walks import (
    CHOOSING_SEEDS,
    CONDITIONS,
    ETA,
    ETA_TIME,
    HEIGHT,
    LOOKAHEAD,
    LOOKAHEAD_RANGE,
    PITCH,
    SATURATED,
    SIGMA,
    SIGMA_TIME,
    TIME,
    TORQUE,
    YAW_ERROR,
    Steering,
    Tracked,
    TrackingStatistic,
    TrackingTask,
    error_panels,
    eta_panels,
    fall_row,
    held_out_seeds,
    mean_row,
    ratio_row,
    walk_all,
)
from quadlog.results.numbers import count
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, TablePicture

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

    then: dict[tuple[str, str], list[TrackingTask]] = {}
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


def _tasks(steering: Steering, condition: str, seeds: range | tuple[int, ...] | list[int]) -> list[TrackingTask]:
    return [TrackingTask("s-curve", "course", steering, CONDITIONS[condition], each) for each in seeds]


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


NAMES = tuple(each.name for each in CONTROLLERS)
PRINTED_ETA = dict(zip(NAMES, (0.2801, 0.2933, 0.5133), strict=True))
PRINTED_SIGMA = dict(zip(NAMES, (0.1957, 0.1981, 0.3822), strict=True))
PRINTED_S = dict(zip(NAMES, (64.0, 68.0, 75.0), strict=True))
PRINTED: dict[TrackingStatistic, tuple[dict[str, float], float]] = {
    ETA: (PRINTED_ETA, 1e-4),
    SIGMA: (PRINTED_SIGMA, 1e-4),
    ETA_TIME: (PRINTED_ETA, 1e-4),
    SIGMA_TIME: (PRINTED_SIGMA, 1e-4),
    TIME: (PRINTED_S, 1.0),
}
"""Table 5, which does not say what its errors are: either of ours stands beside them. With the last digit."""
CURVED = (YAW_ERROR, TORQUE, SATURATED, LOOKAHEAD, LOOKAHEAD_RANGE)
"""What Figs 28 and 29 draw over time, beside the errors; no number of it is printed."""
INTERVALS = "Intervals: 95 % after Student over the seeds; shares of walks after Wilson."
RATIO_INTERVALS = "Intervals: 95 % after Student, of the logarithms over the seeds."


def number_group(condition: str, measured: Measured) -> RowGroup:
    """Table 5 as printed beside ours."""
    rows: list[PaperRow] = []
    for name in NAMES:
        walks, where = measured[condition, name], f"{condition}, {name}"
        for figure, (printed, step) in PRINTED.items():
            why = _why_not_comparable(figure, printed[name], walks)
            rows += mean_row(where, figure, walks, printed[name], step, why_not_comparable=why)
        rows.append(fall_row(where, walks))
        for figure in (PITCH, HEIGHT, *CURVED):
            rows += mean_row(where, figure, walks)
    conditions = (
        "The pose is known exactly and nothing pushes; the seed draws the ground."
        if condition == "ideal"
        else "As `quadlog simulate --disturbed`: a push of 60 N to a side every 2 s, wrong velocities, a noisy and "
        "late pose, a wrong mass. The seed draws them and the ground."
    )
    text = (
        f"{conditions} η, σ: mean and standard deviation of the distance to the path; beside the place in time: to "
        "where a robot without delay would be. A walk that falls counts until it falls, and has no completion time. "
        f"Pitch and height rms are against what the controller wants on that ground. {INTERVALS}"
    )
    return RowGroup(f"Table 5, {condition}", text, tuple(rows))


def _why_not_comparable(figure: TrackingStatistic, printed: float, walks: list[Tracked]) -> str:
    values = figure.of(walks)
    if len(values) == 0 or figure is TIME:
        return "The lengths of the paper's course and its pauses are not printed; ours is 30.8 m at 0.5 m/s."
    times = printed / float(np.mean(values))
    less = f"{times:.1f} times less" if times > 1 else f"{1 / times:.1f} times more"
    return f"Ours is {less}; the paper walked outdoors, one walk each, and its course and pose source are not printed."


def order_group(measured: Measured) -> RowGroup:
    """FpMW < FpM < pMW, as printed."""
    rows: list[PaperRow] = []
    for condition in CONDITIONS:
        walks = {name: measured[condition, name] for name in NAMES}
        rows.append(_order_row(condition, walks))
        for figure, (printed, _) in PRINTED.items():
            for name in NAMES[1:]:
                quantity = f"{condition}: {figure.called}, {name} / FpMW (1)"
                rows += ratio_row(quantity, figure, walks[name], walks["FpMW"], printed[name] / printed["FpMW"])
        step = f"{condition}: {ETA.called}, pMW / FpM (1)"
        rows += ratio_row(step, ETA, walks["pMW"], walks["FpM"], PRINTED_ETA["pMW"] / PRINTED_ETA["FpM"])
        for figure in (PITCH, HEIGHT):
            rows += ratio_row(f"{condition}: {figure.called}, FpM / FpMW (1)", figure, walks["FpM"], walks["FpMW"])
    text = (
        "Table 5's order is FpMW, FpM, pMW in all of its rows. A ratio reproduces where our interval lies above 1 as "
        "printed, by a tenth of the printed difference at least: that is the order, whatever its size. Walks are "
        f"paired by seed. {RATIO_INTERVALS}"
    )
    return RowGroup("The order of the three", text, tuple(rows))


def _order_row(condition: str, walks: dict[str, list[Tracked]]) -> PaperRow:
    """In how many seeds η is in the printed order, which its two steps are judged by."""
    eta_m = np.array([ETA.of(walks[name]) for name in NAMES])
    holds = int((np.diff(eta_m, axis=0) > 0).all(axis=0).sum())
    share, interval = share_interval(holds, eta_m.shape[1])
    called = ", ".join(f"{name} {median:.4f} m" for name, median in zip(NAMES, np.median(eta_m, axis=1), strict=True))
    quantity = f"{condition}: share of seeds with η of FpMW < FpM < pMW (1)"
    return PaperRow(quantity, share, None, *interval, note=f"{holds} of {eta_m.shape[1]}. Medians: {called}.")


def honesty_group(measured: Measured, scan: Scan) -> RowGroup:
    """Fuzzy rules against fixed look-aheads, with MPC and whole-body control throughout."""
    rows: list[PaperRow] = []
    for condition in CONDITIONS:
        if (condition, BEST_FIXED) not in measured:
            continue
        walks = {name: mine for (where, name), mine in measured.items() if where == condition}
        chosen = f"Chosen among {', '.join(f'{length_m:g}' for length_m in LENGTHS_M)} m on {_choosing_seeds()}."
        rows.append(PaperRow(f"{condition}: best fixed look-ahead (m)", best_fixed_m(condition, scan), note=chosen))
        for name in (BEST_FIXED, SAME_MEAN, TUNED.name, TUNED_SAME_MEAN):
            where = f"{condition}, {name}"
            rows += mean_row(where, ETA, walks[name])
            rows += mean_row(where, SIGMA, walks[name])
            rows += mean_row(where, LOOKAHEAD, walks[name])
            rows += [fall_row(where, walks[name])]
        for fuzzy, rival in (
            ("FpMW", SAME_MEAN),
            ("FpMW", BEST_FIXED),
            (TUNED.name, TUNED_SAME_MEAN),
            (TUNED.name, BEST_FIXED),
        ):
            quantity = f"{condition}: η, {fuzzy} / {rival} (1)"
            (row,) = ratio_row(quantity, ETA, walks[fuzzy][: len(walks[rival])], walks[rival])
            rows.append(PaperRow(row.quantity, row.ours, None, row.low, row.high, note=_verdict(row)))
    text = (
        "pMW looks 2 m ahead and FpMW less: so part of what it gains, a fixed look-ahead gains too. Each rival has MPC "
        "and whole-body control. Of the same mean: each seed's fixed look-ahead is the mean of the fuzzy walk on that "
        "seed. Tuned rules: only k_v acts, the error counts 20 times, its rate is filtered, l stays within 0.5 to 2 m. "
        f"Below 1 the rules help. {INTERVALS} Of ratios, of their logarithms."
    )
    return RowGroup("Do the fuzzy rules help?", text, tuple(rows))


def _verdict(row: PaperRow) -> str:
    if row.low is None or row.high is None:
        return "One walk each."
    if row.high < 1:
        return "The rules help."
    return "The rules do harm." if row.low > 1 else "No difference is seen."


def _choosing_seeds() -> str:
    return f"seeds {' and '.join(map(str, CHOOSING_SEEDS))}"


def scan_group(scan: Scan) -> RowGroup:
    """What the best fixed look-ahead was chosen from."""
    rows = [
        row
        for (condition, length_m), walks in scan.items()
        for row in mean_row(f"{condition}, fixed l {length_m:g} m", ETA, walks)
    ]
    text = (
        f"Pure pursuit with one look-ahead, MPC and whole-body control, on {_choosing_seeds()}, which are reported "
        "nowhere else. The smallest η without a fall is taken. Intervals: 95 % after Student over only two seeds, "
        "hence wide."
    )
    return RowGroup("The choice of the best fixed look-ahead", text, tuple(rows))


SENSITIVE = CONTROLLERS[:2]
"""With whole-body control and without; how far ahead they look is the same."""
SHARES, FRICTIONS = (0.3, 0.6, 1.0), (0.65, 0.8, 1.0)
"""Of mpc.turning_share and simulation.friction; on the ground of some seeds no foot holds at 0.6."""
SENSITIVE_WALKS, FAST_SENSITIVE_WALKS = 5, 1

Varied = dict[tuple[str, str, float], list[Tracked]]
"""By controller, key and its value: ideal walks, those at the defaults too."""


def measure_sensitivity(walks: int, seed: int) -> Varied:
    """Every value of the two keys, the other at its default."""
    tasks = {
        (each.name, key, value): [vary(task, value) for task in _tasks(each, "ideal", held_out_seeds(walks, seed))]
        for each in SENSITIVE
        for key, vary, values in (("turning share", _with_share, SHARES), ("friction", _with_friction, FRICTIONS))
        for value in values
    }
    done = iter(walk_all([task for mine in tasks.values() for task in mine]))
    return {which: [next(done) for _ in mine] for which, mine in tasks.items()}


def _with_share(task: TrackingTask, share: float) -> TrackingTask:
    return replace(task, turning_share=share)


def _with_friction(task: TrackingTask, friction: float) -> TrackingTask:
    return replace(task, friction=friction)


def sensitivity_group(varied: Varied) -> RowGroup:
    """What two constants of ours decide."""
    rows = [
        row
        for (name, key, value), walks in varied.items()
        for row in (
            *mean_row(f"{name}, {key} {value:g}", ETA, walks),
            *mean_row(f"{name}, {key} {value:g}", PITCH, walks),
            fall_row(f"{name}, {key} {value:g}", walks),
        )
    ]
    text = (
        "Two constants that the paper does not print, ideal walks. Turning share (mpc.turning_share, 0.6 by default): "
        "the share of the standing robot's inertia that the MPC takes to turn with the trunk. Without whole-body "
        "control (FpM) it decides whether the robot stays on its feet, and with it the order of FpMW and FpM. "
        "Friction between feet and ground (simulation.friction, 0.8 by default): the controllers count on 0.6 "
        f"throughout. A walk that falls counts until it falls. {INTERVALS}"
    )
    return RowGroup("What our constants decide", text, tuple(rows))


FULL_WALKS, FAST_WALKS = 10, 2
ERRATUM = (
    "Eq. 45 does not say which predicted position an error is measured from: both the nearest point of the path and "
    "the place in time are given. Eqs 46 and 47 sum to N and divide by N_e; here both are all ticks."
)


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table from one seed; fast walks less often, and hardly ever with another look-ahead."""
    walks = FAST_WALKS if fast else FULL_WALKS
    measured, scan = measure_controllers(walks, seed, fast)
    varied = measure_sensitivity(FAST_SENSITIVE_WALKS if fast else SENSITIVE_WALKS, seed)
    scanned = (scan_group(scan),) if scan else ()
    seeds = held_out_seeds(walks, seed)
    return PaperTable(
        name="tracking-5",
        title="Three controllers on an S-curve [Tracking, Table 5]",
        caption="A quadruped follows an S-curve, up 15° and down 20°, by fuzzy pure pursuit with MPC and whole-body "
        "control (FpMW), without whole-body control (FpM), and with a fixed look-ahead instead of the fuzzy one (pMW, "
        "l = 2 m). The paper did it outdoors with a robot of its own, once each. Here it is simulated, on a course of "
        "the same slopes and roughness whose lengths are ours (30.8 m at 0.5 m/s).",
        sizes=f"{count(walks)} walks of each controller, ideal and disturbed, seed {seed}: walks drawn from seeds "
        f"{seeds[0]} to {seeds[-1]}. "
        + (
            f"Other look-aheads: {count(FAST_RIVAL_WALKS)} ideal walk each, the best fixed one from an earlier full "
            f"run, chosen on seeds {CHOOSING_SEEDS[0]} and {CHOOSING_SEEDS[1]}."
            if fast
            else f"Other look-aheads walk as often, the best fixed one is chosen on seeds {CHOOSING_SEEDS[0]} and "
            f"{CHOOSING_SEEDS[1]}."
        ),
        seed=seed,
        fast=fast,
        groups=(
            *(number_group(condition, measured) for condition in CONDITIONS),
            order_group(measured),
            honesty_group(measured, scan),
            *scanned,
            sensitivity_group(varied),
        ),
        pictures=_pictures(measured, seed),
        errata=(ERRATUM,),
    )


def _pictures(measured: Measured, seed: int) -> tuple[TablePicture, ...]:
    three = {condition: {name: measured[condition, name] for name in NAMES} for condition in CONDITIONS}
    everything = {
        condition: {name: measured[condition, name] for name in (*NAMES, *RIVALS) if (condition, name) in measured}
        for condition in CONDITIONS
    }
    return (
        drawn(
            "errors",
            "Distance to the path over time of FpMW, FpM and pMW, undisturbed above, disturbed below.",
            f"The walks of seed {held_out_seeds(1, seed)[0]}. It grows where bends begin and end; a fall ends it.",
            error_panels(three),
        ),
        drawn(
            "eta",
            "Mean error of each walk by controller and by rival look-ahead, with means and intervals.",
            "A small dot for each walk; a large one for the mean over the seeds and its 95 % interval. The "
            "rivals below the three controllers have MPC and whole-body control.",
            eta_panels(everything),
        ),
    )
