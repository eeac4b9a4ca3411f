"""When each point of a scan was measured, from fields whose unit no message states.

Drivers disagree: seconds or nanoseconds, since the scan's stamp or since 1970.
A reading counts only if it puts every point within a second of the stamp.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import PointTimes

TIME_FIELDS = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "time_offset",
    "offset_time",
    "point_time",
    "point_time_offset",
    "timeoffset",
)

PLAUSIBLE_NS = 1_000_000_000


def point_times(values: NDArray, stamp_ns: int | None) -> PointTimes | None:
    """When points with these values (N,) were measured, or None where no unit makes the values plausible.

    Integers, of at most 32 bits in every format, are nanoseconds after the
    stamp (Ouster ``t``, Hesai, Livox). Floats are seconds (Velodyne ``time``,
    RoboSense ``timestamp``) or, as Livox has it, float nanoseconds, relative or
    of 1970.
    """
    values = np.ascontiguousarray(values)  # numpy searches and converts numbers side by side several times as fast
    low, high = float(values.min()), float(values.max())
    if values.dtype.kind != "f":
        plausible = values.dtype.itemsize >= 4 and _plausible(low, high)
        return PointTimes(values, int(values.min()), int(values.max())) if plausible else None
    if not (np.isfinite(low) and np.isfinite(high)):
        return _without_gaps(values, stamp_ns)
    for zero, scale, shift_ns in _readings(stamp_ns):
        first_ns, last_ns = (low - zero) * scale - shift_ns, (high - zero) * scale - shift_ns
        if _plausible(first_ns, last_ns):
            return PointTimes(values, round(first_ns), round(last_ns), zero, scale, shift_ns)
    return None


def _readings(stamp_ns: int | None) -> list[tuple[float, float, float]]:
    """(zero, scale, shift) of each way to read a float: offset_ns = (value - zero) * scale - shift."""
    readings = [(0.0, 1e9, 0.0)]
    if stamp_ns is not None:
        # Whole seconds are subtracted first, so that 1970-based doubles lose no more digits.
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        readings += [(float(seconds), 1e9, float(nanoseconds)), (float(stamp_ns), 1.0, 0.0)]
    return readings


def _without_gaps(values: NDArray, stamp_ns: int | None) -> PointTimes | None:
    """Points without an echo often carry no time either; they get that of the first point that has one."""
    finite = np.isfinite(values)
    if not finite.any():
        return None
    return point_times(np.where(finite, values, values[finite][0]), stamp_ns)


def _plausible(low_ns: float, high_ns: float) -> bool:
    return low_ns >= -PLAUSIBLE_NS and high_ns <= PLAUSIBLE_NS
