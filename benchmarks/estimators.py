"""Estimators of positions, log by log: fixes, what a robot could have known then (causal), and the whole log's (batch).

raw: RMSE, m; clock: the same with the best constant offset of the truth's clock removed, on which the rest is counted:
ellipse, worst: share of the truth in 95 % ellipses, over the log and in the worst 10 s, %; NEES: 2 is right.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.figures import run_apart
from quadlog.geometry import base_to_tag, yaw_from_quat
from quadlog.messages import Float, Int, RangeSeries
from quadlog.positioning.body import locate_body
from quadlog.positioning.locate import Anchors, TagInfo, locate
from quadlog.positioning.odometry import BodyMotion
from quadlog.positioning.settings import LocateSettings

SCENARIOS, WALK_S, WALK_SEEDS = ("follow", "forest", "corridor"), 60.0, (1, 2, 3)
CASE_SEEDS = range(10_000, 10_020)  # tests take 0 to 39
STD_M, HEIGHT_M = 0.1, 0.6
CHI2_95_OF_2, WINDOW_S, EDGE_S = 5.991, 10.0, 1.0
LAGS_S = np.linspace(-0.2, 0.2, 41)
LIMITS_M = {"trolley, tag 0": 0.061, "trolley, tag 1": 0.043, "trolley, tag 2": 0.040, "trolley, three tags": 0.033}
LIMITS_M |= {"labyrinth": 0.074, "labyrinth, odometry": 0.048}
TROLLEY_ANCHORS_M = np.array(
    [
        *((-3.4203, 3.0053, 1.0442), (0.0016, 3.0110, 1.0446), (3.6056, 2.9795, 1.0463), (3.6011, -0.0008, 1.0422)),
        *((3.5674, -3.0087, 1.0443), (-0.0072, -2.9652, 1.0444), (-3.4673, -2.9587, 1.0445)),
        (-3.4858, -0.0098, 1.0457),
    ]
)
TROLLEY_LEVERS_M = np.array([(-0.0689, -0.1423), (-0.0750, 0.1402), (0.2034, 0.1451)])
SQUARE_M = np.array([(0.0, 0.0, 1.2), (8.0, 0.0, 1.2), (8.0, 7.0, 1.2), (0.0, 7.0, 1.2)])
TRIANGLE_M = np.array([(0.0, 0.0, 1.2), (8.0, 0.0, 1.2), (4.0, 7.0, 1.2)])
HALL_M = np.array([(0.0, 0.0, 1.2), (40.0, 0.0, 1.2), (40.0, 35.0, 1.2), (0.0, 35.0, 1.2)])
LINE_M = np.array([(0.0, 0.0, 1.2), (3.0, 0.0, 1.2), (6.0, 0.0, 1.2), (9.0, 0.0, 1.2)])


@dataclass(frozen=True)
class Log:
    """Ranges with a truth: true_m (M, 2) of the tag, of the tags' middle where there are several, at true_s (M,).

    judged_s: errors count from there on; lags: whether the truth's clock may be off.
    """

    ranges: RangeSeries
    anchors: Anchors
    tags: tuple[TagInfo, ...]
    true_s: Float
    true_m: Float
    mirror: Literal["refuse", "left"] = "refuse"
    judged_s: float = -np.inf
    lags: bool = True


@dataclass(frozen=True)
class Scores:
    """What one estimator is worth on one log; see the module's docstring."""

    raw_m: float
    clock_m: float
    held: float
    worst: float
    nees: float
    cpu_s: float


def measure(folder: Path) -> Iterator[str]:
    """Recordings where QUADLOG_DATASETS is set, walks with all sensors, then ranges alone; means over the seeds."""
    yield f"  {'log':30}{'by':8}{'raw':>8}{'clock':>8}{'ellipse':>9}{'worst':>7}{'NEES':>7}{'CPU s':>8}  limit of raw"
    logs: dict[str, list[Log]] = {}
    if "QUADLOG_DATASETS" in os.environ:
        datasets = Path(os.environ["QUADLOG_DATASETS"])
        logs |= {name: [log] for name, log in (trolley(datasets / "uwb_lias") | labyrinth(datasets)).items()}
    for scenario in SCENARIOS:
        walks = [synthesized(folder, scenario, seed) for seed in WALK_SEEDS]
        logs[f"{scenario}, odometry"] = walks
        logs[scenario] = [replace(walk, tags=(replace(walk.tags[0], body_motion=None),)) for walk in walks]
    logs |= {name: [case.log(seed) for seed in CASE_SEEDS] for name, case in CASES.items()}
    for name, of_name in logs.items():
        for by in ("fixes", "causal", "batch"):
            found = [scores for log in of_name if (scores := _judged(log, by)) is not None]
            if found:
                yield _row(name, by, found)


def _row(name: str, by: str, found: list[Scores]) -> str:
    """RMSE over all logs, the worst log's worst window, means of the rest."""
    raw_m, clock_m = (np.sqrt(np.mean([getattr(each, key) ** 2 for each in found])) for key in ("raw_m", "clock_m"))
    held, nees, cpu_s = (np.mean([getattr(each, key) for each in found]) for key in ("held", "nees", "cpu_s"))
    row = f"  {name:30}{by:8}{raw_m:8.4f}{clock_m:8.4f}{100 * held:9.1f}{100 * min(each.worst for each in found):7.1f}"
    limit_m = LIMITS_M.get(name) if by == "batch" else None
    verdict = "" if limit_m is None else f"  <= {limit_m:.3f} {'ok' if round(raw_m, 3) <= limit_m else 'SHORT'}"
    return f"{row}{nees:7.2f}{cpu_s:8.2f}{verdict}"


def _judged(log: Log, by: str) -> Scores | None:
    """By one estimator; None where it does not apply: several tags have no fix."""
    settings = LocateSettings(mirror=log.mirror, smooth=by != "causal")
    if by == "fixes" and len(log.tags) > 1:
        return None
    began_s = time.process_time()
    located = locate(log.ranges, log.anchors, log.tags, settings)
    track = located.tags[0].track
    if len(log.tags) > 1:
        levers_m = np.array([(tag.x_m, tag.y_m) for tag in log.tags])
        track = locate_body(list(located.tags), levers_m, log.anchors, settings).track
    cpu_s = time.process_time() - began_s
    t_ns, xy_m, covariance_m2 = track.t_ns, track.position_m, track.covariance_m2
    if by == "fixes":
        tag = located.tags[0]
        fixes, solved = tag.fixes, tag.fixes.solved
        t_ns, xy_m, covariance_m2 = tag.epochs.t_ns[solved], fixes.position_m[solved], fixes.covariance_m2[solved]
    return score(log, t_ns * 1e-9, xy_m, covariance_m2, cpu_s)


def score(log: Log, t_s: Float, xy_m: Float, covariance_m2: Float, cpu_s: float) -> Scores:
    """Positions (N, 2) with their covariances at t_s (N,), where the truth is known and may be shifted."""
    inside = (t_s >= max(log.true_s[0] + EDGE_S, log.judged_s)) & (t_s <= log.true_s[-1] - EDGE_S)
    t_s, xy_m, precision = t_s[inside], xy_m[inside], np.linalg.inv(covariance_m2[inside])

    def error_m(lag_s: float) -> Float:
        return xy_m - np.column_stack([np.interp(t_s + lag_s, log.true_s, each) for each in log.true_m.T])

    raw_m, best_m = error_m(0.0), error_m(0.0)
    if log.lags:
        best_m = min((error_m(lag_s) for lag_s in LAGS_S.tolist()), key=_rms)
    nees = np.einsum("ni,nij,nj->n", best_m, precision, best_m)
    held, window = nees < CHI2_95_OF_2, ((t_s - t_s[0]) / WINDOW_S).astype(np.int64)
    n = np.bincount(window)
    shares = (np.bincount(window, held) / np.maximum(n, 1))[n > 0.5 * n.max()]
    return Scores(_rms(raw_m), _rms(best_m), float(held.mean()), float(shares.min()), float(nees.mean()), cpu_s)


def _rms(error_m: Float) -> float:
    return float(np.sqrt((error_m**2).sum(axis=1).mean()))


def trolley(folder: Path) -> dict[str, Log]:
    """Three tags and eight anchors at 100 Hz against motion capture, tag by tag and as one body."""
    from quadlog.recordings.recording import open_recording
    from quadlog.recordings.streams import gather

    with open_recording(folder / "lias_fast.mcap") as recording:
        ranges = gather(recording, uwb=["/nlink_linktrack_tagframe0"]).ranges
    assert ranges is not None
    truth = np.loadtxt(folder / "lias_fast_mocap.tum")
    yaw_rad = np.unwrap(yaw_from_quat(truth[:, 4:8]))
    anchors = Anchors(np.arange(8), TROLLEY_ANCHORS_M, np.zeros(8))

    def log(tags: tuple[TagInfo, ...], lever_m: Float) -> Log:
        return Log(ranges, anchors, tags, truth[:, 0], base_to_tag(truth[:, 1:3], yaw_rad, *lever_m.tolist()))

    tags = tuple(TagInfo(tag, 0.97, None, *lever_m) for tag, lever_m in enumerate(TROLLEY_LEVERS_M.tolist()))
    alone = {f"trolley, tag {tag.id}": log((tag,), TROLLEY_LEVERS_M[tag.id]) for tag in tags}
    return alone | {"trolley, three tags": log(tags, TROLLEY_LEVERS_M.mean(axis=0))}


def labyrinth(datasets: Path) -> dict[str, Log]:
    """Four anchors in turn, 8 ranges/s, with and without wheels, whose sides the file names the other way round."""

    def rows(name: str, kind: str) -> Float:
        lines = (line.split() for line in (datasets / "uwb_labyrinth" / name).read_text().splitlines())
        return np.array([[float(text) for text in line[1:]] for line in lines if line and line[0] == kind])

    heard, truth = rows("Indoor_UWB_Input.txt", "range2"), rows("Indoor_UWB_GT.txt", "point2")
    wheels = rows("Indoor_UWB_Input.txt", "odom2diff")
    t_s, left_mps, right_mps, half_m = wheels.T[[0, 1, 2, 4]]
    rate_radps = (right_mps - left_mps) / (2 * half_m)
    yaw_rad = np.concatenate([[0.0], np.cumsum(rate_radps[1:] * np.diff(t_s))])
    velocity_mps = np.column_stack([(left_mps + right_mps) / 2, np.zeros(len(t_s))])
    anchor = heard[:, 5].astype(np.int64)
    ids, first = np.unique(anchor, return_index=True)
    anchors = Anchors(ids, np.column_stack([heard[first, 3:5], np.zeros(len(ids))]), np.zeros(len(ids)))
    ranges = RangeSeries(_ns(heard[:, 0]), np.zeros(len(heard), np.int64), anchor, heard[:, 1])
    alone = Log(ranges, anchors, (TagInfo(0, 0.0),), truth[:, 0], truth[:, 1:3])
    motion = BodyMotion(_ns(t_s), velocity_mps, yaw_rad, rate_radps)
    return {"labyrinth": alone, "labyrinth, odometry": replace(alone, tags=(TagInfo(0, 0.0, motion),))}


def synthesized(folder: Path, scenario: str, seed: int) -> Log:
    """A scenario of `quadlog synthesize`: blocked paths, biases, odometry with errors of scale and yaw."""
    from quadlog.config.file import load_config
    from quadlog.pipelines.stages.positions.uwb import odometry_motion
    from quadlog.recordings.recording import open_recording
    from quadlog.recordings.streams import gather

    path, config = folder / f"{scenario}-{seed}.mcap", folder / f"{scenario}-{seed}.toml"
    run_apart(_write_walk, scenario, seed, path, config)
    with open_recording(path) as recording:
        topics = {"odometry": "/odom", "reference": "/truth/robot/pose"}
        streams = gather(recording, uwb=["/nlink_linktrack_tagframe0"], **topics)
    path.unlink()
    uwb, truth = load_config(config).uwb, streams.reference
    assert streams.ranges is not None
    assert truth is not None
    places = sorted((each.id, each.x_m, each.y_m, each.z_m) for each in uwb.anchors)
    anchors = Anchors(np.array([place[0] for place in places]), np.array(places)[:, 1:], np.zeros(len(places)))
    tag = next(each for each in uwb.tags if each.role == "robot")
    height_m = uwb.tag_height_m if tag.height_m is None else tag.height_m
    yaw_rad = np.unwrap(yaw_from_quat(truth.quat_xyzw))
    true_m = base_to_tag(truth.position_m[:, :2], yaw_rad, tag.x_m, tag.y_m)
    info = TagInfo(tag.id, height_m, odometry_motion(streams), tag.x_m, tag.y_m)
    return Log(streams.ranges, anchors, (info,), truth.t_ns * 1e-9, true_m)


def _write_walk(scenario: str, seed: int, path: Path, config: Path) -> None:
    from quadlog.pipelines.simulation.synthesize import make_recording, synthesize

    synthesize(make_recording(scenario, seed, WALK_S, 16), path, config_output=config)


@dataclass(frozen=True)
class Case:
    """Ranges of all anchors along a way (T,) -> (T, 2), and what lengthens them.

    bursts: share of slots of 0.6 s in which an anchor is blocked; bias_m: largest one of a link; reflections_m: std of
    errors that depend on the place; blocked_m: of anchor 2, half of the time; silent_s: without ranges; in_turn: one
    anchor at a time.
    """

    way: Callable[[Float], Float]
    anchors_m: Float
    duration_s: float = 12.0
    rate_hz: float = 50.0
    std_m: float = STD_M
    bursts: float = 0.0
    bias_m: float = 0.0
    reflections_m: float = 0.0
    blocked_m: float = 0.0
    silent_s: tuple[float, float] = (np.inf, np.inf)
    in_turn: bool = False
    judged_s: float = -np.inf
    mirror: Literal["refuse", "left"] = "refuse"

    def log(self, seed: int) -> Log:
        """One draw."""
        rng, n = np.random.default_rng(seed), len(self.anchors_m)
        t_s = np.arange(round(self.duration_s * self.rate_hz)) / self.rate_hz
        place_m = self.way(t_s)
        apart_m = np.insert(place_m, 2, HEIGHT_M, axis=1)[:, None] - self.anchors_m
        late_m = rng.exponential(0.5, (int(self.duration_s / 0.6) + 1, n))
        late_m *= rng.random(late_m.shape) < self.bursts
        range_m = np.linalg.norm(apart_m, axis=2) + rng.normal(0, self.std_m, (len(t_s), n))
        range_m += late_m[(t_s / 0.6).astype(np.int64)] + rng.uniform(0.25, 1.0, n) * self.bias_m
        waves, phase = rng.normal(0, 1.2, (n, 20, 2)), rng.uniform(0, 2 * np.pi, (n, 20))
        field_m = np.cos(np.einsum("akd,td->tak", waves, place_m) + phase).sum(axis=2) * np.sqrt(2 / 20)
        range_m += self.reflections_m * field_m
        range_m[:, 2] += self.blocked_m * (np.floor(t_s / 4) % 2 == 1)
        heard = np.tile(((t_s < self.silent_s[0]) | (t_s > self.silent_s[1]))[:, None], (1, n))
        if self.in_turn:
            heard &= np.arange(len(t_s))[:, None] % n == np.arange(n)
        at, anchor = np.nonzero(heard)
        ranges = RangeSeries(_ns(t_s)[at], np.zeros(len(at), np.int64), anchor, range_m[heard])
        anchors = Anchors(np.arange(n), self.anchors_m, np.zeros(n))
        return Log(ranges, anchors, (TagInfo(0, HEIGHT_M),), t_s, place_m, self.mirror, self.judged_s, lags=False)


def _ns(t_s: Float) -> Int:
    return np.rint(t_s * 1e9).astype(np.int64)


def straight(t_s: Float) -> Float:
    """0.5 m/s through the triangle."""
    return np.array([4.0, 3.0]) + np.array([0.4, 0.3]) * (t_s - 6)[:, None]


def eight(t_s: Float) -> Float:
    """A figure of eight in the square."""
    return np.column_stack([4 + 2.5 * np.sin(2 * np.pi * t_s / 30), 3.5 + 2 * np.sin(4 * np.pi * t_s / 30)])


def carried(t_s: Float) -> Float:
    """0.5 m/s through the hall, carried 8 m away after 8 s."""
    return np.array([10.0, 10.0]) + np.array([0.4, 0.3]) * t_s[:, None] + np.where(t_s[:, None] > 8, [8.0, 0.0], 0.0)


def stops(t_s: Float) -> Float:
    """The eight until 20 s, then standing."""
    return eight(np.minimum(t_s, 20.0))


CASES = {
    "bursts, 3 anchors": Case(straight, TRIANGLE_M, bursts=0.1),
    "jump of 8 m, 4 Hz": Case(carried, HALL_M, 20.0, rate_hz=4.0),
    "silent for 4 s": Case(eight, SQUARE_M, 40.0, 20.0, bias_m=0.2, silent_s=(15.0, 19.0)),
    "3 anchors in turn": Case(eight, TRIANGLE_M, 40.0, 12.0, bias_m=0.2, in_turn=True),
    "anchors on a line, biases": Case(straight, LINE_M, bias_m=0.2, mirror="left"),
    "reflections": Case(eight, SQUARE_M, 45.0, 10.0, 0.05, bias_m=0.2, reflections_m=0.06),
    "standing among reflections": Case(stops, SQUARE_M, 45.0, 10.0, 0.05, 0.0, 0.2, 0.06, judged_s=20.0),
    "a link blocked half the time": Case(eight, SQUARE_M, 40.0, 20.0, blocked_m=0.8),
}
