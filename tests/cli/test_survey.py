"""`quadlog survey` on the committed recording and on the real trolley, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.geometry import quat_from_euler
from quadlog.messages import Odometry, UwbRanges
from quadlog.pipelines.simulation.synthesize import write_recording
from quadlog.simulation.synthetic.recording import START_NS, SynthesizedMessage
from quadlog.storage.formats.tum import read_tum

TABLE = '[[uwb.tags]]\nid = {}\nrole = "robot"\nx_m = {}\ny_m = {}\n'


@pytest.mark.nightly  # walks in a circle hold the same against known places
def test_the_trolley_finds_its_anchors(lias_site, tmp_path, quadlog):
    """Motion capture as odometry, three tags. Measured 0.08 m from the places that its authors surveyed."""
    lias = lias_site.folder
    tags = "".join(TABLE.format(i, *at) for i, at in enumerate(lias_site.levers_m[:, :2].tolist()))
    config = f'[topics]\nposition = "/mocap/trolley/pose"\n[uwb]\ntag_height_m = 0.97\n{tags}'
    (tmp_path / "c.toml").write_text(config)
    output = tmp_path / "anchors.toml"
    arguments = ["survey", lias / "lias_fast.mcap", "-c", tmp_path / "c.toml", "-o", output, "--json"]
    done = quadlog(*arguments)
    assert done.code == 0, done.err
    found = json.loads(done.out)
    rows = found["anchors"]
    place_m, bound_m = (
        np.array([[row[f"{axis}{end}"] for axis in "xy"] for row in rows]) for end in ("_m", "_bound_m")
    )
    first = read_tum(lias / "lias_fast_mocap.tum")
    yaw = 2 * np.arctan2(first.quat_xyzw[0, 2], first.quat_xyzw[0, 3])
    off = (lias_site.anchors_m[:, :2] - first.position_m[0, :2]) @ [1, 1j] * np.exp(-1j * yaw)
    error_m = place_m - np.column_stack([off.real, off.imag])
    assert np.median(np.hypot(*error_m.T)) <= 0.12
    assert np.mean(np.abs(error_m) <= bound_m) >= 0.85
    assert [each.id for each in load_config(output).uwb.anchors] == list(range(8))
    assert "--force" in quadlog(*arguments).err


def test_without_ranges_or_odometry_it_says_what_is_missing(lias_site, refused):
    lias, datasets = lias_site.folder, lias_site.folder.parent
    assert "no topic is fit to be the uwb" in refused(1, "survey", datasets / "odometry" / "jackal_odom_imu.bag")
    assert "the recording has ranges, but no odometry" in refused(1, "survey", lias / "lias_fast.mcap")


ANCHORS_M = np.array([[-3.0, -2.0, 1.6], [9.0, -1.0, 1.8], [8.0, 8.0, 1.5], [-2.0, 7.0, 1.7]])
CIRCLE_M = 3.0


@pytest.fixture
def circle(tmp_path):
    """A function that writes 20 s of a walk in a circle with good odometry: ids of its tags, heard in turn."""

    def write(
        anchors_m=ANCHORS_M, tags=(0,), spoiled: float | None = None, radius_m=CIRCLE_M, scale=1.0, late_m=0.0
    ) -> Path:
        rng, messages = np.random.default_rng(0), []
        for step in range(400):
            t_ns, angle = START_NS + step * 50_000_000, 2 * np.pi * step / 350
            place_m = np.array([radius_m * np.sin(angle), radius_m * (1 - np.cos(angle)), 0.0])
            if radius_m == 0:
                place_m, angle = np.array([0.02 * step, 0.0, 0.0]), 0.0
            pose = Odometry(t_ns, "odom", "base", place_m, quat_from_euler(np.array(angle)), np.zeros(3), np.zeros(3))
            range_m = np.linalg.norm(anchors_m - place_m - [0, 0, 0.6], axis=1)
            range_m = scale * range_m + rng.normal(0.1, 0.05, len(anchors_m)) + rng.exponential(late_m, len(anchors_m))
            if spoiled is not None and step % 10 == 0:
                range_m[0] = spoiled
            ranges = UwbRanges(t_ns, tags[step % len(tags)], np.arange(len(anchors_m)), range_m)
            topics = {"/odom": pose, "/nlink_linktrack_tagframe0": ranges}
            messages += [SynthesizedMessage(topic, t_ns, message) for topic, message in topics.items()]
        write_recording(tmp_path / "circle.mcap", iter(messages))
        return tmp_path / "circle.mcap"

    return write


def test_ranges_of_a_wrong_scale_are_not_surveyed_without_a_word(circle, quadlog):
    done = quadlog("survey", circle(scale=1.3))
    assert done.code == 0
    assert "the ranges fit only if the odometry goes 1.29 times" in done.err


def test_a_walk_that_no_range_fits_is_refused(circle, refused):
    error = refused(1, "survey", circle(late_m=3.0))
    assert "the ranges do not fit the walk" in error
    assert "count as NLOS wherever the anchors are placed" in error


KNOWN = "[[uwb.anchors]]\nid = {}\nx_m = {}\ny_m = {}\nz_m = {}\n"


def test_what_is_left_out_or_not_enough_is_said(circle, quadlog):
    done = quadlog("survey", circle(ANCHORS_M[:2]), "--json")
    rows = json.loads(done.out)["anchors"]
    assert (done.code, [row["observed"] for row in rows]) == (0, [True, True])
    assert "fewer than three anchors are surveyed: that is not enough for positions" in done.err
    np.testing.assert_allclose([[row["x_m"], row["y_m"]] for row in rows], ANCHORS_M[:2, :2], atol=0.3)
    done = quadlog("survey", circle(spoiled=np.nan, tags=(0, *[0] * 200, *range(1, 200))))
    assert done.code == 0
    assert "ranges that are NaN, infinite or outside" in done.err
    assert "tag 0 is taken to be the robot's, 199 other tags are not used" in done.err
    assert [line.split()[0] for line in done.out.splitlines()[:2]] == ["anchor", "0"]


def test_a_straight_line_and_too_many_tags_are_refused(tmp_path, circle, refused):
    (tmp_path / "c.toml").write_text("".join(TABLE.format(tag, 0.0, 0.0) for tag in range(200)))
    recording = circle(np.vstack([ANCHORS_M, ANCHORS_M + 1]), tags=range(200))
    assert "1600 exceeds the limit of 1024" in refused(1, "survey", recording, "-c", tmp_path / "c.toml")
    assert "straight line" in refused(1, "survey", circle(radius_m=0))
    for height in ("high", "=2", "nan", "0=inf"):
        assert "--anchor-height" in refused(2, "survey", recording, "--anchor-height", height)


@pytest.mark.parametrize(
    ("known", "as_configured", "changed", "why"),
    [
        ([0, 1], [0, 1], [1, 1, 1], ""),
        ([0, 1, 2, 3, 7, 8], [7, 8], [1, 1, 1], ""),
        ([0, 7], [0, 7], [1, 1, 1], ""),
        ([0, 1, 2], [], [1, -1, 1], "the odometry turns to the wrong side"),
        ([0, 1, 2], [], [1.5, 1, 1], "correct [[uwb.anchors]]"),
    ],
    ids=["two_known", "all_known_and_some_unheard", "one_known_and_one_unheard", "mirrored", "stretched"],
)
def test_known_anchors_stay_in_a_config_that_loads_unless_they_contradict_the_ranges(
    tmp_path, circle, quadlog, known, as_configured, changed, why
):
    places_m = np.vstack([ANCHORS_M, np.full((5, 3), [4.0, 20.0, 2.0])]) * changed
    (tmp_path / "c.toml").write_text("".join(KNOWN.format(index, *places_m[index]) for index in known))
    done = quadlog("survey", circle(), "-c", tmp_path / "c.toml", "-o", tmp_path / "anchors.toml")
    assert done.code == (1 if why else 0), done.err
    if why:
        assert "survey: known anchors contradict the ranges: " in done.err
        assert (why in done.err, (tmp_path / "anchors.toml").exists()) == (True, False)
        return
    anchors = {each.id: (each.x_m, each.y_m, each.z_m) for each in load_config(tmp_path / "anchors.toml").uwb.anchors}
    assert sorted(anchors) == sorted({0, 1, 2, 3, *known})
    assert [each for each in known if anchors[each] == tuple(places_m[each])] == as_configured
    assert ("stay in their configured frame" in done.err) == (len({0, 1, 2, 3} & {*known}) < 2)
