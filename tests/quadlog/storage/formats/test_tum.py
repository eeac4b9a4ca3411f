from __future__ import annotations

import os
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.errors import UnreadableFile
from quadlog.geometry import yaw_from_quat
from quadlog.storage.formats.tum import read_tum, write_tum

LINE = "1.5 1 2 3 0 0 0 1\n"


@given(
    t_ns=st.lists(st.integers(-(10**18), 2**63 - 1 - 10**18), min_size=1, max_size=20, unique=True),
    x_m=st.floats(-1e6, 1e6),
    yaw_rad=st.floats(-3.14, 3.14),
)
def test_any_trajectory_comes_back_to_the_nanosecond(tmp_path_factory, t_ns, x_m, yaw_rad):
    path = tmp_path_factory.mktemp("run") / "trajectory.tum"
    t_ns = np.array(sorted(t_ns), np.int64)
    same = np.full(len(t_ns), x_m)
    write_tum(path, t_ns, same, -same, np.full(len(t_ns), yaw_rad))
    back = read_tum(path)
    np.testing.assert_array_equal(back.t_ns, t_ns)
    np.testing.assert_array_equal(back.position_m, np.column_stack([same, -same, 0 * same]))
    np.testing.assert_allclose(yaw_from_quat(back.quat_xyzw), yaw_rad, atol=1e-15)


def test_evo_reads_what_we_write(tmp_path: Path) -> None:
    t_ns = 1_700_000_000_123_456_789 + np.arange(40) * 100_000_000
    yaw_rad = np.linspace(0, np.pi / 2, 40)
    write_tum(tmp_path / "trajectory.tum", t_ns, 3 * np.sin(yaw_rad), 3 - 3 * np.cos(yaw_rad), yaw_rad)
    trajectory = file_interface.read_tum_trajectory_file(str(tmp_path / "trajectory.tum"))
    valid, details = trajectory.check()
    assert valid, details
    assert trajectory.num_poses == 40
    assert trajectory.timestamps[0] == pytest.approx(1_700_000_000.123456789, abs=1e-6)
    np.testing.assert_allclose(trajectory.positions_xyz[-1], [3, 3, 0], atol=1e-12)
    turned_rad = Rotation.from_quat(np.roll(trajectory.orientations_quat_wxyz, -1, axis=1)).as_euler("ZYX")[:, 0]
    np.testing.assert_allclose(turned_rad, yaw_rad, atol=1e-12)


def test_we_read_what_evo_writes(tmp_path: Path) -> None:
    quat_wxyz = np.roll(Rotation.random(5, random_state=1).as_quat(), 1, axis=1)
    positions_m = np.random.default_rng(0).normal(size=(5, 3))
    written = PoseTrajectory3D(positions_m, quat_wxyz, np.arange(5) + 1_700_000_000.25)
    file_interface.write_tum_trajectory_file(str(tmp_path / "evo.tum"), written)
    back = read_tum(tmp_path / "evo.tum")
    np.testing.assert_array_equal(back.t_ns, np.arange(5) * 10**9 + 1_700_000_000_250_000_000)
    np.testing.assert_allclose(back.position_m, positions_m)
    np.testing.assert_allclose(back.quat_xyzw, np.roll(quat_wxyz, -1, axis=1))


@pytest.mark.parametrize(
    "bad",
    [
        *("1 2 3", "2 1 2 3 0 0 0 1 9", "x 1 2 3 0 0 0 1", "2 1 2 3 0 0 0 0", "2 nan 2 3 0 0 0 1"),
        *("nan 1 2 3 0 0 0 1", "1e999999999 1 2 3 0 0 0 1", "2 1 2 3 0 0 0 inf", "2;1;2;3;0;0;0;1", "\x00"),
        *("1760000000000000000 1 2 3 0 0 0 1", "2,1,2,3,0,0,0,1,0,0,0", "12000000000 1 2 3 0 0 0 1"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, bad: str) -> None:
    (tmp_path / "t").write_text("# comment\n" + LINE + bad + "\n")
    with pytest.raises(UnreadableFile, match=r"t, line 3: is not 't x y z") as caught:
        read_tum(tmp_path / "t")
    assert ", line 3: " in str(caught.value)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ((LINE + LINE.replace("3", "4")).encode(), "line 2: time does not increase"),
        (b"1.76e18 1 2 3 0 0 0 1\n1.5 1 2 3 0 0 0 1\n", "line 2: time does not increase"),
        (LINE.encode() + b"2 0 -1e300 0 0 0 0 1\n", "line 2: has a position beyond 1e\\+08 m"),
        (bytes(range(256)) * 100, "line"),
        (b"1" * 5000, "line 1: is longer than any pose"),
        (b"# nothing\n", "holds no pose"),
        (None, "No such file"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes | None, reason: str) -> None:
    if content is not None:
        (tmp_path / "t").write_bytes(content)
    with pytest.raises(UnreadableFile, match=reason):
        read_tum(tmp_path / "t")


NS = 1_760_000_000_123_456_789
EUROC = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"


@pytest.mark.parametrize(
    ("content", "first_ns", "told"),
    [
        (LINE, 1_500_000_000, []),
        ("1.5, 1, 2, 3, 0, 0, 0, 1\n", 1_500_000_000, []),
        (EUROC + f"{NS},1,2,3,1,0,0,0\n", NS, ["read as ns"]),
        ("# timestamp tx ty tz qx qy qz qw\n" + LINE, 1_500_000_000, []),
        (f"{NS} 1 2 3 0 0 0 1\n", NS, ["read as ns"]),
        (f"{NS // 1000} 1 2 3 0 0 0 1\n", NS // 1000 * 1000, ["read as us"]),
        (f"{NS // 10**6}.5 1 2 3 0 0 0 1\n", NS // 10**6 * 10**6 + 500_000, ["read as ms"]),
        (3 * LINE, 1_500_000_000, ["2 of 3 lines equal the one before"]),
    ],
)
def test_what_is_not_quite_tum_is_read_and_told(tmp_path: Path, content: str, first_ns: int, told: list[str]) -> None:
    (tmp_path / "t").write_text(content)
    warnings: list[str] = []
    poses = read_tum(tmp_path / "t", warnings)
    assert poses.t_ns.tolist() == [first_ns]
    np.testing.assert_array_equal(poses.position_m, [[1, 2, 3]])
    np.testing.assert_array_equal(poses.quat_xyzw, [[0, 0, 0, 1]])
    assert [words for text, words in zip(warnings, told, strict=True) if words not in text] == []


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    written = "0 0 0 0 0 0 0 1\n"
    Thread(target=(tmp_path / "pipe").write_text, args=(written,), daemon=True).start()  # or reading it never ended
    with pytest.raises(UnreadableFile, match="is no regular file"):
        read_tum(tmp_path / "pipe")
