"""Ranges that are not as they should be, from the file to the poses: what is refused, lost, named, and how far off."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from quadlog.cli.main import run as run_cli
from quadlog.messages import UwbRanges
from quadlog.simulation.synthetic.recording import SynthesizedMessage
from quadlog.simulation.synthetic.writer import write_recording
from tests.lab.strangers import ROS, START_NS, Log

HOUR_NS, TICK_NS = 3600 * 10**9, 50_000_000
SQUARE_M = np.array([(0.0, 0.0, 1.2), (8.0, 0.0, 1.2), (8.0, 7.0, 1.2), (0.0, 7.0, 1.2)])
LINE_M = np.array([(0.0, 0.0, 1.2), (3.0, 0.0, 1.2), (6.0, 0.0, 1.2), (9.0, 0.0, 1.2)])
SIX_M = np.array([[0.0, 0, 1.2], [9, 0.5, 1.2], [8, 7, 1.2], [-0.5, 6, 1.2], [4, -2, 1.2], [3, 9, 1.2]])
Array = np.ndarray
Write = Callable[[Path], Path]


def walk_m(t_ns: Array) -> Array:
    phase = 2 * np.pi * (t_ns - START_NS) * 1e-9 / 20
    return np.array([4.0, 3.5]) + np.stack([2.5 * np.sin(phase), 1.8 * np.sin(2 * phase)], axis=1)


def measure(
    seed: int = 0, anchors_m: Array = SQUARE_M, count: int = 100, tick_ns: int = TICK_NS
) -> tuple[Array, Array]:
    """t_ns (T,) and range_m (T, A) at 20 Hz of a tag at 0.6 m."""
    t_ns = START_NS + np.arange(count, dtype=np.int64) * tick_ns
    xyz_m = np.column_stack([walk_m(t_ns), np.full(count, 0.6)])
    noise_m = 0.05 * np.random.default_rng(seed).standard_normal((count, len(anchors_m)))
    return t_ns, np.linalg.norm(xyz_m[:, None] - anchors_m, axis=2) + noise_m


Frame = tuple[int, int, int, Array]
"""Log time, header's stamp, tag, and ranges to the anchors."""


def frames_of(t_ns: Array, range_m: Array, tag: int = 0, stamp_ns: Array | None = None) -> list[Frame]:
    stamps = t_ns if stamp_ns is None else stamp_ns
    return [(int(t), int(stamp), tag, row) for t, stamp, row in zip(t_ns, stamps, range_m, strict=True)]


def written(frames: Iterable[Frame]) -> Write:
    """As LinkTrack frames."""
    ordered = sorted(frames, key=lambda frame: frame[0])

    def write(path: Path) -> Path:
        messages = (
            SynthesizedMessage("/uwb", log_ns, UwbRanges(stamp_ns, tag, np.arange(len(range_m)), range_m))
            for log_ns, stamp_ns, tag, range_m in ordered
        )
        write_recording(path.with_suffix(".mcap"), messages)
        return path.with_suffix(".mcap")

    return write


def changed(*changes: tuple[Any, Any, float]) -> Write:
    """Ranges replaced: (rows, anchors, range_m)."""
    t_ns, range_m = measure()
    for rows, anchors, value in changes:
        range_m[rows, anchors] = value
    return written(frames_of(t_ns, range_m))


def restamped(rows: slice, stamp_ns: Callable[[Array], Any]) -> Write:
    t_ns, range_m = measure()
    stamps = t_ns.copy()
    stamps[rows] = stamp_ns(t_ns[rows])
    return written(frames_of(t_ns, range_m, stamp_ns=stamps))


def set_back(back_s: float) -> Write:
    return restamped(slice(60, None), lambda t_ns: t_ns - round(back_s * 1e9))


def on_topics(
    pattern: str, names: Sequence[object] = range(4), odd: Sequence[float] = (), slow: bool = False, scans: int = 0
) -> Write:
    """Single ranges of four anchors in turns, a topic for each anchor; some ranges replaced by odd ones."""

    def write(path: Path) -> Path:
        t_ns, range_m = measure(count=400, tick_ns=TICK_NS if slow else TICK_NS // 4)
        log = Log()
        for i, (t, row) in enumerate(zip(t_ns.tolist(), range_m, strict=True)):
            value = odd[i - 100] if 100 <= i < 100 + len(odd) else row[i % 4]
            log.range(t, pattern.format(names[i % 4]), float(value))
        for t in t_ns[:scans].tolist():
            log.scan(t, np.full(90, 5.0), 2 * np.pi)
        return log.write(path)

    return write


Sent = Callable[[int, float], Iterable[tuple[int, str, float]]]
"""Of the i-th range what is logged: how much later, under what before its topic's name, and which value."""


def sent(each: Sent, limits_m: tuple[float, float] = (0.0, 0.0), odometry: bool = False) -> Write:
    """Rounds of single ranges at 10 Hz, 2 ms apart."""

    def write(path: Path) -> Path:
        t_ns, range_m = measure(count=100, tick_ns=2 * TICK_NS)
        log, i = Log(), 0
        for t, row in zip(t_ns.tolist(), range_m, strict=True):
            if odometry:
                log.odometry(t, (*walk_m(np.array([t]))[0], 0.0))
            for anchor, value in enumerate(row.tolist()):
                for late_ns, before, sent_m in each(i, value):
                    at_ns = t + 2_000_000 * anchor + late_ns
                    log.range(at_ns, f"{before}/uwb/tag_0/anchor_{anchor}", sent_m, limits_m)
                i += 1
        return log.write(path)

    return write


def twice(late_ns: int, before: str = "", every: int = 1, off_m: float = 0.0) -> Sent:
    return lambda i, value: [(0, "", value), *([(late_ns, before, value + off_m)] if i % every == 0 else [])]


def spoilt(*values: float) -> Sent:
    """More than half of the ranges replaced."""
    return lambda i, value: [(0, "", value if i % 16 < 7 else values[i % len(values)])]


def carried(place: Callable[[int, int], Any] | None = None, count: int = 480) -> Write:
    """Messages that say where their anchors 100 to 103 are, with the jitter of a self-survey; place: instead."""

    def write(path: Path) -> Path:
        t_ns, range_m = measure(count=count, tick_ns=TICK_NS // 4)
        log = Log()
        for i, t in enumerate(t_ns.tolist()):
            at_m = jittered(i % 4, i) if place is None else place(i % 4, i)
            ends = {"requester_id": 7, "responder_id": 100 + i % 4, "distance": range_m[i, i % 4]}
            ends["responder_location"] = ROS.vector(*at_m, name="Point")
            log.put("/uwb", t, "uwb_driver/msg/UwbRange", "uwb", **ends)
        return log.write(path)

    return write


def jittered(anchor: int, i: int) -> Array:
    return SQUARE_M[anchor] + 0.01 * np.random.default_rng(i).standard_normal(3)


def all_but(anchors: Sequence[int], nowhere: Sequence[float]) -> Write:
    return carried(lambda anchor, i: nowhere if anchor in anchors else jittered(anchor, i), 320)


def site(ids: Sequence[int] = (0, 1, 2, 3), position_m: Array = SQUARE_M) -> str:
    rows = (f"{{id={i}, x_m={x}, y_m={y}, z_m={z}}}" for i, (x, y, z) in zip(ids, position_m, strict=False))
    return f"[uwb]\nanchors = [{', '.join(rows)}]\n"


TIMES = ("poll_tx", "poll_rx", "resp_tx", "resp_rx", "final_tx", "final_rx")
OWN_TEXT = {
    "Node": "uint8 id\nfloat32 dis\n",
    "Frame": "std_msgs/Header header\nuint8 id\nNode[] nodes\n",
    "Single": "std_msgs/Header header\nuint16 peer\nint32 distance_mm\n",
    "Times": "std_msgs/Header header\nuint16 peer\n" + "".join(f"uint64 {name}\n" for name in TIMES),
    "Named": "std_msgs/Header header\nstring me\nstring peer\nfloat64 range\n",
    "Names": "std_msgs/Header header\nstring[] peers\nfloat64[] ranges\n",
    "Flown": "uint64 timestamp\nfloat32[3] position\nfloat32[4] q\n",
    "Place": "builtin_interfaces/Time stamp\nfloat64 x\nfloat64 y\nfloat64 z\n",
}
ROS.register(**OWN_TEXT)


def own(kind: str, name: str = "") -> Write:
    """Ranges in messages of a type that nobody knows, and the walk as another one."""

    def write(path: Path) -> Path:
        log = Log()
        for t, row in zip(*measure(), strict=True):
            x_m, y_m = walk_m(np.array([t]))[0]
            log.put("/place", t, "own/msg/Place", stamp=ROS.stamp(int(t)), x=1000 * x_m, y=1000 * y_m)
            if kind == "Flown":
                half_rad = (t - START_NS) * 1e-9 / 2
                turn = [np.cos(half_rad), 0, 0, -np.sin(half_rad)]
                log.put("/flown", t, "own/msg/Flown", timestamp=int(t), position=[x_m, -y_m, 1], q=turn)
            elif kind == "Names":
                log.put("/own", t, "own/msg/Names", "", peers=SIDES, ranges=row)
            elif kind == "Frame":
                nodes = [ROS.make("own/msg/Node", id=i, dis=value) for i, value in enumerate(row)]
                log.put("/own", t, "own/msg/Frame", "", nodes=nodes)
            for i, value in enumerate(row if kind in ("Single", "Named", "Times") else ()):
                values, flight = {"peer": i, "distance_mm": round(1000 * value)}, value / 299_792_458.0 / 1.565e-11
                if kind == "Named":
                    values = {"me": "T7", "peer": name.format(i, "AB"[i % 2], i // 2), "range": value}
                elif kind == "Times":
                    times = np.cumsum([2**40 - 10**7, flight, 2e7, flight, 3e7, flight])
                    values = {"peer": i} | {at: int(each) % 2**40 for at, each in zip(TIMES, times, strict=True)}
                log.put("/own", t + i * 10**6, f"own/msg/{kind}", "", **values)
        return log.write(path)

    return write


SIDES = ["left", "right", "front", "back"]
NAMED = "{" + ", ".join(f"{side}={i}" for i, side in enumerate(SIDES)) + "}"
OWN_KEYS = {
    "Frame": 'field="nodes[].dis", tag="id", anchor="nodes[].id"',
    "Single": 'field="distance_mm", unit="mm", tag=0, anchor="peer"',
    "Times": f'times={[*TIMES]}, tick_s=1.565e-11, tag=0, anchor="peer"',
    "Named": 'field="range", tag="me", anchor="peer"',
    "Names": f'field="ranges[]", tag=0, anchor="peers[]", names={NAMED}',
}
NAMES = {
    "A{}": range(4),
    "{}": range(4),
    "0x1a{}B": range(0x1A0B, 0x1A4B, 16),
    "d4:22:cd:00:0f:9{}": range(0xD422CD000F90, 0xD422CD000F94),
}


class Case(NamedTuple):
    """A log, and what comes of it.

    says, never: in stderr. worst_m, rms_m: bounds of the error of the poses, of which there are `poses`;
    used: ranges that count; links: how many pairs of tag and anchor `info` lists; info: in its warnings.
    """

    log: Write
    says: tuple[str, ...] = ()
    config: str = site()
    flags: tuple[str, ...] = ()
    code: int = 0
    never: tuple[str, ...] = ()
    worst_m: float = np.inf
    rms_m: float = np.inf
    poses: int | None = None
    used: int | None = None
    links: int | None = None
    info: tuple[str, ...] = ()
    source: str = "uwb"


SOUND, RULE = changed(), "[[uwb.anchors]]"
# In LinkTrack frames zero means absent; in sensor_msgs/Range infinity means that nothing was measured, NaN an error.
BAD = ((10, 1, np.nan), (11, 1, -3.0), (12, 1, np.inf), (13, 1, 1e6), (14, 2, 3e38), (15, 2, 0.01))
MAPPED = ", ".join(f'{{topic="/uwb/range/{letter}", tag=3, anchor={i}}}' for i, letter in enumerate("abcd"))
MEASURED = ", ".join(f'{{topic="/uwb/tag_0/anchor_{i}", unit="%s"}}' for i in range(4))
CASES = {
    "sound": Case(SOUND, never=("give no fix", "left out", "make one fix"), worst_m=0.2, links=4),
    "epochs of two": Case(
        changed((slice(40, 60), slice(2, None), 0.0)), ("of 100 epochs, 20 with fewer",), worst_m=0.3, poses=100
    ),
    "no radio measures that": Case(
        changed(*BAD), ("2 ranges that are NaN or infinite", "1 ranges of zero", "2 ranges above uwb.max_range_m"),
        worst_m=0.2, used=394,
    ),
    "an id twice": Case(SOUND, ("id 1 appears more than once",), site((0, 1, 1, 3)), code=1),
    "another site": Case(
        SOUND, ("3 (100 ranges)", "silent: 10, 11, 12, 13"), site((10, 11, 12, 13)), source="fixed",
        info=("silent: 10, 11",),
    ),
    "one anchor of another site": Case(
        SOUND, ("3 (100 ranges)", "silent: 7"), site((0, 1, 2, 7)), worst_m=0.3,
        info=("seen, but not in [[uwb.anchors]]: 3 (100 ranges)", "silent: 7"),
    ),
    "two heard": Case(
        changed((slice(None), slice(2, None), 0.0)), ("100 with fewer than three", "silent: 2, 3"),
        links=0, source="fixed",
    ),
    "nothing heard": Case(changed((slice(None), slice(None), 0.0)), ("has no UWB ranges",), links=0, source="fixed"),
    "two anchors": Case(SOUND, (RULE,), site(position_m=SQUARE_M[:2]), code=1, links=0, info=("a fix needs three",)),
    "on a line": Case(SOUND, (RULE,), site(position_m=SQUARE_M[:, [0, 0, 2]]), code=1, links=0, info=("mirror",)),
    "in one place": Case(SOUND, (RULE,), site(position_m=SQUARE_M[[0] * 4]), code=1, links=0, info=("mirror",)),
    "a stamp hours off": Case(
        restamped(slice(50, 51), lambda t_ns: t_ns + 3 * HOUR_NS), ("1 header stamps lie more than an hour",),
        worst_m=0.2, poses=99,
    ),
    "ten under one stamp": Case(restamped(slice(50, 60), lambda t_ns: t_ns[5]), worst_m=0.3, poses=91),
    "a clock that jumps": Case(
        restamped(slice(50, None), lambda t_ns: t_ns - 3 * HOUR_NS), ("10800 s apart", "--stamp log"), code=1
    ),
    **{
        f"a clock {wrong}": Case(
            restamped(rows, stamp_ns), ("of a clock that was set; 20 messages stamped up to ",), code=3, worst_m=0.3,
            poses=80, never=("--stamp header",), info=("header stamps jump by ",),
        )
        for wrong, rows, stamp_ns in (
            ("in 1970 at first", slice(20), lambda t_ns: t_ns - t_ns[0] + 20 * 10**9),
            ("a year ahead at first", slice(20), lambda t_ns: t_ns + 365 * 24 * HOUR_NS),
            ("in 1970 for a while", slice(40, 60), lambda t_ns: t_ns - t_ns[0] + 20 * 10**9),
            ("a year ahead in the end", slice(80, 100), lambda t_ns: t_ns + 365 * 24 * HOUR_NS),
        )
    },
    "the same by log time": Case(
        restamped(slice(50, None), lambda t_ns: t_ns - 3 * HOUR_NS), flags=("--stamp", "log"), worst_m=0.2
    ),
    "set back by log time": Case(set_back(1.2), flags=("--stamp", "log"), never=("go back",), worst_m=0.2),
    "tags with ids of anchors": Case(
        written([*frames_of(*measure(), tag=1), *frames_of(measure()[0] + 10**7, measure(1)[1], tag=2)]),
        worst_m=0.2, links=8,
    ),
    "topics of anchors": Case(
        on_topics("/uwb/anchor_{}/range"), ("range, /uwb/anchor_3/range: no tag is named; ranges are taken as those",),
        rms_m=0.06, poses=400, info=("no tag is named",),
    ),
    "topics of numbers": Case(
        on_topics("/uwb/{}/to/2"), ("/uwb/3/to/2: of two numbers the first is taken as the tag",), source="fixed"
    ),
    "topics, anchor first": Case(on_topics("/uwb/anchor_{}/tag_2"), rms_m=0.06, links=4),
    "topics, odd values": Case(
        on_topics("/uwb/tof/n_9/n_{}/distance", odd=(np.nan, -1.0, 0.0, np.inf, -np.inf, 1e30)),
        ("1 ranges that are NaN", "2 ranges of zero or below", "1 ranges above", "2 of 400 ranges were not measured"),
        rms_m=0.06, used=394,
    ),
    **{
        f"twice, {name}": Case(
            sent(each), (f"{n - 400} ranges of {n} that are repeats",), rms_m=0.05, used=400, poses=400,
            never=("no fix", "NLOS"),
        )
        for name, n, each in (
            ("at once", 800, twice(0)), ("each third", 534, twice(5_000_000, every=3)),
            ("by a relay", 800, twice(3_000_000, "/relay")),
        )
    },
    "tried again": Case(
        sent(twice(1_000_000, off_m=0.03)), rms_m=0.06, used=800, poses=800, never=("no fix", "repeats")
    ),
    "frames twice": Case(
        written([*frames_of(*measure()), *frames_of(measure()[0] + 10**6, measure()[1])]),
        ("400 ranges of 800 that are repeats",), worst_m=0.2, used=400,
    ),
    "frames tried again": Case(
        written([*frames_of(*measure()), *frames_of(measure()[0] + 10**6, measure(1)[1])]), never=("repeats",),
        worst_m=0.2, used=800,
    ),
    "beyond their own limits": Case(
        sent(spoilt(60.0), (0.1, 50.0)), ("225 of 400 ranges were not measured and are left out: they are outside",),
        rms_m=0.12, used=175, info=("225 of 400 ranges were not measured",),
    ),
    "below their own limits": Case(sent(spoilt(0.4), (0.5, 100.0)), ("225 of 400 ranges were",), rms_m=0.12, used=175),
    "limits that are none": Case(sent(twice(0, every=500), (0.0, 0.0)), never=("measured",), used=401),
    "all beyond, with odometry": Case(
        sent(lambda i, value: [(0, "", 60.0)], (0.1, 50.0), odometry=True), source="odometry", links=0,
        says=("400 of 400", "UWB gives no position", "from odometry instead", "--set 'topics.position=\"odometry\"'"),
        info=("400 of 400", "no UWB ranges to use"),
    ),
    **{
        f"in {unit}{' too' if named else ''}": Case(
            sent(lambda i, value, scale=scale: [(0, "", scale * value)], odometry=True),
            () if named else (f"fit the anchors in {unit}", "from odometry instead"),
            config=f"{site()}range_topics = [{MEASURED % tuple([unit] * 4)}]\n" if named else site(),
            rms_m=0.05, source="uwb" if named else "odometry", never=("fit the anchors",) if named else (),
            links=None if named else 0, info=() if named else (f"fit the anchors in {unit}",),
        )
        for unit, scale, named in (("cm", 100, False), ("mm", 1000, False), ("mm", 1000, True))
    },
    "frames in cm": Case(
        written(frames_of(measure()[0], 100 * measure()[1])), worst_m=0.2,
        config=f'{site()}range_topics = [{{topic="/uwb", unit="cm"}}]\n',
    ),
    "not a unit": Case(
        SOUND, ("/uwb: set tag and anchor",), code=1, config=f'{site()}range_topics = [{{topic="/uwb", tag=1}}]\n'
    ),
    "topics without ends": Case(
        on_topics("/uwb/range/{}", "abcd"), ("see  quadlog info",), code=1, info=("no UWB ranges",)
    ),
    "topics that are mapped": Case(
        on_topics("/uwb/range/{}", "abcd"), config=f"{site()}range_topics = [{MAPPED}]\n", rms_m=0.06
    ),
    "mapped under names that are not there": Case(
        on_topics("/uwb/anchor_{}/range"), rms_m=0.06, info=("/uwb/anchor_x/range is not", "/plaice is not"),
        says=("[[uwb.range_topics]]: /uwb/anchor_x/range is not in the recording", "mean /uwb/anchor_",
              "recording: /uwb/anchor_0", "[[topics.poses]]: /plaice is not in the recording"),
        config=f'{site()}range_topics = [{{topic="/uwb/anchor_x/range", tag=0, anchor=1}}]\n'
        '[[topics.poses]]\ntopic = "/plaice"\nfields = ["x", "y", "z"]\n',
    ),
    **{
        f"{kind} of any type": Case(
            own(kind), config=f'{site()}range_topics = [{{topic="/own", {keys}}}]\n', source="uwb", rms_m=0.06, links=4,
            never=("cannot", "left out"),
        )
        for kind, keys in OWN_KEYS.items()
        if kind != "Named"
    },
    **{
        f"ends by texts as {name}": Case(
            own("Named", name), config=f'{site(ids)}range_topics = [{{topic="/own", {OWN_KEYS["Named"]}}}]\n',
            rms_m=0.06, links=4, never=("cannot", "left out"),
        )
        for name, ids in NAMES.items()
    },
    "ends by texts without a number": Case(
        own("Names"), ("'left' has no number: give their ids as names in [[uwb.range_topics]]",), code=1,
        config=f'{site()}range_topics = [{{topic="/own", {OWN_KEYS["Names"].partition(", names")[0]}}}]\n',
    ),
    "ends by texts of one number": Case(
        own("Named", "{1}{2}"), ("'A0' and 'B0' would both be anchor 0: give their ids",), code=3, source="fixed",
        config=f'{site()}range_topics = [{{topic="/own", {OWN_KEYS["Named"]}}}]\n',
    ),
    "a field that is not there": Case(
        own("Single"), ("its definition has no number distance (header, peer, distance_mm)",), code=1,
        config=f'{site()}range_topics = [{{topic="/own", field="distance"}}]\n',
    ),
    "times without ticks": Case(
        SOUND, ("/own: times are six or four fields, with tick_s",), code=1,
        config=f'{site()}range_topics = [{{topic="/own", times={[*TIMES]}}}]\n',
    ),
    "poses of any type": Case(
        own("Single"), flags=("--set", "topics.position=/place"), source="pose", worst_m=1e-6,
        config='[[topics.poses]]\ntopic = "/place"\nfields = ["x", "y", "z"]\nunit = "mm"\n',
    ),
    "slow rounds": Case(
        on_topics("/uwb/anchor_{}/range", slow=True), ("within 0.20 s make one fix",), never=("fewer than three",),
        rms_m=0.08,
    ),
    "slow rounds cut short": Case(
        on_topics("/uwb/anchor_{}/range", slow=True), ("fewer than three ranges give no fix",),
        flags=("--set", "uwb.epoch_s=0.05"), never=("make one fix", "a longer walk"), source="fixed",
    ),
    "slow rounds cut short, beside a lidar": Case(
        on_topics("/uwb/anchor_{}/range", slow=True, scans=5), ("--set 'topics.position=\"lidar\"'",),
        flags=("--set", "uwb.epoch_s=0.05"), never=("no topic is fit to be the lidar",), source="fixed",
    ),
    "negative": Case(
        written(frames_of(measure()[0], np.where(np.arange(4) == 3, np.nan, -measure()[1]))),
        ("300 ranges of zero or below", "100 ranges that are NaN or infinite"), never=("no UWB ranges",),
        info=("300 ranges of zero or below",), source="fixed",
    ),
    "huber, not calibrated": Case(
        SOUND, ("needs calibrated ranges",),
        flags=("--set", "uwb.method=huber", "--set", "uwb.calibrate=false"),
    ),
    "carried": Case(carried(), config="", never=("contradict", "warning: /uwb"), rms_m=0.1, links=4),
    "carried by three": Case(all_but([0], (0, 0, 0)), ("100 (",), config=""),
    "carried by two": Case(all_but([0, 1], (0, 0, 0)), ("2 of the 3",), config="", source="fixed"),
    **{
        f"carried, all {nowhere}": Case(all_but(range(4), nowhere), ("ranges are not used",), config="", source="fixed")
        for nowhere in ((0.0, 0.0, 0.0), (np.nan, 1.0, 1.0))
    },
    "carried, one moves": Case(
        carried(lambda anchor, i: jittered(anchor, i) + (anchor == 2) * i / 200), ("anchor 102 by ",), config="",
        never=("101",), info=("anchor 102 by ",), source="",
    ),
    "carried, one is wild": Case(
        carried(lambda anchor, i: (500.0, 0, 0) if i == 2 else jittered(anchor, i), 320), config="",
        never=("contradict",), rms_m=0.15,
    ),
    "carried and configured": Case(
        carried(lambda anchor, i: jittered(anchor, i) + np.array([3.0, 0, 0])), ("4 of 4 anchors", "anchor 102 by 3.0"),
        site(range(100, 104)), rms_m=0.1, info=("[[uwb.anchors]], which are used",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_what_comes_of_it(name: str, tmp_path: Path, replayed: Any, described: Any) -> None:
    case = CASES[name]
    path = case.log(tmp_path / "log")
    done = replayed(path, "--until", "position", *case.flags, config=case.config)
    assert done.code == case.code, done.err
    assert not [words for words in case.says if done.err.count(words) != 1], done.err
    assert not [words for words in case.never if words in done.err], done.err
    if case.code == 0:
        poses = done.table("poses")
        assert case.source in ("", *set(poses["source"]))
        error_m = np.hypot(*(np.column_stack([poses["x_m"], poses["y_m"]]) - walk_m(poses["t_ns"])).T)
        assert case.worst_m == np.inf or error_m.max() < case.worst_m
        assert case.rms_m == np.inf or np.sqrt(np.mean(error_m**2)) < case.rms_m
        assert case.poses is None or case.poses - 10 < len(error_m) <= case.poses
        assert case.used is None or done.record["counts"]["ranges_used"] == case.used
    if case.links is not None or case.info:
        info = described(path, case.config)
        assert case.links is None or len(info["uwb"]) == case.links
        assert all(sum(words in line for line in info["warnings"]) == 1 for words in case.info), info["warnings"]


def test_a_clock_that_is_set_back_does_not_interleave_two_walks(tmp_path, replayed, described):
    """Part of the log is stamped early: every pose is of the walk before or of the one after."""
    path, (t_ns, _), back_s = set_back(1.2)(tmp_path / "back"), measure(), 1.2
    done = replayed(path, "--until", "position", "--set", "uwb.smooth=false", config=site())
    (lost,) = (line for line in done.err.splitlines() if "go back by" in line)
    assert (done.code, lost[:10], "--stamp log" in lost) == (3, "lost: /uwb", True)
    assert f"; {back_s * 80:.0f} of 400 ranges" in lost
    pose_ns, xy_m = (poses := done.table("poses"))["t_ns"], np.column_stack([poses["x_m"], poses["y_m"]])
    early = pose_ns <= t_ns[59]
    assert early.sum() == 60
    true_ns = np.where(early, pose_ns, pose_ns + round(back_s * 1e9))
    settled = early | (pose_ns > t_ns[59] + 400_000_000)
    assert np.hypot(*(xy_m - walk_m(true_ns)).T)[settled].max() < 0.3
    assert [text for text in described(path, site())["warnings"] if "go back" in text] == [lost.removeprefix("lost: ")]


def test_poses_in_arrays_of_north_east_down_are_those_of_north_west_up(tmp_path, replayed):
    fields = [*(f"{'-' * (i > 0)}position[{i}]" for i in range(3)), "q[1]", "-q[2]", "-q[3]", "q[0]"]
    config = f'[topics]\nposition = "/flown"\nposes = [{{topic = "/flown", fields = {fields}}}]\n'
    poses = replayed(own("Flown")(tmp_path / "log"), "--until", "position", config=config).table("poses")
    np.testing.assert_allclose(np.column_stack([poses["x_m"], poses["y_m"]]), walk_m(poses["t_ns"]), atol=1e-5)
    np.testing.assert_allclose(np.unwrap(poses["yaw_rad"]), (poses["t_ns"] - START_NS) * 1e-9, atol=1e-5)
    assert set(poses["source"]) == {"pose"}


def test_a_position_file_that_is_not_quite_tum_is_used_and_told(tmp_path, replayed):
    lines = [f"{START_NS + i * 10**9},{i},0,0,0,0,0,1\n" for i in range(5)]
    (tmp_path / "poses.csv").write_text("".join(2 * line for line in lines))
    done = replayed(
        SOUND(tmp_path / "log"), "--until", "position", "--set", f"topics.position={tmp_path / 'poses.csv'}"
    )
    assert (done.code, done.table("poses")["t_ns"].tolist()) == (0, [START_NS + i * 10**9 for i in range(5)])
    assert sum("read as ns" in text or "5 of 10 lines equal" in text for text in done.warned) == 2


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_side_of_anchors_on_a_line_is_chosen_and_said(tmp_path, replayed, side):
    path = written(frames_of(*measure(anchors_m=LINE_M)))(tmp_path / "line")
    flags = ["--set", f"uwb.mirror={side}", "--set", "uwb.method=huber", "--set", "uwb.calibrate=true"]
    done = replayed(path, "--until", "position", *flags, config=site(position_m=LINE_M))
    assert f"tracks start to the {side} of the way from anchor 0 to anchor 3" in done.err
    assert "uwb.method and uwb.height do not apply" in done.err
    assert "needs calibrated ranges" not in done.err
    assert done.table("links")["bias_applied"].all()
    assert (done.table("poses")["y_m"] > 0).all() == (side == "left")


def test_wrong_places_of_anchors_are_named_and_right_ones_are_not(tmp_path, replayed, described):
    path = written(frames_of(*measure(anchors_m=SIX_M, count=600)))(tmp_path / "six")
    moved_m = SIX_M.copy()
    moved_m[2, :2] += [0.9, -0.6]
    found = []
    for places_m in (SIX_M, SIX_M[[0, 4, 2, 3, 1, 5]], moved_m):
        config = site(range(6), places_m)
        done = replayed(path, "--until", "position", config=config)
        found.append([text for text in done.warned if "seem" in text])
        assert found[-1] == [text for text in described(path, config)["warnings"] if "seem" in text]
    right, (swapped,), (displaced, *_) = found
    assert right == []
    assert swapped.startswith("anchors 1 and 4 seem to be swapped")
    assert displaced.startswith("anchor 2 seems to stand at x_m = ")
    x_m, y_m = (float(word.split(",")[0]) for word in displaced.split(" = ")[1:3])
    assert (x_m, y_m) == pytest.approx((8.0, 7.0), abs=0.15)


def test_many_tags_are_located_and_a_person_from_when_it_appears(tmp_path, replayed):
    t_ns, range_m = measure()
    tags = [frame for tag in range(1, 12) for frame in frames_of(t_ns[50:70] + 1000 * tag, range_m[50:70], tag)]
    path = written([*frames_of(t_ns, range_m), *tags])(tmp_path / "walk")
    done = replayed(path, "--until", "position", config=site())
    assert set(done.table("fixes")["tag"]) == set(range(12))
    assert "messages for 2 of them are omitted" in done.err
    assert done.sources("target") == {"uwb"}
    assert done.table("target")["t_ns"][0] == t_ns[50] + 1000
    assert run_cli(["info", str(path), "-c", str(tmp_path / "quadlog.toml")]) == 0


def test_carried_anchors_are_a_configuration_that_gives_the_same_run(tmp_path, replayed, described):
    """The one beside the run, and the one that init writes, which leaves out anchors without a place."""
    path = carried()(tmp_path / "walk")
    one = replayed(path, "--until", "position")
    again = replayed(path, "--until", "position", config=(one.run / "config.toml").read_text())
    for name in ("fixes", "poses", "ranges", "links"):
        assert (one.run / f"{name}.parquet").read_bytes() == (again.run / f"{name}.parquet").read_bytes()
    assert (one.record["anchors_from_messages"], again.record["anchors_from_messages"]) == (True, False)
    anchors = described(path)["anchors"]
    np.testing.assert_allclose([[row[f"{axis}_m"] for axis in "xyz"] for row in anchors], SQUARE_M, atol=0.01)
    assert all(row["moved_m"] < 0.05 for row in anchors)
    partly, form = all_but([3], (0, 0, 0))(tmp_path / "partly"), tmp_path / "form.toml"
    assert run_cli(["init", str(partly), "-o", str(form)]) == 0
    proposed = tomllib.loads(form.read_text())["uwb"]["anchors"]
    assert [each["id"] for each in proposed] == [100, 101, 102]
    assert "# id = 103" in form.read_text()
    assert replayed(partly, "--until", "position", config=form.read_text()).sources() == {"uwb"}
