"""Clouds that are not as they should be, from the file to the map: skipped and counted, or refused, and never drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.lib import recfunctions
from rosbags.typesys import Stores, get_typestore

from quadlog.mapping.grid import window_at
from quadlog.results.arrays import load_maps
from quadlog.simulation.sensors.lidar import SimulatedScan
from quadlog.simulation.synthetic.follow import synthesize
from quadlog.simulation.synthetic.recording import IMU_TOPIC, LIDAR_TOPIC, ROBOT_TRUTH_TOPIC, START_NS, TF_STATIC_TOPIC
from quadlog.simulation.synthetic.ros_encoding import POINT, TYPE_NAMES, RosEncoder
from quadlog.simulation.synthetic.writer import McapRecording
from quadlog.simulation.worlds.world import occupied_centres

RECORDING = synthesize(seed=0, duration_s=1.6, azimuth_steps=240)
SCANS = 16
BAD = (2, 3, 7, 11)
METHODS = ("range_image", "paper")
FALSE_SHARE = {"range_image": 0.005, "paper": 0.02}
"""Occupied cells with nothing there; the paper's filter keeps more false points of a thin scan."""
CLOUD = TYPE_NAMES[SimulatedScan]
DATATYPES = {"u2": 4, "f4": 7}
STORE = get_typestore(Stores.ROS2_HUMBLE)

Points = np.ndarray
Row = tuple[int, str, str, bytes]
"""Log time, topic, type and payload of a message."""


def sensed(scan: SimulatedScan) -> Points:
    points = np.empty(len(scan.cloud.xyz_m), POINT)
    for axis, name in enumerate("xyz"):
        points[name] = scan.cloud.xyz_m[:, axis]
    points["intensity"], points["ring"] = scan.intensity, scan.cloud.ring
    points["time"] = scan.cloud.offset_ns * 1e-9
    return points


def encoded(points: Points, stamp_ns: int, frame_id: str = "lidar", claimed: int | None = None) -> bytes:
    """A PointCloud2 of any fields; claimed: how many points it says it has."""
    make: dict[str, Callable[..., Any]] = STORE.types
    fields = [
        make["sensor_msgs/msg/PointField"](name, field[1], DATATYPES[field[0].str[1:]], 1)
        for name, field in points.dtype.fields.items()
    ]
    stamp = make["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    header = make["std_msgs/msg/Header"](stamp, frame_id)
    n, step = len(points) if claimed is None else claimed, points.dtype.itemsize
    data = np.frombuffer(points.tobytes(), np.uint8)
    return bytes(STORE.serialize_cdr(make[CLOUD](header, 1, n, fields, False, step, n * step, data, True), CLOUD))


Change = Callable[[Points], "Points | None"]


@pytest.fixture(scope="module")
def log() -> tuple[list[Row], list[tuple[int, int, Points]]]:
    """What stands beside the clouds, and of every cloud its log time, stamp and points."""
    encoder = RosEncoder(2)
    beside, clouds = [], []
    for topic, log_ns, message in RECORDING.messages():
        if topic == LIDAR_TOPIC:
            clouds.append((log_ns, message.cloud.stamp_ns, sensed(message)))
        elif topic in (TF_STATIC_TOPIC, IMU_TOPIC, ROBOT_TRUTH_TOPIC):
            beside.append((log_ns, topic, TYPE_NAMES[type(message)], encoder.encode(message, 0)))
    assert len(clouds) == SCANS
    return beside, clouds


Places = list[tuple[int, np.ndarray]]


def places(result: Any) -> Places:
    """Time and occupied centres (N, 2) of every map."""
    maps = load_maps(result.run)
    return [
        (each.t_ns, occupied_centres(each.occupied, window_at(each.origin_m, maps.cell_m, maps.shape))) for each in maps
    ]


@pytest.fixture(scope="module")
def from_anything(from_obstacle) -> Callable[[int, np.ndarray], np.ndarray]:
    """How far places (N, 2) are from what stands there and from the people, who go a few centimetres meanwhile."""

    def distance_m(t_ns: int, places_m: np.ndarray) -> np.ndarray:
        t_s = np.array([(t_ns - START_NS) * 1e-9 + 0.05])
        away = [from_obstacle(each, places_m) for each in RECORDING.site.obstacles]
        for person in (RECORDING.site.person, RECORDING.site.passer_by):
            away.append(np.linalg.norm(places_m - person.at(t_s).position_m, axis=1) - 0.4)
        return np.min(away, axis=0)

    return distance_m


@pytest.fixture(scope="module")
def false_share(from_anything) -> Callable[[Any], float]:
    """Of all occupied cells, those with nothing within 0.3 m of them."""

    def share(result: Any) -> float:
        off = np.concatenate([from_anything(t_ns, centres_m) for t_ns, centres_m in places(result)])
        assert len(off) > 1000
        return float(np.mean(off > 0.3))

    return share


@pytest.fixture
def replayed_in_full(log, tmp_path: Path, replay_command: Callable[..., Any]) -> Callable[..., Any]:
    """Replays the recording with some clouds changed (None: left out), others beside them."""

    def go(
        change: Change | dict[int, Change] = lambda points: points,
        *flags: str,
        which: Iterable[int] = range(SCANS),
        beside: Iterable[Row] = (),
        until: str = "map",
        claimed: int | None = None,
    ) -> Any:
        rows, which = [*log[0], *beside], set(which)
        changes = change if isinstance(change, dict) else dict.fromkeys(which, change)
        for index, (log_ns, stamp_ns, points) in enumerate(log[1]):
            changed = changes[index](points.copy()) if index in changes else points
            if changed is not None:
                said = claimed if index in which else None
                rows.append((log_ns, LIDAR_TOPIC, CLOUD, encoded(changed, stamp_ns, claimed=said)))
        path = tmp_path / f"log{len(list(tmp_path.iterdir()))}.mcap"
        writer, encoder, known = McapRecording(path), RosEncoder(2), set()
        for log_ns, topic, type_name, payload in sorted(rows, key=lambda row: row[0]):
            if topic not in known:
                writer.add_topic(topic, type_name, encoder.definition(type_name))
                known.add(topic)
            writer.write(topic, log_ns, 0, payload)
        writer.close()
        sources = ["--set", f"topics.position={ROBOT_TRUTH_TOPIC}", "--set", "topics.target=ahead"]
        return replay_command(path, "--until", until, *sources, *flags)

    return go


@pytest.fixture
def replayed(replayed_in_full) -> Callable[..., Any]:
    """The same, without plots."""

    def go(change: Change | dict[int, Change] = lambda points: points, *flags: str, **options: Any) -> Any:
        return replayed_in_full(change, "--no-plots", *flags, **options)

    return go


@pytest.fixture(scope="module")
def sound_runs() -> dict[tuple[str, ...], Any]:
    return {}


@pytest.fixture
def sound(replayed, sound_runs) -> Callable[..., Any]:
    """The recording as it is, replayed once for all tests with the same flags."""

    def go(*flags: str) -> Any:
        if flags not in sound_runs:
            sound_runs[flags] = replayed(lambda points: points, *flags)
        return sound_runs[flags]

    return go


def by(method: str, memory: str = "log_odds") -> list[str]:
    return ["--set", f"lidar.method={method}", "--set", f"grid.memory={memory}"]


def same_maps(one: Any, other: Any) -> bool:
    names = ("maps.npz", "map.pgm", "map.yaml", "ground.npz")
    return all((one.run / name).read_bytes() == (other.run / name).read_bytes() for name in names)


def left_out(points: Points) -> None:
    return None


def filled(value: float) -> Change:
    def change(points: Points) -> Points:
        for name in "xyz":
            points[name] = value
        return points

    return change


def high_up(count: int) -> Change:
    """The first few points well above the ground: each would be an obstacle."""
    return lambda points: points[points["z"] > 0.1][:count]


# What a scan is made, how many points it then has (None: all), and how many of them are valid.
NOTHING_TO_SEE: dict[str, tuple[Change, int | None, int]] = {
    "NaN": (filled(np.nan), None, 0),
    "infinity": (filled(-np.inf), None, 0),
    "zeros": (filled(0.0), None, 0),
    "1e30": (filled(1e30), None, 0),
    "no point": (high_up(0), 0, 0),
    "one point": (high_up(1), 1, 1),
    "ten points": (high_up(10), 10, 10),
}


@pytest.mark.parametrize("method", METHODS)
def test_scans_that_show_nothing_are_skipped_and_said(replayed, log, method):
    """The map is that of the sound scans alone: neither drawn on nor cleared by the others."""
    bad = dict(zip((2, 3, 6, 7, 9, 11, 13), NOTHING_TO_SEE.values(), strict=True))
    sound = replayed(left_out, *by(method), which=bad)
    assert (sound.code, sound.warned()) == (0, [])
    result = replayed({index: change for index, (change, *_) in bad.items()}, *by(method))
    assert result.code == 0
    assert same_maps(result, sound)
    (line,) = result.warned()
    assert line.startswith("warning: 7 of 16 scans: fewer than 20 points")
    assert line.endswith("they are in no map")
    record, scans = result.record(), result.table("scans")
    assert record["counts"]["scans"] == SCANS
    assert record["counts"]["scans_without_points"] == len(bad)
    assert [line.removeprefix("warning: ")] == record["warnings"]
    assert any(note.startswith("9 of 9 scans classified") for note in record["notes"])
    for index, (_, n_raw, n_valid) in bad.items():
        assert scans["n_raw"][index] == (len(log[1][index][2]) if n_raw is None else n_raw)
        assert scans["n_valid"][index] == n_valid
        assert scans["n_ground"][index] == 0
        assert not scans["ground_found"][index]


def test_without_memory_a_scan_that_shows_nothing_frees_nothing(replayed):
    """An all-free map would send the robot through walls."""
    result = replayed(filled(np.nan), *by("range_image", "scan"), which=BAD)
    assert all(len(centres_m) > 100 for _, centres_m in places(result))
    assert len(places(result)) == SCANS - len(BAD)


@pytest.mark.parametrize("kind", ["NaN", "zeros", "no point"])
def test_a_log_of_empty_scans_is_refused_or_skipped_where_it_is_wanted(replayed, kind):
    change, *_ = NOTHING_TO_SEE[kind]
    result = replayed(change)
    assert result.code == 1
    assert "no topic is fit to be the lidar; /lidar/points its first scans are empty" in result.err
    named = replayed(change, "--set", f"topics.lidar={LIDAR_TOPIC}")
    assert named.code == 0
    assert any(line.startswith("warning: 16 of 16 scans: fewer than 20 points") for line in named.warned())


def test_a_log_of_scans_that_show_nothing_has_no_map(replayed_in_full):
    result = replayed_in_full(NOTHING_TO_SEE["one point"][0], until="report")
    assert result.code == 0
    (line,) = (line for line in result.warned() if "scans" in line)
    assert line.startswith("warning: 16 of 16 scans: fewer than 20 points")
    assert f"({LIDAR_TOPIC}: " in line
    assert len(load_maps(result.run)) == 0
    assert not (result.run / "map.pgm").exists()
    assert result.table("scans")["n_raw"][0] > 0


def test_a_lidar_that_starts_late_is_one(replayed):
    first = range(7)
    late = replayed(high_up(0), which=first)
    assert late.code == 0
    assert any(line.startswith("warning: 7 of 16 scans: fewer than 20 points") for line in late.warned())
    assert same_maps(late, replayed(left_out, which=first))
    assert late.record()["topics"][-1]["why"] == "starts with empty scans"


@pytest.mark.parametrize("method", METHODS)
def test_bad_points_change_nothing_about_the_good_ones(replayed, sound, method):
    def spoilt(points: Points) -> Points:
        both = np.repeat(points, 2)
        for name in "xyz":
            both[name][::2] = np.resize([np.nan, np.inf, 0.0, 1e30], len(points))
        return both

    result = replayed(spoilt, *by(method))
    assert result.code == 0
    assert result.warned() == []
    assert same_maps(result, sound(*by(method)))
    scans, sound_scans = result.table("scans"), sound(*by(method)).table("scans")
    np.testing.assert_array_equal(scans["n_raw"], 2 * sound_scans["n_raw"])
    np.testing.assert_array_equal(scans["n_valid"], sound_scans["n_valid"])


def renumbered(number: Callable[[np.ndarray], np.ndarray]) -> Change:
    def change(points: Points) -> Points:
        points["ring"] = number(points["ring"].copy())
        return points

    return change


RNG = np.random.default_rng(0)
BY_RINGS, BY_ELEVATIONS = "by beams, from the points' ring numbers", "by beams, from the points' elevations"
RINGS: dict[str, tuple[Change, str]] = {
    "two beams of one number": (renumbered(lambda ring: np.where(ring == 5, 4, ring)), BY_RINGS),
    "two beams apart of one number": (renumbered(lambda ring: np.where(ring == 12, 2, ring)), BY_ELEVATIONS),
    "all beams of one number": (renumbered(np.zeros_like), BY_ELEVATIONS),
    "any number": (renumbered(lambda ring: RNG.integers(0, 16, len(ring))), BY_ELEVATIONS),
    "the number of the next point": (renumbered(lambda ring: np.roll(ring, 1)), BY_ELEVATIONS),
    "numbers of no beam": (renumbered(lambda ring: ring + 60_000), BY_ELEVATIONS),
    "numbers in disorder": (renumbered(lambda ring: np.random.default_rng(5).permutation(16)[ring]), BY_RINGS),
    "no ring": (lambda points: recfunctions.drop_fields(points, "ring", usemask=False), BY_ELEVATIONS),
    "points in disorder": (lambda points: np.random.default_rng(5).permutation(points), BY_RINGS),
}


@pytest.mark.parametrize("kind", RINGS)
def test_rings_that_cannot_be_believed_draw_nothing_false(replayed, sound, kind, false_share):
    change, route = RINGS[kind]
    flags = by("range_image", "scan")
    result = replayed(change, *flags)
    assert result.code == 0
    assert result.warned() == []
    assert f"16 of 16 scans classified {route}" in result.record()["notes"]
    assert false_share(result) < FALSE_SHARE["range_image"]
    for (t_ns, found_m), (sound_ns, sound_m) in zip(places(result), places(sound(*flags)), strict=True):
        assert t_ns == sound_ns
        found, there = ({(x, y) for x, y in np.floor(each * 10).tolist()} for each in (found_m, sound_m))
        assert len(found & there) > 0.98 * len(there)


def test_the_papers_method_asks_for_no_rings(replayed, sound):
    for kind in ("any number", "no ring"):
        assert same_maps(replayed(RINGS[kind][0], *by("paper")), sound(*by("paper")))


@pytest.mark.parametrize("method", METHODS)
def test_scans_may_differ_in_size(replayed, log, method, false_share):
    rng = np.random.default_rng(3)
    kept = [np.sort(rng.permutation(len(points))[: int(len(points) * rng.uniform(0.3, 1))]) for _, _, points in log[1]]
    each = iter(kept)
    result = replayed(lambda points: points[next(each)], *by(method))
    assert result.code == 0
    assert result.warned() == []
    assert result.table("scans")["n_raw"].tolist() == [len(rows) for rows in kept]
    assert false_share(result) < FALSE_SHARE[method]


def test_clouds_that_claim_more_points_than_they_have_are_lost_and_said(replayed):
    result = replayed(lambda points: points, which=BAD, claimed=1_000_000)
    assert result.code == 3
    assert "4 messages could not be decoded" in result.err
    assert same_maps(result, replayed(left_out, which=BAD))


def in_a_plane(points: Points) -> Points:
    """The beam next to the horizon, as a 2-D lidar's driver sends it."""
    flat = points[points["ring"] == 7]
    flat["z"] = 0.0
    return flat


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("mount_m", [0.45, 0.0001], ids=["mounted", "mount unknown"])
def test_a_2d_scan_draws_what_it_hits_and_is_said_to_know_no_ground(
    replayed, method, mount_m, false_share, from_anything
):
    """Its plane is no ground, and its returns lie at the mount's height: they block, also where that is not given."""
    result = replayed(in_a_plane, *by(method), "--set", f"lidar.mount.z_m={mount_m}")
    assert result.code == 0
    (line,) = result.warned()
    assert line.startswith("warning: 16 of 16 scans: no ground is found, as in a 2-D scan")
    assert "but flat: a 2-D scan" in line
    scans = result.table("scans")
    assert set(scans["n_ground"]) == {0}
    assert not any(scans["ground_found"])
    # What a person who walked away leaves behind would be false as well.
    assert false_share(result) < FALSE_SHARE[method]
    walls_m = [centres_m[from_anything(t_ns, centres_m) < 0.15] for t_ns, centres_m in places(result)]
    assert min(len(each) for each in walls_m) > 60


def test_some_2d_scans_among_others_draw_nothing_false(replayed, false_share):
    result = replayed(in_a_plane, *by("range_image"), which=BAD)
    assert result.code == 0
    assert result.warned()[0].startswith("warning: 4 of 16 scans: no ground is found")
    assert result.record()["counts"]["scans_without_ground"] == len(BAD)
    assert false_share(result) < FALSE_SHARE["range_image"]


def radar(topic: str, count: int) -> list[Row]:
    """A RADAR's clouds: other fields, its own rate, and nothing where it says."""
    kind = np.dtype([(name, "<f4") for name in ("x", "y", "z", "velocity", "rcs")])
    rng = np.random.default_rng(1)
    rows = []
    for stamp_ns in range(START_NS, START_NS + 1_600_000_000, 77_000_000):
        points = np.zeros(count, kind)
        points["x"], points["y"], points["z"] = rng.uniform([[1], [-5], [0]], [[20], [5], [2]], (3, count))
        rows.append((stamp_ns + 10_000_000, topic, CLOUD, encoded(points, stamp_ns, "radar")))
    return rows


@pytest.mark.parametrize(("topic", "count"), [("/ars430", 30), ("/radar/points", 400)])
def test_a_radar_beside_the_lidar_is_not_mixed_into_it(replayed, sound, topic, count):
    result = replayed(beside=radar(topic, count))
    assert result.code == 0
    assert [each["topic"] for each in result.record()["topics"] if each["role"] == "lidar"] == [LIDAR_TOPIC]
    assert same_maps(result, sound())


def test_two_topics_that_could_be_the_lidar_are_a_choice(replayed, sound):
    others = radar("/ars430", 400)
    refused = replayed(beside=others)
    assert refused.code == 1
    assert f"choose with  --set topics.lidar=/ars430  or  --set topics.lidar={LIDAR_TOPIC}" in refused.err
    chosen = replayed(lambda points: points, "--set", f"topics.lidar={LIDAR_TOPIC}", beside=others)
    assert same_maps(chosen, sound())


def test_a_radar_does_not_take_the_place_of_a_lidar_that_starts_late(replayed):
    refused = replayed(high_up(0), which=range(7), beside=radar("/ars430", 30))
    assert refused.code == 1
    assert f"choose with  --set topics.lidar=/ars430  or  --set topics.lidar={LIDAR_TOPIC}" in refused.err


def test_a_radar_alone_is_named_one(replayed):
    result = replayed(left_out, beside=radar("/ars430", 19))
    assert result.code == 0
    (line,) = (line for line in result.warned() if "scans" in line)
    assert line.endswith("they are in no map (/ars430: only 19 points per scan: a radar rather than a lidar)")
