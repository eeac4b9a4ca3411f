"""The unit of the times of points, which messages do not name: the one in which a scan lasts as long as scans take.

Drivers write s, ms, us or ns, as integers or floats, or shares of a scan; since the scan's stamp, since 1970 or since a
start of their own. A lidar has one way for all its clouds, found in the first ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import islice
from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.deskew import MAX_OFFSET_NS
from quadlog.messages import Float, Int, PointCloud, PointTimes

UNITS_NS = (1e9, 1e6, 1e3, 1.0)
LEAST_SHARE = 0.4
"""Of a scan that is covered, below which floats from 0 to 1 are no shares of it."""
LEAST_OF_PERIOD, MOST_OF_PERIOD, FARTHEST_OF_PERIOD = 0.08, 2.5, 1.5
"""How long scans may last: part of a turn, or those of two lidars in turns; and how far they may be from the stamp."""
USUAL_PERIOD_NS = 100_000_000
LOOKED_AT = 20
USUAL_PERCENT = (1, 99)
FLOAT32_WHOLE = 2.0**24
"""Beyond, a float32 has no fractions: nothing is left of seconds since 1970."""
STAMP, EPOCH, OWN = "stamp", "1970", "own"


class TimeReading(NamedTuple):
    """How the times of a lidar's points are read: the field, empty if none can be, and why_not, if there are any.

    unit_ns: of one unit; since: what is zero; most: the largest usual difference between times of a scan.
    """

    field: str = ""
    unit_ns: float = 1.0
    since: str = STAMP
    most: float = 0.0
    why_not: str = ""

    def timed(self, cloud: PointCloud) -> PointCloud:
        """The cloud with the times of its points; one that has them already, or no such field, as it is."""
        if self.field not in cloud.time_fields or cloud.times is not None:
            return cloud
        # Numpy searches numbers side by side several times as fast.
        values = np.ascontiguousarray(cloud.time_fields[self.field])
        if self.since == OWN and values.dtype.kind == "u":
            values = (values - values[0]).view(f"i{values.itemsize}")  # the sensor's counter may have overflowed
        low, high = float(values.min()), float(values.max())
        if not high - low <= self.most:
            values = _without_strays(values, cloud.xyz_m, self.most)
            low, high = float(values.min()), float(values.max())
        zero, shift_ns = low if self.since == OWN else 0.0, 0.0
        if self.since == EPOCH:  # whole units first, so that doubles lose no more digits
            zero, shift_ns = map(float, divmod(cloud.stamp_ns or 0, int(self.unit_ns)))
        first_ns, last_ns = (round((each - zero) * self.unit_ns - shift_ns) for each in (low, high))
        return replace(cloud, times=PointTimes(values, first_ns, last_ns, zero, self.unit_ns, shift_ns))

    def warnings(self, scans: int) -> list[str]:
        """What a user should know of the times in so many scans."""
        if self.why_not:
            return [f"{scans} of {scans} scans are not deskewed: {self.why_not}"]
        own = (
            f"{self.field} of points counts neither from the stamp nor from 1970: a scan's first point is taken to be "
            "measured at its stamp; if that is wrong,  --set lidar.deskew=false"
        )
        return [own] if self.since == OWN else []


AS_THEY_COME = TimeReading()


def find_reading(clouds: Iterable[PointCloud], stamps_ns: Int) -> TimeReading:
    """How the times of a lidar's points are read, by its first clouds and the stamps (C,) of all.

    Of several fields whose times fit, that one counts whose zero is known, then that whose scans last a period best.
    """
    seen = list(islice((each for each in clouds if len(each.xyz_m)), LOOKED_AT))
    names, period_ns = dict.fromkeys(name for cloud in seen for name in cloud.time_fields), usual_step_ns(stamps_ns)
    readings = [_read(name, [cloud for cloud in seen if name in cloud.time_fields], period_ns) for name in names]
    return min(readings, key=lambda each: each[0])[1] if readings else AS_THEY_COME


def usual_step_ns(stamps_ns: Int) -> float:
    """The usual time between scans (C,), of which some may be missing, and those of two lidars lie close together."""
    steps_ns = np.diff(np.unique(stamps_ns))
    usual_ns = steps_ns[steps_ns >= np.quantile(steps_ns, 0.75) / 2] if len(steps_ns) else [USUAL_PERIOD_NS]
    return float(np.median(usual_ns))


def _read(name: str, clouds: Sequence[PointCloud], period_ns: float) -> tuple[tuple[int, float], TimeReading]:
    """The reading of a field in which scans last about a period, or why there is none; and its rank, the best first."""
    usual = [_usual(each.time_fields[name], each.xyz_m) for each in clouds]
    filled = [each for each in zip(usual, clouds, strict=True) if len(each[0])]
    low, high = np.array([np.percentile(values, USUAL_PERCENT) for values, _ in filled]).reshape(-1, 2).T
    stamp_ns, moves = np.array([cloud.stamp_ns or 0 for _, cloud in filled]), high > low
    if not moves.any():
        coarse = len(low) and usual[0].dtype == np.float32 and low[0] >= FLOAT32_WHOLE
        why_not = f"{name} of points is a float32, too coarse for times like {low[0]:.0f}" if coarse else ""
        return (2 if coarse else 3, 0.0), TimeReading(why_not=why_not)
    ends, stamp_ns, lasts = np.array([low, high])[:, moves], stamp_ns[moves], float(np.median((high - low)[moves]))
    as_shares = usual[0].dtype.kind == "f" and lasts >= LEAST_SHARE and np.abs(ends).max() <= 1.001
    least_ns = LEAST_OF_PERIOD * min(period_ns, USUAL_PERIOD_NS)
    most_ns = min(MOST_OF_PERIOD * period_ns, MAX_OFFSET_NS)
    units_ns = [each for each in (*UNITS_NS, period_ns if as_shares else 0.0) if least_ns <= lasts * each <= most_ns]
    if not units_ns:
        why_not = f"{name} of points spans {lasts:.3g}, in no unit the {period_ns * 1e-9:.3g} s of a scan"
        return (2, 0.0), TimeReading(why_not=why_not)
    off, unit_ns = min((abs(log(lasts * each / period_ns)), each) for each in units_ns)
    near_ns = FARTHEST_OF_PERIOD * max(period_ns, lasts * unit_ns)
    far_ns = [np.median(np.abs(ends * unit_ns - zero_ns).max(axis=0)) for zero_ns in (0.0, stamp_ns)]
    since = STAMP if far_ns[0] <= near_ns else EPOCH if far_ns[1] <= near_ns else OWN
    return (int(since == OWN), off), TimeReading(name, unit_ns, since, MOST_OF_PERIOD * period_ns / unit_ns)


def _usual(values: NDArray, xyz_m: Float) -> NDArray:
    """Values of those points (N,) that are returns with a time; where there is none, drivers write NaN or zeros."""
    return values[np.isfinite(values) & np.isfinite(xyz_m).all(axis=1) & xyz_m.any(axis=1)]


def _without_strays(values: NDArray, xyz_m: Float, most: float) -> NDArray:
    """Times (N,) within usual ends: points without a return, and a few with a wrong time, get the nearest."""
    usual = _usual(values, xyz_m)
    low, high = np.percentile(usual, (0, 100)) if len(usual) else (0.0, 0.0)
    if high - low > most:
        low, high = np.percentile(usual, USUAL_PERCENT)
    return np.clip(np.where(np.isfinite(values), values, low), low, high)
