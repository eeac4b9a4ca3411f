"""Rows of the table following-uwb: every method against the Cramér-Rao bound, standing and walking."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.messages import Float, RangeSeries
from quadlog.metrics.intervals import Interval
from quadlog.pipelines.tables.following.uwb_ranges import (
    BOX_HIGH_M,
    BOX_LOW_M,
    BOX_WORDS,
    METHODS,
    RANGE_STD_M,
    STATIONS_M,
    cramer_rao,
    draw_ranges,
)
from quadlog.pipelines.tables.intervals import bootstrap_rms, rms_interval, share_interval
from quadlog.positioning.fix.dilution import CHI2_95
from quadlog.positioning.fix.least_squares import Fixes
from quadlog.positioning.fix.trilateration import solve_fixes
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, locate
from quadlog.results.papers.table import PaperRow, RowGroup

ANCHORS = (3, 4, 5, 8)
CIRCLE_M, DISC_M = 5.0, 3.0
"""Four and more anchors stand evenly on a circle, tags anywhere in a disc inside it."""
NLOS_SHARE, NLOS_MEAN_M = 0.1, 0.5


@dataclass(frozen=True, slots=True)
class EstimatorScore:
    """What one method makes of one kind of ranges. ratio: RMSE / bound; covered: share inside the 95 % ellipse."""

    anchors: int
    nlos: bool
    method: str
    bound_m: float
    ratio: float
    ratio_interval: Interval
    covered: float
    covered_interval: Interval
    n_unsolved: int
    n_fixes: int


def score_all(n_fixes: int, seed: int) -> list[EstimatorScore]:
    """Scores of all methods on the same ranges, by number of anchors, first in line of sight, then with NLOS."""
    scores = []
    for n_anchors in ANCHORS:
        rng = np.random.default_rng([seed, 2, n_anchors])
        anchors_m, position_m = _draw_layout(n_anchors, n_fixes, rng)
        clear_m = draw_ranges(position_m, anchors_m, rng)
        late_m = rng.exponential(NLOS_MEAN_M, clear_m.shape) * (rng.random(clear_m.shape) < NLOS_SHARE)
        for nlos, range_m in ((False, clear_m), (True, clear_m + late_m)):
            for method in METHODS:
                fixes = solve_fixes(method, anchors_m, range_m, 0.0, RANGE_STD_M, np.inf)
                scores.append(_score(fixes, anchors_m, position_m, nlos, method))
    return scores


def efficiency_group(scores: list[EstimatorScore], nlos: bool) -> RowGroup:
    """RMSE / bound of every method, in line of sight or with late ranges."""
    rows = []
    for n_anchors in ANCHORS:
        mine = [score for score in scores if score.anchors == n_anchors and score.nlos == nlos]
        where = f"{n_anchors} anchors" + (", NLOS" if nlos else "")
        if not nlos:
            rows.append(PaperRow(f"{where}: Cramér-Rao bound (m)", mine[0].bound_m))
        rows += [
            PaperRow(f"{where}: RMSE / bound, {each.method}", each.ratio, None, *each.ratio_interval, note=_note(each))
            for each in mine
        ]
    layout = (
        f"Three anchors are the paper's stations, tags anywhere in {BOX_WORDS}; more stand evenly on a circle of "
        f"{CIRCLE_M:g} m radius, tags anywhere in its inner {DISC_M:g} m. Range noise {RANGE_STD_M:g} m. "
    )
    errors = (
        f"One range in ten comes late by an exponential delay of {NLOS_MEAN_M:g} m on average; the bound is that "
        "without such ranges. With three anchors one epoch cannot tell which range is late. "
        if nlos
        else "RMSE over all places, against the root of the mean bound. "
    )
    title = "Against the Cramér-Rao bound, " + ("ranges partly late (NLOS)" if nlos else "line of sight")
    return RowGroup(title, layout + errors + "Intervals are analytic, as above.", tuple(rows))


def coverage_group(scores: list[EstimatorScore]) -> RowGroup:
    """How often the truth lies inside the 95 % ellipse that a method reports, in line of sight."""
    rows = [
        PaperRow(
            f"{each.anchors} anchors: share of fixes inside their 95 % ellipse, {each.method}",
            each.covered,
            None,
            *each.covered_interval,
        )
        for each in scores
        if not each.nlos
    ]
    text = (
        "Line of sight; each method with the covariance it reports. An honest one gives 0.95. Intervals after Wilson."
    )
    return RowGroup("Honesty of the covariance", text, tuple(rows))


def _draw_layout(n_anchors: int, n_fixes: int, rng: np.random.Generator) -> tuple[Float, Float]:
    """Anchors (A, 3) and tag positions (N, 2), all at one height."""
    if n_anchors == len(STATIONS_M):
        return STATIONS_M, rng.uniform(BOX_LOW_M, BOX_HIGH_M, (n_fixes, 2))
    angle = 2 * np.pi * np.arange(n_anchors) / n_anchors
    anchors_m = CIRCLE_M * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n_anchors)])
    turn = rng.uniform(0, 2 * np.pi, n_fixes)
    # The root makes up for how little of a disc lies near its middle.
    radius_m = DISC_M * np.sqrt(rng.random((n_fixes, 1)))
    return anchors_m, radius_m * np.column_stack([np.cos(turn), np.sin(turn)])


def _score(fixes: Fixes, anchors_m: Float, position_m: Float, nlos: bool, method: str) -> EstimatorScore:
    solved = fixes.solved
    error_m = fixes.position_m[solved] - position_m[solved]
    bound_m = float(np.sqrt(np.trace(cramer_rao(position_m[solved], anchors_m), axis1=1, axis2=2).mean()))
    rmse_m, (low_m, high_m) = rms_interval((error_m**2).sum(axis=1))
    whitened = np.linalg.solve(fixes.covariance_m2[solved], error_m[:, :, None])[:, :, 0]
    inside = (error_m * whitened).sum(axis=1) <= CHI2_95
    covered, covered_interval = share_interval(int(inside.sum()), len(inside))
    return EstimatorScore(
        anchors=len(anchors_m),
        nlos=nlos,
        method=method,
        bound_m=bound_m,
        ratio=rmse_m / bound_m,
        ratio_interval=(low_m / bound_m, high_m / bound_m),
        covered=covered,
        covered_interval=covered_interval,
        n_unsolved=int((~solved).sum()),
        n_fixes=len(solved),
    )


def _note(score: EstimatorScore) -> str:
    unsolved = f"; {score.n_unsolved} of {score.n_fixes} epochs have no fix" if score.n_unsolved else ""
    return f"RMSE {score.ratio * score.bound_m:.3f} m{unsolved}."


RATE_HZ, DURATION_S = 50, 12.0
START_M, VELOCITY_MPS = np.array([0.4, -0.4]), np.array([0.4, 0.03])
BURST_S, BURST_SHARE, BURST_MEAN_M = 0.6, 0.1, 0.5
ACCELERATION_STD_MPS2 = 1.0
ACCELERATIONS_MPS2 = (0.1, 0.3, ACCELERATION_STD_MPS2, 3.0)
"""The tracker's prior, which no paper prints, and what else it might be."""
OUTLIER_M = 0.5
LOST_M, LOST_FOR_S = 1.0, 2.0
ESTIMATES = ("fix by fix", "causal track", "smoothed track")
SMOOTH = {"causal track": False, "smoothed track": True}


@dataclass(frozen=True, slots=True)
class Runs:
    """R walks: mean_square_m2 maps each estimate to (R,); lost maps causal and smoothed track to (R,) bool."""

    mean_square_m2: dict[str, Float]
    lost: dict[str, np.ndarray]


def tracking_group(n_runs: int, seed: int) -> RowGroup:
    """RMSE of each estimate over n_runs walks, and how many tracks were lost."""
    rows = []
    for bursts, where in ((False, "line of sight"), (True, "NLOS bursts")):
        runs = _walk_often(n_runs, bursts, seed)
        for number, estimate in enumerate(ESTIMATES):
            rng = np.random.default_rng([seed, 4, number])
            rmse_m, interval = bootstrap_rms(runs.mean_square_m2[estimate], rng)
            rows.append(PaperRow(f"{where}: RMSE, {estimate} (m)", rmse_m, None, *interval))
        for estimate, lost in runs.lost.items():
            count = int(lost.sum())
            share, share_range = share_interval(count, n_runs)
            note = f"{count} of {n_runs} runs."
            rows.append(PaperRow(f"{where}: share of runs lost, {estimate}", share, None, *share_range, note=note))
    speed_mps = float(np.hypot(*VELOCITY_MPS))
    text = (
        f"{n_runs} walks of {DURATION_S:g} s at {speed_mps:.1f} m/s through the triangle of the paper's stations, "
        f"{RATE_HZ} Hz, range noise {RANGE_STD_M:g} m. Bursts: in every slot of {BURST_S:g} s each station is hidden "
        f"with a chance of {BURST_SHARE:g}, and its ranges come late by one exponential delay of {BURST_MEAN_M:g} m on "
        f"average. Lost: more than {LOST_M:g} m off throughout the last {LOST_FOR_S:g} s. No constant of the "
        "tracker was chosen on these draws. Intervals: bootstrap over the walks; shares after Wilson."
    )
    return RowGroup("Three anchors and time: tracks", text, tuple(rows))


def prior_group(n_runs: int, seed: int) -> RowGroup:
    """RMSE of the smoothed track by the prior on the walker's acceleration."""
    rows = []
    for bursts, where in ((False, "line of sight"), (True, "NLOS bursts")):
        for acceleration_mps2 in ACCELERATIONS_MPS2:
            runs = _walk_often(n_runs, bursts, seed, ESTIMATES[2:], acceleration_mps2)
            rng = np.random.default_rng([seed, 4, len(ESTIMATES) - 1])
            rmse_m, interval = bootstrap_rms(runs.mean_square_m2[ESTIMATES[2]], rng)
            quantity = f"{where}: RMSE, smoothed track, acceleration prior {acceleration_mps2:g} m/s² (m)"
            rows.append(PaperRow(quantity, rmse_m, None, *interval))
    text = (
        "The walks above go straight at an even speed, so that the smaller the prior the better the track: what a "
        "smoothed track gains over fixes rests on this constant of ours. Other tables have the usual "
        f"{ACCELERATION_STD_MPS2:g} m/s². Intervals: bootstrap over the walks."
    )
    return RowGroup("What the acceleration prior decides", text, tuple(rows))


def _walk_often(
    n_runs: int,
    bursts: bool,
    seed: int,
    estimates: tuple[str, ...] = ESTIMATES,
    acceleration_mps2: float = ACCELERATION_STD_MPS2,
) -> Runs:
    t_s = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    position_m = START_M + VELOCITY_MPS * t_s[:, None]
    squares: dict[str, list[float]] = {estimate: [] for estimate in estimates}
    lost: dict[str, list[bool]] = {estimate: [] for estimate in estimates if estimate in SMOOTH}
    for run in range(n_runs):
        range_m = _draw_walk(position_m, bursts, np.random.default_rng([seed, 3, int(bursts), run]))
        for estimate, off_m in _errors(t_s, position_m, range_m, estimates, acceleration_mps2).items():
            squares[estimate].append(float(np.nanmean(off_m**2)))
            if estimate in lost:
                lost[estimate].append(bool(off_m[-round(LOST_FOR_S * RATE_HZ) :].min() > LOST_M))
    return Runs(
        {estimate: np.array(values) for estimate, values in squares.items()},
        {estimate: np.array(values) for estimate, values in lost.items()},
    )


def _draw_walk(position_m: Float, bursts: bool, rng: np.random.Generator) -> Float:
    range_m = draw_ranges(position_m, STATIONS_M, rng)
    slot = round(BURST_S * RATE_HZ)
    for begin in range(0, len(range_m) if bursts else 0, slot):
        hidden = rng.random(len(STATIONS_M)) < BURST_SHARE
        range_m[begin : begin + slot] += hidden * rng.exponential(BURST_MEAN_M, len(STATIONS_M))
    return range_m


def _errors(
    t_s: Float, position_m: Float, range_m: Float, estimates: tuple[str, ...], acceleration_mps2: float
) -> dict[str, Float]:
    """Distance from the truth of each estimate: (T,) for fixes, NaN where there is none; as many as tracked else."""
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    n_epochs, n_anchors = range_m.shape
    fixes = solve_fixes("gauss_newton", STATIONS_M, range_m, 0.0, RANGE_STD_M, OUTLIER_M)
    anchor, stamps_ns = np.tile(np.arange(n_anchors), n_epochs), np.repeat(t_ns, n_anchors)
    series = RangeSeries(stamps_ns, np.zeros_like(anchor), anchor, range_m.ravel())
    anchors = Anchors(np.arange(n_anchors), STATIONS_M, np.zeros(n_anchors))
    settings = LocateSettings(
        range_std_m=RANGE_STD_M, outlier_m=OUTLIER_M, acceleration_std_mps2=acceleration_mps2, calibrate=False
    )
    errors = {}
    for estimate in estimates:
        if estimate not in SMOOTH:
            errors[estimate] = np.linalg.norm(fixes.position_m - position_m, axis=1)
            continue
        how = replace(settings, smooth=SMOOTH[estimate])
        track = locate(series, anchors, [TagInfo(0, 0.0)], how).tags[0].track
        errors[estimate] = np.linalg.norm(track.position_m - position_m[np.searchsorted(t_ns, track.t_ns)], axis=1)
    return errors
