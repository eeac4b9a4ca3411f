"""Warnings and losses of a track that no robot can have walked, whatever its source."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from quadlog.errors import MAX_LISTED, set_flag
from quadlog.messages import NS_PER_S
from quadlog.pipelines.stages.journal import Journal
from quadlog.pipelines.stages.log import LogData
from quadlog.pipelines.stages.tracks import RobotTrack
from quadlog.positioning.odometry import LEG_S
from quadlog.positioning.plausible import jumps, speeds, ways_beside
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.formatting import several

MOST_IMPLAUSIBLE, MOST_JUMPING, MOST_JUMPS, MOST_CONTRADICTED = 0.01, 0.1, 2, 0.2
"""Of steps or of time, of seconds with jumps, of jumps at all, and of ways beside odometry: above, it is no walk of a
robot. One spike is two jumps."""


def tell_implausible(data: LogData, journal: Journal, robot: RobotTrack, others: Sequence[str]) -> None:
    """A track that no robot can have walked, or that its own odometry contradicts, is a loss; few jumps are a warning.

    others: topics of other positions.
    """
    flags = "  or  ".join(set_flag("topics.position", [each]) for each in others[:MAX_LISTED])
    t_ns, xy_m, most_mps = robot.t_ns, robot.xy_m, data.config.robot.max_speed_mps
    jumped = jumps(t_ns, xy_m, most_mps)
    speed_mps, step_s = speeds(t_ns, xy_m, jumped)
    known, fast, found = np.isfinite(speed_mps), speed_mps > most_mps, list[str]()
    known_s = step_s[known].sum()
    if step_s[fast].sum() > MOST_IMPLAUSIBLE * known_s:
        top_mps, share = float(speed_mps[fast].max()), step_s[fast].sum() / known_s
        found.append(
            f"positions move faster than {most_mps:g} m/s for {share:.0%} of the time, at up to {top_mps:.1f} m/s; "
            f"if the robot is that fast:  --set robot.max_speed_mps={math.ceil(top_mps)}"
        )
    if jumped.any():
        step_m = np.hypot(*np.diff(xy_m, axis=0).T)
        worst, count = int(np.argmax(np.where(jumped, step_m, 0.0))), int(jumped.sum())
        t_s = (t_ns[worst + 1] - data.first_ns) * 1e-9
        text = f"positions jump {several(count, 'time')}, by up to {step_m[worst]:.2f} m, at {t_s:.1f} s"
        many = count > MOST_IMPLAUSIBLE * len(jumped)
        often = len(np.unique(t_ns[1:][jumped] // NS_PER_S)) > MOST_JUMPING * known_s
        if count > MOST_JUMPS and (many or often):
            found.append(
                f"{text}, {count / len(jumped):.1%} of all steps" + f"; other positions:  {flags}" * bool(flags)
            )
        else:
            journal.warn(f"{text}, as where odometry is reset: maps before and after do not fit together")
    if robot.source in ("uwb", "tf") and (odometry := data.streams.odometry) is not None:
        ways_m, contradicts = ways_beside(t_ns, xy_m, odometry.t_ns, odometry.position_m[:, :2])
        if contradicts.sum() > max(MOST_JUMPS, MOST_CONTRADICTED * len(contradicts)):
            own_m, other_m = np.median(ways_m[:, contradicts], axis=1).tolist()
            found.append(
                f"positions from {robot.source} contradict odometry for {contradicts.mean():.0%} of the walk: in "
                f"{LEG_S:g} s they lead {own_m:.2f} m, odometry {other_m:.2f} m; if odometry is right:  "
                f"{set_flag('topics.position', ['odometry'])}"
            )
    journal.lose([Loss("implausible positions", text) for text in found])
