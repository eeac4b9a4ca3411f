"""What every table of quadlog.toml has in common."""

from __future__ import annotations

from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field

Metres = Annotated[float, Field(ge=-1e6, le=1e6)]
"""A place or a height: anything within a thousand kilometres of map's origin."""


class Section(BaseModel):
    """A table of the file: unknown keys are refused, values are bounded, nothing changes afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


SectionT = TypeVar("SectionT", bound=Section)


def in_order(section: SectionT, low: str, high: str, may_be_equal: bool = False) -> SectionT:
    """The section, unless its lower bound is not below its upper one."""
    lower, upper = getattr(section, low), getattr(section, high)
    if lower > upper or (lower == upper and not may_be_equal):
        raise ValueError(f"{low} must {'not be above' if may_be_equal else 'be below'} {high}")
    return section
