"""A walk among three anchors, fix by fix, filtered and smoothed, in line of sight and through NLOS bursts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.pipelines.tables.judging import bootstrap_rms, share_interval
from quadlog.pipelines.tables.uwb_site import RANGE_STD_M, STATIONS_M, draw_ranges
from quadlog.positioning.tracker import track_ranges
from quadlog.positioning.trilateration import solve_fixes
from quadlog.results.paper_rows import PaperRow, RowGroup

RATE_HZ, DURATION_S = 50, 12.0
START_M, VELOCITY_MPS = np.array([0.4, -0.4]), np.array([0.4, 0.03])
BURST_S, BURST_SHARE, BURST_MEAN_M = 0.6, 0.1, 0.5
ACCELERATION_STD_MPS2 = 1.0
OUTLIER_M = 0.5
LOST_M, LOST_FOR_S = 1.0, 2.0
ESTIMATES = ("fix by fix", "causal track", "smoothed track")


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


def _walk_often(n_runs: int, bursts: bool, seed: int) -> Runs:
    t_s = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    position_m = START_M + VELOCITY_MPS * t_s[:, None]
    squares: dict[str, list[float]] = {estimate: [] for estimate in ESTIMATES}
    lost: dict[str, list[bool]] = {estimate: [] for estimate in ESTIMATES[1:]}
    for run in range(n_runs):
        range_m = _draw_walk(position_m, bursts, np.random.default_rng([seed, 3, int(bursts), run]))
        for estimate, off_m in _errors(t_s, position_m, range_m).items():
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


def _errors(t_s: Float, position_m: Float, range_m: Float) -> dict[str, Float]:
    """Distance from the truth of each estimate: (T,) for fixes, NaN where there is none; as many as tracked else."""
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    n_epochs, n_anchors = range_m.shape
    fixes = solve_fixes("gauss_newton", STATIONS_M, range_m, 0.0, RANGE_STD_M, OUTLIER_M)
    start = fixes.solved & ~fixes.outlier
    errors = {"fix by fix": np.linalg.norm(fixes.position_m - position_m, axis=1)}
    for estimate, smooth in (("causal track", False), ("smoothed track", True)):
        track = track_ranges(
            np.repeat(t_ns, n_anchors),
            np.tile(np.arange(n_anchors), n_epochs),
            range_m.ravel(),
            STATIONS_M,
            0.0,
            t_ns[start],
            fixes.position_m[start],
            range_std_m=RANGE_STD_M,
            acceleration_std_mps2=ACCELERATION_STD_MPS2,
            smooth=smooth,
        ).track
        errors[estimate] = np.linalg.norm(track.position_m - position_m[np.searchsorted(t_ns, track.t_ns)], axis=1)
    return errors
