"""Groups of the table tracking-5: Table 5's numbers, its order, and whether the fuzzy rules help."""

from __future__ import annotations

import numpy as np

from quadlog.pipelines.tables.judging import share_interval
from quadlog.pipelines.tables.tracked_s_curve import (
    BEST_FIXED,
    CONTROLLERS,
    LENGTHS_M,
    SAME_MEAN,
    TUNED,
    TUNED_SAME_MEAN,
    Measured,
    Scan,
    best_fixed_m,
)
from quadlog.pipelines.tables.tracked_walks import CHOOSING_SEEDS, CONDITIONS, Tracked
from quadlog.pipelines.tables.tracking_figures import (
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
    Figure,
    fall_row,
    mean_row,
    ratio_row,
)
from quadlog.results.paper_rows import PaperRow, RowGroup

NAMES = tuple(each.name for each in CONTROLLERS)
PRINTED_ETA = dict(zip(NAMES, (0.2801, 0.2933, 0.5133), strict=True))
PRINTED_SIGMA = dict(zip(NAMES, (0.1957, 0.1981, 0.3822), strict=True))
PRINTED_S = dict(zip(NAMES, (64.0, 68.0, 75.0), strict=True))
PRINTED: dict[Figure, tuple[dict[str, float], float]] = {
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
            rows += mean_row(where, figure, walks, printed[name], step, why_not=_why_not(figure, printed[name], walks))
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


def _why_not(figure: Figure, printed: float, walks: list[Tracked]) -> str:
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
        for figure in (PITCH, HEIGHT):
            rows += ratio_row(f"{condition}: {figure.called}, FpM / FpMW (1)", figure, walks["FpM"], walks["FpMW"])
    text = (
        "Table 5's order is FpMW, FpM, pMW in all of its rows. A ratio reproduces where ours, with its interval, lies "
        "above 1 as printed: that is the order, whatever its size. The order of η in single seeds reproduces where it "
        f"is that of the medians. Walks are paired by seed. {RATIO_INTERVALS}"
    )
    return RowGroup("The order of the three", text, tuple(rows))


def _order_row(condition: str, walks: dict[str, list[Tracked]]) -> PaperRow:
    eta_m = np.array([ETA.of(walks[name]) for name in NAMES])
    holds = int((np.diff(eta_m, axis=0) > 0).all(axis=0).sum())
    share, interval = share_interval(holds, eta_m.shape[1])
    medians = np.median(eta_m, axis=1)
    called = ", ".join(f"{name} {median:.4f} m" for name, median in zip(NAMES, medians, strict=True))
    quantity = f"{condition}: share of seeds with η of FpMW < FpM < pMW (1)"
    reproduces = bool((np.diff(medians) > 0).all())
    return PaperRow(quantity, share, 1.0, *interval, reproduces, f"{holds} of {eta_m.shape[1]}. Medians: {called}.")


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
