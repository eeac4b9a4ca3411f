"""Anchors, biases and the corrected walk in one batch over the whole log [Nguyen]: Gauss-Newton, robust to late ranges.

What lasts of the odometry's errors is estimated with them; its random drift is the likeliest one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from quadlog.geometry import wrap_angle
from quadlog.messages import Float
from quadlog.positioning.self_survey.lateness import (
    DELAY_M,
    ErrorScores,
    RangeErrors,
    error_windows,
    refit_errors,
    score_errors,
)
from quadlog.positioning.self_survey.problem import SurveyProblem

BIAS_MEAN_M, COMMON_BIAS_STD_M, ANCHOR_BIAS_STD_M, LINK_BIAS_STD_M = 0.15, 0.15, 0.1, 0.05
"""Priors of biases: of all links together, of one anchor's, of one link's. Real sets have 0 to 0.4 m."""
LEAST_DRIFT, MOST_DRIFT = 0.001, 0.3
"""Bounds of the random drift, in m and rad after 1 m of way; it grows with the square root."""
DELAY_STD_S = 0.1
"""How far the clocks of ranges and odometry may be apart."""
DRIFT_SPREAD = 0.7
"""Std of the logarithm of the random drift: how well it is known before a log is seen."""
DOUBTFUL_FACTOR = 4.0
"""By how much a step drifts more where the odometry doubts its own poses."""
STANDING_M = 0.02
"""Way that a step counts for at least."""
FEWEST_ROUNDS, MOST_ROUNDS = 9, 40
SETTLED_M = 1e-3
REFITS = 5
BLOCKS_S = (1.0, 3.0, 10.0, 30.0)
FEWEST_BLOCKS = 4
LEAST_LEFT = 0.1
"""Share of the ranges' information that a fit leaves at least, for the sake of short logs."""

Factor = tuple[Float, bool]
LONGEST_STEP_M = 1.0


@dataclass(frozen=True, slots=True)
class HeightPrior:
    """Expected heights of the anchors above the floor: mean_m (A,), std_m (A,)."""

    mean_m: Float
    std_m: Float


@dataclass(frozen=True, slots=True)
class OdometryPrior:
    """Errors to expect of an odometry: std of its scales of way and of turns and of its yaw's drift, and its random
    drift to begin with, in m and rad after 1 m of way. first_pose_std: of the first pose alone, in m and rad.
    """

    scale_std: float
    turn_scale_std: float
    yaw_drift_std_radps: float
    drift: tuple[float, float]
    first_pose_std: tuple[float, float] = (0.01, 0.002)


@dataclass(frozen=True, slots=True)
class SurveyState:
    """knots (K, 3) corrected, anchors_m (A, 3), bias_m (T, A); scale and turn_scale, which multiply the odometry's
    steps and its turns, and yaw_drift_radps, which its yaw lacks; delay_s, by which the ranges' stamps are too early by
    the odometry's clock; range errors; drift (2,) of the odometry in m and rad
    after 1 m; persistence of the range errors.
    """

    knots: Float
    anchors_m: Float
    bias_m: Float
    scale: float
    turn_scale: float
    yaw_drift_radps: float
    delay_s: float
    errors: RangeErrors
    drift: tuple[float, float]
    persistence: float


@dataclass(frozen=True, slots=True)
class SurveySolution:
    """The settled state; covariance (3A + TA, 3A + TA) of the anchors' x, y, z and the links' biases; late (N,) the
    probability of each range being late; range_cost: -log of the ranges' density; other_cost: that of the odometry and
    the priors, and what the volume of the posterior adds (Laplace), up to a constant.
    """

    state: SurveyState
    covariance: Float
    late: Float
    range_cost: float
    other_cost: float

    def cost_above(self, other: SurveySolution) -> float:
        """By how much -log of the likelihood exceeds another solution's, with the larger persistence for both."""
        persistence = max(self.state.persistence, other.state.persistence)
        return (self.range_cost - other.range_cost) / persistence + self.other_cost - other.other_cost


class Batch:
    """The normal equations of a problem; the first knot stays where it is."""

    def __init__(self, problem: SurveyProblem, heights: HeightPrior, odometry: OdometryPrior) -> None:
        self.problem, self._heights, self._odometry = problem, heights, odometry
        self._link = problem.tag * problem.n_anchors + problem.anchor
        self._window = error_windows(problem.t_s, self._link)
        self._n_knots, self._n_links = len(problem.knots), problem.n_tags * problem.n_anchors
        self._first_anchor = 3 * self._n_knots
        self._first_bias = self._first_anchor + 3 * problem.n_anchors
        self._first_lasting = self._first_bias + self._n_links
        self._size = self._first_lasting + 4
        self._bias_information = _bias_information(problem.n_tags, problem.n_anchors)
        scales = odometry.scale_std, odometry.turn_scale_std
        self._lasting_std = np.array([*scales, odometry.yaw_drift_std_radps, DELAY_STD_S])

    def start(self, anchors_m: Float, bias_m: Float, knots: Float, looseness: float = 1.0) -> SurveyState:
        """A state to begin with: anchors (A, 3), biases (A,), knots (K, 3); looseness multiplies the usual drift."""
        windows = int(self._window.max(initial=0)) + 1
        errors = RangeErrors(0.2, DELAY_M, np.full(windows, 0.2))
        bias = np.tile(bias_m, (self.problem.n_tags, 1))
        drift = self._odometry.drift[0] * looseness, self._odometry.drift[1] * looseness
        return SurveyState(knots.copy(), anchors_m.copy(), bias, 1.0, 1.0, 0.0, 0.0, errors, drift, 1.0)

    def solve(self, state: SurveyState) -> SurveySolution:
        """Settle a state: in turn the range errors' parameters, the drift and a damped step over all unknowns."""
        for index in range(MOST_ROUNDS):
            residual_m, design = self._ranges(state)
            errors = state.errors
            for _ in range(REFITS):
                errors = refit_errors(residual_m, self._window, errors)
            state = replace(state, errors=errors)
            scores = score_errors(residual_m, self._window, state.errors)
            tuning = index >= 3 and index % 2 == 1
            ranged = _weighted(design, scores.curvature / state.persistence)
            pull = design.T @ (scores.pull / state.persistence)
            if tuning:
                state = replace(state, drift=self._likeliest_drift(state, ranged, pull))
            normal, gradient = self._with_priors(state, ranged, pull)
            factor = cho_factor(normal[3:, 3:])
            step = self._limited(cho_solve(factor, gradient[3:]))
            if tuning:
                state = replace(state, persistence=self._persistence(state, scores, design, factor))
            state = self._moved(state, step)
            if index >= FEWEST_ROUNDS and np.abs(step[self._first_anchor - 3 : self._first_bias - 3]).max() < SETTLED_M:
                break
        return self._settled(state)

    def _settled(self, state: SurveyState) -> SurveySolution:
        residual_m, design = self._ranges(state)
        scores = score_errors(residual_m, self._window, state.errors)
        ranged = _weighted(design, scores.information / state.persistence)
        normal, _ = self._with_priors(state, ranged, design.T @ scores.pull)
        factor = cho_factor(normal[3:, 3:])
        begin, end = self._first_anchor - 3, self._first_lasting - 3
        wanted = np.zeros((self._size - 3, end - begin))
        wanted[begin:end] = np.eye(end - begin)
        covariance = cho_solve(factor, wanted)[begin:end]
        other_cost = self._other_cost(state) + float(np.log(np.diag(factor[0])).sum())
        return SurveySolution(state, (covariance + covariance.T) / 2, scores.late, scores.cost, other_cost)

    def _persistence(self, state: SurveyState, scores: ErrorScores, design: csr_array, factor: Factor) -> float:
        """By how much a link's summed errors vary more than independent ones would, at least 1.

        The largest over blocks of BLOCKS_S counts. What the fit absorbs of independent errors is allowed for: of a cell
        with information I and design u, H being the normal matrix, I - u^T H^-1 u is left.
        """
        largest, end_s = 1.0, float(self.problem.t_s[-1])
        for block_s in BLOCKS_S:
            if end_s < FEWEST_BLOCKS * block_s:
                break
            slot = (self.problem.t_s / block_s).astype(np.int64)
            cells, cell = np.unique(slot * self._n_links + self._link, return_inverse=True)
            rows = np.arange(len(cell))
            summed = csr_array((scores.information, (cell, rows)), shape=(len(cells), len(cell))) @ design
            reach = summed.toarray()[:, 3:]
            absorbed = np.einsum("cs,sc->", reach, cho_solve(factor, reach.T)) / state.persistence
            left = scores.information.sum() - absorbed
            spread = (np.bincount(cell, scores.pull) ** 2).sum()
            largest = max(largest, float(spread / max(left, LEAST_LEFT * scores.information.sum())))
        return largest

    def _other_cost(self, state: SurveyState) -> float:
        off, _, variance = self._steps(state)
        bias = state.bias_m.ravel() - BIAS_MEAN_M
        height = (state.anchors_m[:, 2] - self._heights.mean_m) / self._heights.std_m
        lasting = _lasting_off(state) / self._lasting_std
        quadratic = (off**2 / variance).sum() + bias @ self._bias_information @ bias + height @ height
        quadratic += lasting @ lasting + self._unusual(state.drift)
        return float(quadratic / 2 + np.log(variance).sum() / 2)

    def _ranges(self, state: SurveyState) -> tuple[Float, csr_array]:
        """Residuals (N,) of the ranges, and their design: d(prediction)/d(unknown), sparse (N, size)."""
        problem, knots = self.problem, state.knots
        n = len(problem.range_m)
        knot, share = problem.knot, problem.share
        yaw_rad = knots[knot, 2]
        velocity_mps = _turned(problem.velocity_mps, np.cos(yaw_rad), np.sin(yaw_rad))
        place_m = problem.tag_places(knots) + state.delay_s * velocity_mps
        offset_m = np.column_stack([place_m, problem.height_m]) - state.anchors_m[problem.anchor]
        distance_m = np.maximum(np.sqrt(np.einsum("ni,ni->n", offset_m, offset_m)), 1e-6)
        unit = offset_m / distance_m[:, None]
        values = np.empty((n, 11))
        columns = np.empty((n, 11), dtype=np.int64)
        for begin, at, seen_m, part in ((0, knot, problem.before_m, 1 - share), (3, knot + 1, problem.after_m, share)):
            turned = _turned(seen_m, -np.sin(knots[at, 2]), np.cos(knots[at, 2]))
            values[:, begin : begin + 2] = part[:, None] * unit[:, :2]
            values[:, begin + 2] = part * np.einsum("ni,ni->n", unit[:, :2], turned)
            columns[:, begin : begin + 3] = 3 * at[:, None] + np.arange(3)
        values[:, 6:9], values[:, 9] = -unit, 1.0
        columns[:, 6:9] = self._first_anchor + 3 * problem.anchor[:, None] + np.arange(3)
        columns[:, 9] = self._first_bias + self._link
        values[:, 10] = np.einsum("ni,ni->n", unit[:, :2], velocity_mps)
        columns[:, 10] = self._first_lasting + 3
        design = csr_array((values.ravel(), columns.ravel(), np.arange(0, 11 * n + 1, 11)), shape=(n, self._size))
        bias_m = state.bias_m[problem.tag, problem.anchor]
        return problem.range_m - bias_m - distance_m, design

    def _steps(self, state: SurveyState) -> tuple[Float, csr_array, Float]:
        """Steps between knots less the odometry's (3K - 3,), their design, and their variances by the state's drift."""
        problem, knots = self.problem, state.knots
        n = self._n_knots - 1
        before, after, step = knots[:-1], knots[1:], problem.step
        cos, sin = np.cos(before[:, 2]), np.sin(before[:, 2])
        dx_m, dy_m = (after[:, :2] - before[:, :2]).T
        off = np.empty((n, 3))
        off[:, 0] = cos * dx_m + sin * dy_m - state.scale * step[:, 0]
        off[:, 1] = cos * dy_m - sin * dx_m - state.scale * step[:, 1]
        turned = state.turn_scale * step[:, 2] + state.yaw_drift_radps * problem.step_s
        off[:, 2] = wrap_angle(after[:, 2] - before[:, 2] - turned)
        zero, one, here = np.zeros(n), np.ones(n), 3 * np.arange(n)
        scale, turn, drift = (np.full(n, self._first_lasting + which) for which in range(3))
        # Rows x, y and yaw of each step: six entries each.
        values = np.array(
            [
                [-cos, -sin, cos * dy_m - sin * dx_m, cos, sin, -step[:, 0]],
                [sin, -cos, -cos * dx_m - sin * dy_m, -sin, cos, -step[:, 1]],
                [-one, one, zero, zero, -step[:, 2], -problem.step_s],
            ]
        )
        along = [here, here + 1, here + 2, here + 3, here + 4, scale]
        columns = np.array([along, along, [here + 2, here + 5, here, here, turn, drift]])
        values, columns = values.transpose(2, 0, 1).reshape(-1), columns.transpose(2, 0, 1).reshape(-1)
        design = csr_array((values, columns, np.arange(0, 18 * n + 1, 6)), shape=(3 * n, self._size))
        return off.ravel(), design, self._step_variance(state.drift).ravel()

    def _step_variance(self, drift: tuple[float, float]) -> Float:
        """(K - 1, 3) variances of the steps' x, y and yaw."""
        way_m = np.maximum(self.problem.length_m, STANDING_M)
        way_m = way_m * (1 + (DOUBTFUL_FACTOR**2 - 1) * self.problem.doubtful_share)
        return way_m[:, None] * np.square([drift[0], drift[0], drift[1]])

    def _with_priors(self, state: SurveyState, ranged: Float, pull: Float) -> tuple[Float, Float]:
        """Normal matrix and the gradient of -cost, the odometry and the priors added to those of the ranges."""
        off, design, variance = self._steps(state)
        normal = ranged + _weighted(design, 1 / variance)
        gradient = pull - design.T @ (off / variance)
        self._add_fixed_priors(state, normal, gradient)
        return normal, gradient

    def _add_fixed_priors(self, state: SurveyState, normal: Float, gradient: Float) -> None:
        z = self._first_anchor + 2 + 3 * np.arange(self.problem.n_anchors)
        biases, lasting = slice(self._first_bias, self._first_lasting), np.arange(4) + self._first_lasting
        known = self._heights.std_m**-2
        normal[z, z] += known
        gradient[z] -= known * (state.anchors_m[:, 2] - self._heights.mean_m)
        normal[biases, biases] += self._bias_information
        gradient[biases] -= self._bias_information @ (state.bias_m.ravel() - BIAS_MEAN_M)
        steady = self._lasting_std**-2.0
        normal[lasting, lasting] += steady
        gradient[lasting] -= steady * _lasting_off(state)

    def _likeliest_drift(self, state: SurveyState, ranged: Float, pull: Float) -> tuple[float, float]:
        """The drift among the neighbours of the present one with the largest posterior density (Laplace)."""
        off, design, _ = self._steps(state)
        priors, prior_gradient = np.zeros_like(ranged), np.zeros(self._size)
        self._add_fixed_priors(state, priors, prior_gradient)

        def misfit(drift: tuple[float, float]) -> float:
            """-2 log of the posterior density of a drift (m and rad after 1 m), up to a constant."""
            variance = self._step_variance(drift).ravel()
            normal = ranged + priors + _weighted(design, 1 / variance)
            gradient = pull + prior_gradient - design.T @ (off / variance)
            factor = cho_factor(normal[3:, 3:])
            gained = gradient[3:] @ cho_solve(factor, gradient[3:])
            volume = 2 * np.log(np.diag(factor[0])).sum()
            misfit = (off**2 / variance).sum() - gained + volume + np.log(variance).sum()
            return float(misfit + self._unusual(drift))

        best, least = state.drift, misfit(state.drift)
        for axis in range(2):
            for factor in (0.7, 1.4):
                tried = list(state.drift)
                tried[axis] = float(np.clip(tried[axis] * factor, LEAST_DRIFT, MOST_DRIFT))
                value = misfit((tried[0], tried[1]))
                if value < least:
                    best, least = (tried[0], tried[1]), value
        return best

    def _unusual(self, drift: tuple[float, float]) -> float:
        """-2 log of the prior density of a random drift."""
        off = np.log(np.divide(drift, self._odometry.drift)) / DRIFT_SPREAD
        return float(off @ off)

    def _limited(self, step: Float) -> Float:
        """The step, shortened where an anchor or a knot would jump."""
        longest_m = np.abs(step[: self._first_bias - 3]).max(initial=1e-12)
        return step * min(1.0, LONGEST_STEP_M / longest_m)

    def _moved(self, state: SurveyState, step: Float) -> SurveyState:
        full = np.concatenate([np.zeros(3), step])
        knots = state.knots + full[: self._first_anchor].reshape(-1, 3)
        anchors_m = state.anchors_m + full[self._first_anchor : self._first_bias].reshape(-1, 3)
        bias_m = state.bias_m + full[self._first_bias : self._first_lasting].reshape(state.bias_m.shape)
        scale, turn_scale, yaw_drift, delay_s = full[self._first_lasting :].tolist()
        return replace(
            state,
            knots=knots,
            anchors_m=anchors_m,
            bias_m=bias_m,
            scale=state.scale + scale,
            turn_scale=state.turn_scale + turn_scale,
            yaw_drift_radps=state.yaw_drift_radps + yaw_drift,
            delay_s=state.delay_s + delay_s,
        )


def _lasting_off(state: SurveyState) -> Float:
    """(4,) the odometry's lasting errors: of its scales, the drift of its yaw, and the delay of the ranges."""
    return np.array([state.scale - 1, state.turn_scale - 1, state.yaw_drift_radps, state.delay_s])


def _turned(vector: Float, cos: Float, sin: Float) -> Float:
    """Vectors (N, 2), turned by angles with these cosines and sines (N,)."""
    x, y = vector.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])


def _weighted(design: csr_array, weight: Float) -> Float:
    """Design^T diag(weight) design, dense."""
    scaled = design.multiply(np.sqrt(weight)[:, None]).tocsr()
    normal: Float = (scaled.T @ scaled).toarray()
    return normal


def _bias_information(n_tags: int, n_anchors: int) -> Float:
    """(TA, TA) inverse of the biases' prior covariance, links ordered by tag, then anchor."""
    same_anchor = np.tile(np.eye(n_anchors), (n_tags, n_tags))
    covariance = COMMON_BIAS_STD_M**2 + ANCHOR_BIAS_STD_M**2 * same_anchor
    covariance = covariance + LINK_BIAS_STD_M**2 * np.eye(n_tags * n_anchors)
    information: Float = np.linalg.inv(covariance)
    return information
