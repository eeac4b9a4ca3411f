"""How ranges become positions: what the section [uwb] has beside its tables of anchors, tags and topics."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from quadlog.config.section import Section, in_order


class LocateSettings(Section):
    """How ranges become fixes and tracks."""

    range_std_m: float | None = Field(
        None,
        ge=0.001,
        le=10,
        description="standard deviation of a range in sight; unset: estimated from the log, link by link, for tracks, "
        "and 0.1 for fixes, in which late ranges count in full [Following, Fig. 9]",
    )
    calibrate: bool = Field(
        True,
        description="constant bias of each link, estimated with the track, where the ranges show one; with uwb.smooth "
        "also a scale of all ranges, where it is clear",
    )
    smooth: bool = Field(
        True,
        description="poses and target smoothed over the whole log; false: what the robot could have known then",
    )
    method: Literal["gauss_newton", "linear", "weighted", "paper", "huber"] = Field(
        "gauss_newton",
        description="how ranges become a fix: gauss_newton (maximum likelihood), huber (the same, late ranges count "
        "less), linear, weighted (linear with the full covariance), paper (linear as weighted in [Following])",
    )
    height: Literal["auto", "given", "solved"] = Field(
        "auto",
        description="a tag's height: as given, or solved for; auto solves where the anchors' heights determine it",
    )
    mirror: Literal["refuse", "left", "right"] = Field(
        "refuse",
        description="anchors on a line leave two mirrored tracks: refuse, or the one that starts to the left or right "
        "of the way from the first anchor to the last",
    )
    min_range_m: float = Field(0.05, ge=0, le=1e5, description="shorter ranges are dropped and counted")
    max_range_m: float = Field(300.0, gt=0, le=1e5, description="longer ranges are dropped and counted")
    epoch_s: float | None = Field(
        None,
        ge=0.0001,
        le=5,
        description="single ranges of one tag this close together make one fix; unset: one round of the anchors, "
        "as the log has it",
    )
    outlier_m: float = Field(
        0.5, gt=0, le=1e5, description="a fix whose residual rms exceeds this is marked and not tracked"
    )
    acceleration_std_mps2: float = Field(
        1.0, ge=0.001, le=1000, description="how hard the robot or person accelerates; stiffness of the smoother"
    )

    @model_validator(mode="after")
    def _ranges_are_in_order(self) -> LocateSettings:
        return in_order(self, "min_range_m", "max_range_m")
