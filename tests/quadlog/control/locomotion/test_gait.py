import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.gait import GAITS, Gait, contact_state

gaits = st.builds(
    Gait,
    name=st.just("any"),
    period_s=st.floats(0.1, 3),
    duty=st.floats(0.05, 1),
    offsets=st.tuples(*[st.floats(-1, 2)] * 4),
)


def state(gait, t_s):
    stance, phase = np.empty(4, np.bool_), np.empty(4)
    contact_state(t_s, gait.period_s, gait.duty, np.array(gait.offsets), stance, phase)
    return stance, phase


@pytest.mark.parametrize(
    ("name", "least", "most"), [("walk", 3, 3), ("trot", 2, 4), ("flying_trot", 0, 2), ("pronk", 0, 4), ("bound", 0, 2)]
)
def test_so_many_feet_are_on_the_ground(name, least, most):
    gait = GAITS[name]
    count = {int(state(gait, t)[0].sum()) for t in np.linspace(0, gait.period_s, 777)[1:-1]}
    assert (min(count), max(count)) == (least, most)


def test_a_walk_lifts_left_hind_left_fore_right_hind_right_fore():
    gait = GAITS["walk"]
    t_s = np.linspace(0, gait.period_s, 801)[:-1] + gait.period_s / 3200
    standing = np.array([state(gait, t)[0] for t in t_s])
    landing = [int(np.flatnonzero(standing[:, leg] & ~np.roll(standing[:, leg], 1))[0]) for leg in range(4)]
    order = np.argsort(landing).tolist()
    start = order.index(2)
    assert order[start:] + order[:start] == [2, 0, 3, 1]


@given(gaits, st.floats(-100, 100))
def test_a_phase_is_within_its_stance_or_swing(gait, t_s):
    stance, phase = state(gait, t_s)
    assert ((phase >= 0) & (phase <= 1)).all()
    whole = np.where(stance, phase * gait.duty, gait.duty + phase * (1 - gait.duty))
    turns = t_s / gait.period_s + np.array(gait.offsets) - whole
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
