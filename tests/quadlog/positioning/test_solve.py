"""The batch against scipy's dense least squares of the same problem."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.optimize import least_squares

from quadlog.positioning.batch import solve as module
from quadlog.positioning.batch.factors import Axes, RangeModel, Steps, TagRanges, Way
from quadlog.positioning.batch.links import range_priors
from quadlog.positioning.batch.motion import Timeline, lifting, make_timeline, motion_information, turning, walking
from quadlog.positioning.batch.solve import Problem, Weights, linearise, solve

ANCHORS_M = np.array([[0, 0, 0.3], [8, 0, 2.4], [8, 7, 0.5], [0, 7, 2.5], [4, -1, 1.2]])
AXES = Axes((walking(1.0), walking(1.0), lifting(0.5), turning()), 2, 3)
LEVERS_M = np.array([[0.2, 0.1], [-0.3, 0.0]])


def problem_of(seed: int = 0) -> tuple[Problem, np.ndarray, np.ndarray]:
    """Four seconds of two tags on a body, every factor there is, and a state about right."""
    rng, t_s = np.random.default_rng(seed), np.sort(np.random.default_rng(seed).uniform(0, 4, 60))
    tag, anchor = rng.integers(0, 2, 60), rng.integers(0, 5, 60)
    place_m = np.column_stack([3 + 0.5 * t_s, 3 + np.sin(t_s), np.full(60, 0.6)])
    range_m = np.linalg.norm(place_m - ANCHORS_M[anchor], axis=1) + 0.05 * rng.standard_normal(60)
    ranges = TagRanges(t_s, tag, anchor, range_m, LEVERS_M, np.array([0.6, 0.8]), 5)
    timeline = make_timeline(t_s, 0.5, 2.0, np.empty(0))
    n, way_s = ranges.n_links, np.arange(0, 4.2, 0.1)
    way = Way(way_s, np.column_stack([0.5 * way_s, np.sin(way_s)]) + 0.01 * rng.standard_normal((42, 2)), 0.3 * way_s)
    variance = np.full(len(timeline.t_s) - 1, 0.02)
    others = (
        Steps(timeline, way, AXES, (n, n + 1, n + 2), (variance, variance / 2)),
        Steps(timeline, way, AXES, (), (variance, variance)),
    )
    mean = np.concatenate([np.zeros(n), [1.0, 0.0, 1.0], np.zeros(16)])
    prior = np.diag(np.concatenate([np.ones(n), np.square([0.1, 0.01, 0.1] + 5 * [1.0, 1.0, 0.1] + [0.05])]))
    prior[:n, :n] = range_priors(n, True, scaled=True)[-1, :n, :n]
    problem = Problem(
        timeline,
        RangeModel(AXES, ANCHORS_M, n + 3, scale=n + 18),
        ranges.slots(timeline.t_s),
        0.1,
        mean,
        prior[None],
        others,
    )
    knots = 0.1 * rng.standard_normal((len(timeline.t_s), 2, 4))
    knots[:, 0, 0] += 3 + 0.5 * timeline.t_s
    knots[:, 0, 1] += 3
    return problem, knots, mean + 0.01 * rng.standard_normal(len(mean))


def test_it_is_least_squares_over_the_whole_log(monkeypatch):
    """Against scipy, which solves for all knots and globals at once, and inverts densely; weights are one."""
    problem, knots, values = problem_of()
    ones = np.ones(len(problem.slots.range_m))
    monkeypatch.setattr(module, "weigh", lambda *_: Weights(0.1 + 0 * values, ones, None, ones, ones))
    solved = solve(problem, knots, values)
    roots = np.linalg.cholesky(problem.motion + 1e-12 * np.eye(16)).transpose(0, 2, 1)
    prior = np.linalg.inv(np.linalg.cholesky(problem.priors[0]))

    def misfit(state: np.ndarray) -> np.ndarray:
        own, its = state[: knots.size].reshape(knots.shape), state[knots.size :]
        around = np.concatenate([own[:-1], own[1:]], axis=1).reshape(-1, 16)
        rows, total = linearise(problem, own, its).weighted(problem.slots, ones)
        parts = [np.einsum("kij,kj->ki", roots, around).ravel(), rows.residual * np.sqrt(total) / 0.1]
        for each in problem.others:
            rows, weight = each.linearise(own, its)
            parts.append(rows.residual * np.sqrt(weight))
        return np.concatenate([*parts, prior @ (its - problem.mean)])

    best = least_squares(misfit, np.append(knots.ravel(), values), xtol=1e-12)
    found = best.x[: knots.size].reshape(knots.shape)
    np.testing.assert_allclose(solved.knots[:, 0], found[:, 0], atol=5e-3)
    np.testing.assert_allclose(solved.values, best.x[knots.size :], atol=5e-3)
    dense = np.linalg.inv(best.jac.T @ best.jac)
    np.testing.assert_allclose(solved.covariance, dense[knots.size :, knots.size :], rtol=0.05, atol=1e-5)
    blocks = [dense[k : k + 8, k : k + 8] for k in range(0, knots.size, 8)]
    np.testing.assert_allclose(solved.knot_covariances, blocks, rtol=0.05, atol=1e-4)


def test_motion_is_the_exact_discretisation():
    for motion in (walking(1.5), turning(), lifting(0.5)):
        information = motion_information((motion,), Timeline(np.array([0.0, 0.3]), np.array([True])))[0]
        drift = np.array([[0.0, 1.0], [-motion.stiffness, -motion.damping]])
        fine, summed = 3000, np.zeros((2, 2))
        for k in range(fine):
            column = expm(drift * 0.3 * (k + 0.5) / fine)[:, 1]
            summed += motion.density * np.outer(column, column) * 0.3 / fine
        wanted = np.linalg.inv(summed) @ np.hstack([-expm(drift * 0.3), np.eye(2)])
        np.testing.assert_allclose(information[2:], wanted, rtol=1e-4)
