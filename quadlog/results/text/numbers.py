"""Numbers as text: significant digits, thousands and shares, in tables, figures and pages alike."""

from __future__ import annotations

import math


def significant(value: float | None, digits: int = 4) -> str:
    """That many significant digits, zeros at the end included, or all digits before the point: 0.5000, 12346.

    Empty for None, NaN and the infinities; zero has no sign.
    """
    if value is None or not math.isfinite(value):
        return ""
    if abs(value) >= 10 ** (digits - 1):
        return f"{value:.0f}"
    return f"{value + 0.0:#.{digits}g}".rstrip(".")


def short(value: float | None, digits: int = 4) -> str:
    """At most that many significant digits: 0.5, 1.235e+04. Empty for None; zero has no sign."""
    return "" if value is None else f"{value + 0.0:.{digits}g}"


def count(number: int) -> str:
    """A whole number with thin spaces between its thousands."""
    return f"{number:,}".replace(",", "\u2009")


def percent(share: float) -> str:
    """A share as a percentage with one decimal."""
    return f"{100 * share:.1f} %"
