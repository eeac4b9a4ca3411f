"""The keys of quadlog.toml that say how a robot walks: [pursuit], [robot], [mpc], [wbc] and [simulation]."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from quadlog.config_section import Section, in_order

Weight = Annotated[float, Field(ge=0, le=1e9)]
Gain = Annotated[float, Field(ge=0, le=1e6)]
PerAxis = tuple[Weight, Weight, Weight]
Feedback = tuple[Gain, Gain]


class Fuzzy(Section):
    """The look-ahead by fuzzy rules, l = l0 + lambda_v k_v v^2 + lambda_w k_w v, l0: lookahead_m [Tracking, 3.2]."""

    lambda_v_s2_per_m: float = Field(1.0, ge=-100, le=100, description="[Tracking, eq. 17]; it prints no value")
    lambda_w_s: float = Field(1.0, ge=-100, le=100, description="[Tracking, eq. 17]; it prints no value")
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
    tables: Literal["printed", "corrected"] = Field("printed", description="the rules as in Tables 1 and 2, or mended")
    centroid: Literal["points", "continuous"] = Field(
        "points", description="over the seven points as printed, or over the whole area"
    )

    @model_validator(mode="after")
    def _limits_are_in_order(self) -> Fuzzy:
        return in_order(self, "l_min_m", "l_max_m", may_be_equal=True)


class Pursuit(Section):
    """Pure pursuit [Tracking, section 3]."""

    lookahead_m: float = Field(2.0, ge=0.01, le=100, description="l, or l0 of the fuzzy rules [Tracking, section 5]")
    speed_mps: float = Field(0.6, ge=0.01, le=10, description="[Tracking, section 5]; unset, the s-curve takes 0.5")
    max_yaw_rate_radps: float = Field(1.5, ge=0.001, le=20, description="the robot turns no faster")
    rate_hz: float = Field(50.0, ge=1, le=1000, description="ticks of the controller and of control.parquet")
    fuzzy: Fuzzy = Fuzzy()


class Robot(Section):
    """The robot's body on maps [Following, Table 1], and the model that walks."""

    length_m: float = Field(0.62, gt=0, le=100)
    width_m: float = Field(0.26, gt=0, le=100)
    height_m: float = Field(0.37, gt=0, le=100)
    model: str = Field(
        "tracking",
        min_length=1,
        description="tracking [Tracking, Table 4], following [Following, Table 1], foot [Foot, Table 2], or a file: "
        "MJCF or URDF",
    )


class Mpc(Section):
    """Convex MPC of ground forces [Tracking, section 4.1]; weights are of squared errors, by axis x, y, z."""

    horizon: int = Field(10, ge=1, le=100, description="steps that are planned ahead")
    dt_s: float = Field(0.03, ge=0.001, le=1, description="length of a step")
    every_s: float = Field(
        0.03, ge=0.001, le=1, description="forces are planned anew so often, and whenever other feet carry"
    )
    weight_rpy: PerAxis = Field(
        (25.0, 25.0, 12.0), description="of roll, pitch, yaw in rad; ours, for the paper has none"
    )
    weight_position: PerAxis = Field((20.0, 20.0, 80.0), description="of the place in m; ours")
    weight_omega: PerAxis = Field((0.15, 0.15, 0.4), description="of the angular velocity in rad/s; ours")
    weight_velocity: PerAxis = Field((2.0, 2.0, 0.8), description="of the velocity in m/s; ours")
    alpha: float = Field(2e-5, gt=0, le=1e3, description="weight of squared forces in N; ours")
    mu: float = Field(0.6, gt=0, le=10, description="friction that is counted on; below simulation.friction to be safe")
    f_min_n: float = Field(0.0, ge=0, le=1e5, description="a foot that stands presses at least so hard")
    f_max_n: float = Field(150.0, gt=0, le=1e5, description="and at most so hard; a heavier robot needs more")

    @model_validator(mode="after")
    def _forces_are_in_order(self) -> Mpc:
        return in_order(self, "f_min_n", "f_max_n", may_be_equal=True)


class Wbc(Section):
    """Whole-body control [Tracking, section 4.2]; gains are pairs, of the error and of its rate."""

    rotation_gains: Feedback = Field((80.0, 8.0), description="of the body's rotation, 1/s^2 and 1/s; ours")
    translation_gains: Feedback = Field((60.0, 8.0), description="of the body's place, 1/s^2 and 1/s; ours")
    swing_gains: Feedback = Field((350.0, 30.0), description="of feet in the air, 1/s^2 and 1/s; ours")
    joint_gains: Feedback = Field((20.0, 0.8), description="of joints, N m/rad and N m s/rad [Tracking, eq. 44]; ours")
    swing_force_gains: Feedback = Field(
        (700.0, 25.0), description="of feet in the air without whole-body control (fpm), N/m and N s/m; ours"
    )
    weight_acceleration: Weight = Field(
        0.1, description="of what the base does beside the tasks [Tracking, eq. 41]; ours"
    )
    weight_force: float = Field(1.0, gt=0, le=1e9, description="of forces beside those of the MPC; ours")
    mu: float = Field(0.6, gt=0, le=10, description="friction that is counted on")
    f_min_n: float = Field(0.0, ge=0, le=1e5, description="a foot that stands presses at least so hard")
    f_max_n: float = Field(150.0, gt=0, le=1e5, description="and at most so hard")
    weakest: float = Field(0.02, gt=0, le=1, description="directions in which a leg moves less are met weakly; ours")

    @model_validator(mode="after")
    def _forces_are_in_order(self) -> Wbc:
        return in_order(self, "f_min_n", "f_max_n", may_be_equal=True)


class Disturbances(Section):
    """What a simulated robot has to bear; --disturbed sets 60 N, 3 cm/s, 3 cm, 0.1 s and -8 %."""

    push_n: float = Field(0.0, ge=0, le=1e5, description="force on the trunk, to the left or right by chance")
    push_s: float = Field(0.1, gt=0, le=60, description="length of a push")
    push_every_s: float = Field(2.0, gt=0, le=3600, description="from push to push")
    velocity_bias_mps: float = Field(0.0, ge=0, le=10, description="error of the estimated velocity, in one direction")
    pose_noise_m: float = Field(0.0, ge=0, le=10, description="standard deviation of the pose the path is followed by")
    pose_lag_s: float = Field(0.0, ge=0, le=10, description="and how late it is")
    mass_error: float = Field(0.0, gt=-1, le=10, description="share by which the MPC's mass is wrong")


class Simulation(Section):
    """The simulated walk, of quadlog simulate and after a replay."""

    controller: Literal["fpmw", "fpm", "pmw", "kinematic", "none"] = Field(
        "fpmw",
        description="fpmw: fuzzy look-ahead, MPC and WBC; fpm: without WBC; pmw: with a fixed look-ahead [Tracking]; "
        "kinematic: a point that does as it is told, fixed look-ahead; none leaves the control stage out",
    )
    gait: Literal["walk", "trot", "flying_trot", "pronk", "bound"] = Field(
        "trot", description="[Following, Table 1]; [Tracking] trots"
    )
    clearance_m: float = Field(0.09, gt=0, le=1, description="how high a foot is lifted; ours")
    terrain: Literal["course", "flat", "3cm", "6cm"] = Field(
        "course",
        description="of quadlog simulate: flat; 3cm, 6cm: 95 % band of noise with a correlation length of 0.25 m "
        "[Tracking, section 5]; course: the s-curve's own, else flat",
    )
    friction: float = Field(0.8, ge=0.01, le=10, description="between feet and ground; ours")
    disturbances: Disturbances = Disturbances()

    @property
    def has_body(self) -> bool:
        """Whether a rigid-body robot walks."""
        return self.controller in ("fpmw", "fpm", "pmw")
