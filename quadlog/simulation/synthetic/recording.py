"""A recording made of simulated sensors on a site, as a stream of messages, with the truth behind them."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from quadlog.geometry import quat_from_euler, seconds_since, transform_from_rpy
from quadlog.messages import Float, Int, Message, Pose, Transforms
from quadlog.simulation.robot.height_field import FLAT, HeightField
from quadlog.simulation.sensors.imu import ImuErrors, imu_messages, odometry_messages
from quadlog.simulation.sensors.lidar import Lidar, SimulatedScan, SweepScene, TruePointClass, sweep
from quadlog.simulation.sensors.scene import Obstacle, RayCaster
from quadlog.simulation.sensors.trajectory import Walk
from quadlog.simulation.sensors.uwb import CarriedTag, TagRanges, UwbErrors, measure_ranges
from quadlog.simulation.synthetic.legged_walk import LeggedWalk

START_NS = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z: every synthesized recording starts here, so that the same seed gives the same bytes."""

LIDAR_TOPIC = "/lidar/points"
UWB_TOPIC = "/nlink_linktrack_tagframe0"
IMU_TOPIC = "/imu/data"
ODOMETRY_TOPIC = "/odom"
JOINT_TOPIC = "/joint_states"
TF_STATIC_TOPIC = "/tf_static"
ROBOT_TRUTH_TOPIC = "/truth/robot/pose"
PERSON_TRUTH_TOPIC = "/truth/person/pose"

ROBOT_TAG, PERSON_TAG = 0, 1

_MS = 1_000_000
_IMU_PERIOD_NS, _ODOMETRY_PERIOD_NS, _TRUTH_PERIOD_NS = 10 * _MS, 20 * _MS, 20 * _MS
_IMU_LATENCY_NS, _ODOMETRY_LATENCY_NS, _LIDAR_LATENCY_NS, _JOINT_LATENCY_NS = 1 * _MS, 3 * _MS, 5 * _MS, 1 * _MS
# The two tags share the air: the person's speaks half a period after the robot's.
_TAG_SLOT_NS = 10 * _MS
_BIAS_RANGE_M = (0.05, 0.3)
_LIDAR_HEIGHT_M = 0.45
_ROBOT_TAG_HEIGHT_M, _PERSON_TAG_HEIGHT_M = 0.6, 1.3  # [Following]
_ROBOT_TAG_X_M = -0.2


@dataclass(frozen=True, slots=True)
class Site:
    """A place and who walks in it: anchors_m (A, 3) in map, obstacles and foliage on the terrain.

    Foliage is what the lidar sees and UWB passes: leaves and stems thinner than its wavelength. Robot and
    people walk on the terrain already (see OnTerrain).
    """

    obstacles: tuple[Obstacle, ...]
    anchors_m: Float
    robot: Walk
    person: Walk
    passer_by: Walk
    foliage: tuple[Obstacle, ...] = ()
    terrain: HeightField = FLAT


class SynthesizedMessage(NamedTuple):
    """A message on its topic; a lidar's comes as a SimulatedScan, with the class of every point."""

    topic: str
    log_time_ns: int
    message: Message | SimulatedScan


@dataclass(frozen=True)
class SynthesizedRecording:
    """What the sensors of a robot on a site say from START_NS on, and everything that was true meanwhile.

    Every sensor draws from its own stream of the seed, so that none depends on another's settings.
    """

    site: Site
    seed: int
    duration_s: float
    lidar: Lidar = field(default_factory=Lidar)
    uwb: UwbErrors = field(default_factory=UwbErrors)

    def with_body(self) -> SynthesizedRecording:
        """The same recording of a robot that a simulated quadruped moves, with its joints."""
        walk = LeggedWalk(self.site.robot, self.duration_s, self.site.terrain)
        return replace(self, site=replace(self.site, robot=walk))

    @cached_property
    def bias_m(self) -> Float:
        """(A,) constant error of every range to each anchor."""
        return self._generator("bias").uniform(*_BIAS_RANGE_M, len(self.site.anchors_m))

    @cached_property
    def imu_errors(self) -> ImuErrors:
        """How the IMU errs: its north is anywhere."""
        return ImuErrors(yaw_offset_rad=float(self._generator("imu north").uniform(-np.pi, np.pi)))

    @property
    def tags(self) -> tuple[CarriedTag, CarriedTag]:
        """The robot's tag and the person's."""
        return (
            CarriedTag(ROBOT_TAG, self.site.robot, _ROBOT_TAG_HEIGHT_M, x_m=_ROBOT_TAG_X_M),
            CarriedTag(PERSON_TAG, self.site.person, _PERSON_TAG_HEIGHT_M),
        )

    @property
    def transform_lidar_to_base(self) -> Float:
        """(4, 4) place of the lidar: above the robot's centre, level, looking ahead."""
        return transform_from_rpy(np.array([0.0, 0.0, _LIDAR_HEIGHT_M]), 0.0, 0.0, 0.0)

    @cached_property
    def caster(self) -> RayCaster:
        """Light's rays against what stands on the site."""
        return RayCaster(self.site.obstacles + self.site.foliage, self.site.terrain)

    @cached_property
    def radio_caster(self) -> RayCaster:
        """UWB's rays against what holds them up."""
        return RayCaster(self.site.obstacles, self.site.terrain)

    @cached_property
    def ranges(self) -> tuple[TagRanges, TagRanges]:
        """All ranges of the robot's tag and of the person's, with the truth behind them."""
        robot, person = (self._ranges(tag, slot * _TAG_SLOT_NS) for slot, tag in enumerate(self.tags))
        return robot, person

    def scans(self) -> Iterator[SimulatedScan]:
        """Every sweep that ends within the recording, one at a time."""
        people = ((self.site.person, TruePointClass.PERSON), (self.site.passer_by, TruePointClass.PASSER_BY))
        world = SweepScene(self.caster, self.site.robot, people, self.transform_lidar_to_base)
        rng = self._generator("lidar")
        for stamp_ns in self._instants(self.lidar.sweep_ns):
            if stamp_ns + self.lidar.sweep_ns <= self._end_ns:
                yield sweep(self.lidar, world, START_NS, int(stamp_ns), rng)

    def messages(self) -> Iterator[SynthesizedMessage]:
        """Every message in order of log time, one at a time; memory does not grow with scans."""
        place_m = self.transform_lidar_to_base[:3, 3]
        pose = Pose(START_NS, "base", "lidar", place_m, quat_from_euler(np.zeros(())))
        mount = Transforms(START_NS, (pose,), static=True)
        robot, person = self.ranges
        imu = imu_messages(
            self.imu_errors, self.site.robot, START_NS, self._instants(_IMU_PERIOD_NS), self._generator("imu")
        )
        odometry = odometry_messages(
            self.site.robot, START_NS, self._instants(_ODOMETRY_PERIOD_NS), self._generator("odometry")
        )
        streams: list[Iterator[SynthesizedMessage]] = [
            iter([SynthesizedMessage(TF_STATIC_TOPIC, START_NS, mount)]),
            _logged(UWB_TOPIC, robot.messages(), 0),
            _logged(UWB_TOPIC, person.messages(), 0),
            _logged(ROBOT_TRUTH_TOPIC, self._true_poses(self.site.robot), 0),
            _logged(PERSON_TRUTH_TOPIC, self._true_poses(self.site.person), 0),
            _logged(IMU_TOPIC, imu, _IMU_LATENCY_NS),
            _logged(ODOMETRY_TOPIC, odometry, _ODOMETRY_LATENCY_NS),
            _logged(LIDAR_TOPIC, self.scans(), self.lidar.sweep_ns + _LIDAR_LATENCY_NS),
        ]
        if isinstance(self.site.robot, LeggedWalk):
            streams.append(
                _logged(JOINT_TOPIC, self.site.robot.joint_messages(START_NS, self._end_ns), _JOINT_LATENCY_NS)
            )
        return heapq.merge(*streams, key=attrgetter("log_time_ns"))

    def _generator(self, sensor: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, *sensor.encode()])

    @property
    def _end_ns(self) -> int:
        return START_NS + round(self.duration_s * 1e9)

    def _instants(self, period_ns: int, first_ns: int = 0) -> Int:
        return np.arange(START_NS + first_ns, self._end_ns, period_ns, dtype=np.int64)

    def _ranges(self, tag: CarriedTag, first_ns: int) -> TagRanges:
        t_ns = self._instants(self.uwb.period_ns, first_ns)
        rng = self._generator(f"tag {tag.id}")
        return measure_ranges(self.uwb, tag, self.site.anchors_m, self.bias_m, self.radio_caster, START_NS, t_ns, rng)

    def _true_poses(self, walk: Walk) -> Iterator[Pose]:
        t_ns = self._instants(_TRUTH_PERIOD_NS)
        motion = walk.at(seconds_since(t_ns, START_NS))
        quat_xyzw = quat_from_euler(motion.yaw_rad, motion.pitch_rad, motion.roll_rad)
        position_m = np.column_stack([motion.position_m, motion.height_m])
        for index, stamp_ns in enumerate(t_ns):
            yield Pose(int(stamp_ns), "map", "", position_m[index], quat_xyzw[index])


def _logged(topic: str, messages: Iterable[Message | SimulatedScan], latency_ns: int) -> Iterator[SynthesizedMessage]:
    for message in messages:
        stamp_ns = message.cloud.stamp_ns if isinstance(message, SimulatedScan) else message.stamp_ns
        assert stamp_ns is not None
        yield SynthesizedMessage(topic, stamp_ns + latency_ns, message)
