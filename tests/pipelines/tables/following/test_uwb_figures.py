from __future__ import annotations

import numpy as np
import pytest

from quadlog.pipelines.tables.following.uwb_ranges import METHODS, STATIONS_M, coordinate_group, range_group, stand_all

N = 20_000


@pytest.fixture(scope="module")
def standing():
    return stand_all(N, seed=0)


@pytest.fixture(scope="module")
def rows(standing):
    return {row.quantity: row for row in coordinate_group(standing).rows}


def test_ranges_are_called_what_they_are(standing):
    group = range_group(standing)
    assert len(group.rows) == 6
    assert "confirm nothing" in group.text
    for row in group.rows:
        assert row.paper == 0.1
        assert row.reproduces is None
        assert row.ours == pytest.approx(0.1, rel=0.02)
        assert row.low < row.ours < row.high
    assert [row.quantity[:7].rstrip(":") for row in group.rows] == ["Fig. 9:"[:6]] * 3 + ["Fig. 10"] * 3


def test_a_direct_fit_reaches_the_bound_on_every_axis(rows):
    """The bound by hand: u of the robot's tag to stations 1, 2, 3."""
    u = np.array([[0.8, 2.4], [0.8, -1.6], [-5.2, 0.0]])
    u /= np.linalg.norm(u, axis=1)[:, None]
    bound_m = 0.1 * np.sqrt(np.diag(np.linalg.inv(u.T @ u)))
    for axis, name in enumerate("xy"):
        what = f"Fig. 12: {name} error of the robot"
        assert rows[f"{what}, Cramér-Rao bound (m)"].ours == pytest.approx(bound_m[axis], rel=1e-9)
        assert rows[f"{what}, gauss_newton, rms (m)"].ours == pytest.approx(bound_m[axis], rel=0.03)


def test_three_stations_leave_nothing_to_weight(rows):
    apart = next(row for name, row in rows.items() if name.startswith("largest distance"))
    assert apart.ours == 0
    for figure, tag in (("Fig. 12", "robot"), ("Fig. 11", "person")):
        for axis in "xy":
            linear, weighted, paper = (
                rows[f"{figure}: {axis} error of the {tag}, {method}, rms (m)"].ours
                for method in ("linear", "weighted", "paper")
            )
            assert linear == pytest.approx(weighted, rel=1e-9)
            assert linear == pytest.approx(paper, rel=1e-9)


def test_the_linear_fix_is_the_intersection_that_numpy_finds(standing):
    for each in standing:
        x, y = STATIONS_M[:, 0], STATIONS_M[:, 1]
        squares = x**2 + y**2 - each.range_m**2
        design = 2 * np.column_stack([x[:2] - x[2], y[:2] - y[2]])
        expected_m = np.linalg.solve(design, (squares[:, :2] - squares[:, 2:]).T).T
        np.testing.assert_allclose(each.fix_m["linear"], expected_m, atol=1e-9)


def test_only_the_papers_method_is_held_against_the_paper(rows):
    judged = [row for row in rows.values() if row.paper is not None]
    assert len(judged) == 4
    assert all(", paper, rms" in row.quantity for row in judged)
    assert all(row.reproduces == (0.05 < row.ours < 0.15) for row in judged)


def test_a_missing_fix_is_counted(standing):
    fix_m = {method: fix_m.copy() for method, fix_m in standing[0].fix_m.items()}
    fix_m["huber"][:3] = np.nan
    holed = type(standing[0])(standing[0].tag, standing[0].range_m, fix_m)
    rows = [row for row in coordinate_group([holed]).rows if "huber" in row.quantity]
    assert len(rows) == 2
    assert all(row.note == f"3 of {N} epochs have no fix." for row in rows)


def test_both_tags_have_draws_of_their_own_and_all_methods(standing):
    robot, person = standing
    assert set(robot.fix_m) == set(METHODS)
    noise = [each.range_m - np.mean(each.range_m, axis=0) for each in (robot, person)]
    assert np.abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.02
    assert not np.array_equal(stand_all(10, seed=1)[0].range_m, robot.range_m[:10])
