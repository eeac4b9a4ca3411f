from __future__ import annotations

import numpy as np
import pytest

from quadlog.simulation.sensors.scene import RayCaster
from quadlog.simulation.synthetic import corridor
from quadlog.simulation.synthetic.recording import START_NS


@pytest.fixture(scope="module")
def lap():
    return corridor.synthesize(seed=0, duration_s=90.0, azimuth_steps=16)


def test_the_corridor_is_two_metres_wide_between_walls_and_doors():
    caster, way = RayCaster(corridor.building()), corridor.route()
    place, heading, curvature = way.at(np.arange(0.0, way.length_m, 0.05))
    left = np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(len(heading))])
    origins = np.column_stack([place, np.full(len(place), 0.5)])
    straight = np.abs(curvature) < 0.02
    to_left, to_right = (caster.cast(origins, side).range_m[straight] for side in (left, -left))
    width = to_left + to_right
    assert np.mean(np.abs(width - 2.0) < 0.02) > 0.6
    # A closed door stands 10 cm back, the open one lets one look 4 m into a room.
    assert width.min() > 1.97
    assert 0.02 < np.mean(np.abs(width - 2.1) < 0.02) < 0.3
    assert np.isclose(to_left.max(), 5.0, atol=0.05)


def test_anchors_around_the_corner_are_out_of_sight(lap):
    for ranges, tag in zip(lap.ranges, lap.tags, strict=True):
        place = tag.position_m((ranges.t_ns - START_NS) * 1e-9)
        south = (place[:, 1] < 1.5) & (np.abs(place[:, 0] - 8.0) < 4.0)
        assert south.sum() > 300
        # From the south side: the two corners of its own and the anchor halfway, none of the far sides.
        assert ranges.line_of_sight[south][:, [0, 1, 4]].all()
        assert not ranges.line_of_sight[south][:, [2, 3, 5, 6, 7]].any()
        assert (ranges.line_of_sight.sum(axis=1) >= 2).all()
