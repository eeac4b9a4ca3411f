"""Logs that tell the robot's position by its legs or its lidar, and logs that lack what was chosen."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.geometry import seconds_since, wrap_angle
from quadlog.messages import Odometry, UwbRanges
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.request import ReplayOptions
from quadlog.pipelines.simulation.synthesize import recording_config
from quadlog.pipelines.survey import survey_recording
from quadlog.positioning.lidar_odometry import LidarOdometry
from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import (
    IMU_TOPIC,
    JOINT_TOPIC,
    LIDAR_TOPIC,
    ODOMETRY_TOPIC,
    ROBOT_TAG,
    ROBOT_TRUTH_TOPIC,
    START_NS,
    TF_STATIC_TOPIC,
    UWB_TOPIC,
    SynthesizedMessage,
)
from quadlog.simulation.synthetic.writer import write_recording

JOINTS, SCANS = {JOINT_TOPIC, IMU_TOPIC}, {TF_STATIC_TOPIC, LIDAR_TOPIC, IMU_TOPIC}
MODEL, LIDAR = "robot.model=tracking", "topics.position=lidar"
Messages = Iterable[SynthesizedMessage]


def silent(first_s: float, last_s: float) -> Callable[[Messages], Messages]:
    """Without joints between these seconds."""
    return lambda messages: (
        each
        for each in messages
        if not (each.topic == JOINT_TOPIC and first_s < (each.log_time_ns - START_NS) * 1e-9 < last_s)
    )


def seldom(messages: Messages) -> Messages:
    return [each for each in messages if each.topic == JOINT_TOPIC][::100]


def at_50_hz(messages: Messages) -> Messages:
    kept = itertools.cycle([True] + 9 * [False])
    return (each for each in messages if each.topic != JOINT_TOPIC or next(kept))


def in_bursts(messages: Messages) -> Messages:
    """Joints wait in a relay that hands them on, and stamps them, every .25 s."""
    for each in messages:
        if each.topic == JOINT_TOPIC:
            t_ns = -(-each.log_time_ns // 250_000_000) * 250_000_000 + (each.log_time_ns - START_NS) // 10_000
            each = each._replace(log_time_ns=t_ns, message=replace(each.message, stamp_ns=t_ns))
        yield each


def of_the_person(messages: Messages) -> Messages:
    return (each for each in messages if not (isinstance(each.message, UwbRanges) and each.message.tag == ROBOT_TAG))


def said(place: Callable[[float, np.ndarray], np.ndarray]) -> Callable[[Messages], Messages]:
    """Odometry that says it is elsewhere, at place(s, position)."""

    def change(messages: Messages) -> Messages:
        for each in messages:
            if not isinstance(each.message, Odometry):
                yield each
                continue
            at_m = place((each.log_time_ns - START_NS) * 1e-9, each.message.position_m)
            yield each._replace(message=replace(each.message, position_m=at_m))

    return change


def other_robot(s: float, place_m: np.ndarray) -> np.ndarray:
    """Every other message, at 50 Hz, is by one that stands 4 m away."""
    return place_m if round(50 * s) % 2 else np.array([0.0, 4.0, 0.0])


def spread(s: float, place_m: np.ndarray) -> np.ndarray:
    """Noise of 10 cm: of two readings 20 ms apart, every tenth pair would be faster than 15 m/s."""
    return place_m + np.random.default_rng(round(1000 * s)).normal(0, 0.1, 3)


class Case(NamedTuple):
    """Topics of a walk, and what comes of them: source and the poses' worst error in the frame of the first one.

    body: of a walk with legs; site: with its anchors configured; says: in notes, warnings or stderr.
    """

    topics: set[str]
    settings: Sequence[str] = ()
    source: str = "legs"
    says: Sequence[str] = ()
    never: Sequence[str] = ()
    worst_m: float = np.inf
    code: int = 0
    site: bool = False
    until: str = "position"
    target: str = "ahead"
    other: str = ""
    change: Callable[[Messages], Messages] = iter
    body: bool = True


CASES = {
    "joints and IMU": Case(
        JOINTS, until="report", worst_m=0.12,  # of 8 m; the IMU's yaw is known to 0.1 degrees, and drifts by 0.3
        says=("stopped after position", "leg lengths of 'tracking' are assumed"),
    ),
    "joints and lidar": Case(
        JOINTS | SCANS, [MODEL], until="map", worst_m=0.12, never=("are assumed", "move against the ground")
    ),
    "joints before odometry and ranges, chosen": Case(
        JOINTS | {ODOMETRY_TOPIC, UWB_TOPIC, ROBOT_TRUTH_TOPIC}, ["topics.position=legs"], site=True, worst_m=0.12
    ),
    "a person in the frame of the anchors is no target": Case(
        JOINTS | {UWB_TOPIC, ROBOT_TRUTH_TOPIC}, site=True, change=of_the_person
    ),
    "legs in another order": Case(
        JOINTS, ["robot.model=b1", f"robot.joints={[str((6 + each) % 12) for each in range(12)]}"],
        says=("feet that carry move against the ground", "hips are those of 'b1'"),
    ),
    "joints beside ranges": Case(
        JOINTS | {UWB_TOPIC, ROBOT_TRUTH_TOPIC}, source="uwb", site=True, target="uwb",
        says=("velocities by legs steady its track",),
    ),
    "a gap, no IMU": Case(
        {JOINT_TOPIC}, [MODEL], change=silent(4.0, 4.5), never=("no foot stands",),
        says=("silent for up to 0.5 s, 1 silence above 0.1 s, 0.5 s in all", "some 0.3", "there is no IMU"),
    ),
    "a short gap": Case(JOINTS, [MODEL], change=silent(4.0, 4.2), says=("in longer ones some 0.00 m",), worst_m=0.15),
    "joints stamped in bursts": Case(
        JOINTS, [MODEL], change=in_bursts, says=("joints come in bursts (99%", "--stamp header"), worst_m=0.12,
        never=("move against the ground", "no stride frequency"), until="report",
    ),
    "joints at 50 Hz": Case(
        JOINTS, [MODEL], change=at_50_hz, says=("joints come 22 times a stride, at 50 Hz",), worst_m=0.12,
        never=("move against the ground",),
    ),
    "joints too seldom": Case(
        {JOINT_TOPIC}, [MODEL], "fixed", ("joints come every 0.2 s, too seldom",), code=3, target="", change=seldom
    ),
    "faster than a robot": Case(
        {ODOMETRY_TOPIC}, source="odometry", code=3, body=False, change=said(lambda s, place_m: 30 * place_m),
        says=("positions move faster than 8 m/s for ", "if the robot is that fast:  --set robot.max_speed_mps="),
    ),
    "as fast as the robot": Case(
        {ODOMETRY_TOPIC}, ["robot.max_speed_mps=80"], "odometry", never=("positions move faster",), body=False,
        change=said(lambda s, place_m: 30 * place_m),
    ),
    "two senders": Case(
        {ODOMETRY_TOPIC}, source="odometry", code=3, body=False, change=said(other_robot), says=("positions jump 2",)
    ),
    "reset once": Case(
        {ODOMETRY_TOPIC}, source="odometry", says=("positions jump 1 time", "where odometry is reset"), body=False,
        change=said(lambda s, place_m: place_m + 5.0 * (s > 2)),
    ),
    "noise": Case({ODOMETRY_TOPIC}, source="odometry", never=("jump", "faster"), body=False, change=said(spread)),
    "odometry of another walk beside ranges": Case(
        {ODOMETRY_TOPIC, UWB_TOPIC, ROBOT_TRUTH_TOPIC}, ["uwb.odometry=false"], "uwb", site=True, code=3, target="uwb",
        change=said(lambda s, place_m: 0.2 * place_m), body=False,
        says=("contradict odometry for 100% of the walk: in 4 s they lead ", "--set 'topics.position=\"odometry\"'"),
    ),
    "odometry that slips beside ranges": Case(
        {ODOMETRY_TOPIC, UWB_TOPIC, ROBOT_TRUTH_TOPIC}, source="uwb", site=True, target="uwb", never=("contradict",),
        change=said(lambda s, place_m: 1.15 * place_m), body=False,
    ),
    "lidar, chosen": Case(SCANS | {ODOMETRY_TOPIC}, [LIDAR], "lidar", until="map", worst_m=0.1, body=False),
    "lidar beside ranges": Case(
        SCANS | {UWB_TOPIC, ROBOT_TRUTH_TOPIC}, ["lidar.odometry=true"], "uwb", ("velocities by lidar steady",),
        site=True, target="uwb", other="lidar", body=False,
    ),
    "lidar before ranges, chosen": Case(
        SCANS | {UWB_TOPIC, ROBOT_TRUTH_TOPIC}, [LIDAR], "lidar", site=True, worst_m=0.1, other="uwb", body=False
    ),
    "no lidar, chosen": Case({IMU_TOPIC}, [LIDAR], code=1, says=("topics.position = 'lidar'",), body=False),
    "no lidar": Case(
        {ODOMETRY_TOPIC, UWB_TOPIC, IMU_TOPIC}, source="odometry", until="report", body=False,
        says=("stopped after position: no topic is fit to be the lidar",),
    ),
    "no lidar, but maps wanted": Case(
        {ODOMETRY_TOPIC, IMU_TOPIC}, until="map", code=1, says=("no topic is fit to be the lidar",), body=False
    ),
    "a lidar that sees nothing": Case(
        SCANS - {IMU_TOPIC}, ["lidar.min_range_m=28", "lidar.max_range_m=29"], "fixed",
        ("lidar: 50 of 50 scans have fewer than", "100% of"), code=3, target="", body=False,
    ),
    "a lidar that sees nothing, chosen": Case(
        SCANS - {IMU_TOPIC}, ["lidar.min_range_m=28", "lidar.max_range_m=29", LIDAR], code=1, body=False,
        says=("50 of 50 scans",),
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def walks(walked) -> dict[bool, tuple[Any, list[SynthesizedMessage]]]:
    """A walk with a body and one without, and their messages."""
    made = {True: walked, False: follow.synthesize(31, 5.0, azimuth_steps=300)}
    return {body: (walk, list(walk.messages())) for body, walk in made.items()}


def errors(walk: Any, poses: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """How far off positions (m) and yaw (rad) are, both in the frame of the first pose."""
    motion = walk.site.robot.at(seconds_since(poses["t_ns"], START_NS))
    true_m, true_rad = motion.position_m - motion.position_m[0], motion.yaw_rad - motion.yaw_rad[0]
    cos, sin = np.cos(motion.yaw_rad[0]), np.sin(motion.yaw_rad[0])
    off_m = np.column_stack([poses["x_m"], poses["y_m"]]) - true_m @ [[cos, -sin], [sin, cos]]
    return np.hypot(*off_m.T), np.abs(wrap_angle(poses["yaw_rad"] - true_rad))


@pytest.mark.parametrize("name", CASES)
def test_where_the_robot_was_is_taken_from_what_is_there(name, tmp_path, walks, replayed):
    case = CASES[name]
    walk, messages = walks[case.body]
    heard = (each for each in messages if each.topic in case.topics)
    write_recording(tmp_path / "walk.mcap", case.change(heard))
    flags = [word for each in case.settings for word in ("--set", each)]
    config = recording_config(walk) if case.site else ""
    done = replayed(tmp_path / "walk.mcap", "--until", case.until, *flags, config=config)
    assert done.code == case.code, done.err
    said = done.err if done.code == 1 else done.err + done.said
    assert all(words in said for words in case.says), said
    assert not any(words in said for words in case.never), said
    if done.code == 1:
        return
    assert done.sources() == {case.source}
    assert done.sources("target") == {case.target} if case.target else not (done.run / "target.parquet").exists()
    assert (done.run / "maps.npz").exists() == (case.until == "map")
    off_m, off_rad = errors(walk, done.table("poses"))
    assert off_m.max() < case.worst_m
    if case.source == "lidar":
        assert (off_rad.max() < 0.03, len(off_m)) == (True, 50)
    if case.other:
        assert done.sources("other_poses") == {case.other}
        assert done.metrics["lidar_uwb_rmse_m"]["value"] < 0.15


def test_two_days_between_two_halves_of_a_log_is_no_part_of_the_walk(tmp_path, walks, replayed):
    """Two logs in one file: their walks are those of each, and nothing is walked or measured between them."""
    heard = [each for each in walks[False][1] if each.topic in {TF_STATIC_TOPIC, ODOMETRY_TOPIC}]
    heard += [each for each in walks[False][1] if each.topic == LIDAR_TOPIC][::4]
    half_ns, gap_ns = START_NS + 2_550_000_000, 172_800_000_000_000
    late = [each._replace(log_time_ns=each.log_time_ns + gap_ns * (each.log_time_ns > half_ns)) for each in heard]
    write_recording(tmp_path / "walk.mcap", sorted(late, key=lambda each: each.log_time_ns))
    flags = ("--until", "control", "--controller", "kinematic", "--stamp", "log")
    parts = replayed(tmp_path / "walk.mcap", *flags)
    assert parts.code == 3
    steps_ns, scans = np.diff(parts.table("control")["t_ns"]), parts.table("scans")["t_ns"]
    assert np.count_nonzero(steps_ns > 20_000_000) == 1
    logged_s = (np.ptp(scans) - np.diff(scans).max()) * 1e-9
    assert parts.metrics["eta_m"]["n"] == pytest.approx(50 * logged_s + 2, abs=2)
    assert parts.record["counts"]["paused_ms"] > 172_000_000
    start = {name: parts.table("control")[name][np.argmax(steps_ns) + 1] for name in ("t_ns", "x_m", "y_m")}
    poses = parts.table("poses")
    for name in ("x_m", "y_m"):
        assert start[name] == pytest.approx(np.interp(start["t_ns"], poses["t_ns"], poses[name]), abs=0.02)
    # What is ahead of the robot before the gap is where it stopped.
    target, last = parts.table("target"), np.argmax(np.diff(parts.table("target")["t_ns"]))
    assert (target["x_m"][last], target["y_m"][last]) == (poses["x_m"][last], poses["y_m"][last])


def test_a_scan_that_was_lost_is_in_no_map(tmp_path, walks, replayed, monkeypatch):
    take = LidarOdometry.take

    def blind(self: LidarOdometry, t_ns: int, xyz_m: np.ndarray, offset_ns: np.ndarray | None) -> None:
        """Six of fifty scans, one at a time, have nothing to match."""
        take(self, t_ns, xyz_m[: 5 if len(self) % 8 == 7 else None], offset_ns)

    monkeypatch.setattr(LidarOdometry, "take", blind)
    write_recording(tmp_path / "walk.mcap", (m for m in walks[False][1] if m.topic in SCANS))
    done = replayed(tmp_path / "walk.mcap", "--until", "map", "--set", "lidar.deskew=false")
    assert (done.code, done.record["counts"]["scans_without_pose"]) == (3, 6)
    assert len(done.table("poses")["t_ns"]) == 44


@pytest.mark.parametrize(("name", "poses", "within_m"), [("lidarme", 156, 0.1), ("anlam_hallway", 160, 6.0)])
def test_real_planar_scans_are_matched_without_a_loss(replayed, name, poses, within_m):
    """A scanner that stands, and one that is carried along a hallway: along its walls a match must not slide."""
    recording = Path(os.environ.get("QUADLOG_DATASETS", "")) / "other_robots" / f"{name}.bag"
    if not recording.exists():
        pytest.skip(f"{recording} is not there")
    done = replayed(recording, "--until", "position", "--duration", "12")
    found = done.table("poses")
    assert (done.code, len(found["t_ns"])) == (0, poses)
    assert np.hypot(found["x_m"], found["y_m"]).max() < within_m


def test_anchors_are_surveyed_along_the_way_of_the_legs(tmp_path, walks):
    """Twelve seconds show little: the bounds have to say so, and hold."""
    walked, messages = walks[True]
    heard = (each for each in messages if each.topic in JOINTS | {UWB_TOPIC})
    write_recording(tmp_path / "walk.mcap", heard)
    (tmp_path / "c.toml").write_text('[[uwb.tags]]\nid = 0\nrole = "robot"\nx_m = -0.2\ny_m = 0.0\nheight_m = 0.6\n')
    config = load_config(tmp_path / "c.toml", [MODEL])
    found = survey_recording(tmp_path / "walk.mcap", config, ReplayOptions(), {None: 1.2}, Silent())
    assert found.source == "legs"
    start = walked.site.robot.at(np.array([(found.start_ns - START_NS) * 1e-9]))
    off = (walked.site.anchors_m[:, :2] - start.position_m[0]) @ [1, 1j] * np.exp(-1j * start.yaw_rad[0])
    assert [each.why_not for each in found.survey.anchors] == [""] * 4
    error_m = [each.position_m[:2] - [off[each.index].real, off[each.index].imag] for each in found.survey.anchors]
    assert (np.abs(error_m) <= [each.bound_m[:2] for each in found.survey.anchors]).all()
    assert np.hypot(*np.transpose(error_m)).max() <= 1.1
