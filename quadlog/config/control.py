"""The keys of quadlog.toml that say how a robot walks: [pursuit], [robot], [mpc] and [simulation]."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from quadlog.config.controllers import CONTROLLER_NAMES, ControllerParts, parts_of
from quadlog.config.plugins import CONTROLLERS, known_name
from quadlog.config.robots import ROBOT_PRESETS
from quadlog.config.section import Section, in_order

Weight = Annotated[float, Field(ge=0, le=1e9)]
PerAxis = tuple[Weight, Weight, Weight]


class Fuzzy(Section):
    """The look-ahead by fuzzy rules, l = l0 + lambda_v k_v v^2 + lambda_w k_w v, l0: lookahead_m [Tracking, 3.2]."""

    lambda_v_s2_per_m: float = Field(
        1.0, ge=-100, le=100, description="weight of the term with v^2 [Tracking, eq. 17]; it prints no value"
    )
    lambda_w_s: float = Field(
        1.0, ge=-100, le=100, description="weight of the term with v [Tracking, eq. 17]; it prints no value"
    )
    k_v0: float = Field(0.0, ge=-100, le=100, description="k_v without error [Tracking, eq. 18]; it prints no value")
    k_w0: float = Field(0.0, ge=-100, le=100, description="k_w without error [Tracking, eq. 18]; it prints no value")
    gain_e_per_m: float = Field(
        1.0, ge=-1e4, le=1e4, description="from the distance to the path to the rules' e, -3 to 3; ours: metres"
    )
    gain_ec_s_per_m: float = Field(
        1.0, ge=-1e4, le=1e4, description="from that distance's rate to the rules' ec, -3 to 3; ours: metres per second"
    )
    signed: bool = Field(False, description="e is the cross-track error, left positive, so that sides differ")
    ec_filter_s: float = Field(0.0, ge=0, le=60, description="time constant of the rate's low-pass filter; 0: none")
    l_min_m: float = Field(0.5, ge=0.01, le=100, description="the look-ahead is no shorter; ours")
    l_max_m: float = Field(
        5.0, ge=0.01, le=100, description="the look-ahead is no longer; ours, beyond what rules give"
    )
    tables: Literal["printed", "corrected"] = Field(
        "corrected", description="the rules as in Tables 1 and 2, or with their errata mended"
    )
    centroid: Literal["points", "continuous"] = Field(
        "points", description="over the seven points as printed, or over the whole area"
    )

    @model_validator(mode="after")
    def _limits_are_in_order(self) -> Fuzzy:
        return in_order(self, "l_min_m", "l_max_m", may_be_equal=True)


class Pursuit(Section):
    """Pure pursuit [Tracking, section 3]."""

    lookahead_m: float = Field(2.0, ge=0.01, le=100, description="l, or l0 of the fuzzy rules [Tracking, section 5]")
    speed_mps: float | None = Field(
        None, ge=0.01, le=10, description="unset: 0.6, along the s-curve 0.5 [Tracking, section 5]"
    )
    max_yaw_rate_radps: float = Field(1.5, ge=0.001, le=20, description="the robot turns no faster")
    clear_chord: bool = Field(
        True,
        description="the look-ahead ends where the straight line to it leaves the space that the plan may use; ours, "
        "for the look-ahead is longer than many plans, and the robot would cut their corners",
    )
    rate_hz: float = Field(50.0, ge=1, le=1000, description="ticks of the controller and of control.parquet")
    fuzzy: Fuzzy = Fuzzy()


def _each_once(values: list[Any], count: int, what: str) -> list[Any]:
    if values and (len(values) != count or len(set(values)) != count):
        raise ValueError(f"must be {count} different {what}, or none")
    return values


class RobotConfig(Section):
    """The robot's body on maps [Following, Table 1], and the model that walks."""

    preset: Literal[(*ROBOT_PRESETS,)] = Field(  # type: ignore[valid-type]
        "paper",
        description="sets the other keys of [robot] where they are not given: go1, go2, a1, b1 [unitree_ros], or paper",
    )
    length_m: float = Field(0.62, gt=0, le=100, description="of the body, along x")
    width_m: float = Field(0.26, gt=0, le=100, description="of the body, along y")
    height_m: float = Field(
        0.37, gt=0, le=100, description="how tall it stands; a cell of map.pgm is free where a ray passed below that"
    )
    max_speed_mps: float = Field(
        8.0,
        ge=0.1,
        le=1000,
        description="a track that is faster for more than 1 % of the time counts as wrong; ours",
    )
    model: str = Field(
        "tracking",
        min_length=1,
        description="tracking [Tracking, Table 4], following [Following, Table 1], foot [Foot, Table 2], a preset's "
        "with its body, or a file: MJCF or URDF",
    )

    joints: list[Annotated[str, Field(min_length=1, max_length=200)]] = Field(
        [],
        description="joints of the log: names, or places in the message, of hip, thigh and calf of the legs FL, FR, RL "
        'and RR, "-" before those that turn the other way; none: by their names, or the message\'s type',
    )
    feet: list[Annotated[int, Field(ge=0, le=63)]] = Field(
        [], description="places of FL, FR, RL and RR among the log's foot forces; none: 1, 0, 3, 2 [unitree_ros]"
    )

    @field_validator("joints", mode="before")
    @classmethod
    def _places_are_names(cls, joints: object) -> object:
        return [str(each) if isinstance(each, int) else each for each in joints] if isinstance(joints, list) else joints

    @field_validator("joints")
    @classmethod
    def _twelve_joints(cls, joints: list[str]) -> list[str]:
        _each_once([each.removeprefix("-") for each in joints], 12, "joints")
        return joints

    @field_validator("feet")
    @classmethod
    def _four_feet(cls, feet: list[int]) -> list[int]:
        return _each_once(feet, 4, "places")


class MpcConfig(Section):
    """Convex MPC of ground forces [Tracking, section 4.1]; weights are of squared errors, by axis x, y, z."""

    horizon: int = Field(10, ge=1, le=100, description="steps that are planned ahead")
    dt_s: float = Field(0.03, ge=0.001, le=1, description="length of a step")
    every_s: float = Field(
        0.03,
        ge=0.001,
        le=1,
        description="time between two plans of the forces; also planned whenever the feet on the ground change",
    )
    weight_rpy: PerAxis = Field(
        (25.0, 25.0, 12.0), description="of roll, pitch, yaw in rad; ours, for the paper has none"
    )
    weight_position: PerAxis = Field((20.0, 20.0, 80.0), description="of the place in m; ours")
    weight_omega: PerAxis = Field((0.15, 0.15, 0.4), description="of the angular velocity in rad/s; ours")
    weight_velocity: PerAxis = Field((2.0, 2.0, 0.8), description="of the velocity in m/s; ours")
    turning_share: float = Field(
        0.6,
        gt=0,
        le=1,
        description="share of the standing robot's inertia that turns with the trunk, as feet stay where they stand; "
        "ours: at 1 fpm falls on the s-curve",
    )
    alpha: float = Field(2e-5, gt=0, le=1e3, description="weight of squared forces in N; ours")
    mu: float = Field(
        0.6,
        gt=0,
        le=10,
        description="friction that MPC and whole-body control count on; below simulation.friction to be safe",
    )
    f_min_n: float = Field(0.0, ge=0, le=1e5, description="a foot that stands presses at least so hard")
    f_max_n: float | None = Field(
        None, gt=0, le=1e5, description="and at most so hard; unset: 1.2 times the robot's weight"
    )

    @model_validator(mode="after")
    def _forces_are_in_order(self) -> MpcConfig:
        return self if self.f_max_n is None else in_order(self, "f_min_n", "f_max_n", may_be_equal=True)


class DisturbancesConfig(Section):
    """What a simulated robot has to bear; --disturbed sets 60 N, 3 cm/s, 3 cm, 0.1 s and -8 %."""

    push_n: float = Field(0.0, ge=0, le=1e5, description="force on the trunk, to the left or right by chance")
    push_s: float = Field(0.1, gt=0, le=60, description="length of a push")
    push_every_s: float = Field(2.0, gt=0, le=3600, description="from push to push")
    velocity_bias_mps: float = Field(0.0, ge=0, le=10, description="error of the estimated velocity, in one direction")
    pose_noise_m: float = Field(0.0, ge=0, le=10, description="standard deviation of the pose the path is followed by")
    pose_lag_s: float = Field(0.0, ge=0, le=10, description="and how late it is")
    mass_error: float = Field(0.0, gt=-1, le=10, description="share by which the MPC's mass is wrong")


class Trot(Section):
    """The experiment trot-32s [Foot, section 4]: how its robot differs from its plan, and y(t) of its 3-D curve."""

    payload_kg: float = Field(0.0, ge=0, le=50, description="on top of the trunk")
    payload_x_m: float = Field(0.0, ge=-0.5, le=0.5, description="where, ahead of the trunk's middle")
    payload_y_m: float = Field(0.0, ge=-0.5, le=0.5, description="where, left of the trunk's middle")
    leg_mass_spread: float = Field(
        0.0, ge=-0.9, le=0.9, description="left legs are heavier by this share, right ones lighter"
    )
    hip_offset_m: float = Field(
        0.0, ge=-0.05, le=0.05, description="left hips sit so far ahead of where they should, right ones so far behind"
    )
    height_m: float = Field(
        0.2, ge=0.12, le=0.4, description="of the trunk's middle [Foot, Table 2]; the experiment gives none"
    )
    foot_curve_k: float = Field(
        175.0,
        ge=-1e6,
        le=1e6,
        description="k of eq. 12, 1/m: the smaller, the farther aside; not 0, and below it to the other side. "
        "Ours: 10 mm",
    )
    lateral: Literal["alternating", "same"] = Field(
        "alternating",
        description="y(t) to the left with one pair and to the right with the other [Foot, eq. 11], or "
        "to the left with both",
    )
    lateral_shape: Literal["parabola", "eased"] = Field(
        "parabola", description="as eq. 12 has it, or with neither speed nor acceleration at its ends"
    )
    first_pair: Literal["left_fore", "right_fore"] = Field(
        "left_fore", description="which foot swings first, with the one across"
    )
    friction_spread: float = Field(
        0.25, ge=0, le=0.9, description="a seed draws simulation.friction within this share of itself; ours"
    )
    foot_radius_spread: float = Field(
        0.1, ge=0, le=0.5, description="and the feet's radius of 20 mm within this share; ours"
    )
    posture_spread_deg: float = Field(
        1.0, ge=0, le=10, description="and how far each joint starts beside its plan, within this; ours"
    )

    @field_validator("foot_curve_k")
    @classmethod
    def _k_divides(cls, k: float) -> float:
        if k == 0:
            raise ValueError("must not be 0, by which nothing can be divided")
        return k


class Simulation(Section):
    """The simulated walk, of quadlog simulate and after a replay."""

    controller: Annotated[str, AfterValidator(partial(known_name, group=CONTROLLERS, own=CONTROLLER_NAMES))] = Field(
        "fpmw",
        description="fpmw: fuzzy look-ahead, MPC and WBC; fpm: without WBC; pmw: with a fixed look-ahead [Tracking]; "
        "kinematic: a point that follows every command, fixed look-ahead; a plug-in: fuzzy look-ahead, its torques; "
        "command: open loop by the log's own commands, see topics.command; none leaves the control stage out",
    )
    command_hold_s: float = Field(
        0.5, gt=0, le=3600, description="a command of the log holds for so long without another; then the robot stops"
    )
    gait: Literal["walk", "trot", "flying_trot", "pronk", "bound"] = Field(
        "trot", description="which legs swing when [Following, Table 1]; [Tracking] trots"
    )
    clearance_m: float = Field(0.09, gt=0, le=1, description="how high a foot is lifted; ours")
    terrain: Literal["course", "flat", "3cm", "6cm"] = Field(
        "course",
        description="of quadlog simulate: flat; 3cm, 6cm: 95 % band of noise with a correlation length of 0.25 m "
        "[Tracking, section 5]; course: the s-curve's own, else flat",
    )
    friction: float = Field(0.8, ge=0.01, le=10, description="between feet and ground; ours")
    disturbances: DisturbancesConfig = DisturbancesConfig()
    trot: Trot = Trot()

    @property
    def parts(self) -> ControllerParts | None:
        """What drives the robot; None where nothing does."""
        return parts_of(self.controller)

    @property
    def has_body(self) -> bool:
        """Whether a rigid-body robot walks."""
        return self.parts is not None and self.parts.body
