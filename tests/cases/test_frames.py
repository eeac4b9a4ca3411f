"""Frames, mounts and clocks of logs that nobody here has seen: what info foretells, what a replay of a part does."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.cli.main import run as run_cli
from quadlog.config.schema import Config
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.request import ReplayOptions
from quadlog.pipelines.stages.log import open_log, read_log
from tests.lab.messages import At
from tests.lab.strangers import LEGS, ROS, Log, Room, add_scans, instants_s, ns


def way(log: Log, parent: str = "odom", child: str = "base_footprint") -> None:
    for t_s in instants_s(8.0, 20):
        log.tf(ns(t_s), parent, child, Room(6.0).at(t_s))


def test_info_ends_with_chains_of_frames_and_how_far_a_replay_will_go(tmp_path, capsys):
    log = Log()
    way(log)
    log.tf(ns(0.0), "base_footprint", "base_link", (0.0, 0.0, 0.0), 0.1, "/tf_static")
    for t_s in instants_s(8.0, 5):
        log.tf(ns(t_s), "base_link", "laser", (0.0, 0.0, np.pi), 0.1)
        log.tf(ns(t_s), "world", "drone", (t_s, 0.0, 0.0))
    add_scans(log, Room(6.0), 1.0)
    assert run_cli(["info", str(log.write(tmp_path / "log"))]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "tf: odom → base_footprint (160)" in lines
    assert "tf: world → drone (40)" in lines
    assert not any("laser (" in line for line in lines)
    expected = "a replay will go to: control; position: tf odom → base_footprint; target: ahead; missing: nothing"
    assert lines[-1] == expected


Add = Callable[[Log, float], object]
"""Adds what a kind of sensor sends at an instant."""


def scanners(log: Log, t_s: float) -> None:
    for name in ("front", "rear"):
        log.scan(
            ns(t_s), Room(6.0).ranges_m(t_s, 90, (0, 0, 0), 2 * np.pi), 2 * np.pi, f"/{name}/scan", f"{name}_laser"
        )


def odometry(topic: str = "/odom") -> Add:
    return lambda log, t_s: log.odometry(ns(t_s), Room(6.0).at(t_s), topic)


def pose(topic: str) -> Add:
    return lambda log, t_s: log.pose(ns(t_s), Room(6.0).at(t_s), topic)


def ranges(topic: str) -> Add:
    return lambda log, t_s: log.range(ns(t_s), topic, 2.0)


def joints(*names: str) -> Add:
    return lambda log, t_s: log.joints(ns(t_s), list(names))


def imu_of_another_clock(log: Log, t_s: float) -> None:
    log.imu(ns(t_s), 9.81)
    log.messages[-1][2].header.stamp.sec -= 86400


class Foretold(NamedTuple):
    """What two seconds of a log have, what is missing, and what gives the position if there is something to replay."""

    kinds: tuple[Add, ...]
    missing: str
    position: str = "nothing"
    config: str = ""


FORETOLD = {
    "two-lidars": Foretold((scanners,), "choose with  --set topics.lidar=/front/scan  or  --set topics.lidar=/rear"),
    "two-lidars-and-odometry": Foretold((scanners, odometry()), "--set topics.lidar=/front/scan", "odometry"),
    "two-odometries": Foretold((odometry("/a"), odometry("/b")), "--set topics.odometry=/b"),
    "wheels": Foretold((joints("left", "right"),), "/joint_states names no joint of four legs, but left"),
    "a-message-a-leg": Foretold((joints(*LEGS[:3]), joints(*LEGS[3:6])), "no joint of four legs, but FL_hip"),
    "ranges-without-ends": Foretold(
        (ranges("/range_a"), ranges("/range_b")),
        "/range_b is a Range without tag and anchor; if it is UWB, map it in [[uwb.range_topics]]",
    ),
    "ranges-without-anchors": Foretold(
        (ranges("/uwb/tag0/anchor1"), pose("/vicon/robot")),
        "--set topics.position=/vicon/robot; UWB ranges need [[uwb.anchors]], see  quadlog survey",
        "fixed",
    ),
    "two-poses": Foretold(
        (pose("/a"), pose("/b")), "what could give it:  --set topics.position=/a  or  --set topics.position=/b", "fixed"
    ),
    "another-payload": Foretold((odometry(),), "/odom cannot be decoded: not a nav_msgs/msg/Odometry"),
    "another-payload-beside-joints": Foretold(
        (odometry(), joints(*LEGS)), "not a nav_msgs/msg/Odometry: not a plain CDR", "legs"
    ),
    "two-clocks": Foretold((odometry(), imu_of_another_clock), "cannot be compared; use  --stamp log"),
    "a-source-that-is-not-there": Foretold(
        (odometry(),),
        "topics.position = 'tf', but no moving transforms lead from 'map' to the robot's frame; what could give it",
        config='[topics]\nposition = "tf"',
    ),
    "no-topics": Foretold((), "no message of a type that quadlog uses"),
}


@pytest.mark.parametrize("name", FORETOLD)
def test_info_foretells_what_a_replay_does_and_says(name, tmp_path, described, replayed):
    case, log = FORETOLD[name], Log()
    for t_s in instants_s(2.0, 20):
        for add in case.kinds:
            add(log, t_s)
    path = log.write(tmp_path / "log.db3")
    if name.startswith("another-payload"):
        with contextlib.closing(sqlite3.connect(path)) as store, store:
            odometry_alone = "topic_id = (SELECT id FROM topics WHERE name = '/odom')"
            store.execute(f"UPDATE messages SET data = CAST(x'0007' || substr(data, 3) AS BLOB) WHERE {odometry_alone}")
    outlook, done = described(path, case.config)["replay"], replayed(path, config=case.config)
    assert case.missing in "; ".join(outlook["missing"])
    assert case.missing in done.err
    if case.position == "nothing":
        assert (outlook["until"], done.code) == ("nothing", 1)
    else:
        found = outlook["until"], outlook["position"], done.sources()
        assert found == ("position", case.position, {case.position})


@pytest.mark.parametrize("kind", ["tf", "joints"])
def test_transforms_and_joints_alone_have_a_length_and_parts(kind, tmp_path, replayed):
    log = Log()
    for t_s in instants_s(8.0, 20):
        joints(*LEGS)(log, t_s) if kind == "joints" else log.tf(ns(t_s), "odom", "base_footprint", Room(6.0).at(t_s))
    done = replayed(log.write(tmp_path / "log"), "--start", "2", "--duration", "3")
    assert (done.code, done.record["recorded_s"]) == (0, pytest.approx(2.95))
    t_ns = done.table("poses" if kind == "tf" else "joints")["t_ns"]
    assert (t_ns[0], t_ns[-1]) == (ns(2.0), ns(4.95))


def test_a_reference_without_stamps_does_not_stop_a_replay(tmp_path, replayed):
    """Beside odometry on a clock that is a year behind."""
    log = Log()
    for t_s in instants_s(8.0, 20):
        odometry()(log, t_s)
        log.messages[-1][2].header.stamp.sec -= 365 * 86400
        pose("/mocap/pose")(log, t_s)
        log.messages[-1][2].header.stamp = ROS.stamp(0)
    done = replayed(log.write(tmp_path / "log"), "--start", "1", "--until", "position")
    assert (done.code, done.sources()) == (0, {"odometry"})
    assert "no reference is used: /mocap/pose" in done.err


def test_a_run_that_was_not_asked_for_positions_does_not_blame_the_log(tmp_path, replayed):
    log = Log()
    way(log)
    page = (replayed(log.write(tmp_path / "log"), "--until", "ingest").run / "report.html").read_text()
    assert "Positions were not computed" in page
    assert "does not tell where the robot was" not in page


LIDAR: At = (0.3, 0.1, np.pi / 2)
CAMERA: At = (0.05, -0.1, -2.0)
WALK_S = 4.0


def beyond(at: At, mount: At) -> At:
    """x_m, y_m, yaw_rad of what is mounted on a body."""
    cos, sin = np.cos(at[2]), np.sin(at[2])
    return at[0] + cos * mount[0] - sin * mount[1], at[1] + sin * mount[0] + cos * mount[1], at[2] + mount[2]


def driven(log: Log, child: str = "base_link", mount: At = (0.0, 0.0, 0.0)) -> None:
    for t_s in instants_s(WALK_S, 20):
        log.odometry(ns(t_s), beyond(Room(6.0).at(t_s), mount), child=child)


def mounted(log: Log, topic: str = "/tf_static", prefix: str = "") -> None:
    """A lidar, and a camera on it."""
    log.tf(ns(0.0), f"{prefix}base_link", f"{prefix}lidar", LIDAR, 0.2, topic)
    log.tf(ns(0.0), f"{prefix}lidar", f"{prefix}camera", CAMERA, 0.1, topic)


def true_poses(log: Log, kind: str, frame: str = "odom") -> None:
    """Of motion capture that follows the camera."""
    for t_s in instants_s(WALK_S, 20):
        at = beyond(beyond(Room(6.0).at(t_s), LIDAR), CAMERA)
        if kind == "Odometry":
            log.odometry(ns(t_s), at, "/mocap/camera", frame=frame, child="camera")
        else:
            log.tf(ns(t_s), frame, "camera", at, 0.3, "/mocap/camera")
            *rest, content = log.messages[-1]
            log.messages[-1] = (*rest, content.transforms[0])


def sent(
    log: Log, topic: str = "/tf", rate_hz: float = 20, shift: At | None = None, late_s: float = 0.0, prefix: str = ""
) -> None:
    """tf of the robot, or of one that drives elsewhere."""
    for t_s in instants_s(WALK_S, rate_hz):
        at = Room(6.0).at(t_s + late_s)
        elsewhere = at if shift is None else beyond(shift, at)
        log.tf(ns(t_s + late_s), f"{prefix}odom", f"{prefix}base_link", elsewhere, 0.0, topic)


class FrameCase(NamedTuple):
    """A log, and what must be said; poses must be right to 1 mm and 0.1 degrees, and so must a reference."""

    make: tuple[Callable[[Log], None], ...]
    says: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    source: str = "odometry"
    scan: tuple[str, str] = ("/scan", "lidar")
    never: tuple[str, ...] = ("its poses are of", "robots", "two nodes")


def row(function: Callable[..., None], *arguments: Any, **named: Any) -> Callable[[Log], None]:
    return lambda log: function(log, *arguments, **named)


FAR: At = (5.0, 2.0, 2.0)
MOUNT = ("lidar.mount.x_m=0.3", "lidar.mount.y_m=0.1", "lidar.mount.yaw_deg=90")
OF_LIDAR, OF_CAMERA = row(driven, "lidar", LIDAR), row(driven, "camera", beyond(LIDAR, CAMERA))
FRAMES = {
    "odometry of the lidar": FrameCase((mounted, OF_LIDAR)),
    "odometry of the end of a chain": FrameCase((mounted, OF_CAMERA)),
    "odometry of the lidar, whose mount is configured": FrameCase((OF_LIDAR,), flags=MOUNT),
    "odometry of what is fixed to a lidar whose mount is configured": FrameCase(
        (lambda log: log.tf(ns(0.0), "lidar", "camera", CAMERA, 0.1, "/tf_static"), OF_CAMERA), flags=MOUNT
    ),
    "odometry of a frame without a place": FrameCase(
        (mounted, row(driven, "foo")), ("/odom: its poses are of foo", "--set 'topics.base_frame=\"foo\"'"), never=()
    ),
    "odometry of the frame that is named": FrameCase((mounted, row(driven, "foo")), flags=("topics.base_frame=foo",)),
    "odometry of base, whose name the clouds bear": FrameCase((driven,), flags=MOUNT, scan=("/scan", "base_link")),
    "odometry of a usual name that tf does not have": FrameCase((mounted, row(driven, "base_footprint"))),
    "odometry of the root, which has no usual name": FrameCase(
        (lambda log: log.tf(ns(0.0), "vehicle", "lidar", LIDAR, 0.2, "/tf_static"), row(driven, "vehicle"))
    ),
    "a true odometry of the camera": FrameCase((mounted, driven, row(true_poses, "Odometry"))),
    "true transforms of the camera": FrameCase((mounted, driven, row(true_poses, "TransformStamped"))),
    "a tf for each robot": FrameCase(
        (mounted, row(sent, "/dog1/tf", shift=FAR), row(sent, "/dog2/tf", late_s=0.007)),
        ("the one of /dog2/tf is taken", "--set 'topics.tf=[\"/tf_static\", \"/dog1/tf\"]'"),
        source="tf", scan=("/dog2/scan", "lidar"), never=("its mount", "jump"),
    ),
    "a tf for each robot, one of which is named": FrameCase(
        (mounted, row(sent, "/dog1/tf", shift=FAR), row(sent, "/dog2/tf")),
        flags=('topics.tf=["/dog2/tf", "/tf_static"]',), source="tf",
    ),
    "a tf that is repeated in a namespace": FrameCase((mounted, sent, row(sent, "/dog/tf", 10)), source="tf"),
    "robots of which the second is seen": FrameCase(
        (row(mounted, prefix="dog2/"), row(sent, shift=FAR, prefix="dog1/"), row(sent, prefix="dog2/")),
        ("tf moves 2 robots: the one of dog2/base_link is taken", "'topics.base_frame=\"dog1/base_link\"'"),
        source="tf", scan=("/scan", "dog2/lidar"), never=("lidar.mount",),
    ),
    "two senders of one transform": FrameCase(
        (mounted, row(sent, rate_hz=50), row(sent, rate_hz=30, shift=(0.15, 0.1, 0.05), late_s=0.003)),
        ("two nodes send odom to base_link in turns, 0.1", "200 poses of one", "--set 'topics.position=\"lidar\"'"),
        source="tf", never=("jump",),
    ),
    "two robots on one topic, and the odometry of one": FrameCase(
        (mounted, sent, row(sent, rate_hz=50, shift=FAR, late_s=0.003), driven),
        ("two nodes send odom to base_link", "80 poses of one", "--set topics.position=/odom"),
        source="tf", never=("jump",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FRAMES)
def test_poses_are_those_of_the_robot_whatever_frame_and_tf_give_them(name, tmp_path, replayed):
    case, log = FRAMES[name], Log()
    for make in case.make:
        make(log)
    add_scans(log, Room(6.0), 0.5, 120, LIDAR, topic=case.scan[0], frame=case.scan[1])
    flags = [word for flag in case.flags for word in ("--set", flag)]
    run = replayed(log.write(tmp_path / "log"), "--until", "position", *flags)
    assert run.code == 0
    for words in case.says:
        assert sum(words in text for text in run.warned) == 1, run.warned
    assert not [text for text in run.warned if any(words in text for words in case.never)]
    poses = run.table("poses")
    assert set(poses["source"]) == {case.source}
    expected = np.array([Room(6.0).at(t_ns * 1e-9) for t_ns in (poses["t_ns"] - ns(0.0)).tolist()])
    np.testing.assert_allclose(np.column_stack([poses["x_m"], poses["y_m"]]), expected[:, :2], atol=1e-3)
    apart_rad = (poses["yaw_rad"] - expected[:, 2] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(apart_rad, 0.0, atol=2e-3)
    if "true" in name:
        assert run.metrics["ate_rmse_m"]["value"] < 1e-3


def test_the_twist_of_a_sensors_odometry_is_turned_into_that_of_base(tmp_path: Path) -> None:
    """A robot that drives forward at 0.5 m/s and turns at 0.8 rad/s, by an odometry of its lidar, which is tilted."""
    log, turned = Log(), Rotation.from_euler("ZYX", [1.0, 0.4, 0.2])
    log.tf(ns(0.0), "base_link", "lidar", LIDAR, 0.2, "/tf_static")
    log.messages[0][2].transforms[0].transform.rotation = ROS.vector(*turned.as_quat(), name="Quaternion")
    of_base = np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.8]])
    of_lidar = turned.inv().apply([of_base[0] + np.cross(of_base[1], [*LIDAR[:2], 0.2]), of_base[1]])
    for t_s in instants_s(1.0, 20):
        log.odometry(ns(t_s), (0.5 * t_s, 0.0, 0.0), child="lidar", twist=tuple(of_lidar.ravel().tolist()))
    with open_log(log.write(tmp_path / "log"), Config(), ReplayOptions()) as opened:
        streams = read_log(opened, Silent()).streams
    assert streams.odometry_linear_mps is not None
    assert streams.odometry_angular_radps is not None
    np.testing.assert_allclose(streams.odometry_linear_mps, np.tile(of_base[0], (20, 1)), atol=1e-9)
    np.testing.assert_allclose(streams.odometry_angular_radps, np.tile(of_base[1], (20, 1)), atol=1e-9)
