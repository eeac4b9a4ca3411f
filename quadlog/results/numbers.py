"""Numbers as text for readers, in tables, figures, pages and sentences. Scripts get full precision instead."""

from __future__ import annotations

import math

NONE = "–"
"""Shown for a value that does not exist."""


def sig(value: float | None, digits: int = 3) -> str:
    """Significant digits without trailing zeros; whole numbers and large ones in full; a true minus sign."""
    if value is None or not math.isfinite(value):
        return NONE
    if (value == int(value) or abs(value) >= 10**digits) and abs(value) < 1e15:
        return count(round(value))
    return minus(f"{value:.{digits}g}")


def count(number: float) -> str:
    """A whole number with thin spaces between its thousands."""
    return minus(f"{int(number):,}".replace(",", "\u2009"))


def percent(share: float | None, digits: int = 3) -> str:
    """A share as a percentage."""
    return NONE if share is None or not math.isfinite(share) else f"{sig(100 * share, digits)}\u202f%"


def file_size(size: float) -> str:
    """Bytes in decimal units."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"


def minus(text: str) -> str:
    """The text of a number with a true minus sign."""
    return f"\u2212{text[1:]}" if text.startswith("-") else text
