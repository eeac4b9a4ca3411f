"""UWB that is not as it should be, from the file to the exit code: no traceback, and a line that names the cause."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from quadlog.cli.main import run as run_cli
from quadlog.messages import UwbRanges
from quadlog.simulation.synthetic.recording import SynthesizedMessage
from quadlog.simulation.synthetic.writer import McapRecording, write_recording

START_NS = 1_700_000_000 * 10**9
HOUR_NS = 3600 * 10**9
SQUARE_M = np.array([(0.0, 0.0, 1.2), (8.0, 0.0, 1.2), (8.0, 7.0, 1.2), (0.0, 7.0, 1.2)])
RANGE = "sensor_msgs/msg/Range"


def walk(t_ns: np.ndarray) -> np.ndarray:
    phase = 2 * np.pi * (t_ns - START_NS) * 1e-9 / 20
    return np.array([4.0, 3.5]) + np.stack([2.5 * np.sin(phase), 1.8 * np.sin(2 * phase)], axis=1)


def measure(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Five seconds at 20 Hz, t_ns (T,) and range_m (T, 4), of a tag at 0.6 m."""
    t_ns = START_NS + np.arange(100, dtype=np.int64) * 50_000_000
    xyz_m = np.column_stack([walk(t_ns), np.full(len(t_ns), 0.6)])
    noise_m = 0.05 * np.random.default_rng(seed).standard_normal((len(t_ns), 4))
    return t_ns, np.linalg.norm(xyz_m[:, None] - SQUARE_M, axis=2) + noise_m


Frame = tuple[int, int, int, np.ndarray]
"""Log time, header's stamp, tag, and ranges to anchors 0 to 3."""


def frames_of(t_ns: np.ndarray, range_m: np.ndarray, tag: int = 0, stamp_ns: np.ndarray | None = None) -> list[Frame]:
    stamps = t_ns if stamp_ns is None else stamp_ns
    return [(int(t), int(stamp), tag, row) for t, stamp, row in zip(t_ns, stamps, range_m, strict=True)]


def write_frames(path: Path, frames: Iterable[Frame]) -> Path:
    """LinkTrack frames, as `quadlog synthesize` writes them."""
    messages = (
        SynthesizedMessage("/uwb", log_ns, UwbRanges(stamp_ns, tag, np.arange(4), range_m))
        for log_ns, stamp_ns, tag, range_m in sorted(frames, key=lambda frame: frame[0])
    )
    write_recording(McapRecording(path), messages)
    return path


def write_topics(path: Path, rows: Sequence[tuple[str, int, float]]) -> Path:
    """Single ranges: topic, time, metres."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    make: dict[str, Callable[..., Any]] = store.types
    text, _ = store.generate_msgdef(RANGE, ros_version=2)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(RANGE, "ros2msg", text.encode())
        channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in sorted({row[0] for row in rows})}
        for topic, t_ns, range_m in sorted(rows, key=lambda row: row[1]):
            stamp = make["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)
            message = make[RANGE](make["std_msgs/msg/Header"](stamp, ""), 0, 0.0, 0.0, 0.0, range_m)
            writer.add_message(channels[topic], t_ns, bytes(store.serialize_cdr(message, RANGE)), t_ns)
        writer.finish()
    return path


def anchor_table(ids: Sequence[int] = (0, 1, 2, 3), position_m: Any = SQUARE_M) -> str:
    rows = (f"{{id={i}, x_m={x}, y_m={y}, z_m={z}}}" for i, (x, y, z) in zip(ids, position_m, strict=False))
    return f"[uwb]\nanchors = [{', '.join(rows)}]\n"


def poses_error_m(result: Any) -> np.ndarray:
    poses = result.table("poses")
    assert set(poses["source"]) == {"uwb"}
    return np.hypot(*(np.column_stack([poses["x_m"], poses["y_m"]]) - walk(poses["t_ns"])).T)


@pytest.fixture
def replayed(tmp_path: Path, replay_command: Callable[..., Any]) -> Callable[..., Any]:
    """`replay --until position` with a configuration."""

    def go(recording: Path, config: str, *flags: str) -> Any:
        (tmp_path / "quadlog.toml").write_text(config)
        return replay_command(
            recording, "-c", str(tmp_path / "quadlog.toml"), "--until", "position", "--no-plots", *flags
        )

    return go


@pytest.fixture
def told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[dict[str, Any], str]]:
    """`info --json` with a config, and stderr."""

    def go(recording: Path, config: str) -> tuple[dict[str, Any], str]:
        (tmp_path / "quadlog.toml").write_text(config)
        assert run_cli(["info", str(recording), "-c", str(tmp_path / "quadlog.toml"), "--json"]) == 0
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return json.loads(out), err

    return go


def changed(*changes: tuple[Any, Any, float]) -> list[Frame]:
    """The frames with ranges replaced: (rows, anchors, range_m)."""
    t_ns, range_m = measure()
    for rows, anchors, value in changes:
        range_m[rows, anchors] = value
    return frames_of(t_ns, range_m)


def restamped(rows: slice, stamp_ns: Callable[[np.ndarray], Any]) -> list[Frame]:
    """The frames, some of them with other header stamps."""
    t_ns, range_m = measure()
    stamps = t_ns.copy()
    stamps[rows] = stamp_ns(t_ns[rows])
    return frames_of(t_ns, range_m, stamp_ns=stamps)


def round_robin(pattern: str, name: Callable[[int], object] = str) -> list[tuple[str, int, float]]:
    """Four anchors in turn, 10 ms apart, one topic each."""
    t_ns, range_m = measure()
    return [
        (pattern.format(name(anchor)), int(t) + anchor * 10_000_000, float(row[anchor]))
        for t, row in zip(t_ns, range_m, strict=True)
        for anchor in range(4)
    ]


def with_bad_values() -> list[tuple[str, int, float]]:
    """In sensor_msgs/Range +inf means nothing there, -inf too near, NaN an error."""
    rows = round_robin("/uwb/tof/n_9/n_{}/distance")
    for index, value in enumerate((np.nan, -1.0, 0.0, np.inf, -np.inf, 1e30)):
        rows[100 + index] = (*rows[100 + index][:2], value)
    return rows


@dataclass(frozen=True)
class Case:
    """A log, and what comes of it: exit code, lines on stderr and lines that must not be there.

    largest_m, rms_m: bounds of the error of its poses; poses, used: how many poses there are and ranges count.
    """

    log: Callable[[], list[Any]]
    says: tuple[str, ...] = ()
    ids: tuple[int, ...] = (0, 1, 2, 3)
    silent: tuple[str, ...] = ("Traceback",)
    code: int = 0
    largest_m: float = np.inf
    rms_m: float = np.inf
    poses: int | None = None
    used: int | None = None


OTHER_SITE = (*(f"{anchor} (100 ranges)" for anchor in range(4)), "silent: 10, 11, 12, 13")
# In LinkTrack frames zero means absent; what is no number never reaches a fix.
BAD_RANGES = tuple(
    zip((10, 11, 12, 13, 14, 15), (1, 1, 1, 1, 2, 2), (np.nan, -3.0, np.inf, 1e6, 3e38, 0.01), strict=True)
)
CASES = {
    "sound": Case(changed, silent=("give no fix", "left out", "make one fix"), largest_m=0.2),
    "epochs of two ranges": Case(
        lambda: changed((slice(40, 60), slice(2, None), 0.0)),
        ("of 100 epochs, 20 with fewer than three ranges",),
        largest_m=0.3,
        poses=100,
    ),
    "ranges no radio can measure": Case(
        lambda: changed(*BAD_RANGES),
        (
            *("2 ranges that are NaN or infinite are left out", "1 ranges of zero or below are left out"),
            *("2 ranges above uwb.max_range_m are left out", "1 ranges below uwb.min_range_m are left out"),
        ),
        largest_m=0.2,
        used=400 - 6,
    ),
    "an anchor id twice": Case(changed, ("id 1 appears more than once",), ids=(0, 1, 1, 3), code=1),
    "another site": Case(changed, OTHER_SITE, ids=(10, 11, 12, 13)),
    "a stamp hours off": Case(
        lambda: restamped(slice(50, 51), lambda t_ns: t_ns + 3 * HOUR_NS),
        ("/uwb: 1 header stamps lie more than an hour from its others",),
        largest_m=0.2,
        poses=99,
    ),
    "ten frames under one stamp": Case(lambda: restamped(slice(50, 60), lambda t_ns: t_ns[5]), largest_m=0.3, poses=91),
    "a topic for each anchor by name": Case(
        lambda: round_robin("/uwb/anchor_{}/range"), silent=("fewer than three",), rms_m=0.06, poses=400
    ),
    "ranges that are none": Case(
        with_bad_values,
        (
            *("2 ranges that are NaN or infinite are left out", "2 ranges of zero or below are left out"),
            "1 ranges above uwb.max_range_m",
        ),
        rms_m=0.06,
        used=400 - 6,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_a_log_says_and_gives(name, tmp_path, replayed):
    case = CASES[name]
    log = case.log()
    path = tmp_path / "log.mcap"
    write_topics(path, log) if isinstance(log[0][0], str) else write_frames(path, log)
    result = replayed(path, anchor_table(case.ids))
    assert result.code == case.code
    for words in case.says:
        assert words in result.err
    for words in case.silent:
        assert words not in result.err
    if case.code:
        return
    if np.isfinite([case.largest_m, case.rms_m]).any():
        error_m = poses_error_m(result)
        assert error_m.max() < case.largest_m
        assert np.sqrt(np.mean(error_m**2)) < case.rms_m
        assert case.poses is None or case.poses - 10 < len(error_m) <= case.poses
    assert case.used is None or result.record()["counts"]["ranges_used"] == case.used


@pytest.mark.parametrize("broken", ["two anchors heard", "no range at all"])
def test_a_log_that_gives_no_fix_is_told_from_one_that_does(tmp_path, replayed, told, broken):
    t_ns, range_m = measure()
    range_m[:, (2 if broken == "two anchors heard" else 0) :] = 0
    path = write_frames(tmp_path / "none.mcap", frames_of(t_ns, range_m))
    result = replayed(path, anchor_table())
    assert result.code == 0
    assert "no position was found" in result.err
    if broken == "two anchors heard":
        assert "of 100 epochs, 100 with fewer than three ranges" in result.err
        assert "anchors configured, but silent: 2, 3" in result.err
    else:
        assert "the recording has no UWB ranges" in result.err
    info, _ = told(path, anchor_table())
    assert info["uwb"] == []


@pytest.mark.parametrize(
    ("position_m", "cause"),
    [
        (SQUARE_M[:2], "2 UWB anchors are known, a fix needs three"),
        (SQUARE_M[:, [0, 0, 2]], "every fix has a mirror image"),
        (SQUARE_M[[0, 0, 0, 0]], "every fix has a mirror image"),
    ],
    ids=["two", "on a diagonal", "in one place"],
)
def test_anchors_that_give_no_fix_are_refused(tmp_path, replayed, told, position_m, cause):
    path = write_frames(tmp_path / "line.mcap", frames_of(*measure()))
    result = replayed(path, anchor_table(position_m=position_m))
    assert result.code == 1
    assert cause in result.err
    assert "[[uwb.anchors]]" in result.err
    info, err = told(path, anchor_table(position_m=position_m))
    assert info["uwb"] == []
    assert cause in err


@pytest.mark.parametrize("hours", [3, -3])
def test_a_clock_that_jumps_by_hours_is_refused_and_mended_as_it_says(tmp_path, replayed, hours):
    t_ns, range_m = measure()
    stamp_ns = np.where(np.arange(100) < 50, t_ns, t_ns + hours * HOUR_NS)
    path = write_frames(tmp_path / "jump.mcap", frames_of(t_ns, range_m, stamp_ns=stamp_ns))
    refused = replayed(path, anchor_table())
    assert refused.code == 1
    assert "10800 s apart" in refused.err
    assert "--stamp log" in refused.err
    mended = replayed(path, anchor_table(), "--stamp", "log")
    assert mended.code == 0
    assert poses_error_m(mended).max() < 0.2


def test_a_tag_that_appears_half_way(tmp_path, replayed):
    t_ns, range_m = measure()
    person_ns, person_m = t_ns[50:] + 10_000_000, measure(1)[1][50:]
    path = write_frames(tmp_path / "late.mcap", [*frames_of(t_ns, range_m), *frames_of(person_ns, person_m, tag=5)])
    result = replayed(path, anchor_table())
    assert result.code == 0
    target = result.table("target")
    assert set(target["source"]) == {"uwb"}
    assert target["t_ns"][0] == person_ns[0]
    assert poses_error_m(result).max() < 0.2


def test_tags_whose_ids_are_also_anchors_are_not_confused(tmp_path, replayed, told):
    t_ns, range_m = measure()
    frames = [*frames_of(t_ns, range_m, tag=1), *frames_of(t_ns + 10_000_000, measure(1)[1], tag=2)]
    path = write_frames(tmp_path / "ids.mcap", frames)
    info, _ = told(path, anchor_table())
    assert [(row["tag"], row["anchor"]) for row in info["uwb"]] == [(tag, a) for tag in (1, 2) for a in range(4)]
    result = replayed(path, anchor_table())
    assert result.code == 0
    assert poses_error_m(result).max() < 0.2


def test_range_topics_that_name_no_ends_are_named_themselves_and_can_be_mapped(tmp_path, replayed, told):
    path = write_topics(tmp_path / "letters.mcap", round_robin("/uwb/range/{}", "abcd".__getitem__))
    info, err = told(path, anchor_table())
    assert "no UWB ranges" in err
    assert all("[[uwb.range_topics]]" in topic["why"] for topic in info["topics"])
    refused = replayed(path, anchor_table())
    assert refused.code == 1
    assert "see  quadlog info" in refused.err
    rows = (f'{{topic="/uwb/range/{letter}", tag=3, anchor={anchor}}}' for anchor, letter in enumerate("abcd"))
    mapped = replayed(path, anchor_table() + f"range_topics = [{', '.join(rows)}]\n")
    assert mapped.code == 0
    assert np.sqrt(np.mean(poses_error_m(mapped) ** 2)) < 0.06


def test_a_log_of_negative_ranges_is_not_one_without_ranges(tmp_path, replayed, told):
    t_ns, range_m = measure()
    range_m[:, 3] = np.nan
    path = write_frames(tmp_path / "negative.mcap", frames_of(t_ns, -range_m))
    result = replayed(path, anchor_table())
    assert result.code == 0
    assert "300 ranges of zero or below are left out" in result.err
    assert "100 ranges that are NaN or infinite are left out" in result.err
    assert "no UWB ranges" not in result.err
    assert "a longer walk tells more" not in result.err
    info, err = told(path, anchor_table())
    assert "300 ranges of zero or below are left out" in err
    assert [(row["anchor"], row["n"], row["range_max_m"] is None) for row in info["links"]] == [
        (0, 100, False),
        (1, 100, False),
        (2, 100, False),
        (3, 100, True),
    ]
    assert run_cli(["init", str(path), "-o", str(tmp_path / "form.toml")]) == 0
    assert "# 100 ranges\n# [[uwb.anchors]]\n# id = 3" in (tmp_path / "form.toml").read_text()


@pytest.mark.parametrize("back_s", [2, 1.2])
def test_a_clock_that_is_set_back_does_not_interleave_two_walks(tmp_path, replayed, told, back_s):
    """Half of the log is stamped early from there on: every pose is of the walk before or of the one after."""
    t_ns, range_m = measure()
    stamp_ns = np.where(np.arange(100) < 60, t_ns, t_ns - round(back_s * 1e9))
    path = write_frames(tmp_path / "back.mcap", frames_of(t_ns, range_m, stamp_ns=stamp_ns))
    result = replayed(path, anchor_table(), "--set", "uwb.smooth=false")
    assert result.code == 3
    line = next(line for line in result.err.splitlines() if "go back by" in line)
    assert "lost: /uwb: its header stamps go back by" in line
    assert f"{back_s - 0.05:.2f} s, to 2023-11-14T22:13:" in line
    assert f"; {back_s * 80:.0f} of 400 ranges" in line
    assert "--stamp log" in line
    poses = result.table("poses")
    pose_ns, xy_m = poses["t_ns"], np.column_stack([poses["x_m"], poses["y_m"]])
    early = pose_ns <= t_ns[59]
    assert early.sum() == 60
    true_ns = np.where(early, pose_ns, pose_ns + round(back_s * 1e9))
    settled = early | (pose_ns > t_ns[59] + 400_000_000)
    assert np.hypot(*(xy_m - walk(true_ns)).T)[settled].max() < 0.3
    info, _ = told(path, anchor_table())
    assert [text for text in info["warnings"] if "go back" in text] == [line.removeprefix("lost: ")]
    unplaced, _ = told(path, "")
    (text,) = [text for text in unplaced["warnings"] if "go back" in text]
    assert text.startswith("/uwb: its header stamps go back by")
    assert "--stamp log" in text
    by_log = replayed(path, anchor_table(), "--stamp", "log", "--force")
    assert "go back" not in by_log.err
    assert poses_error_m(by_log).max() < 0.2


def test_slow_rounds_make_fixes_too(tmp_path, replayed):
    """One range each 50 ms: no three within 0.05 s. A round is derived from the log and said; a set length counts."""
    rows = round_robin("/uwb/anchor_{}/range")
    slow = [(topic, START_NS + index * 50_000_000, 0.0) for index, (topic, _, _) in enumerate(rows)]
    xyz_m = np.column_stack([walk(np.array([t_ns for _, t_ns, _ in slow])), np.full(len(slow), 0.6)])
    true_m = np.linalg.norm(xyz_m - np.tile(SQUARE_M, (100, 1)), axis=1)
    noise_m = 0.05 * np.random.default_rng(0).standard_normal(len(slow))
    path = tmp_path / "slow.mcap"
    write_topics(path, [(row[0], row[1], float(m)) for row, m in zip(slow, true_m + noise_m, strict=True)])
    result = replayed(path, anchor_table())
    assert result.code == 0
    assert "single ranges within 0.20 s make one fix" in result.err
    assert "fewer than three" not in result.err
    assert np.sqrt(np.mean(poses_error_m(result) ** 2)) < 0.08
    fixed = replayed(path, anchor_table(), "--set", "uwb.epoch_s=0.05", "--force")
    assert "make one fix" not in fixed.err
    assert "with fewer than three ranges give no fix" in fixed.err
    assert "a longer walk tells more" not in fixed.err


def test_topics_that_name_the_anchor_first(tmp_path, replayed):
    """Tag 2, whose number is an anchor's too."""
    rows = round_robin("/uwb/anchor_{}/tag_2")
    result = replayed(write_topics(tmp_path / "ends.mcap", rows), anchor_table())
    assert result.code == 0
    assert set(result.table("fixes")["tag"]) == {2}
    assert np.sqrt(np.mean(poses_error_m(result) ** 2)) < 0.06


def test_info_names_unknown_and_silent_anchors_as_replay_does(tmp_path, replayed, told):
    path = write_frames(tmp_path / "named.mcap", frames_of(*measure()))
    _, err = told(path, anchor_table((0, 1, 2, 7)))
    assert "anchors seen, but not in [[uwb.anchors]]: 3 (100 ranges)" in err
    assert "anchors configured, but silent: 7" in err
    result = replayed(path, anchor_table((0, 1, 2, 7)))
    assert result.code == 0
    assert poses_error_m(result).max() < 0.3
    assert {line for line in result.err.splitlines() if "anchors" in line} <= set(err.splitlines())


@pytest.mark.parametrize(
    ("method", "calibrate", "warned"), [("huber", "false", 1), ("huber", "true", 0), ("linear", "false", 0)]
)
def test_huber_without_calibration_is_warned_of(tmp_path, replayed, method, calibrate, warned):
    path = write_frames(tmp_path / "huber.mcap", frames_of(*measure()))
    flags = ["--set", f"uwb.method={method}", "--set", f"uwb.calibrate={calibrate}"]
    assert replayed(path, anchor_table(), *flags).err.count("needs calibrated ranges") == warned


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_side_of_anchors_on_a_line_is_said(tmp_path, replayed, side):
    line_m = np.array([(0.0, 0.0, 1.2), (3.0, 0.0, 1.2), (6.0, 0.0, 1.2), (9.0, 0.0, 1.2)])
    t_ns, _ = measure()
    xyz_m = np.column_stack([walk(t_ns), np.full(len(t_ns), 0.6)])
    path = write_frames(tmp_path / "line.mcap", frames_of(t_ns, np.linalg.norm(xyz_m[:, None] - line_m, axis=2)))
    flags = ["--set", f"uwb.mirror={side}", "--set", "uwb.method=huber", "--set", "uwb.calibrate=true"]
    result = replayed(path, anchor_table(position_m=line_m), *flags)
    assert result.code == 0
    assert f"tracks start to the {side} of the way from anchor 0 to anchor 3" in result.err
    assert "needs calibrated ranges" not in result.err
    assert "uwb.method and uwb.height do not apply" in result.err
    assert result.table("links")["bias_applied"].all()
    assert (result.table("poses")["y_m"] > 0).all() == (side == "left")


def test_info_prints_every_link(tmp_path, capsys):
    path = write_frames(tmp_path / "text.mcap", frames_of(*measure(), tag=7))
    assert run_cli(["info", str(path)]) == 0
    out = capsys.readouterr().out
    for anchor in range(4):
        assert re.search(rf"^/uwb +7 +{anchor} +100 ", out, re.MULTILINE)


def test_of_many_tags_all_are_located_and_ten_described(tmp_path, replayed, capsys):
    t_ns, range_m = measure()
    log = write_frames(
        tmp_path / "walk.mcap",
        [frame for tag in range(30) for frame in frames_of(t_ns[:20] + 1000 * tag, range_m[:20], tag)],
    )
    result = replayed(log, anchor_table())
    assert result.code == 0
    assert set(result.table("fixes")["tag"]) == set(range(30))
    assert "30 tags are located; messages about single tags are left out for 20 of them" in result.err
    capsys.readouterr()
    assert run_cli(["info", str(log), "-c", str(tmp_path / "quadlog.toml")]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert any(line.startswith("  and ") and line.endswith(" more, all of them in --json") for line in printed)
    assert len(printed) < 200
