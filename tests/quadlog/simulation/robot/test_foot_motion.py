"""MuJoCo is the oracle, on a robot whose joints lie as they like."""

import mujoco
import numpy as np
import pytest

from quadlog.simulation.robot.quadruped import foot_motion


def _skew(rng: np.random.Generator) -> mujoco.MjModel:
    """A trunk and a leg of three hinges, each with its own place, attitude and axis."""

    def numbers(count: int) -> str:
        return " ".join(repr(float(x)) for x in rng.normal(size=count))

    inertial, foot = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>', f'<site name="foot" pos="{numbers(3)}"/>'
    text = foot
    for _ in range(3):
        hinge = f'<joint type="hinge" axis="{numbers(3)}" pos="{numbers(3)}"/>'
        text = f'<body pos="{numbers(3)}" quat="{numbers(4)}">{hinge}{inertial}{text}</body>'
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body><freejoint/>{inertial}{text}</body></worldbody></mujoco>"
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_foots_jacobian_and_its_change_are_mujocos(seed):
    rng = np.random.default_rng(seed)
    model = _skew(rng)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = rng.normal(size=model.nq), rng.normal(size=model.nv)
    mujoco.mj_normalizeQuat(model, data.qpos)
    mujoco.mj_forward(model, data)
    here, change = np.zeros((3, 9)), np.zeros((3, 9))
    mujoco.mj_jacSite(model, data, here, None, 0)
    mujoco.mj_jacDot(model, data, change, None, data.site_xpos[0], model.site_bodyid[0])
    # The leg is the second of two: its joints begin later in qvel.
    qvel = np.concatenate([data.qvel[:6], rng.normal(size=3), data.qvel[6:]])
    jacobian, rate, rotation = np.zeros((3, 12)), np.empty(3), data.xmat[1].reshape(3, 3)
    place = data.qpos, rotation, qvel, 9, np.array([1, 2, 3]), data.xanchor, data.xaxis, data.site_xpos[0]
    foot_motion(*place, jacobian, rate)
    np.testing.assert_allclose(np.delete(jacobian, [6, 7, 8], axis=1), here, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rate, change @ data.qvel, rtol=0, atol=1e-11)
    assert not jacobian[:, 6:9].any()
