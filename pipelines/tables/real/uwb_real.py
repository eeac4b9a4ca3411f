"""The table uwb-real: quadlog on real recordings with a truth, beside other estimators, and what its parts give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from quadlog.messages import Float, Int
from quadlog.metrics.intervals import Interval, ratio_interval_in_time
from quadlog.metrics.positioning import Trajectory
from quadlog.metrics.reference_offset import TimeOffset, estimate_time_offset
from quadlog.pipelines.tables.real.estimators import batch_smoother, plain_ekf
from quadlog.pipelines.tables.real.recordings import DATASETS, RealLog, folder_of_datasets, real_logs
from quadlog.positioning.fix.dilution import radius_95
from quadlog.positioning.locate import LocateSettings, TagResult, locate
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup

FAST_S = 40.0
GRID_S = 0.1
SETTLED_S = 1.0
"""Left out at the start, where a causal filter still settles."""
QUADLOG, EKF, EKF_CORRECTED, BATCH = "quadlog", "causal EKF", "causal EKF, ranges corrected", "batch smoother"
ABLATIONS = {
    "without calibrate": {"calibrate": False},
    "without smooth": {"smooth": False},
    "without both": {"calibrate": False, "smooth": False},
}
NO_ODOMETRY, FIXES, HUBER_FIXES = "without odometry", "fixes, gauss_newton", "fixes, huber"
BATCH_PLAIN = "batch smoother, not robust"


@dataclass(frozen=True, slots=True)
class ScoredLog:
    """One log: squared error (K,) of each estimator at the same K instants, and quadlog's own track."""

    log: RealLog
    square_m2: dict[str, Float]
    inside: Float
    track: Trajectory


def score_log(log: RealLog) -> ScoredLog:
    """Every estimator on one log."""
    positions, inside, track = _estimates(log)
    first_ns = max(int(log.truth.t_ns[0]), int(log.ranges.t_ns[0])) + round(SETTLED_S * 1e9)
    last_ns = min(int(log.truth.t_ns[-1]), int(log.ranges.t_ns[-1]))
    at_ns = np.arange(first_ns, last_ns, round(GRID_S * 1e9), dtype=np.int64)
    true_m = _at(at_ns, log.truth.t_ns, log.truth.position_m)
    squares = {
        name: ((_at(at_ns, t_ns, position_m) - true_m) ** 2).sum(axis=1)
        for name, (t_ns, position_m) in positions.items()
    }
    return ScoredLog(log, squares, inside, track)


def _estimates(log: RealLog) -> tuple[dict[str, tuple[Int, Float]], Float, Trajectory]:
    """Times and positions of every estimator; whether quadlog's 95 % ellipses hold the truth; and its track."""
    found: dict[str, tuple[Int, Float]] = {}
    best = _located(log)
    found[QUADLOG] = best.track.t_ns, best.track.position_m
    for name, settings in ABLATIONS.items():
        other = _located(log, **settings)
        found[name] = other.track.t_ns, other.track.position_m
    if log.tag.body_motion is not None:
        unaided = _located(replace(log, tag=replace(log.tag, body_motion=None)))
        found[NO_ODOMETRY] = unaided.track.t_ns, unaided.track.position_m
    for name, result in ((FIXES, best), (HUBER_FIXES, _located(log, method="huber"))):
        solved = result.fixes.solved
        found[name] = result.fix_t_ns[solved], result.fixes.position_m[solved]
    found |= _others(log, best.bias_m)
    error_m = best.track.position_m - _at(best.track.t_ns, log.truth.t_ns, log.truth.position_m)
    inside = np.hypot(*error_m.T) <= radius_95(best.track.covariance_m2, error_m)
    position_m = np.column_stack([best.track.position_m, np.zeros(len(best.track))])
    track = Trajectory(best.track.t_ns, position_m, np.tile([0.0, 0, 0, 1], (len(best.track), 1)))
    every = max(1, round(GRID_S / max(float(np.median(np.diff(best.track.t_ns))) * 1e-9, 1e-9)))
    return found, inside[::every].astype(np.float64), track


def _located(log: RealLog, **settings: object) -> TagResult:
    return locate(log.ranges, log.anchors, [log.tag], LocateSettings(**settings)).tags[0]  # type: ignore[arg-type]


def _others(log: RealLog, bias_m: Float) -> dict[str, tuple[Int, Float]]:
    """The estimators that are not quadlog's, on the ranges that it takes for ranges."""
    limits = LocateSettings()
    usable = (log.ranges.range_m >= limits.min_range_m) & (log.ranges.range_m <= limits.max_range_m)
    t_ns, range_m = log.ranges.t_ns[usable], log.ranges.range_m[usable]
    anchor = np.searchsorted(log.anchors.ids, log.ranges.anchor[usable])
    anchors_m, height_m = log.anchors.position_m, log.tag.height_m
    ekf_m = plain_ekf(t_ns, anchors_m[anchor], range_m, height_m)
    corrected_m = plain_ekf(t_ns, anchors_m[anchor], range_m - bias_m[anchor], height_m)
    batch = [batch_smoother(t_ns, anchor, anchors_m, range_m, height_m, ekf_m, robust=each) for each in (True, False)]
    names = (EKF, EKF_CORRECTED, BATCH, BATCH_PLAIN)
    return {name: (t_ns, each_m) for name, each_m in zip(names, (ekf_m, corrected_m, *batch), strict=True)}


def _at(at_ns: Int, t_ns: Int, position_m: Float) -> Float:
    """Positions (K, 2) at instants (K,), on straight lines."""
    seconds, at_s = (t_ns - at_ns[0]) * 1e-9, (at_ns - at_ns[0]) * 1e-9
    return np.column_stack([np.interp(at_s, seconds, position_m[:, axis]) for axis in range(2)])


def _row(quantity: str, parts: Float, wholes: Float, rng: np.random.Generator, root: bool, note: str = "") -> PaperRow:
    """The ratio of two sums over time, or its root, with the interval of a moving-block bootstrap."""
    shape: Callable[[float], float] = (lambda value: max(value, 0.0) ** 0.5) if root else float
    interval: Interval | None = ratio_interval_in_time(parts, wholes, rng)
    low, high = (None, None) if interval is None else (shape(interval[0]), shape(interval[1]))
    return PaperRow(quantity, shape(float(parts.sum() / wholes.sum())), low=low, high=high, note=note)


def comparison_group(scored: list[ScoredLog], rng: np.random.Generator) -> RowGroup:
    """RMSE of every estimator, and quadlog's over theirs."""
    rows = []
    for each in scored:
        ones = np.ones(len(each.square_m2[QUADLOG]))
        for name in (EKF, EKF_CORRECTED, BATCH, QUADLOG):
            rows.append(_row(f"{each.log.name}: RMSE of {name} (m)", each.square_m2[name], ones, rng, True))
        for name in (EKF, EKF_CORRECTED, BATCH):
            quantity = f"{each.log.name}: RMSE of quadlog / {name} (1)"
            rows.append(_row(quantity, each.square_m2[QUADLOG], each.square_m2[name], rng, True))
    return RowGroup(
        "Against other estimators",
        "Position error of one tag in the plane, every 0.1 s at the same instants, neither aligned nor time-corrected. "
        "The causal EKF has constant velocity and takes one range at a time, as they come and after quadlog's biases "
        "are subtracted. The batch smoother fits a spline and a bias for each anchor to the whole log at once, with "
        "Huber's weights. A ratio below 1 is in quadlog's favour; its interval is paired.",
        tuple(rows),
    )


def ablation_group(scored: list[ScoredLog], rng: np.random.Generator) -> RowGroup:
    """What each part of quadlog gives: its RMSE without it over that with it."""
    rows = []
    for each in scored:
        names = [*ABLATIONS, NO_ODOMETRY, FIXES, HUBER_FIXES]
        for name in (name for name in names if name in each.square_m2):
            quantity = f"{each.log.name}: RMSE of quadlog, {name}, / quadlog (1)"
            rows.append(_row(quantity, each.square_m2[name], each.square_m2[QUADLOG], rng, True))
        quantity = f"{each.log.name}: RMSE of {BATCH_PLAIN}, / {BATCH} (1)"
        rows.append(_row(quantity, each.square_m2[BATCH_PLAIN], each.square_m2[BATCH], rng, True))
    return RowGroup(
        "Ablation",
        "RMSE without a part over that with all of them: above 1, the part helps. Fixes are single epochs, calibrated "
        "but without a track; huber is the robust method for them, and quadlog's track, which always weighs late "
        "ranges down, has no switch for that, so the batch smoother shows what robust weights give over a whole log.",
        tuple(rows),
    )


def honesty_group(scored: list[ScoredLog], rng: np.random.Generator) -> RowGroup:
    """How often quadlog's ellipses hold the truth, and how far off the truth's clock is."""
    rows = []
    for each in scored:
        quantity = f"{each.log.name}: share of the truth in quadlog's 95 % ellipses (1)"
        rows.append(_row(quantity, each.inside, np.ones(len(each.inside)), rng, False))
        offset = estimate_time_offset(each.log.truth, each.track)
        if offset.offset_s is not None and offset.interval is not None:
            low, high = offset.interval
            quantity = f"{each.log.name}: time offset of the truth (s)"
            rows.append(PaperRow(quantity, offset.offset_s, low=low, high=high, note=_offset_note(offset)))
    return RowGroup(
        "Claimed and true errors",
        "Shares are 0.95 where quadlog's covariance of its track is right. The time offset is what to add to the "
        "track's times to have the truth's; where the speed hardly varies, a wrong lever arm looks the same, which the "
        "note says.",
        tuple(rows),
    )


def _offset_note(offset: TimeOffset) -> str:
    if offset.forward_m is None:
        return "Counts in every error above."
    return f"A shift of {offset.forward_m:+.3f} m along the direction of travel would explain it as well."


def make_table(fast: bool, seed: int) -> PaperTable:
    """The table; fast takes the first 40 s of each recording. Without the recordings it has no rows and says so."""
    folder = folder_of_datasets()
    logs = [] if folder is None else list(real_logs(folder, FAST_S if fast else None))
    if not logs:
        return _skipped(fast, seed, f"{DATASETS} is not set" if folder is None else f"{DATASETS} has none of them")
    rng = np.random.default_rng(seed)
    scored = [score_log(log) for log in logs]
    seconds = ", ".join(f"{log.name} {(log.ranges.t_ns[-1] - log.ranges.t_ns[0]) * 1e-9:.0f} s" for log in logs)
    groups = (comparison_group(scored, rng), ablation_group(scored, rng), honesty_group(scored, rng))
    return _table(fast, seed, f"{seconds}; intervals from moving blocks of one log's instants, seed {seed}.", groups)


def _skipped(fast: bool, seed: int, why: str) -> PaperTable:
    sizes = (
        f"Skipped: {why}. Set {DATASETS} to a folder with uwb_lias/lias_fast.mcap or uwb_labyrinth/, and make the "
        "table again with --force."
    )
    return _table(fast, seed, sizes, ())


def _table(fast: bool, seed: int, sizes: str, groups: tuple[RowGroup, ...]) -> PaperTable:
    return PaperTable(
        name="uwb-real",
        title="UWB positioning on real recordings",
        caption="Real ranges with a truth: a trolley with three tags among eight anchors (LIAS-CUHKSZ), and a wheeled "
        "robot among four anchors heard in turn (libRSF's labyrinth). No paper prints these, so nothing is judged. "
        "quadlog's parameters are its defaults; some were chosen on these logs, so its margin on others may be "
        "smaller.",
        sizes=sizes,
        seed=seed,
        fast=fast,
        groups=groups,
    )
