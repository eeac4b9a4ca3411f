"""How a simulated robot walks and what disturbs it: the section [simulation]."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator

from quadlog.config.controllers import CONTROLLER_NAMES, ControllerParts, parts_of
from quadlog.config.section import Section
from quadlog.plugins import CONTROLLERS, known_name

RATE_HZ = 50.0
"""Ticks of the control: how often a robot is steered, and rows of control.parquet; it divides the simulation's rate."""


class DisturbanceSettings(Section):
    """What a simulated robot has to bear; --disturbed sets 60 N, 3 cm/s, 3 cm, 0.1 s and -8 %."""

    push_n: float = Field(0.0, ge=0, le=1e5, description="force on the trunk, to the left or right by chance")
    push_s: float = Field(0.1, gt=0, le=60, description="length of a push")
    push_every_s: float = Field(2.0, gt=0, le=3600, description="from push to push")
    velocity_bias_mps: float = Field(0.0, ge=0, le=10, description="error of the estimated velocity, in one direction")
    pose_noise_m: float = Field(0.0, ge=0, le=10, description="standard deviation of the pose the path is followed by")
    pose_lag_s: float = Field(0.0, ge=0, le=10, description="and how late it is")
    mass_error: float = Field(0.0, gt=-1, le=10, description="share by which the MPC's mass is wrong")


class TrotSettings(Section):
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
    foot_curve_k: float = Field(
        175.0,
        ge=-1e6,
        le=1e6,
        description="k of eq. 12, 1/m: the smaller, the farther aside; not 0, and below it to the other side. "
        "Ours: 10 mm",
    )

    @field_validator("foot_curve_k")
    @classmethod
    def _k_divides(cls, k: float) -> float:
        if k == 0:
            raise ValueError("must not be 0")
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
    tick_s: float | None = Field(
        None,
        ge=0.001,
        le=0.005,
        description="step of controller and physics, a whole part of 0.02; unset: 0.004 with whole-body control, with "
        "which courses end as with 0.002, and else 0.002",
    )
    disturbances: DisturbanceSettings = DisturbanceSettings()
    trot: TrotSettings = TrotSettings()

    @property
    def parts(self) -> ControllerParts | None:
        """What drives the robot; None where nothing does."""
        return parts_of(self.controller)

    @property
    def step_s(self) -> float:
        """Step of controller and physics."""
        by_wbc = self.parts is not None and self.parts.whole_body
        return self.tick_s or (0.004 if by_wbc else 0.002)

    @field_validator("tick_s")
    @classmethod
    def _ticks_fit(cls, tick_s: float | None) -> float | None:
        if tick_s is not None and abs(1 / (RATE_HZ * tick_s) - round(1 / (RATE_HZ * tick_s))) > 1e-9:
            raise ValueError("0.02 s must be a whole number of them, as of 0.001, 0.002, 0.004 and 0.005")
        return tick_s

    @property
    def has_body(self) -> bool:
        """Whether a rigid-body robot walks."""
        return self.parts is not None and self.parts.body
