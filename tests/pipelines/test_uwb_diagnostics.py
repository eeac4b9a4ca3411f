"""What `info` says about UWB, on the committed recording; its links and errors are those of a replay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.pipelines.info import describe_recording
from quadlog.pipelines.request import ReplayOutcome
from quadlog.results.tables import read_table


@pytest.fixture(scope="module")
def follow(fixtures: Path) -> dict[str, Any]:
    config = load_config(fixtures / "follow.toml", environ={})
    return describe_recording(fixtures / "follow.mcap", config)


def test_links_and_errors_are_those_of_a_replay(follow: dict[str, Any], whole_run: ReplayOutcome) -> None:
    """Of the person's tag, and of the robot's fixes: its track is steadied by odometry in a replay alone."""
    links = read_table(whole_run.run, "links")
    rows, person = [row for row in follow["uwb"] if row["tag"] == 1], links["tag"] == 1
    assert len(follow["uwb"]) == len(person)
    same = {"residual_m": "residual_rms_m"} | {name: name for name in ("bias_m", "bias_std_m", "bias_applied", "n")}
    for info, saved in (same | {"nlos_share": "nlos_share"}).items():
        assert_allclose([float(row[info]) for row in rows], links[saved][person].astype(float), err_msg=info)
    errors, told = read_table(whole_run.run, "uwb_errors"), follow["uwb_tags"][0]["fix_error"]
    fixes = errors["source"] == "fixes"
    error_m = np.column_stack([errors["error_x_m"][fixes], errors["error_y_m"][fixes]])
    length_m = np.hypot(*error_m.T)
    assert told["n"] == len(error_m)
    assert_allclose([told["bias_x_m"], told["bias_y_m"]], error_m.mean(axis=0))
    assert told["rmse_m"] == pytest.approx(np.sqrt(np.mean(length_m**2)))
    assert told["share_in_ellipse"] == pytest.approx(np.mean(length_m <= errors["bound_m"][fixes]))


def test_it_is_plain_json(follow: dict[str, Any]) -> None:
    found = {name: follow[name] for name in ("uwb", "uwb_tags")}
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_every_link_says_whether_its_bias_is_applied_or_why_not(follow: dict[str, Any]) -> None:
    rows = follow["uwb"]
    assert [(row["tag"], row["anchor"]) for row in rows] == [(tag, anchor) for tag in (0, 1) for anchor in range(4)]
    for row in rows:
        assert row["bias_m"] is not None
        assert row["bias_applied"] == (row["why_not"] == "")
        assert abs(row["residual_median_m"]) <= row["residual_m"]
        assert 0 <= row["nlos_share"] < 0.5
        assert row["weak_first_path_share"] is None
    # Twelve seconds among walls: positions without one of the links agree much better with the biases.
    assert all(row["bias_applied"] for row in rows)
    for tag in follow["uwb_tags"]:
        assert "the ranges favour a bias of each link" in tag["calibration"]
        assert 0.3 < tag["nis"] < 3


def test_only_the_robots_tag_is_compared_with_the_robots_truth(follow: dict[str, Any]) -> None:
    robot, person = follow["uwb_tags"]
    assert (robot["role"], person["role"]) == ("robot", "person")
    assert (robot["height_m"], person["height_m"]) == (0.6, 1.3)
    assert (person["reference"], person["fix_error"], person["track_error"]) == (None, None, None)
    assert robot["reference"] == "/truth/robot/pose"
    assert robot["track_error"]["rmse_m"] < robot["fix_error"]["rmse_m"]
    assert robot["fixes"] + robot["too_few_ranges"] + robot["degenerate"] == robot["epochs"] == 600
    assert robot["too_few_ranges"] == 2


def test_ellipse_and_hdop_tell_one_story(follow: dict[str, Any]) -> None:
    """For a fix with covariance C, trace(C) is (HDOP std)^2; the 95 % semi-axes are sqrt(5.991) times its roots."""
    robot = follow["uwb_tags"][0]
    from_axes = np.hypot(robot["ellipse_major_median_m"], robot["ellipse_minor_median_m"]) / np.sqrt(5.991)
    assert from_axes == pytest.approx(0.1 * robot["hdop_median"], rel=0.02)


def test_without_anchors_there_is_nothing_of_it(fixtures: Path) -> None:
    info = describe_recording(fixtures / "follow.mcap", Config())
    assert (info["uwb"], info["uwb_tags"]) == ([], [])


def test_what_cannot_be_located_is_said(fixtures: Path) -> None:
    anchors = [{"id": i, "x_m": float(i), "y_m": 0.0, "z_m": 1.0} for i in range(2)]
    info = describe_recording(fixtures / "follow.mcap", Config.model_validate({"uwb": {"anchors": anchors}}))
    assert (info["uwb"], info["uwb_tags"]) == ([], [])
    assert any("needs three" in line for line in info["warnings"])


def test_swapped_anchors_are_told_by_info(fixtures: Path) -> None:
    config = load_config(fixtures / "follow.toml", environ={})
    first, second, *others = config.uwb.anchors
    exchanged = [first.model_copy(update={"id": second.id}), second.model_copy(update={"id": first.id}), *others]
    told = []
    for anchors in (config.uwb.anchors, exchanged):
        uwb = config.uwb.model_copy(update={"anchors": anchors})
        warnings = describe_recording(fixtures / "follow.mcap", config.model_copy(update={"uwb": uwb}))["warnings"]
        told.append([each for each in warnings if "swapped" in each])
    assert told == [[], [f"anchors {second.id} and {first.id} seem to be swapped in [[uwb.anchors]]"]]
