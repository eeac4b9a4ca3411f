"""How far a sensor's yaw is turned against map, and how fast it drifts, from its differences to a course."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.geometry import wrap_angle
from quadlog.messages import Float

GROUP_NS = 200_000_000
"""Instants are grouped by so much: a track's velocity changes more slowly."""
LOOK_S = 1.0
"""Course errors persist over strides: a second of motion is one look at the offset."""
MIN_BLOCKS = 8
CLAIM_LOOKS = 2
"""Few looks do not show their own scatter: what the track claims of its course counts as so many more."""
UNKNOWN_YAW_STD_RAD = np.pi / np.sqrt(3)
"""Of a direction of which nothing is known."""
LIKELY_STD = 4.0
"""Drifts beyond so many of their std are not looked for."""
ASKEW_RAD = np.radians(60)
START_SCALE_RAD, START_GROUPS = 0.3, 2000
LEAST_INFLATION = 1e-9
CLEAR_STD = 3.0
"""N groups show nothing where their mean direction is shorter than this over root N: noise has a course too."""


@dataclass(frozen=True, slots=True)
class CourseDifferences:
    """Course minus a sensor's yaw, in N groups of instants while its carrier moved.

    t_s: (N,) rising, from the track's start; difference_rad: (N,); weight: (N,) in 1/rad^2, of the course alone.
    """

    t_s: Float
    difference_rad: Float
    weight: Float

    def until(self, count: int) -> CourseDifferences:
        """The first count groups."""
        return CourseDifferences(self.t_s[:count], self.difference_rad[:count], self.weight[:count])


@dataclass(frozen=True, slots=True)
class SensorDrift:
    """How the yaw of a kind of sensor leaves the truth, known beforehand: std of a constant rate, and a random walk.

    rate_std_radps: zero for a sensor without such a rate; walk_std: in rad per root second.
    """

    rate_std_radps: float = 0.0
    walk_std: float = 0.0


@dataclass(frozen=True, slots=True)
class YawOffset:
    """What to add to a sensor's yaw: offset_rad at middle_s, changing by drift_radps.

    covariance: (2, 2) of both, in rad and s; walk_std: of the sensor's random walk, in rad per root second, which
    comes on top. first_s, last_s: what the differences span. spread_rad: half of them lie within that of the fit.
    askew_share: of the groups that lie more than 60 degrees off, where the course is not where the carrier looked.
    agrees: whether the differences agree with one offset.
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
    agrees: bool

    def at(self, t_s: Float) -> Float:
        """(T,) what to add at instants (T,)."""
        offset: Float = self.offset_rad + self.drift_radps * (t_s - self.middle_s)
        return offset

    def std_at(self, t_s: Float) -> Float:
        """(T,) its standard deviation.

        A line fitted to a random walk of density q over T s leaves q^2 T/15 in
        the mean; beyond the span the walk goes on alone.
        """
        away_s, c = t_s - self.middle_s, self.covariance
        walked_s = (self.last_s - self.first_s) / 15 + np.maximum(self.first_s - t_s, t_s - self.last_s).clip(0)
        variance = c[0, 0] + 2 * c[0, 1] * away_s + c[1, 1] * away_s**2 + self.walk_std**2 * walked_s
        std: Float = np.sqrt(variance)
        return std


def fit_offset(differences: CourseDifferences, drift: SensorDrift) -> YawOffset:
    """The offset, and a constant drift of which N(0, rate_std_radps) is known beforehand, that fit N > 0 groups.

    A circular mean, or line, with weights that fall as 1/(1 + (residual/scale)^2): started at the best of many drifts
    and 36 directions, it passes over a minority of sideways or backward steps. How much a look weighs against what was
    known of the drift comes from the scatter of the looks themselves.
    """
    middle_s = float(np.average(differences.t_s, weights=differences.weight))
    away_s = differences.t_s - middle_s
    design = np.stack([np.ones_like(away_s), away_s], axis=1)[:, : 1 if drift.rate_std_radps == 0 else 2]
    fitted = _start(differences, away_s, drift.rate_std_radps)[: design.shape[1]]
    # What a look is worth beside the prior only shows in the residuals of a fit: first there is hardly a prior.
    inflation = LEAST_INFLATION
    for _ in range(2):
        fitted, residual = _descend(differences, design, fitted, _prior(drift.rate_std_radps, inflation, len(fitted)))
        _, inflation = _covariance(residual, differences, design, drift.rate_std_radps)
    covariance, _ = _covariance(residual, differences, design, drift.rate_std_radps)
    offset, rate = np.append(fitted, 0.0)[:2]
    return YawOffset(
        middle_s=middle_s,
        offset_rad=float(wrap_angle(offset)),
        drift_radps=float(rate),
        covariance=np.pad(covariance, (0, 2 - len(fitted))),
        first_s=float(differences.t_s[0]),
        last_s=float(differences.t_s[-1]),
        walk_std=drift.walk_std,
        spread_rad=float(np.median(np.abs(residual))),
        askew_share=float(np.mean(np.abs(residual) > ASKEW_RAD)),
        agrees=_agree(residual, differences.weight),
    )


def _agree(residual: Float, weight: Float) -> bool:
    """Whether the residuals point one way more than random directions would; few cannot, even where they do."""
    return float(np.average(np.cos(residual), weights=weight)) * np.sqrt(len(residual)) > CLEAR_STD


def _start(differences: CourseDifferences, away_s: Float, rate_std_radps: float) -> Float:
    """Offset and drift near the best: of 36 directions at each likely drift, the one that most agree with."""
    drifts = [0.0]
    if rate_std_radps > 0:
        # A stretch of backward steps looks like a drift; of doubled angles it is not seen.
        drifts += [_peak(differences, fold, rate_std_radps) for fold in (1, 2)]
    directions = np.arange(36) * (2 * np.pi / 36)
    some = slice(None, None, 1 + len(away_s) // START_GROUPS)
    difference, weight = differences.difference_rad[some], differences.weight[some]
    best, least = np.zeros(2), np.inf
    for drift in drifts:
        straight = difference - drift * away_s[some]
        off = [wrap_angle(straight - each) / START_SCALE_RAD for each in directions]
        cost = [float(np.sum(weight * np.log1p(each**2))) for each in off]
        if min(cost) < least:
            best, least = np.array([directions[int(np.argmin(cost))], drift]), min(cost)
    return best


def _peak(differences: CourseDifferences, fold: int, rate_std_radps: float) -> float:
    """The likely drift that lets fold times the differences point one way: |sum w exp(j fold (d - drift t))|."""
    since_s = differences.t_s - differences.t_s[0]
    bin_s = max(LOOK_S / fold, float(since_s[-1]) / 2**16)
    row = (since_s // bin_s).astype(np.int64)
    angle = fold * differences.difference_rad
    east, north = (np.bincount(row, differences.weight * each(angle)) for each in (np.cos, np.sin))
    finest = max(4 * len(east), 2 * np.pi / (rate_std_radps * bin_s))
    length = 2 ** int(np.ceil(np.log2(min(finest, 2.0**20))))
    drift_radps = 2 * np.pi * np.fft.fftfreq(length, bin_s) / fold
    height = np.abs(np.fft.fft(east + 1j * north, length))
    return float(drift_radps[int(np.argmax(np.where(np.abs(drift_radps) <= LIKELY_STD * rate_std_radps, height, -1)))])


def _prior(drift_std_radps: float, inflation: float, size: int) -> Float:
    """(size, size) what is known of the drift beforehand, in the unit of the weights."""
    return np.diag([0.0, inflation / drift_std_radps**2]) if size == 2 else np.zeros((1, 1))


def _residual(differences: CourseDifferences, design: Float, fitted: Float) -> Float:
    return wrap_angle(differences.difference_rad - design @ fitted)


def _scale(residual: Float) -> float:
    return 2 * max(float(np.median(np.abs(residual))), 1e-6)


def _descend(differences: CourseDifferences, design: Float, fitted: Float, prior: Float) -> tuple[Float, Float]:
    """Reweighted least squares from a start: the fit, and its residuals."""
    residual = _residual(differences, design, fitted)
    for _ in range(50):
        weight = differences.weight / (1 + (residual / _scale(residual)) ** 2)
        information = (design * weight[:, None]).T @ design + prior
        step = np.linalg.solve(information, design.T @ (weight * residual) - prior @ fitted)
        fitted = fitted + step
        residual = _residual(differences, design, fitted)
        if np.abs(design[[0, -1]] @ step).max() < 1e-6:
            break
    return fitted, residual


def _covariance(
    residual: Float, differences: CourseDifferences, design: Float, drift_std_radps: float
) -> tuple[Float, float]:
    """Covariance of the fit, and how much a squared score exceeds what independent groups would give.

    The fit solves sum w psi(r) x = prior, psi = r / (1 + u^2), u = r/scale; its covariance is J^-1 V J^-1 with the
    slope J and the scatter V of the score. Errors persist for unknown times (strides, late paths, biases that depend on
    the place), so V is summed over blocks of 1, 2, 4 ... s and the largest counts. What the track claims of its course,
    or what misfits it more, stands beside few looks.
    """
    u2 = (residual / _scale(residual)) ** 2
    falling = differences.weight / (1 + u2)
    gram = (design * falling[:, None]).T @ design
    # Residuals all over the circle make psi' cancel: the floor keeps the std finite, and large.
    slope = gram * max(float(np.sum(falling * (1 - u2) / (1 + u2)) / np.sum(falling)), 0.1)
    claimed = gram * max(float(np.mean(falling * residual**2)), 1.0)
    scatters = _scatters(design * (falling * residual)[:, None], differences.t_s, claimed)
    moments, found = design.T @ design, list[tuple[float, Float, float]]()
    for scatter in scatters:
        inflation = max(float(scatter[0, 0] / slope[0, 0]), LEAST_INFLATION)
        prior = _prior(drift_std_radps, inflation, len(slope))
        inverse = np.linalg.inv(slope + prior)
        covariance = inverse @ (scatter + inflation * prior) @ inverse
        found.append((float(np.sum(covariance * moments)), covariance, inflation))
    _, covariance, inflation = max(found, key=lambda each: each[0])
    return covariance, inflation


def _scatters(score: Float, t_s: Float, claimed: Float) -> list[Float]:
    """Candidates for the variance of the summed score: over blocks of each length that occurs often enough.

    claimed: the variance that the track's own covariances give.
    """
    scatters: list[Float] = []
    length_s = LOOK_S
    while True:
        block = np.append(0, np.cumsum(np.diff(t_s // length_s) > 0))
        n = int(block[-1]) + 1
        sums = np.stack([np.bincount(block, column) for column in score.T], axis=1)
        scatter = sums.T @ sums * n / max(n - 1, 1)
        if not scatters:
            scatter = (scatter * (n - 1) + claimed * CLAIM_LOOKS) / (n - 1 + CLAIM_LOOKS)
        elif n < MIN_BLOCKS:
            return scatters
        scatters.append(scatter)
        length_s *= 2
