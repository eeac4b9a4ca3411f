"""What `info` tells of UWB, on the committed recording and on a real one."""

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
from quadlog.positioning.fix.dilution import dilution_at


@pytest.fixture(scope="module")
def follow(fixtures: Path) -> dict[str, Any]:
    config = load_config(fixtures / "follow.toml", environ={})
    return describe_recording(fixtures / "follow.mcap", config)


@pytest.fixture(scope="module")
def trolley(lias: Any) -> dict[str, Any]:
    return describe_recording(lias.folder / "lias_fast.mcap", lias.config(robot=0))


def test_it_is_plain_json(follow: dict[str, Any]) -> None:
    found = {name: follow[name] for name in ("uwb", "uwb_tags", "dilution")}
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
        assert "30% is needed" in tag["calibration"]
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


def test_the_map_is_small_and_holds_what_the_anchors_say(follow: dict[str, Any], fixtures: Path) -> None:
    dilution = follow["dilution"]
    hdop = np.array(dilution["hdop"], float)
    assert hdop.shape[0] <= 8
    assert 6 <= hdop.shape[1] <= 12
    anchors = load_config(fixtures / "follow.toml", environ={}).uwb.anchors
    anchors_m = np.array([(each.x_m, each.y_m, each.z_m) for each in anchors])
    centre_m = np.array([dilution["origin_x_m"], dilution["origin_y_m"]]) + np.array([2.5, 3.5]) * dilution["cell_m"]
    assert_allclose(dilution_at(centre_m[None], anchors_m, 0.6), hdop[3, 2])


def test_without_anchors_there_is_nothing_of_it(fixtures: Path) -> None:
    info = describe_recording(fixtures / "follow.mcap", Config())
    assert (info["uwb"], info["uwb_tags"], info["dilution"]) == ([], [], None)


def test_what_cannot_be_located_is_said(fixtures: Path) -> None:
    anchors = [{"id": i, "x_m": float(i), "y_m": 0.0, "z_m": 1.0} for i in range(2)]
    info = describe_recording(fixtures / "follow.mcap", Config.model_validate({"uwb": {"anchors": anchors}}))
    assert (info["uwb"], info["uwb_tags"], info["dilution"]) == ([], [], None)
    assert any("needs three" in line for line in info["warnings"])


def test_real_tags_are_as_good_as_the_reference_says(trolley: dict[str, Any]) -> None:
    """The three tags ride on one trolley, each at its own place; an independent Gauss-Newton got .084 .077 .071 m."""
    tags = trolley["uwb_tags"]
    assert [tag["reference"] for tag in tags] == ["/mocap/trolley/pose"] * 3
    assert (np.array([tag["fix_error"]["rmse_m"] for tag in tags]) <= [0.086, 0.082, 0.075]).all()
    assert (np.array([tag["track_error"]["rmse_m"] for tag in tags]) <= [0.067, 0.059, 0.050]).all()
    for tag in tags:
        assert tag["fix_error"]["share_in_ellipse"] > 0.9
        assert np.hypot(tag["fix_error"]["bias_x_m"], tag["fix_error"]["bias_y_m"]) < 0.02
        assert tag["hdop_median"] == pytest.approx(0.71, abs=0.01)


def test_real_links_are_all_corrected(trolley: dict[str, Any]) -> None:
    assert len(trolley["uwb"]) == 24
    assert all(row["bias_applied"] for row in trolley["uwb"])
    assert all(0.05 < row["bias_m"] < 0.35 for row in trolley["uwb"])
    assert max(row["nlos_share"] for row in trolley["uwb"]) < 0.03
    assert any("145 of 17234 stamps" in line for line in trolley["warnings"])


def test_the_lever_arms_matter(lias: Any, trolley: dict[str, Any]) -> None:
    """With the tags taken for the trolley's middle, a fix would be off by the lever itself."""
    for tag, lever_m in zip(trolley["uwb_tags"], lias.levers_m, strict=True):
        assert tag["track_error"]["rmse_m"] < 0.5 * np.hypot(*lever_m)


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
