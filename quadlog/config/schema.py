"""Every key of quadlog.toml: name with unit, default, bounds, meaning, source.

`quadlog init` writes this file's descriptions as comments; the effective
configuration of a run is this model dumped as TOML.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from quadlog.config.controllers import with_commands
from quadlog.config.robots import RobotConfig
from quadlog.config.section import Metres, Section, in_order
from quadlog.control.settings import MpcSettings, PursuitSettings
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.planning.settings import PlannerSettings, SmoothingSettings
from quadlog.positioning.settings import LocateSettings
from quadlog.simulation.settings import Simulation


def _as_list(value: object) -> object:
    """A lone name where a list of names is wanted, as `--set topics.uwb=/ranges` gives it; "" is none."""
    return list(filter(None, [value])) if isinstance(value, str) else value


Id = Annotated[int, Field(ge=0)]
FieldPath = Annotated[str, Field(min_length=1)]


class PoseTopic(Section):
    """Where the messages of a topic, of any type, hold a pose."""

    topic: str = Field(description="the topic")
    fields: list[FieldPath] = Field(
        description="fields of x, y and z; for an orientation also those of the x, y, z and w of its quaternion"
    )
    unit: Literal["m", "cm", "mm"] = Field("m", description="of x, y and z")

    @model_validator(mode="after")
    def _is_a_pose(self) -> PoseTopic:
        if len(self.fields) not in (3, 7):
            raise ValueError(f"{self.topic}: fields are three, or seven with an orientation")
        return self


class Topics(Section):
    """Which topic plays which role. Empty: detected, and explained by `quadlog info`."""

    lidar: Annotated[list[str], BeforeValidator(_as_list)] = Field(
        [], description="point clouds; several scanners with mounts in tf are one lidar, as one in front and one behind"
    )
    uwb: Annotated[list[str], BeforeValidator(_as_list)] = Field(
        [], description="UWB ranges; several topics where each anchor has its own"
    )
    odometry: str = Field("", description="odometry")
    imu: str = Field("", description="IMU")
    joints: str = Field("", description="the joints of the robot's legs")
    reference: str = Field(
        "",
        description='true pose; empty: a pose topic named truth, gt, mocap, vicon, ...; "none": no reference',
    )
    command: str = Field(
        "",
        description='commands that simulation.controller = "command" walks by: Twist, TwistStamped, or how the robot '
        "moved by its odometry, sportmodestate or a pose; auto, and empty with that controller: the only commands",
    )
    position: str = Field(
        "auto",
        description="robot position: uwb, tf, odometry, pose (the only pose topic without a name of truth), legs "
        "(joints), lidar (matched scans), gnss (the only topic of satellite fixes), twist "
        "(the only topic of measured velocities, integrated), fixed, a pose topic or TUM file; "
        "auto: the first of these that the recording has",
    )
    target: str = Field("auto", description="what is followed: auto, uwb (a second tag), ahead, fixed, or a pose topic")
    target_x_m: Metres = Field(0.0, description='where target = "fixed" is, in map')
    target_y_m: Metres = Field(0.0, description="see target_x_m")
    ahead_s: float = Field(3.0, gt=0, le=60, description='target = "ahead": where the robot itself is so much later')
    map_frame: str = Field(
        "map", description="fixed frame in tf; if it is not there: the root that the robot's frame hangs on"
    )
    tf: Annotated[list[str], BeforeValidator(_as_list)] = Field(
        [], description="transforms, static ones too; empty: all, of several robots those beside the other topics"
    )
    base_frame: str = Field("", description="name of the robot's frame in tf; empty: the usual one, as base_link")
    poses: list[PoseTopic] = Field([], description="topics of messages of any type that hold a pose")


class Anchor(Section):
    """A UWB anchor in map."""

    id: int = Field(ge=0, description="the anchor's id in the range messages")
    x_m: Metres = Field(description="where it hangs in map")
    y_m: Metres = Field(description="see x_m")
    z_m: Metres = Field(0.0, description="height above the map's floor")
    bias_m: float = Field(
        0.0, ge=-100, le=100, description="known constant bias, subtracted from every range to this anchor"
    )


class Tag(Section):
    """A UWB tag: who carries it, how high, and where it sits in base."""

    id: int = Field(ge=0, description="the tag's id in the range messages")
    role: Literal["robot", "person", "none"] = Field(
        "none", description="who carries it; several of the robot are one body: position and yaw from all"
    )
    height_m: Metres | None = Field(None, description="height above the map's floor; unset: uwb.tag_height_m")
    x_m: Metres = Field(0.0, description="where the tag sits in base, forward")
    y_m: Metres = Field(0.0, description="where the tag sits in base, to the left")


class RangeTopic(Section):
    """What the messages of a topic with ranges do not say, or where messages of any type hold ranges."""

    topic: str = Field(description="the topic")
    tag: Id | FieldPath | None = Field(
        None,
        description="id of the tag that it measures from, where messages have no ids; with field or times also a field",
    )
    anchor: Id | FieldPath | None = Field(None, description="the same of the anchor; an id is set with that of the tag")
    unit: Literal["m", "cm", "mm"] | None = Field(None, description="of its ranges; unset: metres, mm of gtec_msgs")
    field: FieldPath | None = Field(
        None, description='field of the range in a message of any type, as "range", "uwb.distance" or "nodes[].dis"'
    )
    times: list[FieldPath] | None = Field(
        None,
        description="instead: fields of the six times of double-sided two-way ranging (poll sent and received, "
        "response sent and received, final sent and received), or of its four intervals (round and reply of A, of B)",
    )
    tick_s: float | None = Field(None, gt=0, le=1, description="unit of times; of DW1000 and DW3000: 1.565e-11")

    @model_validator(mode="after")
    def _says_something(self) -> RangeTopic:
        ends = (self.tag, self.anchor)
        if (self.times is None) != (self.tick_s is None) or len(self.times or range(4)) not in (4, 6):
            raise ValueError(f"{self.topic}: times are six or four fields, with tick_s")
        if self.times and (self.field or self.unit):
            raise ValueError(f"{self.topic}: set field and its unit, or times")
        if not self.field and not self.times:
            if any(isinstance(each, str) for each in ends):
                raise ValueError(f"{self.topic}: tag and anchor are ids, unless field or times are set")
            if (self.tag is None) != (self.anchor is None) or (self.tag is None and self.unit is None):
                raise ValueError(f"{self.topic}: set tag and anchor, or unit, or all three; or field")
        return self


class UwbConfig(LocateSettings):
    """From ranges to positions."""

    tag_height_m: Metres = Field(0.6, description="height of tags without their own; a person's is 1.3 [Following]")
    person_height_m: Metres = Field(1.3, description="height of the person's tag without its own [Following]")
    odometry: bool = Field(
        True, description="steady the robot's track with the odometry's velocity, where there is one"
    )
    anchors: list[Anchor] = Field([], description="positions of the anchors in map; without them UWB is not used")
    tags: list[Tag] = Field([], description="without this table the lowest id is the robot, the next one the person")
    range_topics: list[RangeTopic] = Field(
        [], description="for topics that do not name a range's ends, have another unit, or messages of any type"
    )

    @model_validator(mode="after")
    def _ids_are_unique(self) -> UwbConfig:
        for name, ids in (("anchors", [a.id for a in self.anchors]), ("tags", [t.id for t in self.tags])):
            twice = sorted({i for i in ids if ids.count(i) > 1})
            if twice:
                raise ValueError(f"{name}: id {twice[0]} appears more than once")
        return self


class Mount(Section):
    """The lidar's place in base."""

    x_m: Metres = Field(0.0, description="forward of base")
    y_m: Metres = Field(0.0, description="left of base")
    z_m: Metres = Field(0.0, description="height above base; base is the ground under the robot's centre")
    roll_deg: float = Field(0.0, ge=-360, le=360, description="turned by R_z(yaw) R_y(pitch) R_x(roll)")
    pitch_deg: float = Field(0.0, ge=-360, le=360, description="positive with the nose down")
    yaw_deg: float = Field(0.0, ge=-360, le=360, description="positive to the left")


class LidarConfig(Section):
    """From a raw scan to its valid points."""

    method: Literal["range_image", "paper"] = Field(
        "range_image",
        description="range_image: isolation and a walk up every column of the scan, a height map for scans without "
        "beams; paper: statistical outliers and a RANSAC plane [Following]",
    )
    mount: Mount = Mount()
    field_of_view_deg: float | None = Field(
        None, gt=0, le=360, description="kept in front of the robot; unset: 180 for paper [Following], else 360"
    )
    deskew: bool = Field(True, description="undo the robot's motion during a scan, where its points carry times")
    odometry: bool = Field(
        False,
        description="track the robot by matching scans also where UWB gives its position: metrics compare both, and "
        "without odometry in the log its velocity steadies UWB's track; some 7 ms a scan",
    )
    level: bool = Field(True, description="undo the robot's roll and pitch, where an IMU or odometry gives them")
    min_range_m: float = Field(0.3, ge=0, le=1000, description="nearer points are not valid")
    max_range_m: float = Field(30.0, gt=0, le=1000, description="farther points are not valid")
    outlier_neighbours: int = Field(
        20, ge=1, le=1000, description="k of the statistical filter, the point itself excluded"
    )
    outlier_std_ratio: float = Field(
        2.0, gt=0, le=100, description="n of the statistical filter: keep D <= mu + n sigma"
    )
    pose_gap_s: float = Field(
        0.5, gt=0, le=3600, description="a scan farther than this from any pose is skipped and counted"
    )

    @model_validator(mode="after")
    def _ranges_are_in_order(self) -> LidarConfig:
        return in_order(self, "min_range_m", "max_range_m")


class GroundConfig(Section):
    """The plane that is the ground."""

    distance_m: float = Field(0.1, ge=0.001, le=5, description="points nearer to the plane belong to it")
    confidence: float = Field(0.99, gt=0, lt=1, description="p of N = log(1-p)/log(1-w^3)")
    inlier_share: float = Field(0.3, gt=0, lt=1, description="w of N = log(1-p)/log(1-w^3)")
    min_points: int = Field(
        100, ge=3, le=1_000_000, description="with fewer points, or fewer on the plane, there is no ground"
    )


class Grid(Section):
    """The occupancy grid around the robot, in map."""

    cell_m: float = Field(0.1, ge=0.005, le=10, description="edge of a cell [Following]")
    size_cells: int = Field(200, ge=3, le=4000, description="edge of the square window [Following]")
    min_height_m: Metres = Field(0.05, description="lower obstacle points, above the ground, are ignored")
    max_height_m: Metres = Field(1.5, description="higher points do not block the robot")
    min_points: int = Field(
        2,
        ge=1,
        le=1_000_000,
        description="obstacle points that make a cell occupied; 1 lets single false points stop it, and is what scans "
        "without ground, as of 2-D scanners, get",
    )
    memory: Literal["log_odds", "scan"] = Field(
        "log_odds", description="log_odds: a cell stays until it is seen through; scan: this scan only [Following]"
    )
    extent: Literal["window", "run"] = Field(
        "window", description="what the sliding window leaves behind is forgotten, or kept for the whole run"
    )
    clear_s: float = Field(
        0.4, gt=0, le=60, description="log_odds: a cell that is seen through for so long becomes free"
    )
    dilation_m: float = Field(0.3, ge=0, le=10, description="obstacles grow by this for planning [Planning, 3 cells]")
    dilation: Literal["euclidean", "square", "body"] = Field(
        "euclidean",
        description="shape of the growth: a disc or a square [Planning] of dilation_m, or a disc that holds the "
        "robot's body however it turns",
    )
    target_radius_m: float = Field(
        0.5, ge=0, le=100, description="the target's own returns within this are no obstacle"
    )

    @model_validator(mode="after")
    def _heights_are_in_order(self) -> Grid:
        return in_order(self, "min_height_m", "max_height_m")


class Results(Section):
    """What the run folder keeps."""

    cloud_samples: int = Field(3, ge=0, le=50, description="scans kept with the class of every point")
    ground_cell_m: float = Field(0.2, ge=0.01, le=10, description="cell of the ground's height map")


class ExpectedRange(Section):
    """Bounds of a metric, both ends included; at least one."""

    min: float | None = None
    max: float | None = None

    @model_validator(mode="after")
    def _bounds_something(self) -> ExpectedRange:
        if self.min is None and self.max is None:
            raise ValueError("needs min, max or both")
        return self if self.min is None or self.max is None else in_order(self, "min", "max", may_be_equal=True)

    def holds(self, value: float | None) -> bool:
        """Whether a metric's value lies within; never where it was not measured, None."""
        low, high = self.min, self.max
        return value is not None and (low is None or value >= low) and (high is None or value <= high)


UNKNOWN_METRIC = "unknown_metric"


class Expect(Section):
    """Bounds on metrics by name, as in eta_m = { max = 0.3 }, instead of those of which a page warns by default."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, ExpectedRange]

    @model_validator(mode="after")
    def _metrics_exist(self) -> Expect:
        for name in self.model_extra or {}:
            if name not in CATALOGUE:
                raise PydanticCustomError(UNKNOWN_METRIC, "there is no such metric", {"metric": name})
        return self


class Config(Section):
    """The whole file."""

    topics: Topics = Topics()
    uwb: UwbConfig = UwbConfig()
    lidar: LidarConfig = LidarConfig()
    ground: GroundConfig = GroundConfig()
    grid: Grid = Grid()
    planner: PlannerSettings = PlannerSettings()
    smoothing: SmoothingSettings = SmoothingSettings()
    pursuit: PursuitSettings = PursuitSettings()
    robot: RobotConfig = RobotConfig()
    mpc: MpcSettings = MpcSettings()
    simulation: Simulation = Simulation()
    results: Results = Results()
    expect: Expect = Expect()

    @model_validator(mode="before")
    @classmethod
    def _reads_commands(cls, data: object) -> object:
        return with_commands(data)
