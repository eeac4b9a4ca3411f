"""Yaw in map: that of another sensor, turned onto the course of the track, with its uncertainty.

One tag gives no heading. While its carrier walks forward, the course does; a degree off moves what is 10 m away 17 cm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quadlog.geometry import interpolate_angle, seconds_since, wrap_angle
from quadlog.messages import Float, Int
from quadlog.positioning.batch.motion import Track

HOLD_BELOW_MPS = 0.2
TURN_STD_RADPS = 0.5
"""A yaw that is only held is off by so much after a second, by twice that after two: walkers turn on the spot."""
LONGEST_LAG_S = 2.0
UNKNOWN_YAW_STD_RAD = np.pi / np.sqrt(3)
"""Of a direction of which nothing is known."""


def course_heading(
    track: Track, before_motion_rad: float | None = None, lag_s: Float | float = 0.0
) -> tuple[Float, Float]:
    """(T,) yaw along the velocity, held where the speed is below HOLD_BELOW_MPS, and its std (T,).

    Before the first motion: before_motion_rad, which a causal track must give, worth nothing, else the first course;
    zero without any. The std, for a carrier that looks where it walks, is that of the velocity across the course over
    the speed; while held it grows by TURN_STD_RADPS times the time since, and lag_s, (T,) or one, by which the velocity
    is late.
    """
    course, course_std, speed = course_of(track)
    moving = speed >= HOLD_BELOW_MPS
    source = np.maximum.accumulate(np.where(moving, np.arange(len(track)), -1))
    if before_motion_rad is None and moving.any():
        source = np.where(source >= 0, source, np.argmax(moving))
    source, known = source.clip(0), source >= 0
    held_s = np.abs(track.t_ns - track.t_ns[source]) * 1e-9 + lag_s
    std = np.minimum(np.hypot(course_std[source], TURN_STD_RADPS * held_s), UNKNOWN_YAW_STD_RAD)
    yaw_rad = wrap_angle(np.where(known, course[source], before_motion_rad or 0.0))
    return yaw_rad, np.where(known, std, UNKNOWN_YAW_STD_RAD)


def course_of(track: Track) -> tuple[Float, Float, Float]:
    """(T,) direction of the velocity, its std, which is that across it over the speed, and the speed."""
    speed = np.hypot(track.velocity_mps[:, 0], track.velocity_mps[:, 1])
    divisor = np.maximum(speed, 1e-9)
    across = np.stack([-track.velocity_mps[:, 1], track.velocity_mps[:, 0]], axis=1) / divisor[:, None]
    variance = np.einsum("ni,nij,nj->n", across, track.velocity_covariance_m2ps2, across)
    course = np.arctan2(track.velocity_mps[:, 1], track.velocity_mps[:, 0])
    return course, np.sqrt(np.maximum(variance, 0.0)) / divisor, speed


def filter_lag_s(track: Track) -> Float:
    """(T,) how late the velocity of a causal track is: the lag of a constant-velocity filter in its steady state.

    From true to filtered velocity it is w^2 / (s^2 + sqrt(2) w s + w^2), with
    w^2 the ratio of the variances of velocity and position that the filter works with: a lag of sqrt(2) / w.
    """
    position_m2 = np.trace(track.covariance_m2, axis1=1, axis2=2) / track.position_excess
    velocity_m2ps2 = np.trace(track.velocity_covariance_m2ps2, axis1=1, axis2=2)
    return np.sqrt(2 * position_m2 / np.maximum(velocity_m2ps2, 1e-12)).clip(max=LONGEST_LAG_S)


COUNTS_BY_STD = 2.0
"""A course counts for an offset where the speed exceeds its own std by this: noise has a course too."""
MIN_COURSE_STD_RAD = np.radians(1.0)
"""Nobody walks straighter than this, however well the track is known."""
RATE_NS = 250_000_000
"""Yaw rates are means over so much to either side, which is as sharp as a track is."""
GROUP_NS = 200_000_000
"""Instants are grouped by so much: a track's velocity changes more slowly."""
IMU_DRIFT, ODOMETRY_DRIFT, GYRO_DRIFT = (0.001, 0.001), (0.003, 0.003), (0.02, 0.001)
"""Std of a constant rate of drift (rad/s), and a random walk (rad per root second). Orientations of consumer IMUs drift
by degrees a minute, of legged or wheeled odometry by ten: orders, not tuned. Turn-on biases of consumer gyroscopes are
about a degree a second, their noise a few hundredths per root second."""
CLEARLY_LESS = 0.5
"""A sign is taken for turned only where the fit then spreads by this much less: a straight walk hides it."""
REFITS = np.unique((1.05 ** np.arange(400)).astype(np.int64))
"""A causal offset is fitted to so many groups, again when there are 5 % more."""


@dataclass(frozen=True, slots=True)
class YawSensor:
    """Yaw (M,) at increasing t_ns (M,) in a frame of its own; drift as IMU_DRIFT; either_way: it may be upside down."""

    t_ns: Int
    yaw_rad: Float
    drift: tuple[float, float]
    either_way: bool = False


def gyro_sensor(t_ns: Int, rate_radps: Float) -> YawSensor:
    """The yaw since the first instant, by trapezoids, of a rate (M,) about an IMU's z axis, which may point down."""
    t_s = seconds_since(t_ns, int(t_ns[0]) if len(t_ns) else 0)
    return YawSensor(t_ns, summed(t_s, rate_radps), GYRO_DRIFT, True)


def summed(t_s: Float, rate: Float) -> Float:
    """(M, ...) the integral of rates (M, ...) since the first instant, by trapezoids."""
    steps = ((rate[1:] + rate[:-1]).T * np.diff(t_s) / 2).T
    return np.concatenate([np.zeros_like(rate[:1]), np.cumsum(steps, axis=0)])


@dataclass(frozen=True, slots=True)
class TagsYaw:
    """Yaw (T,) of base by the lever arms of several tags, and its std (T,), of which one part is constant all along."""

    yaw_rad: Float
    std_rad: Float
    constant_std_rad: float


@dataclass(frozen=True, slots=True)
class AlignedHeading:
    """Yaw in map at the track's T instants, in [-pi, pi), and its std, at most UNKNOWN_YAW_STD_RAD.

    is_known: (T,) bool, whether the course had shown how the sensor is turned. fit: the offset, of a causal heading the
    last one; None where the track never moved while the sensor gave yaw, and of a causal heading that was never known.
    upside_down: whether its turns count the other way.
    """

    yaw_rad: Float
    yaw_std_rad: Float
    is_known: np.ndarray
    fit: YawOffset | None = None
    upside_down: bool = False


def align_yaw(
    track: Track, sensor: YawSensor, tag_ahead_m: float = 0.0, by_tags: TagsYaw | None = None, *, causal: bool = False
) -> AlignedHeading:
    """Turn a sensor's yaw by the offset, a line in time, that fits the track's course best.

    It is fitted to course minus yaw over moving instants where the sensor was on, weighted by the course's variance;
    see fit_offset. A tag tag_ahead_m in front of base swings out in turns, by arcsin(yaw rate x tag_ahead_m / speed),
    which is taken out. Without motion, or with nothing in common, the std is that of an unknown direction. by_tags:
    instead of the course, also at rest. causal: at each instant the fit to what was known then, again at REFITS.
    """
    n, fit, side = len(track), None, 0
    std, known = np.full(n, UNKNOWN_YAW_STD_RAD), np.zeros(n, dtype=bool)
    if n == 0 or len(sensor.t_ns) == 0:
        return AlignedHeading(np.zeros(n), std, known)
    lag_s = filter_lag_s(track) if causal and by_tags is None else np.zeros(n)
    ways = [replace(sensor, yaw_rad=sign * sensor.yaw_rad) for sign in ((1.0, -1.0) if sensor.either_way else (1.0,))]
    seen = [_differences(track, way, tag_ahead_m, by_tags, lag_s) for way in ways]
    own_rad = [interpolate_angle(track.t_ns, way.t_ns, way.yaw_rad) for way in ways]
    over_ns, t_s, yaw_rad = seen[0][1], seconds_since(track.t_ns, int(track.t_ns[0])), own_rad[0].copy()
    counts = REFITS[len(over_ns) >= REFITS].tolist() if causal else [len(over_ns)][: len(over_ns)]
    since = [int(np.searchsorted(track.t_ns, over_ns[count - 1])) if causal else 0 for count in counts]
    for count, begin, end in zip(counts, since, [*since, n][1:], strict=True):
        fits, rows = [fit_offset(groups[:, :count], sensor.drift) for groups, _ in seen], slice(begin, end)
        side = int(fits[-1].spread_rad < CLEARLY_LESS * fits[0].spread_rad)
        fit = fits[side]
        if causal or fit.agrees:
            yaw_rad[rows] = own_rad[side][rows] + fit.at(t_s[rows])
        if fit.agrees:
            std[rows] = np.hypot(fit.std_at(t_s[rows]), by_tags.constant_std_rad if by_tags else 0.0)
            known[rows] = True
    if causal and not known.any():
        fit = None
    # While the sensor is silent its yaw is held, as a course is.
    after = np.searchsorted(sensor.t_ns, track.t_ns).clip(max=len(sensor.t_ns) - 1)
    silent_ns = np.minimum(*(np.abs(sensor.t_ns[each] - track.t_ns) for each in (after, (after - 1).clip(0))))
    std = np.minimum(np.hypot(std, TURN_STD_RADPS * silent_ns * 1e-9), UNKNOWN_YAW_STD_RAD)
    return AlignedHeading(wrap_angle(yaw_rad), std, known, fit, side == 1)


def _differences(
    track: Track, sensor: YawSensor, tag_ahead_m: float, by_tags: TagsYaw | None, lag_s: Float
) -> tuple[Float, Int]:
    """(3, N) groups of course, or the tags' yaw, minus the sensor's yaw lag_s (T,) before; and when (N,) they end."""
    begin_ns, end_ns, seen_ns = sensor.t_ns[0], sensor.t_ns[-1], track.t_ns - np.rint(lag_s * 1e9).astype(np.int64)
    yaw_rad, std, speed = course_of(track) if by_tags is None else (by_tags.yaw_rad, by_tags.std_rad, None)
    use = (std <= 1 / COUNTS_BY_STD) & (seen_ns >= begin_ns) & (track.t_ns <= end_ns)
    if speed is not None:
        use &= speed >= HOLD_BELOW_MPS
    t_ns, seen_ns = track.t_ns[use], seen_ns[use]
    weight = np.maximum(std[use], MIN_COURSE_STD_RAD) ** -2
    difference = yaw_rad[use] - interpolate_angle(seen_ns, sensor.t_ns, sensor.yaw_rad)
    if speed is not None:
        # Of a late course the future is known as far as it is late; of a smoothed one, all.
        ahead_ns = np.where(lag_s[use] > 0, np.minimum(t_ns - seen_ns, RATE_NS), RATE_NS)
        ends_ns = np.clip([seen_ns - RATE_NS, seen_ns + ahead_ns], begin_ns, end_ns)
        first, last = (interpolate_angle(each, sensor.t_ns, sensor.yaw_rad) for each in ends_ns)
        rate_radps = wrap_angle(last - first) / np.maximum(np.diff(ends_ns, axis=0)[0] * 1e-9, 1e-9)
        difference = difference - np.arcsin((tag_ahead_m * rate_radps / speed[use]).clip(-1, 1))
    cell, group = np.unique((t_ns - track.t_ns[0]) // GROUP_NS, return_inverse=True)
    count = np.bincount(group)
    east, north = (np.bincount(group, weight * each(difference)) for each in (np.cos, np.sin))
    t_s = np.bincount(group, seconds_since(t_ns, int(track.t_ns[0]))) / count
    groups = np.array([t_s, np.arctan2(north, east), np.bincount(group, weight) / count])
    return groups, track.t_ns[0] + (cell + 1) * GROUP_NS


LOOK_S = 1.0
"""Course errors persist over strides: a second of motion is one look at the offset."""
MIN_BLOCKS = 8
CLAIM_LOOKS = 2
"""Few looks do not show their own scatter: what the track claims of its course counts as so many more."""
LIKELY_STD = 4.0
"""Drifts beyond so many of their std are not looked for."""
ASKEW_RAD = np.radians(60)
START_SCALE_RAD, START_GROUPS, LEAST_INFLATION = 0.3, 1000, 1e-9
CLEAR_STD = 3.0
"""N groups show nothing where their mean direction is shorter than this over root N: noise has a course too."""


@dataclass(frozen=True, slots=True)
class YawOffset:
    """What to add to a sensor's yaw: offset_rad at middle_s, changing by drift_radps.

    covariance: (2, 2) of both, in rad and s; walk_std: of the sensor's random walk, in rad per root second, which
    comes on top. first_s, last_s: what the differences span. spread_rad: half of them lie within that of the fit,
    infinite where they do not agree with one offset. askew_share: of the groups that lie more than 60 degrees off,
    where the course is not where the carrier looked.
    """

    middle_s: float
    offset_rad: float
    drift_radps: float
    covariance: Float
    first_s: float
    last_s: float
    walk_std: float
    spread_rad: float
    askew_share: float

    @property
    def agrees(self) -> bool:
        """Whether the differences agree with one offset."""
        return bool(np.isfinite(self.spread_rad))

    def at(self, t_s: Float) -> Float:
        """(T,) what to add at instants (T,)."""
        return self.offset_rad + self.drift_radps * (t_s - self.middle_s)

    def std_at(self, t_s: Float) -> Float:
        """(T,) its std; a line leaves q^2 T/15 of a random walk over T s, which goes on alone beyond the span."""
        away_s, c = t_s - self.middle_s, self.covariance
        walked_s = (self.last_s - self.first_s) / 15 + np.maximum(self.first_s - t_s, t_s - self.last_s).clip(0)
        variance = c[0, 0] + 2 * c[0, 1] * away_s + c[1, 1] * away_s**2 + self.walk_std**2 * walked_s
        return np.sqrt(variance)


def fit_offset(groups: Float, drift: tuple[float, float]) -> YawOffset:
    """The offset and the drift that fit groups (3, N) best: rising instants (s), differences (rad), weights (1/rad^2).

    drift: as IMU_DRIFT. A line with weights that fall as 1/(1 + (residual/scale)^2): started where most agree, it
    passes over a minority of sideways or backward steps. How much a look weighs against what was known of the drift
    comes from the scatter of the looks themselves.
    """
    t_s, difference, weight = groups
    middle_s = float(np.average(t_s, weights=weight))
    design = np.column_stack([np.ones_like(t_s), t_s - middle_s])
    line, prior = _start(t_s - middle_s, difference, weight, drift[0]), np.diag([0.0, drift[0] ** -2])
    # What a look is worth beside the prior only shows in the residuals of a fit: first there is hardly a prior.
    inflation = LEAST_INFLATION
    for _ in range(2):
        for _ in range(50):
            residual = wrap_angle(difference - design @ line)
            falling = weight / (1 + (residual / _scale(residual)) ** 2)
            pull = design.T @ (falling * residual) - inflation * prior @ line
            step = np.linalg.solve((design.T * falling) @ design + inflation * prior, pull)
            line = line + step
            if np.abs(design[[0, -1]] @ step).max() < 1e-6:
                break
        residual = wrap_angle(difference - design @ line)
        covariance, inflation = _covariance(residual, groups, design, prior)
    # Whether the residuals point one way more than random directions would; few cannot, even where they do.
    agrees = np.average(np.cos(residual), weights=weight) * np.sqrt(len(residual)) > CLEAR_STD
    spread = float(np.median(np.abs(residual))) if agrees else np.inf
    askew, (first_s, last_s) = float(np.mean(np.abs(residual) > ASKEW_RAD)), t_s[[0, -1]].tolist()
    offset, rate_radps = float(wrap_angle(line[0])), float(line[1])
    return YawOffset(middle_s, offset, rate_radps, covariance, first_s, last_s, drift[1], spread, askew)


def _scale(residual: Float) -> float:
    return 2 * max(float(np.median(np.abs(residual))), 1e-6)


def _start(away_s: Float, difference: Float, weight: Float, rate_std_radps: float) -> Float:
    """Offset and drift that most groups agree with, or most of the doubled angles, which backward steps do not turn."""
    some = slice(None, None, 1 + len(away_s) // START_GROUPS)
    away_s, difference, weight = away_s[some], difference[some], weight[some]
    likely = LIKELY_STD * rate_std_radps
    drifts, starts = np.linspace(-likely, likely, 3 + 2 * int(likely * np.ptp(away_s))), list[Float]()
    for fold in (1, 2):
        sums = (weight * np.exp(1j * fold * difference)) @ np.exp(-1j * fold * np.outer(away_s, drifts))
        best = int(np.argmax(np.abs(sums)))
        starts += [np.array([np.angle(sums[best]) / fold + turn, drifts[best]]) for turn in (0.0, np.pi)[:fold]]
    off = [wrap_angle(difference - start[0] - start[1] * away_s) / START_SCALE_RAD for start in starts]
    return starts[int(np.argmin([np.sum(weight * np.log1p(each**2)) for each in off]))]


def _covariance(residual: Float, groups: Float, design: Float, prior: Float) -> tuple[Float, float]:
    """(2, 2) of the fit, and how much a squared score exceeds what independent groups would give.

    The fit solves sum w psi(r) x = prior, psi = r / (1 + u^2), u = r/scale. Errors persist for unknown times, so scores
    are summed over blocks of 1, 2, 4 ... s and the largest scatter counts.
    """
    t_s, _, weight = groups
    u2 = (residual / _scale(residual)) ** 2
    falling = weight / (1 + u2)
    # Residuals all over the circle make psi' cancel: the floor keeps the std finite, and large.
    bend = max(float(np.sum(falling * (1 - u2) / (1 + u2)) / np.sum(falling)), 0.1)
    claimed = max(float(np.mean(falling * residual**2)), 1.0)
    excess, length_s = list[float](), LOOK_S
    while True:
        block = np.append(0, np.cumsum(np.diff(t_s // length_s) > 0))
        n, sums = int(block[-1]) + 1, np.bincount(block, falling * residual)
        if excess and n < MIN_BLOCKS:
            break
        scatter = float(sums @ sums / np.sum(falling)) * n / max(n - 1, 1)
        excess.append(scatter if excess else (scatter * (n - 1) + claimed * CLAIM_LOOKS) / (n - 1 + CLAIM_LOOKS))
        length_s *= 2
    inflation = max(max(excess) / bend, LEAST_INFLATION)
    return np.linalg.inv((design.T * falling) @ design * bend / inflation + prior), inflation
