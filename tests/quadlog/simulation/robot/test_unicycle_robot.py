from __future__ import annotations

import math

import pytest
from scipy.integrate import solve_ivp

from quadlog.simulation.robot.unicycle_robot import unicycle_step


@pytest.mark.parametrize(("v", "w"), [(0.6, 0.0), (0.6, 1e-9), (0.6, 0.3), (-0.4, -1.5), (0.0, 1.0), (1.0, 9.0)])
def test_step_is_the_exact_arc(v, w):
    """Against an integrator that knows no closed form."""
    start = (1.0, -2.0, 0.7)
    truth = solve_ivp(
        lambda _, s: [v * math.cos(s[2]), v * math.sin(s[2]), w], (0, 1.3), start, rtol=1e-12, atol=1e-12
    ).y[:, -1]
    x, y, yaw = unicycle_step(*start, v, w, 1.3)
    assert (x, y) == pytest.approx((truth[0], truth[1]), abs=1e-9)
    assert math.cos(yaw - truth[2]) == pytest.approx(1.0, abs=1e-9)
    assert -math.pi <= yaw < math.pi
