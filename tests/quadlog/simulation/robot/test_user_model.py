from pathlib import Path

import mujoco
import numpy as np
import pytest

from quadlog.control.locomotion.robot import ROBOTS, SIDES, Robot
from quadlog.errors import TooLarge, UnreadableFile, UnusableRobot
from quadlog.simulation.robot import model_files
from quadlog.simulation.robot.height_field import Extent, flat, undulating
from quadlog.simulation.robot.model import quadruped_model, quadruped_spec
from quadlog.simulation.robot.user_model import load_user_model

ROBOT = ROBOTS["tracking"]
UNITREE = {"left_fore": "FL", "right_fore": "FR", "left_hind": "RL", "right_hind": "RR"}


def mjcf(robot: Robot) -> str:
    spec = quadruped_spec(robot)
    spec.compile()
    return spec.to_xml()


def unitree_names(text: str) -> str:
    """Our own model with Unitree's names, and hip and knee turning about +y."""
    for leg, short in UNITREE.items():
        for ours, theirs in [("abduction", "hip"), ("hip", "thigh"), ("knee", "calf")]:
            text = text.replace(f'"{leg}_{ours}"', f'"{short}_{theirs}_joint"')
        text = text.replace(f'"{leg}_foot"', f'"{short}_foot"')
    return text.replace('axis="0 -1 0"', 'axis="0 1 0"')


def urdf(robot: Robot, legs: int = 4) -> str:
    """The robot as Unitree writes its URDF: a massless base, fixed feet, meshes that are not there."""

    model = quadruped_model(robot, flat()).model

    def link(name: str, ours: str, shape: str = "") -> str:
        body = model.body(ours)
        (mass,), centre, (xx, yy, zz) = body.mass.tolist(), body.ipos.tolist(), body.inertia.tolist()
        return (
            f'<link name="{name}"><visual><geometry><mesh filename="package://r/{name}.dae"/></geometry></visual>'
            f'<collision><geometry><mesh filename="/etc/passwd"/></geometry></collision>{shape}'
            f'<inertial><origin xyz="{centre[0]!r} {centre[1]!r} {centre[2]!r}"/><mass value="{mass!r}"/>'
            f'<inertia ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )

    def joint(name: str, parent: str, child: str, place: tuple[float, ...], axis: str = "") -> str:
        kind = "revolute" if axis else "fixed"
        limit = f'<axis xyz="{axis}"/><limit effort="33.5" velocity="20" lower="-20" upper="30"/>' if axis else ""
        at = " ".join(map(repr, place))
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{at}"/>{limit}</joint>'
        )

    parts = ['<robot name="any"><link name="base"/>', joint("floating_base", "base", "trunk", (0.0, 0.0, 0.0))]
    parts.append(link("trunk", "trunk"))
    ball = f'<collision><geometry><sphere radius="{robot.foot_radius_m}"/></geometry></collision>'
    aside, thigh_m, shank_m = robot.lengths_m
    for leg, (ours, short) in enumerate(list(UNITREE.items())[:legs]):
        side = float(SIDES[leg])
        for name, piece in [("hip", "abduction"), ("thigh", "thigh"), ("calf", "shank")]:
            parts.append(link(f"{short}_{name}", f"{ours}_{piece}"))
        parts.append(f'<link name="{short}_foot">{ball}</link>')
        parts.append(joint(f"{short}_foot_fixed", f"{short}_calf", f"{short}_foot", (0.0, 0.0, -shank_m)))
        parts.append(joint(f"{short}_calf_joint", f"{short}_thigh", f"{short}_calf", (0.0, 0.0, -thigh_m), "0 1 0"))
        parts.append(joint(f"{short}_thigh_joint", f"{short}_hip", f"{short}_thigh", (0.0, side * aside, 0.0), "0 1 0"))
        hip = tuple(robot.hips_m[leg].tolist())
        parts.append(joint(f"{short}_hip_joint", "trunk", f"{short}_hip", hip, "1 0 0"))
    return "".join([*parts, "</robot>"])


def write(folder: Path, text: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("kind", ["ours", "mjcf", "urdf"])
def test_models_with_other_names_and_axes_move_alike(tmp_path: Path, kind: str):
    texts = {"ours": mjcf(ROBOT), "mjcf": unitree_names(mjcf(ROBOT)), "urdf": urdf(ROBOT)}
    ground = undulating(0.03, seed=1, extent=Extent(-1.0, -1.0, 1.0, 1.0))
    theirs, ours = load_user_model(write(tmp_path, texts[kind]), ground), quadruped_model(ROBOT, ground)
    robot = theirs.robot
    assert robot.mass_kg == pytest.approx(ROBOT.mass_kg)
    assert robot.lengths_m == pytest.approx(ROBOT.lengths_m)
    assert (robot.hip_x_m, robot.hip_y_m, robot.torque_limit_nm) == pytest.approx((0.1805, 0.047, 33.5))
    assert robot.foot_radius_m == pytest.approx(0.02)
    # The same movement from the same torques is the same robot in every mass, length, sign and limit.
    qpos = ours.standing_at(0.1, 0.2, 0.3)
    ends = []
    for quadruped in (theirs, ours):
        data = mujoco.MjData(quadruped.model)
        data.qpos[:7], data.qpos[quadruped.joint_qpos] = qpos[:7], qpos[quadruped.joint_qpos]
        for step in range(100):
            data.ctrl[:] = 5 * np.sin(0.1 * step + np.arange(12)) + 40 * (np.arange(12) == 5) * (step < 5)
            mujoco.mj_step(quadruped.model, data)
        ends.append(
            np.concatenate(
                [data.qpos[:7], data.qpos[quadruped.joint_qpos], data.site_xpos[quadruped.foot_sites].ravel()]
            )
        )
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_a_joint_that_is_turned_round_keeps_its_range(tmp_path: Path):
    model = load_user_model(write(tmp_path, urdf(ROBOT)), flat()).model
    np.testing.assert_array_equal(model.joint("left_fore_abduction").range, [-20, 30])
    np.testing.assert_array_equal(model.joint("left_fore_knee").range, [-30, 20])


def test_mujoco_leaves_no_log_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    text = urdf(ROBOT)
    load_user_model(write(tmp_path, text.replace('lower="-20" upper="30"', 'lower="1" upper="1"', 1)), flat())
    with pytest.raises(UnreadableFile, match="nan"):
        load_user_model(write(tmp_path, text.replace('effort="33.5"', 'effort="NaN"', 1)), flat())
    assert [path.name for path in tmp_path.iterdir()] == ["robot.xml"]


def test_a_body_whose_origin_is_elsewhere_keeps_it(tmp_path: Path):
    text = urdf(ROBOT).replace(
        '<child link="trunk"/><origin xyz="0.0 0.0 0.0"/>', '<child link="trunk"/><origin xyz="0.02 0 0.05"/>'
    )
    quadruped = load_user_model(write(tmp_path, text), flat())
    assert quadruped.robot.hip_centre_m == pytest.approx((0.02, 0.0, 0.05))
    data = mujoco.MjData(quadruped.model)
    data.qpos[:] = quadruped.standing_at(0.0, 0.0)
    mujoco.mj_forward(quadruped.model, data)
    np.testing.assert_allclose(data.site_xpos[quadruped.foot_sites][:, 2], 0.02, atol=1e-3)


@pytest.mark.parametrize(
    ("text", "needed"),
    [
        (unitree_names(mjcf(ROBOT)).replace("FL_", "arm_"), "named left_fore or FL_... (found none)"),
        (urdf(ROBOT, legs=3), "named right_hind or RH_"),
        (unitree_names(mjcf(ROBOT)).replace("_foot", "_tip"), "a foot: a site, sphere or body below FL_calf_joint"),
        (
            unitree_names(mjcf(ROBOT)).replace('name="RR_calf_joint"', 'name="tail"'),
            "found RR_hip_joint, RR_thigh_joint",
        ),
        (
            mjcf(ROBOT).replace('<joint name="left_fore_hip"', '<joint type="slide" name="left_fore_hip"'),
            "three hinge joints",
        ),
        (mjcf(ROBOT).replace('axis="0 -1 0"', 'axis="1 0 0"', 1), "legs like quadlog's"),
        (urdf(ROBOT).replace('effort="33.5"', 'effort="0"', 1), "a torque limit of FL_calf_joint"),
    ],
)
def test_missing_parts_are_named(tmp_path: Path, text: str, needed: str):
    with pytest.raises(UnusableRobot) as caught:
        load_user_model(write(tmp_path, text), flat())
    assert needed in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no xml",
        "<html/>",
        "<mujoco><worldbody><body><geom/></body></worldbody>",
        '<mujoco><worldbody><body><geom type="box" size="x"/></body></worldbody></mujoco>',
        '<mujoco><include file="absent.xml"/></mujoco>',
        '<mujoco><include file="robot.xml"/></mujoco>',
        mjcf(ROBOT).replace("<worldbody>", '<asset><mesh name="a" file="absent.stl"/></asset><worldbody>'),
        "\ud800",
    ],
)
def test_invalid_files_are_refused(tmp_path: Path, text: str):
    path = tmp_path / "robot.xml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(UnreadableFile) as caught:
        load_user_model(path, flat())
    assert "\n" not in str(caught.value)


def test_only_the_robot_of_a_scene_is_taken(tmp_path: Path):
    """As in published models: options, keyframes, sensors, textures that are not there, cameras, a floor."""
    beside = """<option gravity="0 0 -1" density="5"/><keyframe><key name="home" qpos="0"/></keyframe>
    <sensor><jointpos joint="left_fore_hip"/><gyro site="imu"/></sensor>
    <contact><exclude body1="trunk" body2="box"/></contact><custom><numeric name="n" data="1"/></custom>
    <tendon><fixed name="t"><joint joint="left_fore_hip" coef="1"/></fixed></tendon>
    <actuator><position tendon="t" forcerange="-1 1"/></actuator>
    <equality><joint joint1="left_fore_hip" joint2="left_hind_hip" active="false"/></equality>
    <asset><texture name="x" type="2d" file="absent.png"/><material name="m" texture="x"/>
    <hfield name="h" file="absent.png" size="1 1 1 1"/></asset></mujoco>"""
    text = mjcf(ROBOT).replace("</mujoco>", beside).replace('<geom name="trunk"', '<geom material="m" name="trunk"')
    around = """<worldbody><light/><camera/><geom type="plane" size="1 1 1" material="m"/>
    <geom type="hfield" hfield="h"/>
    <body name="box"><geom size="1"/><site name="imu" material="m"/></body>"""
    scene = load_user_model(write(tmp_path, text.replace("<worldbody>", around, 1)), flat())
    alone = load_user_model(write(tmp_path, mjcf(ROBOT)), flat())
    assert scene.robot == alone.robot
    sizes = ("nq", "nbody", "ngeom", "nu", "nsensor", "neq", "ntendon", "nkey", "ncam", "nhfield", "ntex")
    assert [getattr(scene.model, name) for name in sizes] == [getattr(alone.model, name) for name in sizes]
    assert scene.model.opt.density == 0
    np.testing.assert_array_equal(scene.model.actuator_forcerange, alone.model.actuator_forcerange)


def test_an_included_file_and_a_mesh_beside_it_are_taken(tmp_path: Path):
    (tmp_path / "parts").mkdir()
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)]
    faces = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    write(tmp_path / "parts", "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + faces, "wedge.obj")
    text = mjcf(ROBOT).replace('<geom name="trunk"', '<geom type="mesh" mesh="wedge" mass="0"/><geom name="trunk"')
    body = text[text.index("<worldbody>") : text.index("</worldbody>") + len("</worldbody>")]
    write(tmp_path, f"<mujoco>{body}</mujoco>", "body.xml")
    asset = '<compiler angle="radian" meshdir="parts"/><asset><mesh file="wedge.obj"/></asset>'
    path = write(tmp_path, text.replace(body, f'{asset}<include file="body.xml"/>'))
    quadruped = load_user_model(path, flat())
    assert quadruped.model.nmesh == 1
    before = model_files.content_digest(path)
    assert model_files.content_digest(path) == before
    wedge = tmp_path / "parts" / "wedge.obj"
    wedge.write_text(wedge.read_text().replace("0.1 0 0", "0.1000001 0 0"))
    assert model_files.content_digest(path) != before
    assert quadruped.robot.mass_kg == pytest.approx(ROBOT.mass_kg)


def test_the_size_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = write(tmp_path, mjcf(ROBOT))
    monkeypatch.setattr(model_files, "MOST_XML_BYTES", 1000)
    with pytest.raises(TooLarge):
        model_files.read_model(path)
