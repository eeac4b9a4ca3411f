from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.null_space import prioritised

SEEDS = st.integers(0, 2**32 - 1)


def solve(tasks, wanted, weakest=1e-6):
    """(tasks met weakly, out) of Jacobians (m, n) in their order and what each wants, (m, C)."""
    rows, columns = np.concatenate(tasks), np.concatenate(wanted)
    count, n = rows.shape
    out = np.full((n, columns.shape[1]), np.nan)
    room = [np.full(shape, np.nan) for shape in ((count, n), (n, count), (count, count), (count, count))]
    weak = prioritised(rows, np.cumsum([len(task) for task in tasks]), columns, weakest, out, *room)
    return weak, out


def printed(tasks, wanted, weakest):
    """Eqs 34 and 38 as the paper has them, with numpy's SVD, and the gain s / max(s, weakest)^2 for 1 / s."""
    n = tasks[0].shape[1]
    out, above = np.zeros((n, wanted[0].shape[1])), np.zeros((0, n))
    for jacobian, want in zip(tasks, wanted, strict=True):
        free = np.eye(n) - np.linalg.pinv(above, rcond=1e-9) @ above
        u, s, vt = np.linalg.svd(jacobian @ free, full_matrices=False)
        s[s < 1e-9] = 0.0
        out = out + vt.T @ ((s / np.maximum(s, weakest) ** 2)[:, None] * (u.T @ (want - jacobian @ out)))
        above = np.concatenate([above, jacobian])
    return out


def hierarchy(rng, dependent=False):
    """Tasks of random sizes in 18 columns, and two things wanted of each; rows may repeat what others say."""
    sizes = rng.integers(0, 7, rng.integers(1, 5))
    tasks = [rng.normal(size=(size, 18)) for size in sizes]
    for k, task in enumerate(tasks):
        above = np.concatenate(tasks[: k + 1])
        if dependent and len(task) and len(above) > 1:
            mix = rng.normal(size=len(above))
            mix[len(above) - 1] = 0.0
            task[-1] = mix @ above
    return tasks, [rng.normal(size=(size, 2)) for size in sizes]


@given(seed=SEEDS, dependent=st.booleans())
def test_against_the_printed_recursion(seed, dependent):
    """Dependent rows, more rows than columns, and tasks without rows included."""
    tasks, wanted = hierarchy(np.random.default_rng(seed), dependent)
    _, out = solve(tasks, wanted)
    np.testing.assert_allclose(out, printed(tasks, wanted, 1e-6), rtol=0, atol=1e-6)


def test_nearly_dependent_rows_leave_lower_tasks_no_way_to_them():
    """A row that a part of 1e-8 sets apart from those above it: the one below must be orthogonal to both."""
    rng = np.random.default_rng(7)
    rows = rng.normal(size=(8, 10))
    rows[5] = rng.normal(size=5) @ rows[:5] + 1e-8 * rng.normal(size=10)
    basis, wanted = np.empty((8, 10)), rng.normal(size=(8, 1))
    room = (np.empty((10, 8)), np.empty((8, 8)), np.empty((8, 8)))
    prioritised(rows, np.array([5, 6, 8]), wanted, 1e-3, np.empty((10, 1)), basis, *room)
    np.testing.assert_allclose(basis @ basis.T, np.eye(8), rtol=0, atol=1e-14)


def test_the_gain_is_bounded_and_continuous_where_a_leg_gets_straight():
    weakest = 0.02
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    before = None
    for s in np.geomspace(1.0, 1e-14, 3000):
        weak, out = solve([turn @ np.diag([1.0, 0.5, s]) @ turn], [turn[:, 2:]], weakest)
        length = float(np.linalg.norm(out))
        assert weak == (s < weakest)
        assert length <= 1 / weakest * (1 + 1e-9)
        assert before is None or abs(length - before) < 0.02 / weakest
        before = length
    assert length < 1e-6
