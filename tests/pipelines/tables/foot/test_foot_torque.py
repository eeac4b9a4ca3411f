from __future__ import annotations

import numpy as np
import pytest

from quadlog.pipelines.tables.foot import torque_model as figures
from quadlog.pipelines.tables.foot.torque import make_table


@pytest.fixture(scope="module")
def rows():
    return {row.quantity: row for row in make_table(False, 0).rows}


def ours(rows, quantity):
    return rows[quantity].ours


def test_fig_3_by_hand(rows):
    g = 9.81
    abduction = rows["tau 1, abduction (N m)"]
    assert (abduction.paper, abduction.reproduces) == (0.0, "no")
    assert abduction.ours == pytest.approx(0.07 * 0.5 * g)
    assert ours(rows, "left leg: tau 1 (N m)") == pytest.approx(-abduction.ours)
    assert round(ours(rows, "tau 2, hip, at touch-down (N m)"), 3) == -0.131
    assert round(ours(rows, "tau 2, hip, at lift-off (N m)"), 3) == 0.115
    assert ours(rows, "f_z, one leg's mass (N)") == pytest.approx(0.5 * g)
    assert ours(rows, "f_z, half of 10 kg (N)") == pytest.approx(5 * g)
    assert ours(rows, "half of 10 kg: tau 2, least (N m)") == pytest.approx(-1.30625)
    assert ours(rows, "half of 10 kg: tau 3, least (N m)") < -5
    assert ours(rows, "knee in front: tau 3, least (N m)") > 0


def test_the_legs_own_weight_is_all_of_a_swings_reaction_over_the_whole_swing():
    # At rest at both ends, a leg's angular momentum gains nothing.
    assert figures.swing_hip_reaction(0.0).mean() == pytest.approx(0, abs=5e-4)
    assert figures.swing_hip_reaction(9.81).mean() > 0.1


def test_a_swing_of_half_the_time_takes_four_times_the_torque(monkeypatch):
    in_table_2s_period = figures.swing_hip_reaction(0.0)
    monkeypatch.setattr(figures, "PERIOD_S", 0.25)
    np.testing.assert_allclose(figures.swing_hip_reaction(0.0), 4 * in_table_2s_period, atol=1e-9)


def test_gravity_about_the_diagonal_is_the_corrected_eq_8(rows):
    off = figures.off_centre()
    diagonal = np.hypot(0.36, 0.26)
    assert ours(rows, "D, from support foot to support foot (m)") == pytest.approx(diagonal)
    assert off.moment_nm == pytest.approx(4 * off.leg_mass_kg * 9.81 * off.behind_m)
    assert off.ahead_m == pytest.approx(figures.ROBOT.centre_of_mass_m[0])
    assert ours(rows, "about the diagonal, size (N m)") == pytest.approx(off.moment_nm * 0.26 / diagonal)
    about_x, about_y = rows["about x, size (N m)"], rows["about y, size (N m)"]
    assert about_x.ours == pytest.approx(off.moment_nm * 0.36 * 0.26 / diagonal**2)
    assert about_y.ours == pytest.approx(off.moment_nm * 0.26**2 / diagonal**2)
    assert ours(rows, "about x, eq. 8 as printed (N m)") == pytest.approx(off.moment_nm)
    assert ours(rows, "about y, eq. 8 as printed (N m)") == pytest.approx(off.moment_nm * 0.12 / (0.14 + 0.36))
    left, right = (
        ours(rows, f"{pair}: about x (N m)") for pair in ("left fore and right hind", "right fore and left hind")
    )
    assert left == -right


def test_k_gives_the_curve_its_peak(rows):
    inertia, moment = ours(rows, "J1, a leg about its abduction axis (kg m^2)"), ours(rows, "about x, size (N m)")
    for peak_mm in (5, 10, 20):
        k = ours(rows, f"k for a peak of {peak_mm} mm (1/m)")
        t_s = np.linspace(0, 0.5, 1001)
        y_m = moment / (4 * k * inertia) * t_s * (t_s - 0.5)
        assert -y_m.min() == pytest.approx(peak_mm / 1e3)
        # What it solves: 2 J1 k y'' = M.
        np.testing.assert_allclose(2 * inertia * k * np.gradient(np.gradient(y_m, t_s), t_s)[2:-2], moment, rtol=1e-6)
    printed = ours(rows, "k for 10 mm: y at T / 4, eq. 12 as printed (mm)")
    k = ours(rows, "k for a peak of 10 mm (1/m)")
    assert printed == pytest.approx(1e3 * moment / (k * inertia) * (4 * 0.25**2 - 8 * 0.25))
    assert rows["k for 10 mm: y at T / 4 (mm)"].ours == pytest.approx(-10)
    assert rows["k for 10 mm: y at T / 2 (mm)"].ours == 0
