"""Metrics of simulated walks as text: a row per walk, and mean and deviation over the seeds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from quadlog.results.text.markup import aligned

# metric, heading, factor from its unit to the one shown, format
_SHOWN = (
    ("eta_m", "eta m", 1.0, ".4f"),
    ("sigma_m", "sigma m", 1.0, ".4f"),
    ("eta_time_m", "timed m", 1.0, ".3f"),
    ("max_error_m", "max m", 1.0, ".3f"),
    ("heading_rmse_rad", "yaw deg", math.degrees(1), ".2f"),
    ("completion_time_s", "time s", 1.0, ".2f"),
    ("pitch_rms_rad", "pitch deg", math.degrees(1), ".2f"),
    ("height_rms_m", "height mm", 1e3, ".1f"),
    ("forward_m", "forward m", 1.0, ".3f"),
    ("lateral_drift_m", "left mm", 1e3, ".1f"),
    ("yaw_rate_degps", "yaw deg/s", 1.0, ".4f"),
    ("roll_range_deg", "roll range", 1.0, ".2f"),
    ("pitch_range_deg", "pitch range", 1.0, ".2f"),
    ("yaw_range_deg", "yaw range", 1.0, ".2f"),
    ("torque_max_nm", "torque Nm", 1.0, ".1f"),
    ("torque_saturation_share", "cut %", 100.0, ".2f"),
    ("cost_of_transport", "CoT", 1.0, ".2f"),
    ("realtime_factor", "x real", 1.0, ".1f"),
    ("fallen", "falls", 1.0, ".0f"),
)


def walks_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Aligned lines, one for each row with its seed, and mean and sample deviation below more than one.

    A metric that a walk does not have stays empty; one that no walk has is left out.
    """
    shown = [each for each in _SHOWN if any(each[0] in row for row in rows)]
    lines = [["seed", *(heading for _, heading, _, _ in shown)]]
    lines += [[str(row["seed"]), *(_cell(row.get(name), times, to) for name, _, times, to in shown)] for row in rows]
    if len(rows) > 1:
        columns = [([row[name] for row in rows if name in row], times, to) for name, _, times, to in shown]
        lines.append(["mean", *(_cell(statistics.fmean(values), times, _finer(to)) for values, times, to in columns)])
        deviations = [statistics.stdev(values) if len(values) > 1 else None for values, _, _ in columns]
        finer = zip(deviations, columns, strict=True)
        lines.append(["std", *(_cell(value, times, _finer(to)) for value, (_, times, to) in finer)])
    return "".join(f"{line}\n" for line in aligned(lines))


def _finer(to: str) -> str:
    """Falls are whole numbers for one walk, a share over several."""
    return ".2f" if to == ".0f" else to


def _cell(value: float | None, times: float, to: str) -> str:
    return "" if value is None else format(value * times, to)
