from __future__ import annotations

import numpy as np
import pytest

from quadlog.control.locomotion.robot import ROBOTS
from quadlog.simulation.robot import height_field as ground
from quadlog.simulation.robot import rendering as frames
from quadlog.simulation.robot.model import quadruped_model


def _model():
    return quadruped_model(ROBOTS["tracking"], ground.flat())


def test_the_camera_follows_the_robot():
    model = _model()
    joints = np.array([model.standing_at(0.0, 0.0), model.standing_at(7.0, -3.0, 2.0)])
    try:
        pictures = frames.render_frames(model.model, joints)
    except frames.CannotDraw as error:
        pytest.skip(str(error))
    assert pictures.shape == (2, frames.HEIGHT_PX, frames.WIDTH_PX, 3)
    # The camera goes along, so both show the same robot: the dark trunk in the middle.
    middle = pictures[:, 100:160, 150:250].astype(float).mean(axis=(1, 2, 3))
    border = pictures[:, 250:].astype(float).mean(axis=(1, 2, 3))
    assert (middle < 0.8 * border).all()


def test_the_shadow_moves_with_the_robot():
    model = _model()
    try:
        pictures = frames.render_frames(
            model.model, np.array([model.standing_at(0.0, 0.0), model.standing_at(9.0, 9.0)])
        )
    except frames.CannotDraw as error:
        pytest.skip(str(error))
    dark = (pictures[:, 150:].max(axis=3) < 60).sum(axis=(1, 2))
    assert dark[0] > 1500
    assert dark[1] == pytest.approx(dark[0], rel=0.02)


def test_a_missing_backend_raises_with_its_reason(monkeypatch):
    monkeypatch.setattr(frames, "BACKENDS", ("none-such",))
    with pytest.raises(frames.CannotDraw, match=r"none-such: .*MUJOCO_GL"):
        frames.render_frames(_model().model, np.array([_model().standing_at(0.0, 0.0)]))
