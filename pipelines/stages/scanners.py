"""Clouds of several scanners as those of one lidar that sits in base."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quadlog.config.schema import Mount
from quadlog.errors import QuadlogError, set_flag
from quadlog.geometry import apply_transform
from quadlog.lidar.point_times import AS_THEY_COME, TimeReading, find_reading, usual_step_ns
from quadlog.messages import Int, PointCloud, Timed
from quadlog.pipelines.stages.mount import CloudMover, LidarMount
from quadlog.recordings.streams import Streams

if TYPE_CHECKING:
    from quadlog.pipelines.stages.log import Log


class PlacedScanner(NamedTuple):
    """The clouds of a topic. times: how the times of points are read."""

    topic: str
    mount: LidarMount
    mover: CloudMover | None
    times: TimeReading

    def taken(self, t_ns: int, cloud: PointCloud) -> PointCloud:
        """A cloud that was taken at t_ns, with times, in the frame of the mount."""
        return self.times.timed(cloud) if self.mover is None else self.mover.moved(t_ns, cloud)


class Sweep(NamedTuple):
    """A cloud as it was taken at t_ns by the scanner with this number."""

    scanner: int
    t_ns: int
    cloud: PointCloud


@dataclass(frozen=True)
class Scanners:
    """Several scanners as one. kept: (C,) which clouds count, in the order of the log; turn: which of the turns each
    that counts is part of; t_ns: (T,) when these were, as the first scanner in each has it.
    """

    each: Sequence[PlacedScanner]
    kept: np.ndarray
    turn: Int
    t_ns: Int

    @classmethod
    def of(
        cls, log: Log, found: Sequence[LidarMount], movers: Sequence[CloudMover | None], streams: Streams
    ) -> Scanners:
        """Those of a log by their mounts. Raises QuadlogError where one has no place."""
        if log.config.lidar.mount != Mount():
            raise QuadlogError("lidar.mount places one scanner, and topics.lidar names several: tf must place them")
        unknown = [topic for topic, mount in zip(log.lidars, found, strict=True) if not mount.known]
        if unknown:
            flag = set_flag("topics.lidar", [next((each for each in log.lidars if each not in unknown), unknown[0])])
            lone = f"choose one with  {flag}"
            raise QuadlogError(f"topics.lidar: no transform places the frame of {', '.join(unknown)} in base: {lone}")
        kept, scanners = ~streams.repeated_clouds, []
        for number, (topic, mount, mover) in enumerate(zip(log.lidars, found, movers, strict=True)):
            logged = log.recording.messages(topic, *log.window)
            clouds = (each.message for each in logged if isinstance(each.message, PointCloud))
            times = find_reading(clouds, streams.clouds_ns[streams.clouds_of == number])
            scanners.append(PlacedScanner(topic, mount, mover, times))
        return cls(scanners, kept, *turns_of(streams.clouds_of[kept], streams.clouds_ns[kept]))

    @property
    def times(self) -> TimeReading:
        """That of a scanner whose times cannot be read, if there is one."""
        return next((each.times for each in self.each if each.times.why_not), AS_THEY_COME)

    def one(self, streams: Streams) -> Streams:
        """The streams with the stamps of the turns."""
        none = np.zeros(len(self.t_ns), np.bool_)
        return replace(streams, clouds_ns=self.t_ns, clouds_of=none.astype(np.int64), repeated_clouds=none)

    def turns(self, logged: Iterable[Timed]) -> Iterator[tuple[int, list[Sweep]]]:
        """Times of all turns, and their clouds by time; logged: the clouds of all scanners."""
        number_of = {scanner.topic: number for number, scanner in enumerate(self.each)}
        size, waiting, turn = np.bincount(self.turn), defaultdict[int, list[Sweep]](list), 0
        turns = iter(self.turn.tolist())
        clouds = ((t_ns, number_of[topic], cloud) for t_ns, topic, cloud in logged if isinstance(cloud, PointCloud))
        for (t_ns, number, cloud), kept in zip(clouds, self.kept, strict=False):
            if kept:
                waiting[next(turns)].append(Sweep(number, t_ns, self.each[number].taken(t_ns, cloud)))
            while turn < len(size) and len(waiting[turn]) == size[turn]:
                yield int(self.t_ns[turn]), sorted(waiting.pop(turn), key=lambda sweep: sweep.t_ns)
                turn += 1

    def as_one(self, t_ns: int, sweeps: Sequence[Sweep]) -> PointCloud:
        """The clouds of a turn as one in base that was taken at t_ns; points without times count as of their cloud's.

        It has no beams: those of several scanners are numbered alike.
        """
        xyz_m, offsets_ns = [], []
        for number, own_ns, cloud in sweeps:
            xyz_m.append(apply_transform(self.each[number].mount.transform_lidar_to_base, cloud.xyz_m))
            offset_ns = np.zeros(len(cloud.xyz_m), np.int64) if cloud.offset_ns is None else cloud.offset_ns
            offsets_ns.append(offset_ns + (own_ns - t_ns))
        together = np.concatenate(xyz_m).astype(np.float32)
        return PointCloud(t_ns, sweeps[0].cloud.frame_id, together, offset_ns=np.concatenate(offsets_ns))


def turns_of(scanner: Int, t_ns: Int) -> tuple[Int, Int]:
    """Which clouds (C,) are one: those of different scanners (C,) within half a period; and when these (T,) were."""
    scanners = np.unique(scanner).tolist()
    half_ns = min((usual_step_ns(t_ns[scanner == each]) for each in scanners), default=0.0) / 2
    turn, begins_ns, members = np.zeros(len(t_ns), np.int64), list[int](), list[dict[int, int]]()
    for row in np.argsort(t_ns, kind="stable").tolist():
        own, own_ns = int(scanner[row]), int(t_ns[row])
        if not members or own in members[-1] or own_ns - begins_ns[-1] > half_ns:
            begins_ns.append(own_ns)
            members.append({})
        members[-1][own] = own_ns
        turn[row] = len(members) - 1
    return turn, np.array([each[min(each)] for each in members], np.int64)
