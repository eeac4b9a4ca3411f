"""The tables tracking-courses and tracking-5, made of walks that nobody walked."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from quadlog.pipelines.tables.tracking import (
    courses as tracked_courses,
)
from quadlog.pipelines.tables.tracking import (
    courses as tracking_courses,
)
from quadlog.pipelines.tables.tracking import (
    table_5 as s_curve_rows,
)
from quadlog.pipelines.tables.tracking import (
    table_5 as tracked_s_curve,
)
from quadlog.pipelines.tables.tracking import (
    table_5 as tracking_5,
)
from quadlog.pipelines.tables.tracking.walks import CURVES, Tracked
from quadlog.results.papers.page import section_text

T_S = np.linspace(0, 60, 50)


def pretend(tasks):
    """Walks whose η grows with the look-ahead, is worse without whole-body control, and differs by seed."""
    asked.extend(tasks)
    return [_pretended(task) for task in tasks]


asked = []


def _pretended(task):
    steering = task.steering
    l_m = 1.5 if steering.controller != "pmw" else steering.lookahead_m
    fell = steering.controller == "fpm" and task.disturbed and task.seed % 3 == 0
    eta_m = 0.01 * l_m * (1 + 0.01 * (task.seed % 7)) * (1.5 if steering.controller == "fpm" else 1.0)
    eta_m *= {"6cm": 1.3}.get(task.terrain, 1.0) * (1.2 if task.disturbed else 1.0)
    names = ("sigma_m", "eta_time_m", "sigma_time_m", "max_error_m", "heading_rmse_rad", "pitch_rms_rad")
    figures = dict.fromkeys((*names, "height_rms_m", "speed_std_mps", "yaw_rate_std_radps"), eta_m)
    figures |= {"eta_m": eta_m, "fallen": float(fell), "lookahead_mean_m": l_m, "lookahead_range_m": 1 + eta_m}
    figures |= {"speed_mean_mps": 0.59} | ({} if fell else {"completion_time_s": 52.6})
    figures |= {
        figure.key: eta_m for figure in (*tracked_courses.CURVED, *s_curve_rows.CURVED) if figure.key not in figures
    }
    curves = {name: np.sin(T_S) for name in CURVES} if task.drawn else {}
    return Tracked(figures, T_S, eta_m * (1 + np.sin(T_S)), curves)


@pytest.fixture(scope="module")
def tables():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracked_s_curve, "walk_all", pretend)
        patch.setattr(tracked_courses, "walk_all", pretend)
        return {
            ("tracking_5", True): tracking_5.make_table(True, 0),
            ("tracking_5", False): tracking_5.make_table(False, 0),
            ("tracking_courses", False): tracking_courses.make_table(False, 0),
        }


@pytest.fixture(params=[("tracking_5", True), ("tracking_5", False), ("tracking_courses", False)], ids=str)
def table(request, tables):
    return tables[request.param]


def rows(table):
    return {row.quantity: row for row in table.rows}


def test_it_says_what_was_run(table):
    assert table.command == f"quadlog tables {table.name}{' --fast' if table.fast else ''}"
    assert f"walks drawn from seeds 2000 to {2001 if table.fast else 2009}" in table.sizes
    for group in table.groups:
        assert "ntervals" in group.text, group.title
    text = section_text(table)
    assert "nan" not in text.lower().replace("name", "")


def test_what_is_judged_was_printed_and_what_fails_says_why(table):
    for row in table.rows:
        assert (row.paper is None) == (row.reproduces is None), row.quantity
        if row.reproduces is False:
            assert row.note, row.quantity


def test_pictures_are_pictures_and_say_what_they_show(table):
    for picture in table.pictures:
        with Image.open(io.BytesIO(picture.png)) as image:
            assert image.width == 1200
            assert len(image.convert("RGB").getcolors(maxcolors=1 << 24)) > 50
        assert picture.alt
        assert picture.caption


def test_table_5_stands_beside_ours(tables):
    mine = rows(tables["tracking_5", False])
    printed = {"FpMW": (0.2801, 0.1957, 64), "FpM": (0.2933, 0.1981, 68), "pMW": (0.5133, 0.3822, 75)}
    for condition in ("ideal", "disturbed"):
        for name, (eta_m, sigma_m, time_s) in printed.items():
            where = f"{condition}, {name}"
            assert mine[f"{where}: η (m)"].paper == mine[f"{where}: η beside the place in time (m)"].paper == eta_m
            assert mine[f"{where}: σ (m)"].paper == mine[f"{where}: σ beside the place in time (m)"].paper == sigma_m
            assert mine[f"{where}: completion time (s)"].paper == time_s
        assert mine[f"{condition}: η, pMW / FpMW (1)"].paper == pytest.approx(1.8326, abs=1e-4)


def test_what_figs_28_and_29_draw_stands_in_numbers(tables):
    mine = rows(tables["tracking_5", False])
    for name in ("FpMW", "FpM", "pMW"):
        assert mine[f"disturbed, {name}: largest joint torque (N m)"].paper is None


def test_the_order_is_judged_by_interval_and_by_medians(tables):
    mine = rows(tables["tracking_5", False])
    assert mine["ideal: η, FpM / FpMW (1)"].reproduces
    assert mine["ideal: η, pMW / FpMW (1)"].ours == pytest.approx(2 / 1.5)
    times = mine["ideal: completion time, pMW / FpMW (1)"]
    assert (times.ours, times.reproduces) == (1.0, False)
    order = mine["ideal: share of seeds with η of FpMW < FpM < pMW (1)"]
    # Here FpM is worse than pMW: 1.5 * 1.5 > 2.
    assert (order.ours, order.reproduces) == (0.0, False)


def test_falls_leave_no_time_behind(tables):
    mine = rows(tables["tracking_5", False])
    assert mine["disturbed, FpM: share of walks that fall (1)"].note == "3 of 10."
    assert "Of 7 of 10 walks." in mine["disturbed, FpM: completion time (s)"].note


def test_rivals_look_as_far_ahead_as_the_fuzzy_walk(tables):
    mine = rows(tables["tracking_5", False])
    for condition in ("ideal", "disturbed"):
        assert mine[f"{condition}, fixed l, FpMW's mean: mean look-ahead (m)"].ours == 1.5
        assert mine[f"{condition}: η, FpMW / fixed l, FpMW's mean (1)"].ours == pytest.approx(1.0)
        assert mine[f"{condition}: best fixed look-ahead (m)"].ours == min(tracked_s_curve.LENGTHS_M)
        assert mine[f"{condition}: η, FpMW / best fixed l (1)"].note == "The rules do harm."
    fast = rows(tables["tracking_5", True])
    assert fast["ideal: best fixed look-ahead (m)"].ours == tracked_s_curve.KNOWN_BEST_M["ideal"]
    assert fast["ideal: η, FpMW / best fixed l (1)"].low is None


def test_no_reported_walk_was_chosen_on(tables):
    assert {task.seed for task in asked if task.seed < 1000} == set(tracked_s_curve.CHOOSING_SEEDS)
    assert all(task.steering.controller == "pmw" for task in asked if task.seed < 1000)
    assert min(task.seed for task in asked if task.seed >= 1000) == 2000


def test_the_printed_circle_does_not_fit_its_speed(tables):
    table = tables["tracking_courses", False]
    row = rows(table)["ideal, circle, 6 cm: completion time (s)"]
    assert (row.paper, row.reproduces) == (62, False)
    assert "0.507 m/s" in row.note
    assert "52.4 s" in table.errata[0]


def test_what_the_paper_draws_stands_in_numbers_on_uneven_ground(tables):
    mine = rows(tables["tracking_courses", False])
    for figure in tracked_courses.CURVED:
        assert f"disturbed, circle, 6 cm: {figure.called} ({figure.unit})" in mine
        assert f"ideal, line, 3 cm: {figure.called} ({figure.unit})" in mine
        assert f"ideal, line, flat: {figure.called} ({figure.unit})" not in mine


def test_flat_ground_without_disturbances_is_walked_once(tables):
    mine = rows(tables["tracking_courses", False])
    assert mine["ideal, line, flat: η (m)"].low is None
    assert mine["disturbed, line, flat: η (m)"].low is not None
    assert mine["ideal, line: position errors, η, 6 cm / 3 cm (1)"].ours == pytest.approx(1.3)
    assert mine["ideal, line: position errors, η, 6 cm / 3 cm (1)"].reproduces
