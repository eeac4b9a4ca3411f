from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from quadlog.config.schema import Config
from quadlog.messages import PoseSeries
from quadlog.pipelines.stages.positions.uwb_tags import levers_on_robot, tag_truth

T_NS = 1_700_000_000_000_000_000 + np.arange(5, dtype=np.int64) * 50_000_000


def config_with(*tags: dict[str, object]) -> Config:
    return Config.model_validate({"uwb": {"tags": list(tags)}})


def test_further_tags_sit_on_the_robot_when_their_table_places_them_there():
    config = config_with(
        {"id": 4, "role": "robot", "x_m": 0.1},
        {"id": 5, "role": "none", "y_m": -0.2},
        {"id": 6, "role": "none"},
        {"id": 7, "role": "person", "x_m": 0.3},
    )
    assert levers_on_robot(config, 4) == {4: (0.1, 0.0), 5: (0.0, -0.2)}
    assert levers_on_robot(config, None) == {5: (0.0, -0.2)}


def test_without_a_table_the_robots_tag_sits_at_its_origin():
    assert levers_on_robot(config_with(), 2) == {2: (0.0, 0.0)}
    assert levers_on_robot(config_with(), None) == {}


def test_the_lever_turns_with_the_robot():
    yaw_rad = np.linspace(-3, 3, 5)
    rotation = Rotation.from_euler("z", yaw_rad[:, None])
    position_m = np.column_stack([np.arange(5.0), -np.arange(5.0), np.full(5, 0.3)])
    poses = PoseSeries(T_NS, position_m, rotation.as_quat())
    expected = position_m + rotation.apply([0.4, -0.2, 0.0])
    assert_allclose(tag_truth(T_NS, poses, (0.4, -0.2)), expected[:, :2], atol=1e-12)


@pytest.mark.parametrize("outside_ns", [T_NS[0] - 1, T_NS[-1] + 1])
def test_where_the_reference_is_silent_nothing_is_known(outside_ns: int):
    poses = PoseSeries(T_NS, np.zeros((5, 3)), Rotation.identity(5).as_quat())
    assert np.isnan(tag_truth(np.array([outside_ns]), poses, (0.0, 0.0))).all()
    gap = PoseSeries(T_NS[[0, 4]], np.zeros((2, 3)), Rotation.identity(2).as_quat())
    assert np.isnan(tag_truth(T_NS[2:3], gap, (0.0, 0.0))).all()
