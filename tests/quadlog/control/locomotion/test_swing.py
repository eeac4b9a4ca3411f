import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly

from quadlog.control.locomotion.foot_trajectory import swing_state

START, END, CLEARANCE_M, DURATION_S = np.array([0.1, -0.2, 0.02]), np.array([0.25, -0.15, 0.06]), 0.09, 0.19


def state(phase):
    out = np.empty((3, 3))
    swing_state(phase, DURATION_S, START, END, CLEARANCE_M, *out)
    return out


def test_it_starts_and_ends_at_rest():
    for phase, place in [(0.0, START), (1.0, END), (-0.3, START), (1.4, END)]:
        position, velocity, acceleration = state(phase)
        np.testing.assert_allclose(position, place, atol=1e-15)
        np.testing.assert_array_equal(velocity, 0)
        np.testing.assert_array_equal(acceleration, 0)


def test_it_is_highest_above_the_line_in_the_middle():
    position, velocity, _ = state(0.5)
    np.testing.assert_allclose(position, (START + END) / 2 + [0, 0, CLEARANCE_M], atol=1e-15)
    np.testing.assert_allclose(velocity, 1.875 * (END - START) / DURATION_S)


@settings(deadline=None)
@given(st.floats(0.01, 0.99))
def test_along_the_line_it_is_the_quintic_at_rest_at_both_ends(phase):
    quintic = BPoly.from_derivatives([0, DURATION_S], [[START[0], 0, 0], [END[0], 0, 0]])
    t_s = phase * DURATION_S
    expected = [float(quintic(t_s, order)) for order in range(3)]
    np.testing.assert_allclose(state(phase)[:, 0], expected, rtol=1e-9, atol=1e-9)


@settings(deadline=None)
@given(st.floats(0.01, 0.99))
def test_velocity_and_acceleration_are_derivatives(phase):
    step_s = 1e-6
    ahead, back, here = state(phase + step_s / DURATION_S), state(phase - step_s / DURATION_S), state(phase)
    np.testing.assert_allclose(here[1:], (ahead - back)[:2] / (2 * step_s), rtol=1e-6, atol=1e-6)
