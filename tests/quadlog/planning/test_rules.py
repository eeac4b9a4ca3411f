from __future__ import annotations

import math

from quadlog.planning.rules import Rules


def test_exact_units_tell_paths_of_a_large_map_apart():
    """Two paths are as long only if they have as many steps of each kind, up to 55 000 diagonal ones more or less.

    The nearest miss is where a multiple of the root of 2 is nearest to a whole number.
    """
    straight, diagonal = Rules("exact").step_units
    for diagonals in range(1, 55_000):
        length = diagonals * math.sqrt(2)
        for straights in (math.floor(length), math.ceil(length)):
            assert (straights * straight > diagonals * diagonal) == (straights > length)
        assert abs(diagonals * diagonal - length * straight) < straight * abs(length - round(length))
