"""Positioning: fixes against the Cramer-Rao bound, tracks through bursts, and the real trolley against its truth."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.figures import Figure
from quadlog.messages import Float, RangeSeries
from quadlog.positioning.fixes import Fixes, solve_fixes
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, locate

FIXES = 100_000
STD_M, HEIGHT_M = 0.1, 0.6
ROUNDS = 5
BURST_RUNS = range(10_000, 11_000)  # tests take 0 to 39
TRIANGLE_M = np.array([(0.0, 0.0, 1.2), (8.0, 0.0, 1.2), (4.0, 7.0, 1.2)])
LOST_M = 1.0
TROLLEY_ANCHORS_M = np.array(
    [
        *((-3.4203, 3.0053, 1.0442), (0.0016, 3.0110, 1.0446), (3.6056, 2.9795, 1.0463), (3.6011, -0.0008, 1.0422)),
        *(
            (3.5674, -3.0087, 1.0443),
            (-0.0072, -2.9652, 1.0444),
            (-3.4673, -2.9587, 1.0445),
            (-3.4858, -0.0098, 1.0457),
        ),
    ]
)
TROLLEY_LEVERS_M = ((-0.0689, -0.1423), (-0.0750, 0.1402), (0.2034, 0.1451))
TROLLEY_LIMITS_M = {"as measured": (0.182, 0.163, 0.156), "calibrated": (0.086, 0.082, 0.075)}
TRACK_LIMITS_M = (0.065, 0.047, 0.043)


def measure(_: Path) -> Iterator[Figure]:
    """Simulated figures first; the trolley where QUADLOG_DATASETS tells where it is."""
    for n_anchors in (3, 5, 8):
        yield from _single_fixes(n_anchors)
    yield from _bursts()
    if "QUADLOG_DATASETS" in os.environ:
        yield from _trolley(Path(os.environ["QUADLOG_DATASETS"]) / "uwb_lias")


def _single_fixes(n_anchors: int) -> Iterator[Figure]:
    """Error over the bound and the share in 95 % ellipses; the throughput too, against one pass over the data."""
    anchors_m, position_m, range_m = simulate_fixes(n_anchors)
    fixes = _solve(anchors_m, range_m)
    error_m = fixes.position_m - position_m
    rmse_m = float(np.sqrt((error_m**2).sum(axis=1).mean()))
    bound_m = float(np.sqrt(_bound_m2(anchors_m, position_m).trace(axis1=1, axis2=2).mean()))
    floor = f"floor: the bound is {bound_m:.4f} m"
    yield Figure(f"{n_anchors} anchors, RMSE of a fix / Cramer-Rao bound", rmse_m / bound_m, "x", 1.02, floor=floor)
    inside = np.einsum("ei,eij,ej->e", error_m, np.linalg.inv(fixes.covariance_m2), error_m) <= -2 * np.log(0.05)
    off = abs(100 * float(inside.mean()) - 95)
    yield Figure(f"{n_anchors} anchors, fixes in 95 % ellipses, off 95 by", off, "points", 1.0)
    solve_s = min(_seconds(lambda: _solve(anchors_m, range_m)) for _ in range(ROUNDS))
    pass_s = min(_seconds(lambda: np.isfinite(range_m).sum()) for _ in range(ROUNDS))
    floor = f"floor: one pass over the ranges, {FIXES / pass_s / 1e6:.0f} million/s"
    yield Figure(f"{n_anchors} anchors, fixes on one core", FIXES / solve_s / 1e6, "million/s", 0.05, True, floor)


def simulate_fixes(n_anchors: int) -> tuple[Float, Float, Float]:
    """Anchors (A, 3) evenly on a circle of 5 m, at one height; FIXES tags (E, 2) within 3.5 m; ranges (E, A)."""
    rng = np.random.default_rng(n_anchors)
    angle = 2 * np.pi * np.arange(n_anchors) / n_anchors
    anchors_m = np.column_stack([5 * np.cos(angle), 5 * np.sin(angle), np.full(n_anchors, 1.2)])
    radius_m, direction = 3.5 * np.sqrt(rng.random(FIXES)), 2 * np.pi * rng.random(FIXES)
    position_m = np.column_stack([radius_m * np.cos(direction), radius_m * np.sin(direction)])
    return anchors_m, position_m, _distances_m(position_m, anchors_m) + rng.normal(0, STD_M, (FIXES, n_anchors))


def _distances_m(position_m: Float, anchors_m: Float) -> Float:
    flat_m2 = ((position_m[:, None] - anchors_m[:, :2]) ** 2).sum(axis=2)
    distance_m: Float = np.sqrt(flat_m2 + (anchors_m[:, 2] - HEIGHT_M) ** 2)
    return distance_m


def _bound_m2(anchors_m: Float, position_m: Float) -> Float:
    """(E, 2, 2) the inverse Fisher information at the true positions."""
    direction = (position_m[:, None] - anchors_m[:, :2]) / _distances_m(position_m, anchors_m)[:, :, None]
    bound: Float = np.linalg.inv(np.einsum("eai,eaj->eij", direction, direction) / STD_M**2)
    return bound


def _solve(anchors_m: Float, range_m: Float) -> Fixes:
    return solve_fixes("gauss_newton", anchors_m, range_m, HEIGHT_M, STD_M, np.inf)


def _seconds(action: object) -> float:
    before_s = time.perf_counter()
    assert callable(action)
    action()
    return time.perf_counter() - before_s


def _bursts() -> Iterator[Figure]:
    """1000 walks of 12 s with three anchors: tracking by itself, and with the biases estimated, as by default."""
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        for calibrate, words in ((False, "tracks alone"), (True, "calibrated too")):
            errors = list(pool.map(burst_errors_m, BURST_RUNS, [calibrate] * len(BURST_RUNS), chunksize=20))
            rms_m = [float(np.sqrt(np.mean(each**2))) for each in errors]
            total_m = float(np.sqrt(np.mean(np.square(rms_m))))
            worst = f"worst run {max(rms_m):.3f}, median {statistics.median(rms_m):.3f}"
            yield Figure(f"bursts, {words}: smoothed RMSE", total_m, "m", 0.05, floor=worst)
            lost = sum(float(np.median(each[-50:])) > LOST_M for each in errors)
            yield Figure(f"bursts, {words}: runs that end locked out", lost, "of 1000", 0)


def burst_errors_m(seed: int, calibrate: bool) -> Float:
    """(T,) distances of the smoothed track to the truth: 50 Hz, 0.5 m/s, each anchor blocked a tenth of 0.6 s slots."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(600) / 50
    position_m = np.array([4.0, 3.0]) + np.array([0.4, 0.3]) * (t_s - 6)[:, None]
    late_m = rng.exponential(0.5, (20, 3)) * (rng.random((20, 3)) < 0.1)
    range_m = _distances_m(position_m, TRIANGLE_M) + rng.normal(0, STD_M, (600, 3)) + np.repeat(late_m, 30, axis=0)
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    series = RangeSeries(np.repeat(t_ns, 3), np.zeros(1800, np.int64), np.tile(np.arange(3), 600), range_m.ravel())
    anchors = Anchors(np.arange(3), TRIANGLE_M, np.zeros(3))
    track = locate(series, anchors, [TagInfo(0, HEIGHT_M)], LocateSettings(calibrate=calibrate)).tags[0].track
    truth_m = np.stack([np.interp(track.t_ns, t_ns, position_m[:, axis]) for axis in range(2)], axis=1)
    error_m: Float = np.linalg.norm(track.position_m - truth_m, axis=1)
    return error_m


def _trolley(folder: Path) -> Iterator[Figure]:
    """Fixes and tracks of each tag, from ranges alone, against motion capture."""
    from quadlog.recordings.recording import open_recording
    from quadlog.recordings.streams import gather

    with open_recording(folder / "lias_fast.mcap") as recording:
        ranges = gather(recording, uwb=["/nlink_linktrack_tagframe0"]).ranges
    assert ranges is not None
    truth = np.loadtxt(folder / "lias_fast_mocap.tum")
    anchors, tags = Anchors(np.arange(8), TROLLEY_ANCHORS_M, np.zeros(8)), [TagInfo(tag, 0.97) for tag in range(3)]
    for words, limits in TROLLEY_LIMITS_M.items():
        located = locate(ranges, anchors, tags, LocateSettings(calibrate=words == "calibrated"))
        for tag, limit in zip(located.tags, limits, strict=True):
            rmse_m = _rmse_m(tag.fix_t_ns, tag.fixes.position_m, truth, tag.tag)
            yield Figure(f"trolley, tag {tag.tag}, fixes {words}: RMSE", rmse_m, "m", limit)
    for tag, limit in zip(located.tags, TRACK_LIMITS_M, strict=True):
        yield Figure(
            f"trolley, tag {tag.tag}, track: RMSE",
            _rmse_m(tag.track.t_ns, tag.track.position_m, truth, tag.tag),
            "m",
            limit,
        )


def _rmse_m(t_ns: np.ndarray, position_m: Float, truth: Float, tag: int) -> float:
    """Of the rows that are solved, against TUM rows (N, 8) and the tag's place on the trolley."""
    x, y, z, w = truth[:, 4:8].T
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    ahead_m, left_m = TROLLEY_LEVERS_M[tag]
    place = (
        truth[:, 1] + np.cos(yaw) * ahead_m - np.sin(yaw) * left_m,
        truth[:, 2] + np.sin(yaw) * ahead_m + np.cos(yaw) * left_m,
    )
    error_m = position_m - np.stack([np.interp(t_ns * 1e-9, truth[:, 0], axis) for axis in place], axis=1)
    return float(np.sqrt(np.nanmean((error_m**2).sum(axis=1))))
