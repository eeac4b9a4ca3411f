"""How a robot follows its path and how hard its feet push: the sections [pursuit], [pursuit.fuzzy] and [mpc]."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from quadlog.config.section import Section, in_order


class FuzzySettings(Section):
    """The look-ahead by fuzzy rules, l = l0 + lambda_v k_v v^2 + lambda_w k_w v, l0: lookahead_m [Tracking, 3.2]."""

    lambda_v_s2_per_m: float = Field(
        1.0, ge=-100, le=100, description="weight of the term with v^2 [Tracking, eq. 17]; it prints no value"
    )
    lambda_w_s: float = Field(
        1.0, ge=-100, le=100, description="weight of the term with v [Tracking, eq. 17]; it prints no value"
    )
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
    def _limits_are_in_order(self) -> FuzzySettings:
        return in_order(self, "l_min_m", "l_max_m", may_be_equal=True)


class PursuitSettings(Section):
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
    fuzzy: FuzzySettings = FuzzySettings()


class MpcSettings(Section):
    """What convex MPC and whole-body control take feet to push with [Tracking, sections 4.1, 4.2]."""

    mu: float = Field(0.6, gt=0, le=10, description="friction that they count on; below simulation.friction to be safe")
    f_max_n: float | None = Field(
        None, gt=0, le=1e5, description="a foot presses at most so hard; unset: 1.2 times the robot's weight"
    )
