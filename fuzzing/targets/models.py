"""Robots as MJCF or URDF, from anywhere."""

from __future__ import annotations

from pathlib import Path


def models(folder: Path, data: bytes) -> None:
    """As far as standing on the ground."""
    from quadlog.simulation.robot.height_field import flat
    from quadlog.simulation.robot.user_model import load_user_model

    path = folder / "robot.xml"
    path.write_bytes(data)
    load_user_model(path, flat())


def model_seeds() -> list[bytes]:
    """The own robot of quadlog, and the least of one as URDF."""
    from quadlog.control.locomotion.robot import ROBOTS
    from quadlog.simulation.robot.model import mjcf

    parts = [_link("base", _inertial(9.0, 0.5))]
    for leg, x_m, y_m in (("FL", 0.2, 0.1), ("FR", 0.2, -0.1), ("RL", -0.2, 0.1), ("RR", -0.2, -0.1)):
        parent, place = "base", f"{x_m} {y_m} 0"
        for part, axis in (("hip", "1 0 0"), ("thigh", "0 1 0"), ("calf", "0 1 0")):
            child = f"{leg}_{part}"
            limit = '<limit effort="30" velocity="20" lower="-3" upper="3"/>'
            parts.append(_link(child, _inertial(1.0, 0.01)))
            parts.append(_joint("revolute", parent, child, place, f'<axis xyz="{axis}"/>{limit}'))
            parent, place = child, f"0 {0.8 * y_m} 0" if part == "hip" else "0 0 -0.2"
        ball = '<collision><geometry><sphere radius="0.02"/></geometry></collision>'
        parts += [_link(f"{leg}_foot", ball), _joint("fixed", parent, f"{leg}_foot", place, "")]
    return [mjcf(ROBOTS["tracking"]).encode(), f'<robot name="a">{"".join(parts)}</robot>'.encode()]


def _inertial(mass_kg: float, inertia_kgm2: float) -> str:
    turning = " ".join(f'{axis}="{inertia_kgm2 if axis[1] == axis[2] else 0}"' for axis in ("ixx", "iyy", "izz", "ixy"))
    return f'<inertial><mass value="{mass_kg}"/><inertia {turning} ixz="0" iyz="0"/></inertial>'


def _link(name: str, inside: str) -> str:
    return f'<link name="{name}">{inside}</link>'


def _joint(kind: str, parent: str, child: str, place: str, inside: str) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{place}"/>'
    return f'<joint name="{child}_joint" type="{kind}">{ends}{inside}</joint>'


MODEL_TOKENS = (
    *b'nan|inf|1e300|-1e300|1e-300|0 0 0|size="|class="|<default>|<frame>|<geom/>|type="mesh"'.split(b"|"),
    *b"<include file=\"robot.xml\"/>|<asset><mesh name='a' vertex='|<joint/>|<freejoint/>|childclass=".split(b"|"),
)
