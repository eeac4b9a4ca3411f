"""Clouds as they are read: classified and made small for maps, or matched to one another for a track."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quadlog.config.schema import Config
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass, merged
from quadlog.lidar.deskew import Skewed, sweep_span
from quadlog.lidar.levelling import NotLevelled, UpSeries, level_rotations
from quadlog.lidar.paper_method import PaperSettings
from quadlog.lidar.scan_classifier import RangeImageSettings, ScanClassifier, Seen
from quadlog.messages import Float, Int, PointCloud
from quadlog.pipelines.stages.scanners import Sweep
from quadlog.positioning.lidar_odometry import (
    FEWEST_RETURNS_MATCHED,
    LidarOdometry,
    LidarTrack,
    ScanMatch,
)

if TYPE_CHECKING:
    from quadlog.pipelines.stages.log import LogData


def even_sample(count: int, wanted: int) -> set[int]:
    """At most `wanted` numbers, spread over those below count: multiples of a power of 2, 0 among them."""
    stride = 1
    while wanted and count > 2 * wanted * stride:
        stride *= 2
    held = range(0, count, stride)
    step = max(len(held) / max(wanted, 1), 1)
    return {held[int(index * step)] for index in range(min(wanted, len(held)))}


ROUTE_WORDS = {
    "rings": "by beams, from the points' ring numbers",
    "planar": "by the one beam of a 2-D scanner",
    "elevations": "by beams, from the points' elevations",
    "height_map": "without beams, by a map of the lowest points",
    "paper": "as in [Following]",
    "several": "scanner by scanner",
}


class TimedScan(NamedTuple):
    """A classified cloud: its row of `scans.parquet`, the stamp and middles of its time slots (K,).

    level: whether its ground can be one, None where none is found. skewed: why its points have no times; not_levelled:
    why it keeps the robot's tilt; None where they have, and it does not.
    """

    t_ns: int
    row: dict[str, float]
    slot_ns: Int
    level: bool | None
    skewed: Skewed | None
    not_levelled: NotLevelled | None
    found: ClassifiedScan


Turn = tuple[int, Sequence[Sweep]]
"""When clouds of all scanners were taken as one, and each."""
Seens = tuple[Seen, ...]
"""What each scanner has shown."""
MOST_AHEAD = 4
"""So many turns wait for a thread or to be taken; as many as are placed at once, so that no thread waits meanwhile."""


class _Ahead(NamedTuple):
    """A turn that is classified in a thread, by what scanners will have shown before it; foreseen: with it."""

    turn: Turn
    given: Seens
    foreseen: Seens | None
    found: Future[tuple[TimedScan, Seens]]


class Scanner:
    """Classifies clouds, those of each of several scanners by themselves."""

    def __init__(self, config: Config, seed: int, data: LogData) -> None:
        mounts = [data.mount] if data.scanners is None else [each.mount for each in data.scanners.each]
        self._mounts, self._up = [each.transform_lidar_to_base for each in mounts], data.up
        self._classifier = ScanClassifier(_classifier_settings(config), seed, uses_times=config.lidar.deskew)
        self._seen = (Seen(),) * len(mounts)

    def all(self, turns: Iterable[Turn], threads: int) -> Iterator[TimedScan]:
        """All turns in order, the same for any number of threads, each at one turn and MOST_AHEAD waiting.

        A scan is classified by what those before it will have shown if nothing changes, and once more if that was not
        so. Where what it shows cannot be foreseen, the next one waits for it.
        """
        if threads < 2:
            yield from (self.classified(*turn) for turn in turns)
            return
        waiting = deque[_Ahead]()
        pool = ThreadPoolExecutor(threads, "quadlog-scan")
        try:
            for turn in turns:
                given = waiting[-1].foreseen if waiting else self._seen
                while waiting and (given is None or len(waiting) >= threads + MOST_AHEAD):
                    first = waiting.popleft()
                    yield self._taken(first)
                    given = given if self._seen == first.foreseen and waiting else None
                given = self._seen if given is None else given
                foreseen = self._foreseen(given, turn)
                waiting.append(_Ahead(turn, given, foreseen, pool.submit(self._classified, turn, given)))
            yield from map(self._taken, waiting)
        finally:
            pool.shutdown(cancel_futures=True)

    def classified(self, t_ns: int, sweeps: Sequence[Sweep]) -> TimedScan:
        """The next cloud, or the next ones of several scanners as one that was taken at t_ns."""
        scan, self._seen = self._classified((t_ns, sweeps), self._seen)
        return scan

    def _taken(self, ahead: _Ahead) -> TimedScan:
        scan, seen = ahead.found.result()
        if ahead.given != self._seen:
            return self.classified(*ahead.turn)
        self._seen = seen
        return scan

    def _foreseen(self, seen: Seens, turn: Turn) -> Seens | None:
        """What is seen after a turn that contradicts nothing; None where that cannot be known."""
        taken = {sweep.scanner for sweep in turn[1]}
        after = [each.foreseen() if number in taken else each for number, each in enumerate(seen)]
        return None if None in after else tuple(filter(None, after))

    def _classified(self, turn: Turn, seen: Seens) -> tuple[TimedScan, Seens]:
        """A turn by what each scanner has shown before it, and what they have shown with it; in any thread."""
        (t_ns, sweeps), started, after = turn, time.perf_counter(), list(seen)
        each = list[tuple[ClassifiedScan, Skewed | None, NotLevelled | None]]()
        for scanner, own_ns, cloud in sweeps:
            span_ns = sweep_span(cloud.times, len(cloud.xyz_m))
            ends_ns = own_ns + np.array((0, 0) if isinstance(span_ns, Skewed) else span_ns, np.int64)
            rotations, not_levelled = _upright(ends_ns, self._up)
            transforms = np.empty((2, 4, 4))
            transforms[:] = self._mounts[scanner]
            transforms[:, :3] = rotations @ transforms[:, :3]
            scan, after[scanner] = self._classifier.classify_after(after[scanner], cloud, transforms)
            why_skewed = span_ns if isinstance(span_ns, Skewed) else Skewed.NO_TIMES
            each.append((scan, why_skewed if len(scan.slot_ns) == 1 else None, not_levelled))
        found = merged([scan for scan, *_ in each], [own_ns - t_ns for _, own_ns, _ in sweeps])
        row = _row(t_ns, found) | {"ms": (time.perf_counter() - started) * 1e3}
        level = None if found.ground is None else found.ground.is_level
        skewed = next((why for _, why, _ in each if why is not None), None)
        not_levelled = next((why for *_, why in each if why is not None), None)
        return TimedScan(t_ns, row, t_ns + found.slot_ns, level, skewed, not_levelled, found), tuple(after)


def _upright(t_ns: Int, up: UpSeries | None) -> tuple[Float, NotLevelled | None]:
    """(W, 3, 3) rotations that turn base upright at the instants (W,) of a scan, and why they do not, or None."""
    return (np.tile(np.eye(3), (len(t_ns), 1, 1)), None) if up is None else level_rotations(t_ns, up)


class LidarTracker:
    """The robot's track by the clouds of a log."""

    def __init__(self, data: LogData, config: Config) -> None:
        """Reads all clouds."""
        # Points too far for the map still tell where the robot is.
        self._odometry, self._deskew = LidarOdometry(config.lidar.min_range_m), config.lidar.deskew
        self._mount, self._up = data.mount.transform_lidar_to_base, data.up
        self._levelled: list[Float] = []
        self._scans, self._times = 0, data.point_times
        for t_ns, cloud in data.clouds():
            self._take(t_ns, cloud)

    def _take(self, t_ns: int, cloud: PointCloud) -> None:
        self._scans += 1
        known = len(self._odometry)
        span = sweep_span(cloud.times, len(cloud.xyz_m)) if self._deskew else Skewed.NO_TIMES
        offset_ns, middle_ns = None, t_ns
        if not isinstance(span, Skewed):
            offset_ns, middle_ns = cloud.offset_ns, t_ns + sum(span) // 2
        rotations, _ = _upright(np.array([middle_ns], dtype=np.int64), self._up)
        rotation = (rotations[0] @ self._mount[:3, :3]).astype(np.float32)
        shift_m = (rotations[0] @ self._mount[:3, 3]).astype(np.float32)
        self._odometry.take(t_ns, cloud.xyz_m @ rotation.T + shift_m, offset_ns)
        self._levelled += [rotations[0]] * (len(self._odometry) - known)

    def track(self) -> LidarTrack:
        """Poses of base at the middle of each scan; the frame is base at the first scan, with z up.

        Where no tilt is known to level scans by, z of the frame is that of base at the first scan.
        """
        matched = self._odometry.track()
        return replace(matched, rotation=matched.rotation @ np.array(self._levelled).reshape(-1, 3, 3))

    def lost_share(self) -> float:
        """Share of the scans without a pose."""
        return 1 - (self._odometry.track().match != ScanMatch.LOST).sum() / max(self._scans, 1)

    def why_lost(self) -> str:
        """Why scans have no pose; empty where all do."""
        if self._scans == 0:
            return "it took no scan"
        lost, few = round(self.lost_share() * self._scans), f"fewer than {FEWEST_RETURNS_MATCHED}"
        return f"{lost} of {self._scans} scans have {few} returns or match nothing seen before" if lost else ""

    def warnings(self) -> list[str]:
        """How many scans do not determine the whole pose, and why."""
        match = self._odometry.track().match
        sliding = (match == ScanMatch.DEGENERATE).sum()
        lines = self._times.warnings(self._scans) if self._deskew else []
        lines += [f"{why}: no pose is given there"] if (why := self.why_lost()) else []
        if sliding:
            lines.append(
                f"{sliding} of {len(match)} scans show surfaces that face one way, as a corridor does: along them "
                "positions may slide"
            )
        return lines


def _classifier_settings(config: Config) -> RangeImageSettings | PaperSettings:
    lidar, ground = config.lidar, config.ground
    if lidar.method == "paper":
        return PaperSettings(
            min_range_m=lidar.min_range_m,
            max_range_m=lidar.max_range_m,
            field_of_view_deg=lidar.field_of_view_deg or 180.0,
            outlier_neighbours=lidar.outlier_neighbours,
            outlier_std_ratio=lidar.outlier_std_ratio,
            ground_distance_m=ground.distance_m,
            ground_confidence=ground.confidence,
            ground_inlier_share=ground.inlier_share,
            ground_min_points=ground.min_points,
        )
    return RangeImageSettings(
        min_range_m=lidar.min_range_m,
        max_range_m=lidar.max_range_m,
        field_of_view_deg=lidar.field_of_view_deg or 360.0,
        ground_min_points=ground.min_points,
    )


def _row(t_ns: int, scan: ClassifiedScan) -> dict[str, float]:
    """The columns of scans.parquet, but for its time."""
    of_class = scan.counts.tolist()
    counts = {"n_raw": sum(of_class), "n_valid": sum(of_class[PointClass.CROPPED :])}
    counts |= {f"n_{kind.name.lower()}": of_class[kind] for kind in PointClass if kind > PointClass.CROPPED}
    normal = [np.nan] * 3 if scan.ground is None else scan.ground.normal.tolist()
    plane = dict(zip(("ground_nx", "ground_ny", "ground_nz"), normal, strict=True))
    d_m = np.nan if scan.ground is None else scan.ground.d_m
    return {"t_ns": t_ns, **counts, **plane, "ground_d_m": d_m, "ground_found": scan.ground is not None}
