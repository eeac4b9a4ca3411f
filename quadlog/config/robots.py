"""The section [robot]: a body on maps, the model that walks, and where the log has its joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from quadlog.config.section import Section

# Length, width, height from [unitree_ros]: over the thighs, over the knees with thighs at 45 degrees, and up to the
# trunk's top, of the robots in quadlog.control.locomotion.robot.
BODIES_M = {"go1": (0.68, 0.28, 0.35), "go2": (0.69, 0.31, 0.35), "a1": (0.64, 0.29, 0.33), "b1": (1.19, 0.45, 0.56)}
OTHER_BODY_M = (0.62, 0.26, 0.37)
"""Of every other model [Following, Table 1]."""
SIZES = ("length_m", "width_m", "height_m")


def without_preset(robot: Mapping[str, Any]) -> dict[str, Any]:
    """The section as the version before had it, whose preset named a model and its body; sizes of others are kept."""
    name = str(robot["preset"])
    body_m = dict(zip(SIZES, BODIES_M.get(name, OTHER_BODY_M), strict=True))
    kept = {key: value for key, value in robot.items() if key != "preset" and body_m.get(key) != value}
    return {"model": "tracking" if name == "paper" else name} | kept


class RobotConfig(Section):
    """The robot's body on maps, and the model that walks."""

    model: str = Field(
        "tracking",
        min_length=1,
        description="tracking [Tracking, Table 4], following [Following, Table 1], foot [Foot, Table 2]; go1, go2, a1, "
        "b1 [unitree_ros]; or a file: MJCF or URDF",
    )
    length_m: float | None = Field(
        None, gt=0, le=100, description="of the body, along x; unset: that of go1, go2, a1, b1, else 0.62 [Following]"
    )
    width_m: float | None = Field(None, gt=0, le=100, description="of the body, along y; unset: as length_m, or 0.26")
    height_m: float | None = Field(
        None,
        gt=0,
        le=100,
        description="how tall it stands; a cell of map.pgm is free where a ray passed below that; unset: as length_m, "
        "or 0.37",
    )
    max_speed_mps: float = Field(
        8.0,
        ge=0.1,
        le=1000,
        description="a track that is faster for more than 1 % of the time counts as wrong; ours",
    )
    joints: list[Annotated[str, Field(min_length=1, max_length=200)]] = Field(
        [],
        description="joints of the log: names, or places in the message, of hip, thigh and calf of the legs FL, FR, RL "
        'and RR, "-" before those that turn the other way; none: by their names, or the message\'s type',
    )
    feet: list[Annotated[int, Field(ge=0, le=63)]] = Field(
        [], description="places of FL, FR, RL and RR among the log's foot forces; none: 1, 0, 3, 2 [unitree_ros]"
    )

    @property
    def body_m(self) -> tuple[float, float, float]:
        """Length, width and height, as set or the model's."""
        own = BODIES_M.get(self.model, OTHER_BODY_M)
        return tuple(getattr(self, key) or size for key, size in zip(SIZES, own, strict=True))  # type: ignore[return-value]

    @field_validator("joints", mode="before")
    @classmethod
    def _places_are_names(cls, joints: object) -> object:
        return [str(each) if isinstance(each, int) else each for each in joints] if isinstance(joints, list) else joints

    @field_validator("joints", "feet")
    @classmethod
    def _each_once(cls, values: list[Any], info: ValidationInfo) -> list[Any]:
        count, what = (12, "joints") if info.field_name == "joints" else (4, "places")
        different = {each.removeprefix("-") if isinstance(each, str) else each for each in values}
        if values and not len(values) == len(different) == count:
            raise ValueError(f"must be {count} different {what}, or none")
        return values
