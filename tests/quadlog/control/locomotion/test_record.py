import numpy as np
from numba import njit

from quadlog.control.locomotion.numba_record import Record

LAYOUT = np.dtype([("stands", "u1", 4), ("place", "f8", (2, 3)), ("speed", "f8")], align=True)


@njit
def move(record):
    to = record[0]
    for leg in range(4):
        to.stands[leg] = not to.stands[leg]
    to.place[1, 2] += to.speed


def test_what_a_compiled_function_writes_is_seen_in_the_views_and_back():
    one, other = Record(LAYOUT), Record(LAYOUT)
    assert one.stands.dtype == np.bool_
    assert one.place.shape == (2, 3)
    assert not hasattr(one, "speed")
    one.stands[:], one.place[:], one.record["speed"] = [True, False, True, False], 1.0, 0.5
    move(one.record)
    np.testing.assert_array_equal(one.stands, [False, True, False, True])
    np.testing.assert_array_equal(one.place, [[1, 1, 1], [1, 1, 1.5]])
    assert not other.record.tobytes().strip(b"\0")
