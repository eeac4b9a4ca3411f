import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.gait import (
    GAITS,
    LANDS_FROM_PHASE,
    LOST_S,
    SEEKING_MPS,
    Gait,
    Stride,
    advance,
    contact_state,
    swing_state,
)
from quadlog.control.locomotion.robot import ROBOTS

ROBOT = ROBOTS["tracking"]
TROT = GAITS["trot"]
STANCE_S, SWING_S = TROT.duty * TROT.period_s, (1 - TROT.duty) * TROT.period_s
DT_S, CLEARANCE_M = 0.002, 0.09
STANDING_M = ROBOT.standing_feet_m + np.array([0, 0, ROBOT.standing_height_m])
# Of the trot, the pair that swings first.
PAIR = [0, 3]
# What feels no ground in this many ticks on end still stands.
HOLDS_TICKS = round(LOST_S / DT_S) - 1


class March:
    """A stride under a body that goes straight on, feet and touches given from outside."""

    def __init__(self, gait: Gait = TROT, velocity=(0.0, 0.0, 0.0), yaw_rad=0.0) -> None:
        self.gait, self.ticks, self.yaw_rad = gait, 0, yaw_rad
        self.velocity = np.array(velocity)
        self.stride = Stride(ROBOT, gait, CLEARANCE_M, STANDING_M)

    @property
    def t_s(self) -> float:
        """Of the last tick."""
        return (self.ticks - 1) * DT_S

    @property
    def plan(self) -> tuple[np.ndarray, np.ndarray]:
        planned, phase = np.empty(4, dtype=bool), np.empty(4)
        gait = self.gait
        contact_state(self.t_s, gait.period_s, gait.duty, np.array(gait.offsets), planned, phase)
        return planned, phase

    def step(self, touches=None, feet_m=STANDING_M) -> bool:
        """A tick; unless told, feet touch exactly when they should."""
        self.ticks += 1
        touches = self.plan[0] if touches is None else np.asarray(touches)
        position_m = np.array([0, 0, ROBOT.standing_height_m]) + self.velocity * self.t_s
        motion = (position_m, self.yaw_rad, self.velocity, self.velocity, 0.0)
        return advance(self.stride.record, self.t_s, DT_S, feet_m, touches, *motion)

    def until(self, leg: int, phase: float, planned: bool = False, touches=None) -> None:
        """On until a leg's swing or stance has come to a phase."""
        for _ in range(1000):
            self.step(touches)
            now, at = self.plan
            if now[leg] == planned and at[leg] >= phase:
                return
        raise AssertionError("it never came to that phase")


def test_a_foot_swings_from_where_it_stood_last_to_its_foothold():
    march, start_m, end_m = March(), STANDING_M.copy(), STANDING_M
    start_m[PAIR] += [0.05, 0.01, 0.02]
    march.until(0, 0.999 - DT_S / STANCE_S, planned=True)
    march.step(feet_m=start_m)
    planned, phase = march.plan
    assert not planned[PAIR].any()
    assert (phase[PAIR] < 0.02).all()
    while not march.plan[0][0]:
        expected = np.empty((3, 3))
        for leg in PAIR:
            swing_state(march.plan[1][leg], SWING_S, start_m[leg], end_m[leg], CLEARANCE_M, *expected)
            np.testing.assert_allclose(march.stride.swing[:, leg], expected, atol=1e-9, rtol=1e-9)
        # Where the foot is measured to be after that does not matter.
        elsewhere_m = STANDING_M.copy()
        elsewhere_m[PAIR] += [0.3, -0.2, 0.1]
        march.step(feet_m=elsewhere_m)


def test_touching_late_in_the_swing_is_landing_and_stays_so():
    march = March()
    march.until(0, LANDS_FROM_PHASE)
    assert not march.stride.stands[0]
    where_m = STANDING_M + np.array([0.03, 0, 0.04])
    assert march.step([True] * 4, where_m)
    assert march.stride.stands.all()
    np.testing.assert_array_equal(march.stride.contacts_m, where_m)
    np.testing.assert_array_equal(march.stride.landings_m, where_m)
    # It goes on standing though it loses touch now and then, through the stance that was planned too, and lifts off.
    was_planned, ticks = False, 0
    while march.plan[0][0] or not was_planned:
        was_planned = march.plan[0][0]
        assert march.stride.stands[0]
        ticks += 1
        march.step([ticks % (HOLDS_TICKS + 1) == 0] * 4)
    assert ticks > 100
    assert not march.stride.stands[0]


def test_a_foot_late_for_the_ground_goes_down_until_it_touches():
    march = March()
    march.until(0, 0.0, planned=False)
    march.until(0, 0.0, planned=True, touches=[False, True, True, False])
    ends_m, ticks = STANDING_M[PAIR], 0
    while march.plan[1][0] < 0.5:
        ticks += 1
        assert not march.stride.stands[PAIR].any()
        swing = march.stride.swing[:, PAIR]
        np.testing.assert_allclose(swing[0, :, :2], ends_m[:, :2], atol=1e-6)
        np.testing.assert_allclose(swing[0, :, 2], ends_m[:, 2] - ticks * DT_S * SEEKING_MPS, atol=2e-4)
        np.testing.assert_array_equal(swing[1], [[0, 0, -SEEKING_MPS]] * 2)
        np.testing.assert_array_equal(swing[2], np.zeros((2, 3)))
        march.step([False, True, True, False])
    assert ticks > 50
    lower_m = STANDING_M - [0, 0, 0.04]
    assert march.step([True] * 4, lower_m)
    assert march.stride.stands[PAIR].all()
    np.testing.assert_array_equal(march.stride.contacts_m[PAIR], lower_m[PAIR])


patterns = st.lists(st.tuples(st.integers(1, 60), st.lists(st.booleans(), min_size=4, max_size=4)), max_size=6)


@given(st.sampled_from(list(GAITS)), patterns, st.integers(0, 2**32 - 1))
def test_whatever_feet_feel(gait, pattern, seed):
    march, rng = March(GAITS[gait], (0.4, 0.1, 0.0)), np.random.default_rng(seed)
    stride, airborne = march.stride, np.zeros(4, dtype=int)
    for ticks, touches in pattern:
        for _ in range(ticks):
            stood, plane = stride.stands.copy(), stride.plane.copy()
            feet_m = STANDING_M + rng.uniform(-0.05, 0.05, (4, 3))
            changed = march.step(touches, feet_m)
            planned, phase = march.plan
            stands = stride.stands
            assert changed == (stands != stood).any()
            airborne = np.where(touches, 0, airborne + 1)
            # What is planned to stand and touches stands; what stood goes on for a while; none out of the air.
            assert stands[planned & touches].all()
            assert stands[planned & stood & (airborne <= HOLDS_TICKS)].all()
            assert not stands[airborne > HOLDS_TICKS + 1].any()
            assert not (stands & ~stood & ~np.array(touches)).any()
            assert not stands[~planned & (phase < LANDS_FROM_PHASE)].any()
            np.testing.assert_array_equal(stride.contacts_m[stands], feet_m[stands])
            np.testing.assert_array_equal(stride.landings_m[stands], feet_m[stands])
            if changed:
                rows = np.column_stack([stride.contacts_m[:, :2], np.ones(4)])
                plane = np.linalg.lstsq(rows, stride.contacts_m[:, 2], rcond=None)[0]
            np.testing.assert_allclose(stride.plane, plane, rtol=1e-9, atol=1e-12)
            for array in (stride.swing, stride.contacts_m, stride.landings_m):
                assert np.isfinite(array).all()
